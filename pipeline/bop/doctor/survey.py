"""What the checks look at: a dataset's files read once, faults kept as text, and samples of what is large.

Nothing is written, and a broken file never ends the survey: what cannot be read is None or a text in `damage`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from pipeline.bop import layout
from pipeline.bop.annotations import SceneCameras, SceneGroundTruth, read_cameras, read_ground_truth
from pipeline.bop.doctor.findings import some
from pipeline.bop.facts import DatasetFacts, dataset_facts
from pipeline.bop.images import image_size, read_depth
from pipeline.bop.json_files import read_json_object
from pipeline.bop.models import read_model, read_models_info
from pipeline.exceptions import InputError
from pipeline.rendering import SceneRendering, render_scene
from pipeline.scene import Camera, GroundTruth, Model

T = TypeVar("T")


@dataclass(frozen=True)
class Effort:
    """How many things of each kind are looked at; None: all."""

    scenes: int | None = 12
    image_files: int | None = 600
    rendered_images: int | None = 8
    models: int | None = 40
    whole_files: bool = False
    """Whether image files are read to their end and their checksums verified, or only their first and last bytes."""


THOROUGH = Effort(None, None, None, None, whole_files=True)


@dataclass(frozen=True, eq=False)
class SceneSurvey:
    """One scene."""

    scene_id: int
    layout: layout.SceneLayout
    cameras: SceneCameras
    ground_truth: SceneGroundTruth | None
    images: dict[int, Path]
    depths: dict[int, Path]

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the first image (or depth image); None if it cannot be read."""
        return size_of(next(iter([*self.images.values(), *self.depths.values()]), None))

    def annotated(self) -> list[int]:
        """Images that have an undamaged camera and at least one annotation."""
        spans = self.ground_truth.spans if self.ground_truth else {}
        return [im_id for im_id, span in spans.items() if span.stop > span.start and im_id in self.cameras.rows]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A model file."""

    path: Path
    obj_id: int
    model: Model | None
    """In metres, its diameter that of the mesh; None if the file cannot be read."""
    problem: str = ""

    @property
    def diameter_mm(self) -> float:
        """Largest distance of two vertices as the file has it, taken as millimetres; NaN if it cannot be read."""
        return self.model.diameter * 1000.0 if self.model else float("nan")


@dataclass(frozen=True, eq=False)
class View:
    """An annotated image, and what its ground truth would look like."""

    scene: SceneSurvey
    im_id: int
    camera: Camera
    instances: tuple[tuple[GroundTruth, Model], ...]
    depth: Float[np.ndarray, "h w"] | None
    """Measured, metres; None where there is none."""
    rendering: SceneRendering
    """Pixels at integer coordinates, as the camera has them; instance ids are positions in `instances`."""

    def measured_and_rendered(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Depths at the pixels where an instance is the nearest of all annotated ones and something was measured."""
        assert self.depth is not None
        pixels = (self.rendering.instance_ids == index) & (self.depth > 0)
        return self.depth[pixels].astype(float), self.rendering.depth[pixels].astype(float)


class Survey:
    """A split of a dataset, opened for the doctor."""

    def __init__(self, root: Path, split: str | None, effort: Effort, results: Sequence[Path] = ()) -> None:
        self.root = root
        self.effort = effort
        self.results = tuple(results)
        self.facts: DatasetFacts = dataset_facts(root.resolve().name)
        self.split = layout.choose_split(root, split, self.facts)
        self._folders = layout.scene_folders(root / self.split)

    @property
    def scene_ids(self) -> tuple[int, ...]:
        """All scenes of the split, also those that are not looked at."""
        return tuple(sorted(self._folders))

    @cached_property
    def scenes(self) -> tuple[SceneSurvey, ...]:
        """The scenes that are looked at."""
        return tuple(self._scene(scene_id) for scene_id in spread(self.scene_ids, self.effort.scenes))

    def _scene(self, scene_id: int) -> SceneSurvey:
        folder = self._folders[scene_id]
        scene = layout.SceneLayout(folder, layout.choose_sensor(folder, None, self.facts.sensors))
        gt_path = scene.json("scene_gt")
        return SceneSurvey(
            scene_id=scene_id,
            layout=scene,
            cameras=read_cameras(scene.json("scene_camera")),
            ground_truth=read_ground_truth(gt_path, scene.json("scene_gt_info")) if gt_path.is_file() else None,
            images=layout.numbered_files(scene.image_folder()),
            depths=layout.numbered_files(scene.depth_folder()),
        )

    @cached_property
    def model_folders(self) -> tuple[Path, ...]:
        """Folders that hold models, the one for evaluation first."""
        folders = layout.model_folders(self.root, (self.facts.eval_models, self.facts.display_models))
        return tuple(folder for folder in folders if layout.model_files(folder))

    @cached_property
    def meshes(self) -> tuple[Mesh, ...]:
        """The models that are looked at, of all folders."""
        files = [item for folder in self.model_folders for item in layout.model_files(folder).items()]
        return tuple(_read_mesh(path, obj_id) for obj_id, path in spread(files, self.effort.models))

    @cached_property
    def model_ids(self) -> frozenset[int]:
        """All objects that have a model file."""
        return frozenset(obj_id for folder in self.model_folders for obj_id in layout.model_files(folder))

    def model(self, obj_id: int) -> Model | None:
        """The model for evaluation; None if there is none that can be read."""
        return self._models(obj_id)

    @cached_property
    def _models(self) -> Callable[[int], Model | None]:
        read = {(mesh.path, mesh.obj_id): mesh.model for mesh in self.meshes}

        @cache
        def find(obj_id: int) -> Model | None:
            paths = [layout.model_files(folder).get(obj_id) for folder in self.model_folders]
            path = next((path for path in paths if path), None)
            if path is None or (path, obj_id) in read:
                return read.get((path, obj_id)) if path else None
            return _read_mesh(path, obj_id).model

        return find

    def diameter(self, obj_id: int) -> float:
        """Diameter of an object in metres, from models_info.json or else its mesh; NaN if neither can be read."""
        for info in self.models_info.values():
            entry = info.get(obj_id, {}) if isinstance(info, dict) else {}
            if isinstance(entry.get("diameter"), int | float):
                return entry["diameter"] / 1000.0
        model = self.model(obj_id)
        return model.diameter if model else float("nan")

    @cached_property
    def models_info(self) -> dict[Path, dict[int, dict[str, Any]] | str]:
        """Entries of each `models_info.json`, or what is wrong with the file."""
        return {path: _or_problem(read_models_info, path) for path in self._info_paths if path.is_file()}

    @property
    def _info_paths(self) -> list[Path]:
        return [folder / "models_info.json" for folder in self.model_folders]

    @cached_property
    def camera_json(self) -> dict[str, Any] | str:
        """The dataset's `camera.json` or what is wrong with it; empty where there is none."""
        path = self.root / "camera.json"
        return _or_problem(read_json_object, path) if path.exists() else {}

    @cached_property
    def views(self) -> tuple[View, ...]:
        """A sample of annotated images with their ground truth rendered, of those with depth if there are any."""
        annotated = [(scene, im_id) for scene in self.scenes for im_id in scene.annotated()]
        with_depth = [(scene, im_id) for scene, im_id in annotated if im_id in scene.depths]
        with_image = [(scene, im_id) for scene, im_id in annotated if im_id in scene.images]
        sample = spread(with_depth or with_image, self.effort.rendered_images)
        return tuple(view for scene, im_id in sample if (view := self._view(scene, im_id)))

    def _view(self, scene: SceneSurvey, im_id: int) -> View | None:
        depth = self.depth(scene, im_id)
        size = size_of(scene.images.get(im_id) or scene.depths.get(im_id))
        if size is None or (depth is not None and depth.shape != size[::-1]):
            return None
        camera = Camera(scene.cameras.K[scene.cameras.row(im_id)], *size)
        assert scene.ground_truth is not None
        found = [(gt, self.model(gt.obj_id)) for gt in scene.ground_truth.of_image(im_id)]
        instances = tuple((gt, model) for gt, model in found if model)
        poses = [(model, gt.camera_from_model) for gt, model in instances]
        return View(scene, im_id, camera, instances, depth, render_scene(poses, camera, pixel_center=0.0))

    def depth(self, scene: SceneSurvey, im_id: int) -> Float[np.ndarray, "h w"] | None:
        """Measured depth in metres; None if there is none, it cannot be read, or has the 8 bits of a picture."""
        path = scene.depths.get(im_id)
        if path is None or bits_of_png(path) == 8 or im_id not in scene.cameras.rows:
            return None
        depth = _or_problem(lambda p: read_depth(p, scene.cameras.depth_scale_mm[scene.cameras.row(im_id)]), path)
        return None if isinstance(depth, str) else depth

    def sampled_files(self) -> Iterator[tuple[SceneSurvey, int, Path | None, Path | None]]:
        """Image and depth file of a sample of images."""
        items = [(scene, im_id) for scene in self.scenes for im_id in sorted(scene.images.keys() | scene.depths.keys())]
        for scene, im_id in spread(items, self.effort.image_files):
            yield scene, im_id, scene.images.get(im_id), scene.depths.get(im_id)


def spread(items: Sequence[T], limit: int | None) -> list[T]:
    """At most `limit` items, evenly spread over all, always the same ones."""
    if limit is None or len(items) <= limit:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, limit).round().astype(int)]


def size_of(path: Path | None) -> tuple[int, int] | None:
    """Width and height of an image file; None if it cannot be read."""
    if path is None:
        return None
    try:
        return image_size(path)
    except (InputError, OSError):
        return None


def bits_of_png(path: Path) -> int | None:
    """Bits per channel as a PNG's header says; None for other files."""
    try:
        with path.open("rb") as file:
            head = file.read(26)
    except OSError:
        return None
    return head[24] if head.startswith(b"\x89PNG") and len(head) == 26 else None


def by_scene(im_ids: Mapping[int, Sequence[int]]) -> str:
    """How many images of which scenes, as text."""
    return some([f"scene {scene_id}: {len(found)}, first {found[0]}" for scene_id, found in im_ids.items() if found])


def number_of(im_ids: Mapping[int, Sequence[int]]) -> int:
    """Number of images in all scenes."""
    return sum(map(len, im_ids.values()))


def file_name(path: Path, survey: Survey) -> str:
    """A file as seen from the dataset's folder."""
    return str(path.relative_to(survey.root))


def _read_mesh(path: Path, obj_id: int) -> Mesh:
    try:
        return Mesh(path, obj_id, read_model(path, obj_id, appearance=False))
    except (InputError, OSError) as error:
        return Mesh(path, obj_id, None, str(error))


def _or_problem(read: Callable[[Path], T], path: Path) -> T | str:
    try:
        return read(path)
    except (InputError, OSError) as error:
        return str(error)
