"""What the search makes of random correspondences, against the formula that sets the least quality of a pose.

    python benchmarks/fitting_chance.py [--searches 10]

Support is quality summed over pixels, of the best pose of each search without a floor. `pipeline.epos.fitting.chance`
has the formula that was fitted to such figures; a ratio well above 1.25 would mean that nonsense passes for a pose.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pipeline.epos.fitting.chance import chance_support
from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.synthetic import K


@dataclass(frozen=True)
class Options:
    """What is searched."""

    searches: int = 10
    """Of each kind."""
    pixels: tuple[int, ...] = (30, 200, 1000, 2000)
    alternatives: tuple[int, ...] = (1, 4, 12)
    """Correspondences of each pixel."""
    taus: tuple[float, ...] = (2.0, 4.0, 8.0)
    """Inlier thresholds, pixels."""


def main() -> None:
    """Print the largest support of each kind beside the formula's."""
    options = tyro.cli(Options)
    table = Table("pixels", "per pixel", "tau_r [px]", "mean support", "largest", "formula", "largest / formula")
    for pixels, alternatives, tau in product(options.pixels, options.alternatives, options.taus):
        config = FittingConfig(min_over_chance=0.0, inlier_threshold_px=tau)
        found = [_support(_random(seed, pixels, alternatives), config, seed) for seed in range(options.searches)]
        formula = chance_support(pixels, pixels * alternatives, tau)
        table.add_row(str(pixels), str(alternatives), f"{tau:g}", f"{np.mean(found):.1f}", f"{max(found):.1f}",
                      f"{formula:.1f}", f"{max(found) / formula:.2f}")  # fmt: skip
    Console().print(table)


def _random(seed: int, pixels: int, alternatives: int) -> PotentialCorrespondences:
    """Random points of a box of 8 cm at each cell of a square in the image."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(pixels)))
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)[:pixels] + 60
    rows = np.repeat(np.arange(pixels), alternatives)
    points = rng.uniform(-0.04, 0.04, (len(rows), 3))
    return PotentialCorrespondences(1, cells[rows] * 4 + 1.5, points, rng.random(len(rows)), rows)


def _support(correspondences: PotentialCorrespondences, config: FittingConfig, seed: int) -> float:
    fitting = fit_poses(correspondences, K, config, instances=1, seed=seed)
    return max((pose.quality * fitting.pixels for pose in fitting.poses), default=0.0)


if __name__ == "__main__":
    main()
