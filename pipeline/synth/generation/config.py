"""What `inspector synthesize` is to make, as its configuration files say it.

A dataset has scenes of one or several kinds: `traced` (objects arranged in furnished scenes or in the cube room, path
traced), `pasted` (render & paste), and `board` (a marker board on a turntable). Lengths are metres, angles degrees.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

from pipeline.exceptions import InputError
from pipeline.synth.arranging import Falling, Standing
from pipeline.synth.boards import TLESS_TEST
from pipeline.synth.cameras import CameraRanges
from pipeline.synth.render_and_paste import PasteSettings
from pipeline.synth.sensors import DepthSensor
from pipeline.synth.tracing.tone_mapping import PhotoConfig
from pipeline.synth.worlds import FURNISHED

Count = tuple[int, int]
"""Least and most."""
Materials = Literal["own", "randomized", "plain"]


@dataclass(frozen=True)
class CameraConfig:
    """Intrinsics: those of a sensor, of a dataset (its camera.json), or numbers of one's own."""

    sensor: str | None = "carmine"
    """Name of a sensor's intrinsics, such as carmine, carmine_tless, kinect_v1 or kinect_v2."""
    dataset: Path | None = None
    """Folder of a BOP dataset whose camera.json is taken."""
    width: int | None = None
    """Pixels; with height, fx, fy, cx and cy in place of a sensor."""
    height: int | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None


@dataclass(frozen=True)
class DepthConfig:
    """How depth is measured: as by a sensor, with what is given here in place of its values."""

    sensor: str = "exact"
    """exact, carmine, kinect_v1 or kinect_v2."""
    a: float | None = None
    """Of the linear bias d = (d_c - b) / a."""
    b: float | None = None
    """Metres."""
    settings: DepthSensor | None = None
    """All values of a sensor of one's own."""


@dataclass(frozen=True)
class DistractorConfig:
    """Other objects that are arranged and rendered too, but not annotated (thesis sec. synth_bop20)."""

    models: Path
    """Folder of a BOP dataset."""
    objects: tuple[int, ...] = ()
    """Ids; by default all."""
    count: Count = (1, 4)


@dataclass(frozen=True)
class SceneConfig(ABC):
    """What scenes of all kinds have."""

    kind: ClassVar[str]

    scenes: int = 1
    """Number of BOP scenes made like this."""
    objects: tuple[int, ...] = ()
    """Ids; by default those of the dataset."""
    depth: DepthConfig | None = None
    """In place of the dataset's."""

    @property
    @abstractmethod
    def sets(self) -> int:
        """Number of parts of a scene that are made at one go: arrangements, or turns of a turntable."""

    @property
    @abstractmethod
    def images_per_set(self) -> int:
        """Images of such a part."""

    @property
    def name(self) -> str:
        """For messages."""
        return f"[[scene]] of kind {self.kind}"

    def check(self) -> None:
        """Raise InputError for values that cannot be."""
        for name in ("scenes", "sets", "images_per_set"):
            if getattr(self, name) < 1:
                raise InputError(f"{self.name}: {name.replace('_', ' ')} {getattr(self, name)}; give 1 or more")


@dataclass(frozen=True)
class TracedScene(SceneConfig):
    """Objects arranged in a world and path traced."""

    kind: ClassVar[str] = "traced"

    arrangements: int = 1
    """Per scene."""
    images: int = 25
    """Per arrangement (25 in the BOP Challenge 2020)."""
    worlds: tuple[str, ...] = FURNISHED
    """Of which one is chosen for each arrangement."""
    world_seed: int | None = None
    """Clutter, materials and light of the worlds; by default other ones for each arrangement."""
    stages: tuple[str, ...] = ()
    """Names of stages of the world; by default all."""
    count: Count | None = None
    """How many of the objects are arranged; by default all."""
    arranging: Falling | Standing = field(default_factory=Falling)
    distractors: DistractorConfig | None = None
    cameras: CameraRanges = field(default_factory=CameraRanges)
    cameras_of: Path | None = None
    """Folder of a BOP dataset: azimuths, elevations and distances are sampled from the ranges of its poses instead."""
    around: bool = False
    """Spread the azimuths evenly over their range, image by image, in place of sampling each."""
    min_visible: float = 0.3
    """Share of the focused object that an image must show."""
    quality: str = "bop20"
    """low, medium, high or bop20."""
    materials: Materials = "own"
    """own: as the model's colours, of plastic; randomized: own colours, random roughness, specular and metallic; plain:
    a random plain colour."""
    photo: PhotoConfig = field(default_factory=PhotoConfig)

    @property
    def sets(self) -> int:
        """Arrangements."""
        return self.arrangements

    @property
    def images_per_set(self) -> int:
        """Images of an arrangement."""
        return self.images


@dataclass(frozen=True)
class PastedScene(SceneConfig):
    """Objects rasterized over pictures (thesis sec. synth_experiments, R&P)."""

    kind: ClassVar[str] = "pasted"

    images: int = 1000
    """Per scene."""
    poses_of: Path | None = None
    """Folder of a BOP dataset whose images are imitated, one after the other: their cameras and their objects' poses."""
    poses_split: str | None = None
    """Folder of its images; by default its test split."""
    settings: PasteSettings = field(default_factory=PasteSettings)

    @property
    def sets(self) -> int:
        """All images are made at one go."""
        return 1

    @property
    def images_per_set(self) -> int:
        """Images of a scene."""
        return self.images


@dataclass(frozen=True)
class BoardLayout:
    """Markers around a free middle, and on the sides of the block; see `boards.framed_board`."""

    columns: int = 8
    rows: int = 8
    free_columns: int = 4
    """Markers left out in the middle."""
    free_rows: int = 4
    marker_side: float = 0.05
    gap: float = 0.0125
    margin: float = 0.0125
    sides: bool = True
    dictionary: str = "DICT_4X4_100"
    """OpenCV's name of the markers, such as DICT_APRILTAG_36h11."""


@dataclass(frozen=True)
class BoardScene(SceneConfig):
    """Objects on a turntable with a marker board (thesis sec. tless_acquisition_setup)."""

    kind: ClassVar[str] = "board"

    azimuths_deg: tuple[float, ...] = TLESS_TEST[0]
    elevations_deg: tuple[float, ...] = TLESS_TEST[1]
    distance: float = 0.7
    """Metres from the camera to the point that it looks at, a little above the middle of the board."""
    board: BoardLayout = field(default_factory=BoardLayout)
    seed: int | None = None
    """Of the room; by default another one for each scene."""
    count: Count | None = None
    """How many of the objects stand on the board; by default all."""
    arranging: Falling | Standing = field(default_factory=Standing)
    quality: str = "bop20"
    materials: Materials = "own"
    photo: PhotoConfig = field(default_factory=PhotoConfig)

    @property
    def sets(self) -> int:
        """Turns of the turntable."""
        return len(self.azimuths_deg)

    @property
    def images_per_set(self) -> int:
        """Images at one turn."""
        return len(self.elevations_deg)


SCENE_KINDS: dict[str, type[TracedScene | PastedScene | BoardScene]] = {
    scene.kind: scene for scene in (TracedScene, PastedScene, BoardScene)
}
"""By what `kind` says in a configuration file."""


@dataclass(frozen=True)
class SynthesisConfig:
    """A whole dataset."""

    scene: tuple[TracedScene | PastedScene | BoardScene, ...]
    """Their BOP scenes are numbered in this order."""
    models: Path | None = None
    """Folder of a BOP dataset, of which only the models are needed; by default the eight parts that come with this."""
    objects: tuple[int, ...] = ()
    """Ids; by default all."""
    split: str = "train_pbr"
    """Folder of the images; a test split gets lists of targets too."""
    first_scene: int = 0
    """Id of the first scene."""
    seed: int = 0
    rgb: Literal["png", "jpg"] = "jpg"
    """Format of the colour images; jpg is what BOP's own synthetic images have."""
    depth_scale: float = 0.1
    """Millimetres of one step of the depth images."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)

    def scenes(self) -> Iterator[tuple[int, TracedScene | PastedScene | BoardScene]]:
        """Ids of all BOP scenes with their recipes."""
        scene_id = self.first_scene
        for recipe in self.scene:
            for _ in range(recipe.scenes):
                yield scene_id, recipe
                scene_id += 1

    @property
    def images(self) -> int:
        """Number of all images."""
        return sum(recipe.sets * recipe.images_per_set for _, recipe in self.scenes())
