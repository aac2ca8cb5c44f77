"""Parameters of pose fitting (thesis sec. epos_fitting; values of sec. epos_experiments, Method Parameters)."""

from dataclasses import dataclass
from math import inf
from typing import Literal, get_args

from pipeline.exceptions import InputError

Scheme = Literal["pooled", "progressive_x"]


Ransac = Literal["gc", "msac", "opencv"]


Solver = Literal["epnp+lm", "epnp", "sqpnp+lm", "sqpnp"]

_CHOICES = {"scheme": get_args(Scheme), "ransac": get_args(Ransac), "solver": get_args(Solver)}
_MOST_ITERATIONS = 1_000_000
_POSITIVE = (
    "inlier_threshold_px",
    "min_inliers",
    "draws",
    "draws_per_pixel",
    "agreeing",
    "max_iterations",
    "neighbourhood_radius",
)


@dataclass(frozen=True)
class FittingConfig:
    """How poses are fitted to correspondences."""

    scheme: Scheme = "pooled"
    """pooled: one search for all instances, the variant that measures best on many-to-many data.
    progressive_x: instances proposed one by one and consolidated by PEARL, as in the thesis."""
    inlier_threshold_px: float = 4.0
    """tau_r."""
    min_triangle_area_px2: float = 100.0
    """tau_t: triplets whose pixels span less are not tried."""
    quality_threshold: float = 0.5
    """tau_q: a quality that ends the search for a single instance."""
    min_probability: float = 0.5
    """tau_p: the probability of another instance below which the search for more ends, where their number is not given."""
    min_inliers: int = 6
    """Pixels that a pose must explain to be returned..."""
    min_over_chance: float = 1.25
    """... and how many times the quality that poses reach on random correspondences (`chance_support`): 0 returns whatever
    fits best. With 1.25, nonsense gave no pose in any of 240 searches. The thesis has no such test: in its task
    a wrong pose costs no more than none."""
    reject_twins: bool = True
    """Take no pose for another instance that claims the pixels of an accepted one: its twin under a symmetry, for example.
    The thesis has no such test. progressive_x then also discounts all correspondences of a pixel that is explained."""

    draws: int = 2500
    """pooled: triplets drawn per wanted instance (for ten where their number is not given)..."""
    draws_per_pixel: float = 4.0
    """pooled: ... or this many per pixel with correspondences, if that is less but still enough for three instances (for
    one where their number is not given)."""
    agreeing: int = 5
    """pooled: a pose is settled when as many other hypotheses have agreed with it; all wanted ones settled end the search."""
    neighbour_distance_px: tuple[float, float] = (12.0, 64.0)
    """pooled: how far from its seed the other two pixels of a triplet lie."""

    ransac: Ransac = "gc"
    """progressive_x: how an instance is proposed; gc: GC-RANSAC as in the thesis, msac: without local optimization,
    opencv: solvePnPRansac with EPnP on pixels not yet explained."""
    solver: Solver = "epnp+lm"
    """progressive_x: pose from more than three correspondences."""
    max_iterations: int = 400
    """progressive_x: tau_i, triplets tried per proposed instance."""
    neighbourhood_radius: float = 20.0
    """progressive_x: tau_d, distance up to which correspondences are neighbours in 5D (pixels and centimetres)."""
    spatial_coherence: float = 1.0
    """progressive_x: weight of all neighbours of a correspondence together against its own error. The thesis states none."""
    max_similarity: float = 0.8
    """progressive_x: tau_j, Jaccard similarity of inliers from which a proposal is not new."""

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise InputError(f"fitting: {name} is {getattr(self, name)!r}; available: {', '.join(choices)}")
        for name in _POSITIVE:
            if not 0 < getattr(self, name) < inf:
                raise InputError(f"fitting: {name} is {getattr(self, name)}; expected a number above 0")
        for name in ("min_triangle_area_px2", "spatial_coherence", "min_over_chance"):
            if not 0 <= getattr(self, name) < inf:
                raise InputError(f"fitting: {name} is {getattr(self, name)}; expected a number from 0")
        for name in ("quality_threshold", "min_probability", "max_similarity"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"fitting: {name} is {getattr(self, name)}; expected 0 to 1")
        if self.max_iterations > _MOST_ITERATIONS:
            raise InputError(f"fitting: max_iterations is {self.max_iterations}; expected {_MOST_ITERATIONS:,} at most")
        if not 0 < self.neighbour_distance_px[0] < self.neighbour_distance_px[1] < inf:
            raise InputError(
                f"fitting: neighbour_distance_px is {self.neighbour_distance_px}; expected a smaller and a larger number"
            )
