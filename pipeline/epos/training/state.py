"""All that it takes to go on with training as if it had never stopped."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32

from pipeline.epos.checkpoint import load_network, read_tensors, write_tensors
from pipeline.epos.networks.network import EposNetwork
from pipeline.exceptions import FormatError, InputError

STATE_FILE = "state.pt"
NETWORK_FILE = "network.pt"


def save_state(
    path: Path,
    network: EposNetwork,
    optimizer: torch.optim.Optimizer,
    losses: Float32[np.ndarray, "s 4"],
    device: torch.device,
) -> None:
    """Write the state after some steps, whole or not at all: weights, optimizer, generators, losses of all steps.

    A process that is killed at any moment leaves the state before or this one. Raises InputError if it cannot be
    written.
    """
    generators = {"cpu": torch.get_rng_state()}
    if device.type == "cuda":
        generators["cuda"] = torch.cuda.get_rng_state(device)
    write_tensors(
        path,
        {
            "network": network.state_dict(),
            "optimizer": optimizer.state_dict(),
            "generators": generators,
            "losses": torch.from_numpy(losses),
        },
    )


def load_state(
    path: Path, network: EposNetwork, optimizer: torch.optim.Optimizer, device: torch.device
) -> Float32[np.ndarray, "s 4"]:
    """Restore weights, optimizer and generators; returns the losses of the steps done.

    Raises:
        FormatError: the file is damaged, or of a network of another shape.

    """
    content: dict[str, Any] = read_tensors(path)
    try:
        network.load_state_dict(content["network"])
        optimizer.load_state_dict(content["optimizer"])
        torch.set_rng_state(content["generators"]["cpu"])
        if device.type == "cuda" and "cuda" in content["generators"]:
            torch.cuda.set_rng_state(content["generators"]["cuda"], device)
        return content["losses"].numpy()
    except (KeyError, RuntimeError, ValueError, TypeError) as error:
        raise FormatError(f"{path}: is not the state of this training; give another folder, or delete it") from error


def take_weights(path: Path, network: EposNetwork) -> None:
    """Copy backbone, pyramid and decoder of a trained network, and the heads if they are for as many fragments.

    Raises:
        InputError: the file cannot be read, or the architecture is another.

    """
    ours, trained = network.config, load_network(path).network
    theirs = trained.config
    if (theirs.backbone, theirs.norm) != (ours.backbone, ours.norm):
        raise InputError(
            f"{path}: has backbone {theirs.backbone} with {theirs.norm} norm, not {ours.backbone} with {ours.norm} norm; "
            "give the same network settings"
        )
    same_heads = trained.fragment_counts == network.fragment_counts
    weights = {name: w for name, w in trained.state_dict().items() if same_heads or "_head" not in name}
    network.load_state_dict(weights, strict=False)
