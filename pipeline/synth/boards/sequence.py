"""Image sequences of a marker board on a turntable: which world and which camera for each image.

    scene = board_scene(framed_board(), seed=0)
    arrangement = arrange(scene.world(), scene.stage, models, Falling(), rng)
    objects = list(zip(arrangement.models, materials, arrangement.world_from_models))
    for turn in board_sequence(scene, camera, azimuths, elevations, distance=0.7):
        tracer = PathTracer(turn.world, objects)
        for seen in turn.cameras:
            rgb = tracer.render(seen, inverse(seen.world_from_camera))
        del tracer  # Mitsuba compiles no code anew for a scene like one that is gone

World poses are in the board frame, so `arrangement.world_from_models` holds in every image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from pipeline.scene import Camera
from pipeline.synth.boards.board_world import BoardScene
from pipeline.synth.boards.views import TurntableView, turntable_views
from pipeline.synth.worlds.world import World


@dataclass(frozen=True, eq=False)
class Turn:
    """The turntable stands still, the camera takes some images."""

    turn_deg: float
    """Of the turntable in the room, counter-clockwise seen from above."""
    world: World
    """In the board frame."""
    views: tuple[TurntableView, ...]
    cameras: tuple[Camera, ...]
    """One per view, `world_from_camera` in the board frame."""


def board_sequence(
    scene: BoardScene,
    camera: Camera,
    azimuths_deg: Sequence[float],
    elevations_deg: Sequence[float],
    distance: float = 0.7,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.03),
) -> Iterator[Turn]:
    """All views, turn by turn: one world at a time is made, and serves all elevations of its azimuth.

    `camera` gives the intrinsics; azimuths and elevations are the camera's on the board, in degrees, `distance` that
    to `centre` (board frame), in metres. Raises `InputError` for elevations outside 0..90 degrees.
    """
    views = turntable_views(azimuths_deg, elevations_deg, distance, centre)
    return (_turn(scene, camera, turn, tuple(group)) for turn, group in groupby(views, lambda view: view.turn_deg))


def _turn(scene: BoardScene, camera: Camera, turn_deg: float, views: tuple[TurntableView, ...]) -> Turn:
    cameras = tuple(replace(camera, world_from_camera=view.board_from_camera) for view in views)
    return Turn(turn_deg, scene.world(turn_deg), views, cameras)
