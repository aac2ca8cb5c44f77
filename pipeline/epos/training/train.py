"""Training from beginning to end, or on from where it stopped."""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float32

from pipeline.epos.checkpoint import TrainedNetwork, save_network
from pipeline.epos.networks.network import EposNetwork, chosen_device
from pipeline.epos.prediction import reduced_precision
from pipeline.epos.training.config import OptimizationConfig, TrainConfig
from pipeline.epos.training.loss import epos_loss
from pipeline.epos.training.preparing import Prepared, prepare
from pipeline.epos.training.samples import Batch, batches
from pipeline.epos.training.state import NETWORK_FILE, STATE_FILE, load_state, save_state, take_weights
from pipeline.epos.training.watching import record_progress, sample_keys
from pipeline.exceptions import InputError
from pipeline.run import Run


class Progress(NamedTuple):
    """Where training is."""

    step: int
    """Steps done."""
    steps: int
    loss: tuple[float, float, float, float]
    """Of the last step: total, objects, fragments, coordinates; weighted, per cell."""
    seconds: float
    """Since this process began training."""


def train(config: TrainConfig, progress: Callable[[Progress], None] = lambda _: None) -> Path:
    """Train a network, and return the file with it.

    In `config.out` lie the network (`network.pt`), the state to go on from (`state.pt`), and recordings as in a run. Both
    are written every `checkpoint_every` steps, and when `progress` raises, which is how to stop; the same config goes on
    there, and on a CPU the weights come out the same to the bit as without the stop.

    Raises:
        InputError: the dataset, the split or an object is not there, an image cannot be used, the folder holds another
            training, the loss is not finite.

    """
    device = chosen_device(config.device)
    prepared = prepare(config)
    with (
        Run.create(
            config.out, dataset=prepared.dataset, method="epos-training", config=_plain(config), seed=config.seed
        ) as run,
        _threads_beside(config.workers),
    ):
        return _Training(config, prepared, run, device).run(progress)


@contextmanager
def _threads_beside(workers: int) -> Iterator[None]:
    """Leave a core to each worker: threads of torch that share one wait for each other most of the time."""
    before = torch.get_num_threads()
    torch.set_num_threads(max(1, min(before, len(os.sched_getaffinity(0)) - workers)))
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Training:
    """One training in this process."""

    def __init__(self, config: TrainConfig, prepared: Prepared, run: Run, device: torch.device) -> None:
        self.config, self.prepared, self._run, self.device = config, prepared, run, device
        torch.manual_seed(config.seed)
        self.network = EposNetwork(config.network, [len(known.fragments) for known in prepared.objects])
        if config.start_from is not None:
            take_weights(config.start_from, self.network)
        self.network.freeze(config.freeze)
        self.network.move(device).train()
        self.optimizer = make_optimizer(self.network, config.optimization)
        self.losses = np.zeros((config.steps, 4), np.float32)
        self.done = 0
        path = config.out / STATE_FILE
        if path.exists():
            losses = load_state(path, self.network, self.optimizer, device)
            self.done = len(losses)
            self.losses[: self.done] = losses
        self.keys = sample_keys(prepared.dataset, config.sample_images)

    def run(self, progress: Callable[[Progress], None]) -> Path:
        """All steps that are left."""
        config, begun = self.config, perf_counter()
        for batch in batches(self.prepared.samples, config.batch, self.done, config.steps, config.workers, self.device):
            loss = self._step(batch)
            self.losses[self.done] = loss
            self.done += 1
            saved = self.done % config.checkpoint_every == 0 or self.done == config.steps
            if saved:
                self._save()
            try:
                if self.done % config.record_every == 0 or self.done == config.steps:
                    self._record()
                progress(Progress(self.done, config.steps, _four(loss), perf_counter() - begun))
            except BaseException:  # between two steps all is whole; inside one it is not
                if not saved:
                    self._save()
                raise
        if not (config.out / NETWORK_FILE).exists():
            self._save()
        return config.out / NETWORK_FILE

    def _step(self, batch: Batch) -> Float32[np.ndarray, "4"]:
        config = self.config
        loss = training_step(self.network, self.optimizer, batch.to(self.device), config, rate_at(self.done, config))
        if not np.isfinite(loss).all():
            raise InputError(
                f"{config.out}: the loss is not finite at step {self.done + 1}; the last checkpoint is kept; "
                "train with a smaller learning rate"
            )
        return loss

    def _trained(self, origin: str = "") -> TrainedNetwork:
        return TrainedNetwork(self.network, self.prepared.trained_objects, origin)

    def _save(self) -> None:
        story = json.dumps({"steps_done": self.done, **_plain(self.config)}, default=str)
        save_network(self.config.out / NETWORK_FILE, self._trained(story))
        state = self.config.out / STATE_FILE
        save_state(state, self.network, self.optimizer, self.losses[: self.done], self.device)

    def _record(self) -> None:
        if not self.keys:
            return
        generator = torch.get_rng_state()
        self.network.eval()
        record_progress(self._run, self.prepared, self.keys, self._trained(), self.losses[: self.done])
        self.network.train()
        torch.set_rng_state(generator)


def training_step(
    network: EposNetwork, optimizer: torch.optim.Optimizer, batch: Batch, config: TrainConfig, rate: float
) -> Float32[np.ndarray, "4"]:
    """Change the weights once; returns the loss before: total, objects, fragments, coordinates.

    Where the loss is not finite nothing is changed.
    """
    tuned = config.optimization
    for group in optimizer.param_groups:
        group["lr"] = rate
    optimizer.zero_grad(set_to_none=True)
    with reduced_precision(batch.images.device, config.precision):
        features = network.features(batch.images)
    loss = epos_loss(network, features.float(), batch.targets, config.loss)
    values = torch.stack(list(loss)).detach().cpu().numpy()
    if np.isfinite(values).all():
        loss.total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), tuned.max_gradient_norm)
        optimizer.step()
    return values


def make_optimizer(network: EposNetwork, config: OptimizationConfig) -> torch.optim.AdamW:
    """AdamW over what is not frozen; weights of layers decay, biases and normalizations do not."""
    parameters = [p for p in network.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in parameters if p.ndim > 1], "weight_decay": config.weight_decay},
        {"params": [p for p in parameters if p.ndim <= 1], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=config.learning_rate)


def rate_at(step: int, config: TrainConfig) -> float:
    """Learning rate of a step, counted from 0: a linear warm-up, then the polynomial decay of DeepLab."""
    tuned = config.optimization
    warm = min((step + 1) / max(tuned.warm_up_steps, 1), 1.0)
    return tuned.learning_rate * warm * (1.0 - step / config.steps) ** 0.9


def _four(loss: Float32[np.ndarray, "4"]) -> tuple[float, float, float, float]:
    total, objects, fragments, coordinates = loss.tolist()
    return total, objects, fragments, coordinates


def _plain(config: TrainConfig) -> dict[str, object]:
    """What must not change when training goes on, as JSON can hold it."""
    whole = asdict(config)
    return json.loads(json.dumps({name: whole[name] for name in config.remembered}, default=str))
