"""A trained network with all that it takes to use it, in one small file.

The file is read with `weights_only`: it holds tensors and plain values, and no code is run.
"""

import dataclasses
import io
import json
import pickle
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from pipeline.bop.json_files import read_bytes, write_atomically
from pipeline.epos.config import Precision
from pipeline.epos.fragments import Fragments
from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork
from pipeline.epos.prediction import SeenImage, see
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.scene import Image, Model

FORMAT = "pose-inspector epos network"
VERSION = 1

SHIPPED = Path(__file__).resolve().parents[2] / "assets" / "checkpoints"
"""Folder of networks that come with the program."""

_SAME_SHAPE = 0.01
"""Largest difference of bounding boxes, in their diagonals, of models that count as the same object."""


@dataclass(frozen=True, eq=False)
class TrainedObject:
    """An object that a network knows."""

    obj_id: int
    fragments: Fragments
    bounds: Float[np.ndarray, "2 3"]
    """Least and largest coordinates of the model, metres: by them it is noticed when another object has the same id."""

    @classmethod
    def of(cls, model: Model, fragments: Fragments) -> "TrainedObject":
        """The object of a model that was split."""
        return cls(model.obj_id, fragments, model_bounds(model))


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network and its objects, in the order of its outputs."""

    network: EposNetwork
    objects: tuple[TrainedObject, ...]
    origin: str = ""
    """How it was trained, for people."""

    @property
    def obj_ids(self) -> tuple[int, ...]:
        """Ids of the objects, in the order of the outputs."""
        return tuple(known.obj_id for known in self.objects)

    def position(self, obj_id: int) -> int:
        """Place of an object in the outputs. Raises UnknownIdError."""
        if obj_id not in self.obj_ids:
            raise UnknownIdError("object", obj_id, "the objects that the network was trained on", self.obj_ids)
        return self.obj_ids.index(obj_id)

    def see(self, image: Image, precision: Precision = "float32") -> SeenImage:
        """Run the network on an image that has colours; raises as `prediction.see`."""
        assert image.rgb is not None
        return see(self.network, image.rgb, precision)

    def check_model(self, model: Model) -> None:
        """Raise UnknownIdError for an object that is not known, InputError if its shape is another than in training."""
        bounds = model_bounds(model)
        known = self.objects[self.position(model.obj_id)].bounds
        if np.abs(bounds - known).max() > _SAME_SHAPE * np.linalg.norm(known[1] - known[0]):
            sides = [" x ".join(f"{1000 * side:.1f}" for side in box[1] - box[0]) for box in (bounds, known)]
            raise InputError(
                f"object {model.obj_id}: its model ({sides[0]} mm) is not the one that the network was trained on "
                f"({sides[1]} mm, or placed otherwise); give the checkpoint of this dataset"
            )


def model_bounds(model: Model) -> Float[np.ndarray, "2 3"]:
    """Least and largest coordinates of a model, metres."""
    return np.stack([model.vertices.min(axis=0), model.vertices.max(axis=0)]).astype(np.float64)


def save_network(path: Path, trained: TrainedNetwork) -> None:
    """Write a network; other processes never see half a file. Raises InputError if it cannot be written."""
    objects = [
        {
            "obj_id": known.obj_id,
            "centers": torch.from_numpy(np.array(known.fragments.centers)),
            "sizes": torch.from_numpy(np.array(known.fragments.sizes)),
            "bounds": torch.from_numpy(known.bounds),
        }
        for known in trained.objects
    ]
    weights = {name: tensor.cpu() for name, tensor in trained.network.state_dict().items()}
    config = json.dumps(dataclasses.asdict(trained.network.config))
    write_tensors(path, {"config": config, "objects": objects, "weights": weights, "origin": trained.origin})


def shipped_checkpoint() -> Path:
    """The network that comes with the program. Raises InputError where there is none, or more than one."""
    found = sorted(SHIPPED.glob("*.pt"))
    if not found:
        raise InputError(
            "epos: no network comes with this; train one (inspector train epos) and give it by --checkpoint"
        )
    if len(found) > 1:
        raise InputError(f"epos: {', '.join(path.name for path in found)} come with this; give one by --checkpoint")
    return found[0]


def load_network(path: Path, device: torch.device | str = "cpu") -> TrainedNetwork:
    """Read a network, ready to be used. Raises MissingFileError or FormatError."""
    content = read_tensors(path)
    try:
        objects = tuple(
            TrainedObject(
                known["obj_id"],
                Fragments(known["centers"].numpy(), known["sizes"].numpy()),
                known["bounds"].numpy(),
            )
            for known in content["objects"]
        )
        values = json.loads(content["config"])
        config = NetworkConfig(**{**values, "atrous_rates": tuple(values["atrous_rates"])})
        network = EposNetwork(config, [len(known.fragments) for known in objects])
        network.load_state_dict(content["weights"])
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise FormatError(f"{path}: its parts do not fit together; train the network again") from error
    network.move(device).eval().requires_grad_(False)
    return TrainedNetwork(network, objects, content.get("origin", ""))


def write_tensors(path: Path, content: dict[str, Any]) -> None:
    """Write tensors and plain values, whole or not at all."""
    file = io.BytesIO()
    torch.save({"format": FORMAT, "version": VERSION, **content}, file)
    write_atomically(path, file.getvalue())


def read_tensors(path: Path) -> dict[str, Any]:
    """Read what `write_tensors` wrote, on the CPU. Raises MissingFileError or FormatError."""
    data = read_bytes(path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as parts:  # torch checks neither
            damaged = parts.testzip()
        content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (RuntimeError, ValueError, EOFError, KeyError, pickle.UnpicklingError, zipfile.BadZipFile) as error:
        raise FormatError(
            f"{path}: is no readable network of EPOS ({len(data)} bytes); get or train it again"
        ) from error
    if damaged is not None:
        raise FormatError(f"{path}: {damaged} in it is damaged; get or train it again")
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FormatError(f"{path}: holds no network of EPOS; give the network.pt that training wrote")
    if content.get("version") != VERSION:
        raise FormatError(
            f"{path}: is of version {content.get('version')}, this program reads {VERSION}; train it again"
        )
    return content
