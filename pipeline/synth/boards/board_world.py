"""A marker board on a turntable in a room, as a world whose frame is the board's (thesis sec. tless_acquisition_setup).

The world frame is the board frame at every turn of the turntable: the origin is the middle of the board's upper side,
z is up, and the floor is below. So objects keep their poses and cameras move about them, as in a dataset; what turns,
the other way, is the room with its light, so that shading changes as it does on a turntable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import InputError
from pipeline.geometry import transform_points
from pipeline.synth.boards import lab
from pipeline.synth.boards.marker_board import MarkerBoard
from pipeline.synth.boards.turntable import disc_radius, height_over_table, screen, standing_part, turning_part
from pipeline.synth.materials import Material
from pipeline.synth.tracing.tone_mapping import PhotoConfig
from pipeline.synth.worlds.layout import Furnished, Thing, frame, placed
from pipeline.synth.worlds.world import AreaLight, Beam, Light, Point, PointLight, Sky, Stage, World

STAGE = "board"
FREE_HEIGHT = 1.2
"""Metres above the board."""
EXPOSED_FOR_BOARD = PhotoConfig(bright=0.55, most_lift=1.0)
"""Keeps the paper from being overexposed before the black screen."""


@dataclass(frozen=True, eq=False)
class BoardScene:
    """A board on a turntable in a room, ready to be turned."""

    board: MarkerBoard
    seed: int
    room: Furnished
    """All that does not turn, in a frame of its own."""
    room_from_board: Float[np.ndarray, "4 4"]
    """With the turntable not turned."""
    turning: Thing
    """What turns, in the board frame."""
    white: tuple[float, float, float]
    """Colour of the light at large."""

    def world(self, turn_deg: float = 0.0) -> World:
        """The world with the turntable turned so far, counter-clockwise seen from above; a new one each time.

        Its frame is the board's, its one stage, `board`, what `stage` gives.
        """
        board_from_room = frame(turn_deg=-turn_deg) @ np.linalg.inv(self.room_from_board)
        pieces = [*placed(self.room.pieces, board_from_room), *self.turning]
        lights = tuple(_placed_light(light, board_from_room) for light in self.room.lights)
        name = f"turntable at {turn_deg:g} degrees"
        return World(name, self.seed, tuple(pieces), lights, (self.stage,), self._free_space, self.white)

    @cached_property
    def stage(self) -> Stage:
        """The free middle, or the whole board where it has none; its frame is the board frame."""
        extent = self.board.free if min(self.board.free) > 0 else self.board.size
        polygon = np.array(extent) / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
        return Stage(STAGE, polygon, np.eye(4), FREE_HEIGHT)

    @property
    def _free_space(self) -> Float[np.ndarray, "2 3"]:
        """The box about the board that is inside the room at every turn."""
        centre = self.room_from_board[:3, 3]
        reach = min(*centre[:2], *(np.array(self.room.size[:2]) - centre[:2])) / np.sqrt(2) - 0.03
        low, high = 0.05 - centre[2], self.room.size[2] - 0.05 - centre[2]
        return np.array([[-reach, -reach, low], [reach, reach, high]])


def board_scene(
    board: MarkerBoard, seed: int = 0, middle: Material | None = None, with_screen: bool = False
) -> BoardScene:
    """Set a board up on a turntable; the seed decides on the room, its light, and the middle where it is not given.

    `with_screen` puts up the black screen of T-LESS's training images; render them with `EXPOSED_FOR_BOARD`.

    Raises `InputError` for a board that the table is too small for.
    """
    if disc_radius(board) > lab.MOST_RADIUS:
        raise InputError(
            f"marker board of {board.size[0]:.3g} x {board.size[1]:.3g} m is too large for the table;"
            f" take one of at most {2 * lab.MOST_RADIUS:.2g} m across"
        )
    rng = np.random.default_rng([seed, 40])
    room, room_from_table = lab.room(rng, disc_radius(board))
    room_from_board = room_from_table @ frame(z=height_over_table(board))
    room.put(standing_part(board), room_from_board)
    if with_screen:
        room.put(screen(board), room_from_board)
    chosen = middle or lab.middle(rng)
    return BoardScene(board, seed, room, room_from_board, turning_part(board, chosen), lab.white(room))


def board_world(
    board: MarkerBoard, seed: int = 0, turn_deg: float = 0.0, middle: Material | None = None, with_screen: bool = False
) -> World:
    """The world of one turn; for several make a `board_scene`, which shares what is the same. Raises `InputError`."""
    return board_scene(board, seed, middle, with_screen).world(turn_deg)


def _placed_light(light: Light, b_from_a: Float[np.ndarray, "4 4"]) -> Light:
    """A light moved by a rigid transform."""
    linear = b_from_a.copy()
    linear[:3, 3] = 0.0
    if isinstance(light, Sky):
        return light
    if isinstance(light, PointLight):
        return replace(light, position=_moved(light.position, b_from_a))
    if isinstance(light, Beam):
        return replace(light, position=_moved(light.position, b_from_a), target=_moved(light.target, b_from_a))
    half_u, half_v = _moved(light.half_u, linear), _moved(light.half_v, linear)
    return AreaLight(_moved(light.centre, b_from_a), half_u, half_v, light.radiance, light.picture)


def _moved(point: Point, b_from_a: Float[np.ndarray, "4 4"]) -> Point:
    x, y, z = transform_points(b_from_a, np.array(point)).tolist()
    return x, y, z
