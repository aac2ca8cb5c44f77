"""What is drawn over the image and how: the switches of the layers."""

from dataclasses import fields
from typing import Any, get_args

import viser

from inspector.frame import Frame
from inspector.selection import DepthLayer, Display, Selection, Style
from inspector.views import Context

_SWITCHES = {
    "ground_truth": ("Ground truth (G)", "Model at the annotated pose, green"),
    "estimate": ("Estimate (T)", "Model at the estimated pose, blue"),
    "compared": ("Compared", "Model at the compared method's pose, orange"),
    "others": ("Others (O)", "All other annotated instances of the image, gray"),
    "blink": ("Blink (B)", "Show ground truth and estimate in turn"),
    "wipe": ("Wipe (X)", "Estimate left of the line, ground truth right of it"),
    "image": ("Image (I)", "The colour or gray image"),
    "masks": ("Masks (M)", "The dataset's masks of the visible parts"),
    "witness": ("Witness (V)", "The vertices that decide MSSD (red) and MSPD (yellow)"),
    "points": ("Points (U)", "Measured depth in the 3D view"),
}


class DisplayView:
    """Switches for the layers of the picture."""

    title = "Layers"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._controls: dict[str, Any] = {}

    def build(self) -> None:
        """Add a control for every field of Display."""
        gui, display = self._context.gui, self._context.selection().display
        views = gui.add_button_group("View", ("Image (1)", "3D scene (2)"))
        views.on_click(lambda event: self._context.change(view="image" if "Image" in event.target.value else "scene"))
        for item in fields(Display):
            value = getattr(display, item.name)
            if item.name in _SWITCHES:
                label, hint = _SWITCHES[item.name]
                self._controls[item.name] = gui.add_checkbox(label, value, hint=hint)
            elif item.name == "style":
                self._controls[item.name] = gui.add_dropdown("Models as (C)", get_args(Style), initial_value=value)
            elif item.name == "depth":
                self._controls[item.name] = gui.add_dropdown("Depth (H)", get_args(DepthLayer), initial_value=value)
            elif item.name == "opacity":
                self._controls[item.name] = gui.add_slider("Opacity", 0.0, 1.0, 0.05, value)
            elif item.name == "wipe_position":
                self._controls[item.name] = gui.add_slider("Wipe at", 0.0, 1.0, 0.01, value)
        for name, control in self._controls.items():
            control.on_update(lambda event, name=name: self._changed(name, event))

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Make the controls say what is in force."""
        for name, control in self._controls.items():
            value = getattr(selection.display, name)
            if control.value != value:
                control.value = value

    def _changed(self, name: str, event: viser.GuiEvent) -> None:
        if event.client is not None:  # not our own update
            self._context.change(display={name: event.target.value})
