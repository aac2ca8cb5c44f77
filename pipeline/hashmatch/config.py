"""All parameters of HashMatch; the defaults are those of the thesis (ch. HashMatch, sec. Experimental Evaluation)."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

TEMPLATE_SIZE = 108
"""Pixels; side of a template and of the sliding window."""

NORMAL_BINS = 8
"""b_n: one for surfaces that face the camera, the others around."""

GRADIENT_BINS = 8
"""Orientations of image gradients, over half a turn: which side is brighter does not matter."""

TEMPLATES_OF_THESIS = 2916
"""Of an object, for which n is meant."""


@dataclass(frozen=True)
class HashMatchConfig:
    """Find known objects in RGB-D images by templates, hashing and particle swarms (HashMatch)."""

    task: Literal["localization", "siso", "detection"] = "localization"
    """Localization reports as many instances of an object as the targets say (ViVo), SiSo the best one, detection all
    that are good enough."""
    objects: tuple[int, ...] = ()
    """Ids of the objects to learn and to look for; by default all among the targets."""
    templates: Path | None = None
    """Folder of a split, such as tless/train_primesense, whose images become the templates; by default templates are
    rendered from the models."""
    views: Literal["hemisphere", "sphere"] = "hemisphere"
    """Directions from which templates see the object: the upper half (thesis), for objects that stand upright before a
    camera that looks down, or all around. With in-plane circle: for objects in any orientation, as in bins or T-LESS."""
    in_plane: Literal["limited", "circle"] = "limited"
    """Rotations of the templates about the optical axis: -40 to 40 degrees (thesis), for cameras held upright, or all
    around."""
    angle_step_deg: int = 10
    """Step in azimuth, elevation and in-plane rotation."""
    in_plane_limit_deg: int = 40
    """Largest in-plane rotation where it is limited."""
    skip_symmetric_views: bool = True
    """Leave out views that look like another one under a symmetry that models_info.json lists for the model. Only equal
    templates go; they would take the n places of a window from different ones. Models without symmetries keep all."""
    scales_up: int = 4
    """Levels of the pyramid that are larger than the image, for objects far away."""
    scales_down: int = 4
    """Levels that are smaller than the image, for objects nearby."""
    scale_factor: float = 1.2
    """s: between two levels of the pyramid."""
    fit_scales: bool = True
    """Add levels at which objects at the measured distances fit the window, where the above do not reach them."""
    window_step_px: int = 5
    """Between two windows, at every level."""
    overhang_px: int = 54
    """By how much a window may reach beyond the border of the image; half a window, so that objects are found whose
    middle is still in sight."""
    edgel_threshold: float = 0.3
    """tau, as a share of the diameter of the smallest object: response of the Sobel operator over depth at an edgel."""
    edgel_share: float = 0.3
    """theta, as a share of the least number of edgels in a template."""
    grid: int = 12
    """r: reference points in a row of the grid."""
    depth_bins: int = 5
    """b_d: bins of depth differences, equally frequent among the templates."""
    tables: int = 100
    """|H|: hash tables."""
    triplets: int = 5000
    """q: triplets of reference points from which those of the tables are chosen."""
    votes_kept: int = 100
    """n: templates that a window passes on, at most. In proportion more where objects have more than the 2,916 templates
    of the thesis on average, as with all views: nearest templates then share their votes with more neighbours."""
    votes_needed: int = 3
    """m: votes that a template needs."""
    points: int = 100
    """p: points of a template for each of the tests T2 to T5."""
    matches_needed: float = 0.6
    """v, as a share of p."""
    neighborhood_px: int = 5
    """g: side of the square in which a matching value is searched."""
    distance_tolerance: float = 0.05
    """alpha, as a share of the object's diameter."""
    orientation_margin_deg: float = 10.0
    """A point of a template also matches the next bin when its orientation is that near to it."""
    gradient_threshold: float = 16.0
    """Least response of the Sobel operator over 8-bit colour at a gradient of an image."""
    template_gradient_threshold: float = 24.0
    """The same at a gradient of a template, where contours stand before black."""
    hue_tolerance_deg: float = 24.0
    """Difference of hue at which colours match."""
    size_from_surface: bool = True
    """T1 expects the surface where the template shows it; else half a diameter before the centroid (thesis), which
    is too near for flat objects."""
    overlap: float = 0.5
    """Detections of an object whose boxes overlap by more (intersection over union) are the same one."""
    starts: int = 2500
    """Verified templates of an object whose rough poses are compared with the depth image: the best of each place."""
    drawn_per_instance: int = 300
    """Of these, for each instance sought, the best ones that are drawn to the measured surface."""
    redrawn_per_instance: int = 60
    """Of these, for each instance sought, the best ones that are drawn to it once more, at more pixels."""
    swarms_per_instance: int = 4
    """Of these, the best ones that get a swarm."""
    rescans: int = 1
    """How often objects still missing are sought again, with what sure poses explain masked out (as is a gripper in the
    thesis)."""
    refine: bool = True
    """Refine poses by particle swarm."""
    particles: int = 20
    """Particles of a swarm."""
    iterations: int = 14
    """Steps of a swarm."""
    rays: int = 500
    """Pixels at which a swarm compares rendered with measured depth."""
    depth_tolerance_m: float = 0.010
    """Difference of depth at which a pixel counts no more for a swarm."""
    least_fit: float = 0.3
    """Detection drops refined poses that explain less of their visible surface."""
    seed: int = 0
    """Of the triplets and the swarms."""
    threads: int = 0
    """Threads that match in each process; 0 takes as many as there are cores for it."""
    cache: Path | None = None
    """Folder in which learned templates are kept, made if absent; by default one in the user's cache."""

    def for_templates(self, per_object: float) -> "HashMatchConfig":
        """The same with n for objects of so many templates on average."""
        return replace(self, votes_kept=round(self.votes_kept * max(1.0, per_object / TEMPLATES_OF_THESIS)))
