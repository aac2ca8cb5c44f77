"""Where things come to rest: dropped until they lie inside their region, still and free of overlap (metres, z up)."""

from collections.abc import Sequence
from functools import cache
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform
from pipeline.synth import clutter, physics
from pipeline.synth.ray_world import posed
from pipeline.synth.scenes import Recipe
from pipeline.synth.things import Placed, Thing, clutter_thing, part_thing

MAX_OVERLAP_MM3 = 0.5
"""Volume that two things may share."""
MAX_LAYOUTS = 60


def arrange(recipe: Recipe, seed: int) -> list[Placed]:
    """Drop the recipe's things until they lie inside the region, at rest and free of overlap; parts come first.

    The first layout of the sequence that starts with `seed` and passes is taken.
    """
    things = [part_thing(obj_id) for obj_id in recipe.parts] + [clutter_thing(name) for name in recipe.clutter]
    for attempt in range(MAX_LAYOUTS):
        rng = np.random.default_rng([seed, recipe.scene_id, attempt])
        starts = _tumbled_starts(recipe, things, rng) if recipe.tumbled else _spread_starts(recipe, things, rng)
        poses = _fall(things, starts, _bin_walls(1.2) if recipe.in_bin else ())
        if recipe.in_bin:  # the high walls only kept things in while they tumbled: go on with the true ones
            poses = _fall(things, poses, _bin_walls(clutter.BIN_INSIDE_MM[2] / 1000.0))
        placed = [Placed(thing, pose) for thing, pose in zip(things, poses, strict=True)]
        if _is_sound(recipe, placed):
            return placed
    raise AssertionError(f"scene {recipe.scene_id}: none of {MAX_LAYOUTS} layouts came to rest inside the region")


def _spread_starts(recipe: Recipe, things: Sequence[Thing], rng: np.random.Generator) -> list[Float[np.ndarray, "4 4"]]:
    """Apart from each other, just above the table, on one of the sides on which a thing rests well."""
    taken: list[tuple[np.ndarray, float]] = []  # centres and radii of the circles about the things
    largest_first = sorted(range(len(things)), key=lambda i: -np.ptp(things[i].surface.vertices, axis=0).max())
    starts = {i: _free_start(recipe, things[i], taken, rng) for i in largest_first}
    return [starts[i] for i in range(len(things))]


def _free_start(
    recipe: Recipe, thing: Thing, taken: list[tuple[np.ndarray, float]], rng: np.random.Generator
) -> Float[np.ndarray, "4 4"]:
    """A place in the region that is not taken, further out the longer the search lasts; it is taken from then on."""
    tries = 3000
    for k in range(tries):
        spread = 0.6 + k / (tries - 1)
        rotation = _resting_rotation(thing, rng)
        vertices = thing.surface.vertices @ rotation.T
        radius = float(np.linalg.norm(vertices[:, :2], axis=1).max()) * 0.9
        at = rng.uniform(-1, 1, 2) * recipe.half_size * spread
        if all(np.linalg.norm(at - other) > radius + other_radius + recipe.gap for other, other_radius in taken):
            taken.append((at, radius))
            return transform(rotation, np.array([*at, 0.002 - vertices[:, 2].min()]))
    raise AssertionError(f"scene {recipe.scene_id}: no room for {thing.name}")


def _resting_rotation(thing: Thing, rng: np.random.Generator) -> Float[np.ndarray, "3 3"]:
    """One of the poses in which the thing rests stably on a table, chosen by its likelihood, turned at random."""
    poses, likelihoods = _stable_rotations(thing)
    chosen = poses[rng.choice(len(poses), p=likelihoods)]
    return Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix() @ chosen


@cache
def _stable_rotations(thing: Thing) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, " n"]]:
    import trimesh

    hull = trimesh.Trimesh(thing.surface.vertices, thing.surface.faces).convex_hull
    with np.errstate(all="ignore"):  # sliver faces of the hull
        transforms, likelihoods = trimesh.poses.compute_stable_poses(hull, threshold=0.0)
    likely = likelihoods > 0.3 * likelihoods.max()
    return transforms[likely, :3, :3], likelihoods[likely] / likelihoods[likely].sum()


def _tumbled_starts(
    recipe: Recipe, things: Sequence[Thing], rng: np.random.Generator
) -> list[Float[np.ndarray, "4 4"]]:
    """One above the other, in random orientations."""
    heights = 0.08 + 0.065 * rng.permutation(len(things))
    at = rng.uniform(-1, 1, (len(things), 2)) * recipe.half_size
    rotations = Rotation.random(len(things), rng).as_matrix()
    return [transform(R, np.array([*xy, z])) for R, xy, z in zip(rotations, at, heights, strict=True)]


def _fall(
    things: Sequence[Thing], starts: Sequence[Float[np.ndarray, "4 4"]], walls: Sequence[physics.Wall]
) -> list[Float[np.ndarray, "4 4"]]:
    bodies = [physics.Body(thing.hulls, start) for thing, start in zip(things, starts, strict=True)]
    return physics.drop(bodies, walls)


def _bin_walls(height: float) -> list[physics.Wall]:
    """The four sides of the bin."""
    x, y, _ = np.array(clutter.BIN_INSIDE_MM) / 2000.0
    half, thick = height / 2, clutter.BIN_WALL_MM / 2000.0
    sides = [physics.Wall((sign * (x + thick), 0, half), (thick, y + 2 * thick, half)) for sign in (-1, 1)]
    return sides + [physics.Wall((0, sign * (y + thick), half), (x + 2 * thick, thick, half)) for sign in (-1, 1)]


def _is_sound(recipe: Recipe, placed: Sequence[Placed]) -> bool:
    """Nothing below the table, outside the region or above the bin, and no two things overlap."""
    limit = np.array(clutter.BIN_INSIDE_MM[:2]) / 2000.0 if recipe.in_bin else 1.6 * np.array(recipe.half_size)
    for item in placed:
        vertices = posed(item.thing.surface, item.world_from_model).vertices
        reach = vertices if recipe.in_bin else item.world_from_model[None, :3, 3]
        if vertices[:, 2].min() < -0.0005 or (np.abs(reach[:, :2]) > limit + 0.0005).any():
            return False
        if recipe.in_bin and vertices[:, 2].max() > clutter.BIN_INSIDE_MM[2] / 1000.0 + 0.05:
            return False
    return all(overlap_mm3(a, b) <= MAX_OVERLAP_MM3 for a, b in combinations(placed, 2))


def overlap_mm3(a: Placed, b: Placed) -> float:
    """Volume that two placed things share."""
    first, second = (
        item.thing.solid_mm.transform(item.world_from_model[:3] * (1.0, 1.0, 1.0, 1000.0)) for item in (a, b)
    )
    return (first ^ second).volume()
