"""What the recorder is handed of an image: candidates after each stage, windows, detections, templates, swarms.

Called only when something is recorded; paths are those of `pipeline.recording.entities`, and
`pipeline.hashmatch.window_report` reads them back.
"""

from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.showing.detections import show_detections, show_refinement, show_tests
from pipeline.hashmatch.showing.objects import show_objects, show_templates
from pipeline.hashmatch.showing.stages import show_stages
from pipeline.hashmatch.showing.windows import show_windows
from pipeline.recording import StageRecorder

__all__ = ["show_matching", "show_refinement", "show_tests"]


def show_matching(detector: Detector, matching: Matching, recorder: StageRecorder) -> None:
    """Record what the cascade made of an image, up to non-maxima suppression."""
    show_objects(detector, matching, recorder)
    recorder.mask("hashmatch/edgels", matching.base.edgel)
    show_stages(detector, matching, recorder)
    numbers = show_windows(detector, matching, recorder)
    show_detections(detector, matching, recorder)
    show_templates(detector, matching, numbers, recorder)
