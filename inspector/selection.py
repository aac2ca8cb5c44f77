"""What one browser looks at, as one immutable value that fits in a URL.

Everything that a person can choose and would want back after a reload or wants to send to a colleague stands
here: the target, the methods, the criterion, filters, the layers, the view and the zoom.
"""

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from inspector.epos.choice import EposChoice
from inspector.hashmatch.choice import HashMatchChoice

Criterion = Literal["mssd", "mspd", "vsd", "add"]
View = Literal["image", "scene"]
Style = Literal["contour", "fill", "wireframe", "shaded"]
DepthLayer = Literal["off", "depth", "difference to ground truth", "difference to estimate"]
Status = Literal["all", "wrong", "correct", "missing", "extra", "fixed", "broken", "both wrong"]

DEFAULT_THRESHOLDS: dict[Criterion, float] = {"mssd": 0.2, "mspd": 20.0, "vsd": 0.3, "add": 0.1}
"""Thresholds of correctness: fractions of the diameter for MSSD and ADD, pixels at 640 px width for MSPD, VSD plain."""


Score = Literal["average", "vsd", "mssd", "mspd"]
Grouping = Literal["object", "scene"]
NO_EYE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""In 3D, look from where the view starts."""


CLOSE_UP = 3.0
"""Zoom from which outlines are drawn thinner."""


class RowKey(NamedTuple):
    """Names a row of the target table: a ground-truth instance, or an estimate that has none (`gt_index` -1)."""

    scene_id: int
    im_id: int
    obj_id: int
    gt_index: int
    estimate: int
    """Row of the estimate in its results file, used where `gt_index` is -1; otherwise -1."""


@dataclass(frozen=True)
class Display:
    """Which layers are drawn, and how."""

    ground_truth: bool = True
    estimate: bool = True
    compared: bool = True
    """The compared method's estimate."""
    others: bool = False
    """Also all other instances of the image."""
    style: Style = "contour"
    opacity: float = 1.0
    """Opacity of the overlays, 0..1."""
    blink: bool = False
    wipe: bool = False
    wipe_position: float = 0.5
    """Share of the image width left of which the estimate is shown and right of which the ground truth."""
    image: bool = True
    depth: DepthLayer = "off"
    masks: bool = False
    """Visible masks of the annotated instances."""
    witness: bool = True
    """The vertices that decide MSSD and MSPD."""
    points: bool = True
    """The point cloud of the measured depth, in the 3D view."""
    recorded: str = ""
    """Entity of the run's recording that is drawn over the image; empty for none."""


@dataclass(frozen=True)
class Filter:
    """Which rows of the target table are shown."""

    obj_id: int | None = None
    scene_id: int | None = None
    status: Status = "all"
    visible_min: float = 0.0
    visible_max: float = 1.0


@dataclass(frozen=True)
class Board:
    """What the leaderboard shows."""

    open: bool = False
    score: Score = "average"
    first: int | None = None
    """Submission whose bars and curves are shown."""
    second: int | None = None
    """Submission beside it."""
    by: Grouping = "object"
    """What the bars stand for."""


@dataclass(frozen=True)
class Selection:
    """The state of one browser."""

    dataset: str = ""
    """Name and split (`lmo/test`) of the dataset looked at; empty for the one that the server was started with."""
    row: RowKey | None = None
    method: int = 0
    """Index of the results file whose estimates are inspected."""
    compare: int | None = None
    criterion: Criterion = "mssd"
    thresholds: tuple[float, float, float, float] = tuple(DEFAULT_THRESHOLDS.values())  # type: ignore[assignment]
    """Threshold per criterion, in the order of `DEFAULT_THRESHOLDS`."""
    tau_mm: float = 20.0
    """VSD misalignment tolerance, millimetres."""
    delta_mm: float = 15.0
    """VSD visibility tolerance, millimetres."""
    sort: str = "error"
    descending: bool = True
    view: View = "image"
    zoom: float = 1.0
    """1 fits the image into the window."""
    center_u: float = 0.5
    center_v: float = 0.5
    """Point of the image in the middle of the window, as a share of its width and height."""
    follow: bool = False
    """Zoom to the object of every row that is gone to."""
    eye: tuple[float, float, float, float, float, float] = NO_EYE
    """Position of the browser's camera in 3D and the point that it looks at, camera frame of the image, metres."""
    dark: bool = True
    filter: Filter = field(default_factory=Filter)
    display: Display = field(default_factory=Display)
    board: Board = field(default_factory=Board)
    hashmatch: HashMatchChoice = field(default_factory=HashMatchChoice)
    epos: EposChoice = field(default_factory=EposChoice)

    @property
    def threshold(self) -> float:
        """Threshold of the criterion in force."""
        return self.thresholds[list(DEFAULT_THRESHOLDS).index(self.criterion)]

    def same_picture(self, other: "Selection") -> bool:
        """Whether two selections differ at most in zoom, point of view and leaderboard, and need the same outlines."""
        here = replace(
            self,
            zoom=other.zoom,
            center_u=other.center_u,
            center_v=other.center_v,
            eye=other.eye,
            follow=other.follow,
            board=other.board,
        )
        return here == other and self.close_up == other.close_up

    @property
    def close_up(self) -> bool:
        """Whether the image is shown so large that thin outlines can be seen."""
        return self.zoom >= CLOSE_UP

    @property
    def table_key(self) -> tuple:
        """Everything that the rows of the table, their order and their cells depend on."""
        return (
            self.method, self.compare, self.criterion, self.thresholds, self.sort, self.descending, self.filter
        )  # fmt: skip

    def with_threshold(self, value: float) -> "Selection":
        """Return the selection with the threshold of the criterion in force changed."""
        index = list(DEFAULT_THRESHOLDS).index(self.criterion)
        changed = (*self.thresholds[:index], value, *self.thresholds[index + 1 :])
        return replace(self, thresholds=changed)
