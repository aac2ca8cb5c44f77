"""VSD taken apart: every quantity of the thesis's figure "Quantities used in the calculation of VSD", live."""

import numpy as np
import viser
from jaxtyping import Bool, Float, UInt8

from inspector import html, layers
from inspector.frame import Frame
from inspector.selection import Selection
from inspector.views import Context
from pipeline.bop.vsd import Vsd

MARGIN = 0.15
"""Share of the box around both renderings that is shown beyond it on each side."""


class VsdView:
    """The masks and maps behind the VSD of the selected estimate, with sliders for its tolerances."""

    title = "VSD"

    def __init__(self, context: Context) -> None:
        self._context = context

    def build(self) -> None:
        """Add the sliders and the figure."""
        gui, selection = self._context.gui, self._context.selection()
        self._value = gui.add_html("")
        self._tau = gui.add_slider(
            "tau [mm]",
            1.0,
            100.0,
            0.5,
            selection.tau_mm,
            hint="Misalignment tolerance: larger distance differences cost 1",
        )
        self._delta = gui.add_slider(
            "delta [mm]",
            1.0,
            50.0,
            0.5,
            selection.delta_mm,
            hint="Visibility tolerance: how far behind the measured surface",
        )
        self._tau.on_update(lambda event: self._changed("tau_mm", event))
        self._delta.on_update(lambda event: self._changed("delta_mm", event))
        self._figure = gui.add_html("")

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Recompute the figure and its number."""
        now = self._context.selection()
        for control, value in ((self._tau, now.tau_mm), (self._delta, now.delta_mm)):
            if control.value != value:
                control.value = value
        reason = _missing(frame)
        if frame is None or reason is not None:
            self._value.content = html.block(html.paragraph(reason or "Click a row of the table.", dim=True))
            self._figure.content = ""
            return
        result = frame.vsd(selection.tau_mm / 1000, selection.delta_mm / 1000)
        self._value.content = html.block(html.numbers(_numbers(frame, result, selection)))
        self._figure.content = html.block(f'<div class="pi-figure">{"".join(_figure(frame, result))}</div>')

    def _changed(self, name: str, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._context.change(**{name: float(event.target.value)})


def _missing(frame: Frame | None) -> str | None:
    """Why there is no VSD, None if there is one."""
    if frame is None:
        return None
    if frame.image.depth is None:
        return "VSD needs depth, and this image has none. MSSD, MSPD and ADD do not need it: see Target."
    if frame.ground_truth is None:
        return "VSD needs a ground-truth pose, and this row has none."
    if frame.estimate is None:
        return "The method gave no estimate for this instance: VSD is 1."
    return None


def _numbers(frame: Frame, result: Vsd, selection: Selection) -> list[html.Line]:
    both = result.visible_estimate & result.visible_gt
    union = np.count_nonzero(result.visible_estimate | result.visible_gt)
    limit = selection.thresholds[2]
    ten = frame.vsd_values(selection.delta_mm / 1000)
    return [
        ("VSD", f"{result.values[0]:.3f}", f"at tau {selection.tau_mm:g} mm; correct below {limit:g}", bool(result.values[0] < limit)),
        ("mean VSD", f"{ten.mean():.3f}", "over BOP's ten tolerances, 5 % to 50 % of the diameter", None),
        ("pixels", str(union), f"in the union, {np.count_nonzero(both)} in the intersection of the masks", None),
    ]  # fmt: skip


def _figure(frame: Frame, result: Vsd) -> list[str]:
    """Image, the five quantities of the thesis's figure with both rendered distances, and the cost per pixel."""
    rows, columns = _window(result)
    shown = result.distance_gt[result.distance_gt > 0]
    low, high = (shown.min() - 0.05, shown.max() + 0.05) if len(shown) else (0.0, 1.0)

    def cut(crop: np.ndarray, fill: float = 0) -> np.ndarray:
        return result.expand(crop, fill)[rows, columns]

    def distance(crop: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
        return layers.near_far(cut(crop), low, high)

    rgb = frame.image.rgb
    measured = layers.near_far(frame.distance_test[rows, columns], low, high)
    picture = rgb[rows, columns] if rgb is not None else np.zeros((*measured.shape[:2], 3), np.uint8)
    difference, cost = cut(result.difference, np.nan), cut(result.cost(result.taus[0]), np.nan)
    return [
        html.figure("RGB", "image", picture),
        html.figure("D<sub>I</sub>", "measured distance", measured),
        html.figure("D̂", "distance at the estimate", distance(result.distance_estimate)),
        html.figure("V̂", "visible at the estimate", _mask(cut(result.visible_estimate), layers.ESTIMATE)),
        html.figure("D̄", "distance at the ground truth", distance(result.distance_gt)),
        html.figure("V̄", "visible at the ground truth", _mask(cut(result.visible_gt), layers.GROUND_TRUTH)),
        html.figure("D<sub>Δ</sub>", "estimate minus ground truth, ±20 mm", layers.signed(difference, 0.02)),
        html.figure("cost", "red counts as wrong", _cost(cost)),
    ]


def _window(result: Vsd) -> tuple[slice, slice]:
    """The box of both renderings with a margin, within the image."""
    box, (height, width) = result.box, result.image_shape
    margin = int(MARGIN * max(box.shape)) + 2
    rows = slice(max(box.y0 - margin, 0), min(box.y1 + margin, height))
    return rows, slice(max(box.x0 - margin, 0), min(box.x1 + margin, width))


def _mask(mask: Bool[np.ndarray, "h w"], color: tuple[int, int, int]) -> UInt8[np.ndarray, "h w 3"]:
    return np.where(mask[..., None], np.array(color, np.uint8), np.uint8(25))


def _cost(cost: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Pixels that cost 1 red, that cost 0 green, outside dark."""
    picture = np.full((*cost.shape, 3), 25, np.uint8)
    picture[cost == 0] = (70, 160, 90)
    picture[cost == 1] = (230, 60, 50)
    return picture
