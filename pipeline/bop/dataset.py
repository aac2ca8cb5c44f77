"""One split of a dataset in the BOP scenewise format: cameras, images, ground truth, masks, models, targets.

Opening reads folder names only; a scene's files are parsed when one of its images is first asked for, and kept.
Several threads may use one Dataset.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.bop import layout
from pipeline.bop.annotations import SceneCameras, SceneGroundTruth, read_cameras, read_ground_truth
from pipeline.bop.facts import DatasetFacts, dataset_facts
from pipeline.bop.images import image_size, read_depth, read_mask, read_rgb
from pipeline.bop.json_files import read_json_object
from pipeline.bop.memo import Memo
from pipeline.bop.model_folders import ModelFolders, ModelKind
from pipeline.bop.targets import read_targets, targets_from_ground_truth
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.scene import Camera, GroundTruth, Image, ImageKey, Model, Target


def open_dataset(root: Path, split: str | None = None, sensor: str | None = None) -> "Dataset":
    """Open a split of a dataset in the BOP scenewise format.

    Without `split` the dataset's official test split is taken, else the first of test*, val*, train*. Without
    `sensor` each scene is seen by the sensor that the dataset prefers (it matters for HOT3D, IPD and the like).
    Raises MissingFileError if there is no such folder or no scene in it, UnknownIdError for an unknown split or sensor.
    """
    root = Path(root)
    facts = dataset_facts(root.resolve().name)
    chosen = layout.choose_split(root, split, facts)
    folders = layout.scene_folders(root / chosen)
    if sensor is not None and not any(sensor in layout.sensors(folder) for folder in folders.values()):
        available = {name for folder in folders.values() for name in layout.sensors(folder)}
        raise UnknownIdError("sensor", sensor, str(root / chosen), available)
    return Dataset(root, chosen, facts, folders, sensor)


def splits(root: Path) -> tuple[str, ...]:
    """Names of the splits of a dataset that hold scenes. Raises MissingFileError if the folder is absent."""
    return layout.splits(Path(root))


class Dataset:
    """A split of a BOP dataset, read lazily; made by `open_dataset`.

    A method that is asked for an image or object that is not there raises UnknownIdError; one that meets a damaged
    file raises FormatError or MissingFileError for that image or scene, and everything else stays usable.
    """

    def __init__(
        self, root: Path, split: str, facts: DatasetFacts, scene_folders: dict[int, Path], sensor: str | None = None
    ) -> None:
        self.root = root
        self.split = split
        """Name of the split's folder, such as `test_primesense`."""
        self.facts = facts
        self.name: str = root.resolve().name
        self.scene_ids: tuple[int, ...] = tuple(sorted(scene_folders))
        self._scene_folders = scene_folders
        self._sensor = sensor
        self.models = ModelFolders(root, facts)
        """Files of the object models."""
        self._memo = Memo()

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to another process it is opened anew there, and reads for itself what it is asked for."""
        folders = {scene_id: folder.absolute() for scene_id, folder in self._scene_folders.items()}
        return Dataset, (self.root.absolute(), self.split, self.facts, folders, self._sensor)

    @property
    def obj_ids(self) -> tuple[int, ...]:
        """Ids of the objects that have a model, or without models those that the dataset is known to have."""
        return self.models.obj_ids or self.facts.obj_ids

    def image_ids(self, scene_id: int) -> tuple[int, ...]:
        """Ids of a scene's images on disk; where there are no image files, those of its `scene_camera.json`."""
        return self._memo.get(("image ids", scene_id), lambda: self._find_image_ids(scene_id))

    def images(self) -> Iterator[ImageKey]:
        """Keys of all images."""
        return (ImageKey(scene_id, im_id) for scene_id in self.scene_ids for im_id in self.image_ids(scene_id))

    def sensor(self, scene_id: int) -> str:
        """Suffix of the sensor by which a scene is seen; empty in the classic layout."""
        return self._layout(scene_id).sensor

    def camera(self, key: ImageKey) -> Camera:
        """Camera of an image. Raises FormatError if its K is missing or damaged."""
        self._check_image(key)
        cameras = self._cameras(key.scene_id)
        row = cameras.row(key.im_id)
        width, height = self._size(key)
        world = cameras.world_from_camera[row]
        return Camera(cameras.K[row], width, height, world if np.isfinite(world).all() else None)

    def has_ground_truth(self, scene_id: int) -> bool:
        """Whether a scene has a file of ground truth, damaged or not."""
        return self._layout(scene_id).json("scene_gt").is_file()

    def ground_truth(self, key: ImageKey) -> tuple[GroundTruth, ...]:
        """Annotated instances of an image; empty where there are none.

        Raises FormatError that names the file, the image, the annotation and the value if one is damaged.
        """
        self._check_image(key)
        return self.scene_ground_truth(key.scene_id).of_image(key.im_id)

    def scene_ground_truth(self, scene_id: int) -> SceneGroundTruth:
        """All annotations of a scene as arrays, empty where it has none; damage is listed inside."""
        return self._memo.get(("ground truth", scene_id), lambda: self._read_ground_truth(scene_id))

    def image(self, key: ImageKey) -> Image:
        """An image with its camera, colour and depth; arrays are read anew each time, so they are the caller's own."""
        return Image(key, self.camera(key), self.rgb(key), self.depth(key))

    def rgb(self, key: ImageKey) -> UInt8[np.ndarray, "h w 3"] | None:
        """Colour (or repeated gray) image, None where there is none."""
        path = self.rgb_path(key)
        return None if path is None else read_rgb(path)

    def depth(self, key: ImageKey) -> Float[np.ndarray, "h w"] | None:
        """Depth as float32 metres, 0 where not measured, None where there is no depth image.

        Raises FormatError if it cannot be read, has 8 bits or another size than the colour image.
        """
        path = self.depth_path(key)
        if path is None:
            return None
        depth = read_depth(path, self.depth_scale_mm(key))
        width, height = self._size(key)
        if depth.shape != (height, width):
            found, wanted = f"{depth.shape[1]} x {depth.shape[0]}", f"{width} x {height}"
            raise FormatError(f"{path}: has {found} pixels, its image {wanted}; register it to the colour image")
        return depth

    def depth_scale_mm(self, key: ImageKey) -> float:
        """Millimetres of one unit of the depth image (BOP `depth_scale`)."""
        self._check_image(key)
        cameras = self._cameras(key.scene_id)
        return float(cameras.depth_scale_mm[cameras.row(key.im_id)])

    def mask(self, key: ImageKey, gt_index: int, visible: bool = True) -> Bool[np.ndarray, "h w"] | None:
        """Visible (or full) silhouette of an annotation, None where the dataset has no mask of it."""
        self._check_image(key)
        path = self._layout(key.scene_id).mask(key.im_id, gt_index, visible)
        return None if path is None else read_mask(path)

    def rgb_path(self, key: ImageKey) -> Path | None:
        """File of the colour or gray image, None where there is none."""
        return self._file(key, self._layout(key.scene_id).image_folder())

    def depth_path(self, key: ImageKey) -> Path | None:
        """File of the depth image, None where there is none."""
        return self._file(key, self._layout(key.scene_id).depth_folder())

    def model(self, obj_id: int, kind: ModelKind = "eval") -> Model:
        """Model of an object: "eval" for errors, "display" with colour; each falls back to what there is.

        The same object is returned each time. Diameter and symmetries come from the models for evaluation.
        """
        return self.models.model(obj_id, kind)

    def targets(self) -> tuple[Target, ...]:
        """What methods are asked for: the list that comes with the split, else visible ground truth, else nothing.

        Only images on disk count, and damaged scenes and images are left out (see `problems`).
        Raises FormatError if the list is damaged; `annotated_targets` are there then.
        """
        return self._memo.get(("targets",), self._find_targets)

    def annotated_targets(self) -> tuple[Target, ...]:
        """The visible ground truth as targets, whatever lists the split has."""
        return tuple(target for scene_id in self.scene_ids for target in self._visible_targets(scene_id))

    def problems(self) -> tuple[InputError, ...]:
        """What is wrong with the JSON files of this split, one error per damaged image or file; reads all of them."""
        found: list[str] = []
        try:
            self.targets()
        except InputError as error:
            found.append(str(error))
        for scene_id in self.scene_ids:
            truth = self.scene_ground_truth(scene_id)
            found += [*self._cameras(scene_id).damage.values(), *truth.damage.values(), *truth.warnings]
            unknown = set(truth.obj_ids.tolist()) - set(self.models.obj_ids)
            if unknown and self.models.obj_ids:
                objects = ", ".join(map(str, sorted(unknown)[:20]))
                found.append(f"{truth.path}: has instances of objects without a model ({objects}); add their models")
        return (*self.models.problems, *map(FormatError, found))

    def _find_targets(self) -> tuple[Target, ...]:
        on_disk = {scene_id: frozenset(self.image_ids(scene_id)) for scene_id in self.scene_ids}
        for path in layout.target_files(self.root, self.split):
            found = read_targets(path, on_disk, lambda key: self._visible_targets(key.scene_id, key))
            if found:
                return found
        return self.annotated_targets()

    def _visible_targets(self, scene_id: int, key: ImageKey | None = None) -> tuple[Target, ...]:
        """Targets from the ground truth of a scene, or of one of its images."""
        found = self._memo.get(
            ("visible targets", scene_id),
            lambda: targets_from_ground_truth(scene_id, self.scene_ground_truth(scene_id), self.image_ids(scene_id)),
        )
        return found if key is None else tuple(target for target in found if target.im_id == key.im_id)

    def _layout(self, scene_id: int) -> layout.SceneLayout:
        return self._memo.get(("layout", scene_id), lambda: self._find_layout(scene_id))

    def _find_layout(self, scene_id: int) -> layout.SceneLayout:
        if scene_id not in self._scene_folders:
            raise UnknownIdError("scene", scene_id, f"{self.name}/{self.split}", self.scene_ids)
        folder = self._scene_folders[scene_id]
        return layout.SceneLayout(folder, layout.choose_sensor(folder, self._sensor, self.facts.sensors))

    def _file(self, key: ImageKey, folder: Path | None) -> Path | None:
        self._check_image(key)
        name = self._names(folder).get(key.im_id)
        return None if folder is None or name is None else folder / name

    def _names(self, folder: Path | None) -> dict[int, str]:
        """Names of the image files in a folder by image id."""
        return {} if folder is None else self._memo.get(("names", folder), lambda: layout.numbered_names(folder))

    def _find_image_ids(self, scene_id: int) -> tuple[int, ...]:
        scene = self._layout(scene_id)
        on_disk = self._names(scene.image_folder()).keys() | self._names(scene.depth_folder()).keys()
        ids = on_disk or self._cameras(scene_id).rows.keys()
        return tuple(sorted(ids))

    def _check_image(self, key: ImageKey) -> None:
        known = self._memo.get(("image set", key.scene_id), lambda: frozenset(self.image_ids(key.scene_id)))
        if key.im_id not in known:
            raise UnknownIdError("image", key.im_id, f"scene {key.scene_id} of {self.name}/{self.split}", known)

    def _cameras(self, scene_id: int) -> SceneCameras:
        scene = self._layout(scene_id)
        return self._memo.get(("cameras", scene_id), lambda: read_cameras(scene.json("scene_camera")))

    def _read_ground_truth(self, scene_id: int) -> SceneGroundTruth:
        scene = self._layout(scene_id)
        return read_ground_truth(scene.json("scene_gt"), scene.json("scene_gt_info"))

    def _size(self, key: ImageKey) -> tuple[int, int]:
        return self._memo.get(("size", key), lambda: self._find_size(key))

    def _find_size(self, key: ImageKey) -> tuple[int, int]:
        """Width and height of an image from its files, else from the dataset's `camera.json`, else from the facts."""
        damage: InputError | None = None
        for path in filter(None, (self.rgb_path(key), self.depth_path(key))):
            try:
                return image_size(path)
            except InputError as error:
                damage = damage or error
        try:
            return self._usual_size()
        except InputError as error:
            raise damage or error from error

    def _usual_size(self) -> tuple[int, int]:
        camera_file = self.root / "camera.json"
        if camera_file.is_file():
            content = read_json_object(camera_file)
            if isinstance(content.get("width"), int) and isinstance(content.get("height"), int):
                return content["width"], content["height"]
        if self.facts.image_size is None:
            raise MissingFileError(
                f"{camera_file}: no image and no width and height to take the image size from; add them"
            )
        return self.facts.image_size
