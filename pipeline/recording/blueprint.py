"""The layout in which rerun's own viewer opens a recording."""

import os
from pathlib import Path
from typing import Any

from pipeline.recording.files import APPLICATION_ID
from pipeline.recording.recorder import IMAGE_TIMELINE

BLUEPRINT_FILE = "layout.rbl"

_ON_IMAGE = ("/image/rgb", "/models/**", "/epos/correspondences/**", "/method/**")
_CASCADE = ("windows", "objectness", "hashing", "verification", "nms")
_IN_SPACE = ("/image/**", "/models/**", "/estimates/**", "/ground_truth/**", "/hashmatch/pso/**", "/epos/hypotheses/**")


def save_blueprint(path: Path) -> None:
    """Write the default layout: image with models, depth, stages, 3D view, curves and log.

    Raises:
        OSError: it cannot be written.

    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    _layout().save(APPLICATION_ID, temporary)
    temporary.replace(path)


def _layout() -> Any:
    import rerun.blueprint as rrb

    images = rrb.Tabs(
        _image_view("Image with models", _ON_IMAGE),
        _image_view("Depth", ("/image/depth",)),
    )
    cascade = [_image_view(stage, (f"/hashmatch/{stage}/**",)) for stage in _CASCADE]
    stages = rrb.Tabs(
        _image_view("EPOS", ("/image/rgb", "/epos/**")),
        rrb.Grid(*cascade, _image_view("candidates", ("/image/rgb", "/hashmatch/candidates/**")), name="HashMatch"),
        _image_view("VSD", ("/vsd/**",)),
        _image_view("Other method", ("/method/**",)),  # heatmaps lie behind a colour image
    )
    eye = rrb.EyeControls3D(position=(0.0, -0.2, -0.3), look_target=(0.0, 0.0, 1.0), eye_up=(0.0, -1.0, 0.0))
    spaces = rrb.Tabs(
        rrb.Spatial3DView(
            origin="/", contents=_IN_SPACE, name="Camera frame", eye_controls=eye, time_ranges=_this_image()
        ),
        rrb.Spatial3DView(
            origin="epos/correspondences", name="Correspondences on the model", time_ranges=_this_image()
        ),
    )
    texts = rrb.Tabs(rrb.TextLogView(origin="/", name="Log"), rrb.BarChartView(origin="/", name="Curves"))
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(images, spaces), rrb.Horizontal(stages, texts)),
        rrb.TimePanel(timeline=IMAGE_TIMELINE, state="collapsed", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _image_view(name: str, contents: tuple[str, ...]) -> Any:
    import rerun.blueprint as rrb

    return rrb.Spatial2DView(origin="image", contents=contents, name=name, time_ranges=_this_image())


def _this_image() -> Any:
    """Only what was logged for the image itself: rerun would go on showing what an earlier one had."""
    import rerun.blueprint as rrb

    now = rrb.TimeRangeBoundary.cursor_relative(seq=0)
    return rrb.VisibleTimeRange(IMAGE_TIMELINE, start=now, end=now)
