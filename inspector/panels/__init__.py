"""The tabs of the window, one view per file; `VIEWS` says which there are and in which order."""

from inspector.panels.curves import CurvesView
from inspector.panels.data import DataView
from inspector.panels.display import DisplayView
from inspector.panels.recording import RecordingView
from inspector.panels.target import TargetView
from inspector.panels.vsd import VsdView
from inspector.views import View

VIEWS: tuple[type[View], ...] = (TargetView, VsdView, CurvesView, DisplayView, RecordingView, DataView)
"""Tabs on the right, in order; views of the pipeline's stages are added here."""
