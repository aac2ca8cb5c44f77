"""The tabs of the window, one view per file; `views_for` says which there are and in which order."""

from importlib import import_module

from inspector.panels.curves import CurvesView
from inspector.panels.data import DataView
from inspector.panels.display import DisplayView
from inspector.panels.recording import RecordingView
from inspector.panels.target import TargetView
from inspector.panels.vsd import VsdView
from inspector.views import View
from inspector.workspace import Workspace

STAGE_VIEWS = {
    "hashmatch": ("inspector.hashmatch.view", "HashMatchView"),
    "epos": ("inspector.epos.view", "EposView"),
}
"""Module and class of the views of a method's stages, by the first part of the paths that it records; imported only
where such are recorded, as methods may need much that is slow to import."""


def views_for(workspace: Workspace) -> tuple[type[View], ...]:
    """The tabs on the right, in order; those of a method's stages only where such are recorded."""
    recorded = frozenset[str]() if workspace.recordings is None else workspace.recordings.stages()
    stages = [
        getattr(import_module(module), name) for stage, (module, name) in STAGE_VIEWS.items() if stage in recorded
    ]
    return (TargetView, *stages, VsdView, CurvesView, DisplayView, RecordingView, DataView)
