"""What one browser looks at, as one immutable value that fits in a URL.

Everything that a person can choose and would want back after a reload or wants to send to a colleague stands
here: the target, the methods, the criterion, filters, the layers, the view and the zoom.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Literal, NamedTuple
from urllib.parse import parse_qsl, urlencode

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


def to_query(selection: Selection, default: Selection | None = None) -> str:
    """Write the selection as a URL query; only what differs from `default` is named."""
    pairs: list[tuple[str, str]] = []
    for name, value, usual in _leaves(selection, default or Selection()):
        if value != usual:
            pairs.append((name, "none" if value is None else _to_text(value)))
    return urlencode(pairs, safe=",/")


def from_query(query: str, default: Selection | None = None) -> Selection:
    """Read a selection back from a URL query; what is missing or does not parse is as in `default`."""
    values = dict(parse_qsl(query.lstrip("?")))
    default = default or Selection()
    return replace(
        _read(default, values, prefix=""),
        filter=_read(default.filter, values, prefix="filter."),
        display=_read(default.display, values, prefix="display."),
        board=_read(default.board, values, prefix="board."),
    )


def _leaves(selection: Selection, default: Selection) -> list[tuple[str, object, object]]:
    found = []
    for item in fields(selection):
        value, usual = getattr(selection, item.name), getattr(default, item.name)
        if isinstance(value, _Part):
            found += [
                (f"{item.name}.{part.name}", getattr(value, part.name), getattr(usual, part.name))
                for part in fields(value)
            ]
        else:
            found.append((item.name, value, usual))
    return found


def _to_text(value: object) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, tuple):
        return ",".join(map(_to_text, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


_Part = Filter | Display | Board
_CHOICES: dict[str, tuple[str, ...]] = {
    "criterion": tuple(DEFAULT_THRESHOLDS),
    "view": View.__args__,
    "filter.status": Status.__args__,
    "display.style": Style.__args__,
    "display.depth": DepthLayer.__args__,
    "board.score": Score.__args__,
    "board.by": Grouping.__args__,
}
_OPTIONAL_INTS = {"compare", "filter.obj_id", "filter.scene_id", "board.first", "board.second"}
_RANGES = {"zoom": (0.2, 200.0), "display.opacity": (0.0, 1.0), "center_u": (-1.0, 2.0), "center_v": (-1.0, 2.0)}


def _read(default, values: dict[str, str], prefix: str):
    changes = {}
    for item in fields(default):
        text = values.get(prefix + item.name)
        if text is None or isinstance(getattr(default, item.name), _Part):
            continue
        try:
            changes[item.name] = _from_text(prefix + item.name, text, getattr(default, item.name))
        except ValueError:
            continue
    return replace(default, **changes)


def _from_text(name: str, text: str, usual: object) -> object:
    if name in _CHOICES:
        if text not in _CHOICES[name]:
            raise ValueError(text)
        return text
    if name == "row":
        return RowKey(*map(int, text.split(","))) if text.count(",") == 4 else _raise(text)
    if name in _OPTIONAL_INTS and text == "none":
        return None
    if name in _OPTIONAL_INTS or (isinstance(usual, int) and not isinstance(usual, bool)):
        return int(text)
    if isinstance(usual, bool):
        return bool(int(text))
    if isinstance(usual, tuple):
        numbers = tuple(_finite(part) for part in text.split(","))
        return numbers if len(numbers) == len(usual) else _raise(text)
    if isinstance(usual, float):
        lowest, highest = _RANGES.get(name, (-1e9, 1e9))
        return min(max(_finite(text), lowest), highest)
    return text


def _finite(text: str) -> float:
    number = float(text)
    return number if abs(number) < 1e12 else _raise(text)


def _raise(text: str):
    raise ValueError(text)
