"""The page on which symmetries are looked at: the model against its turned self, the candidates, what was decided."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from inspector.page import style_sheet
from inspector.server import InspectorServer, make_server
from inspector.symmetries.review import Review
from inspector.symmetries.texts import KEYS, heading, list_of_candidates, scale
from pipeline.exceptions import InputError
from pipeline.geometry import transform_points
from pipeline.scene import Model
from pipeline.symmetry_search.groups import Axis, Candidate
from pipeline.symmetry_search.search import SymmetrySearch

MODEL_COLOR, TURNED_COLOR = (150, 160, 170), (255, 150, 40)
VIEWS = ("both", "blink", "distance")
PERIOD_SECONDS = 0.5
"""Of blinking, and between two pictures while the search goes on."""
POINTS = 20_000
"""Points of the surface that show the distance."""


class SymmetryApp:
    """Serves a review; all browsers see the same, and each turns the model as it likes."""

    def __init__(self, review: Review, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._review = review
        self.server: InspectorServer = make_server(host, port, head_html=style_sheet())
        self._lock = threading.RLock()
        self._stopped = threading.Event()
        self._drawn: object = None
        self._handles: dict[str, Any] = {}
        self._build()
        review.listen(self._update)
        self._update()
        threading.Thread(target=self._blink, name="blinking", daemon=True).start()

    def wait(self) -> None:
        """Serve until interrupted."""
        while not self._stopped.wait(0.3):
            pass

    def stop(self) -> None:
        """Free the port."""
        self._stopped.set()
        self.server.stop()

    # ---------------------------------------------------------------- building
    def _build(self) -> None:
        viser, review = self.server.viser, self._review
        viser.scene.set_up_direction("+z")
        viser.initial_camera.position = (0.65, -0.8, 0.55)
        viser.initial_camera.look_at = (0.0, 0.0, 0.0)
        gui = viser.gui
        gui.configure_theme(control_layout="fixed", control_width="large", dark_mode=True, show_logo=False)
        self._head = gui.add_html("")
        ids = tuple(map(str, review.models))
        self._object = gui.add_dropdown("Object", ids, visible=len(ids) > 1)
        self._list = gui.add_html("")
        self._view = gui.add_dropdown("Show", VIEWS)
        self._angle = gui.add_slider("Turned by [°]", 0.0, 360.0, 0.5, 180.0)
        self._scale = gui.add_html("")
        buttons: dict[str, tuple[str, Callable[[], None], Any]] = {
            "Accept (Y)": ("Y", lambda: review.decide("accepted"), "green"),
            "Refuse (X)": ("X", lambda: review.decide("refused"), "red"),
            "Decide all of the object as suggested (G)": ("G", review.decide_as_suggested, "gray"),
            "Undo (U)": ("U", review.undo, "gray"),
            "Save to models_info.json (K)": ("K", review.save, "blue"),
        }
        for label, (key, action, color) in buttons.items():
            button = gui.add_button(label, color=color)
            button.on_click(lambda _, action=action: action())
            self._command(label.partition(" (")[0], key, action)
        self._command("Next candidate", "N", lambda: review.step(1))
        self._command("Previous candidate", "P", lambda: review.step(-1))
        self._command("Next object", "O", lambda: review.step_object(1))
        self._command("Previous object", "I", lambda: review.step_object(-1))
        self._command("Both, blink, distance", "V", self._next_view)
        gui.add_html(KEYS)
        self._chosen_view = VIEWS[0]
        self._view.on_update(lambda event: self._show(event.target.value))
        self._angle.on_update(lambda _: self._draw())
        self._object.on_update(lambda event: review.look_at(int(event.target.value)) if event.client else None)

    def _command(self, label: str, key: str, action: Callable[[], None]) -> None:
        self.server.viser.gui.add_command(label, hotkey=key).on_trigger(lambda _: action())  # type: ignore[arg-type]

    def _next_view(self) -> None:
        self._view.value = VIEWS[(VIEWS.index(self._chosen_view) + 1) % len(VIEWS)]

    def _show(self, view: str) -> None:
        self._chosen_view = view
        self._drawn = None
        self._draw()

    # ---------------------------------------------------------------- showing
    def _update(self) -> None:
        """Say how things stand, and draw what is looked at."""
        review = self._review
        with self._lock:
            self._head.content = heading(review)
            self._list.content = list_of_candidates(review)
            if self._object.value != str(review.state.obj_id):
                self._object.value = str(review.state.obj_id)
            candidate = review.candidate
            shown = (review.state.obj_id, review.state.position, candidate is None)
            if candidate is not None and shown != self._drawn_of():
                self._fit_slider(candidate)
            self._draw()

    def _drawn_of(self) -> object:
        return self._drawn[:3] if isinstance(self._drawn, tuple) else None

    def _fit_slider(self, candidate: Candidate) -> None:
        """A discrete symmetry has few angles, a continuous one any."""
        step = 360.0 / candidate.fold if candidate.fold else 0.5
        self._angle.step = step
        self._angle.value = step if candidate.fold else 90.0

    def _draw(self) -> None:
        with self._lock, self.server.viser.atomic():
            review = self._review
            state, candidate = review.state, review.candidate
            wanted = (state.obj_id, state.position, candidate is None, self._angle.value, self._chosen_view)
            if wanted == self._drawn:
                return
            self._drawn = wanted
            model = review.models[state.obj_id]
            center, size = _box(model)
            self._draw_model(model, center, size)
            search = review.searches.get(state.obj_id)
            if candidate is None or not isinstance(search, SymmetrySearch):
                self._drop("/turned", "/axis", "/distance")
                return
            turn = candidate.axis.turn(np.radians(self._angle.value))
            self._draw_axis(candidate.axis, center, size)
            if self._chosen_view == "distance":
                self._draw_distance(search, turn, center, size)
                self._drop("/turned")
            else:
                self._drop("/distance")
                vertices = (transform_points(turn, model.vertices) - center) / size
                self._mesh("/turned", vertices, model, TURNED_COLOR, 0.55)

    def _drop(self, *names: str) -> None:
        for name in names:
            if name in self._handles:
                self._handles.pop(name).remove()
        if "/distance" in names:
            self._scale.content = ""

    def _draw_model(self, model: Model, center: Float[np.ndarray, "3"], size: float) -> None:
        vertices, scene = (model.vertices - center) / size, self.server.viser.scene
        if model.colors is not None and self._chosen_view == "blink":
            import trimesh

            mesh = trimesh.Trimesh(vertices, model.faces, vertex_colors=model.colors, process=False)
            self._handles["/model"] = scene.add_mesh_trimesh("/model", mesh, cast_shadow=False)
            return
        self._mesh("/model", vertices, model, MODEL_COLOR, 0.25 if self._chosen_view == "distance" else None)

    def _mesh(
        self,
        name: str,
        vertices: Float[np.ndarray, "v 3"],
        model: Model,
        color: tuple[int, int, int],
        opacity: float | None,
    ) -> None:
        self._handles[name] = self.server.viser.scene.add_mesh_simple(
            name,
            vertices.astype(np.float32),
            model.faces.astype(np.uint32),
            color=color,
            opacity=opacity,
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_axis(self, axis: Axis, center: Float[np.ndarray, "3"], size: float) -> None:
        """The axis from one side of the model to the other."""
        middle = axis.through + (axis.direction @ (center - axis.through)) * axis.direction
        ends = (
            np.array([middle - 0.75 * size * axis.direction, middle + 0.75 * size * axis.direction]) - center
        ) / size
        self._handles["/axis"] = self.server.viser.scene.add_line_segments(
            "/axis", ends[None].astype(np.float32), (90, 170, 255), thickness=3.0, thickness_units="screen"
        )

    def _draw_distance(
        self, search: SymmetrySearch, turn: Float[np.ndarray, "4 4"], center: Float[np.ndarray, "3"], size: float
    ) -> None:
        """Points of the turned surface, coloured by their distance to the surface."""
        surface = search.surface
        points = surface.samples[:: max(1, len(surface.samples) // POINTS)] + surface.center
        moved = transform_points(turn, points)
        distances = surface.distances(moved - surface.center)
        largest = max(search.bound, 1e-6)
        self._handles["/distance"] = self.server.viser.scene.add_point_cloud(
            "/distance",
            ((moved - center) / size).astype(np.float32),
            _heat(distances / largest),
            point_size=0.008,
            point_shape="rounded",
            precision="float32",
            point_shading="flat",
        )
        self._scale.content = scale(float(distances.max()), largest)

    def _blink(self) -> None:
        blinking, first = False, False
        while not self._stopped.wait(PERIOD_SECONDS):
            wanted = self._chosen_view == "blink" and self._review.candidate is not None
            first = wanted and not first
            if wanted or blinking:
                self._set_visible(model=first or not wanted, turned=not first)
            blinking = wanted

    def _set_visible(self, *, model: bool, turned: bool) -> None:
        with self._lock:
            for name, visible in (("/model", model), ("/turned", turned)):
                if name in self._handles:
                    self._handles[name].visible = visible


def search_all(review: Review, find: Callable[[Model], SymmetrySearch]) -> None:
    """Search object by object, in the background of a page or not."""
    for done, (obj_id, model) in enumerate(review.models.items(), start=1):
        try:
            found: SymmetrySearch | InputError = find(model)
        except InputError as error:
            found = error
        review.add(obj_id, found, done / len(review.models))


def _box(model: Model) -> tuple[Float[np.ndarray, "3"], float]:
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)), 1e-9)


def _heat(shares: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours of shares 0..1: dark blue, green, yellow, red."""
    stops = np.array([[40, 60, 150], [40, 170, 140], [250, 220, 60], [230, 50, 40]], float)
    at = np.clip(shares, 0, 1) * (len(stops) - 1)
    return np.stack([np.interp(at, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=1).astype(np.uint8)
