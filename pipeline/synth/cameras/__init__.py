"""Cameras that look at arranged objects (thesis sec. synth_composition).

ranges = ranges_of_dataset(Path("lmo"))            # or CameraRanges(elevation_deg=(20, 70), distance=(0.5, 1.0))
chooser = ViewChooser(world, models, world_from_models)
view = chooser.choose(intrinsics, ranges, rng)     # pose, exact depth and object ids
annotations = annotate_view(view, models)          # ground truth, masks, visible masks
"""

from pipeline.synth.cameras.chooser import ViewChooser, ViewRules, choose_view
from pipeline.synth.cameras.dataset_ranges import ranges_of_dataset
from pipeline.synth.cameras.errors import CameraSettingsError, NoViewError
from pipeline.synth.cameras.ranges import CameraRanges, Viewpoint, sample_view, viewpoints_of, world_from_camera
from pipeline.synth.cameras.views import View, ViewAnnotations, annotate_view, render_view, rounded_pose

__all__ = [
    "CameraRanges",
    "CameraSettingsError",
    "NoViewError",
    "View",
    "ViewAnnotations",
    "ViewChooser",
    "ViewRules",
    "Viewpoint",
    "annotate_view",
    "choose_view",
    "ranges_of_dataset",
    "render_view",
    "rounded_pose",
    "sample_view",
    "viewpoints_of",
    "world_from_camera",
]
