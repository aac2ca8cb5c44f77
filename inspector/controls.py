"""The controls above the table: methods, the criterion of correctness, and filters."""

from typing import Any, get_args

import viser

from inspector import html
from inspector.selection import DEFAULT_THRESHOLDS, Criterion, Status
from inspector.table import Table
from inspector.views import Context

CRITERIA: dict[Criterion, str] = {
    "mssd": "MSSD / diameter",
    "mspd": "MSPD [px]",
    "vsd": "VSD",
    "add": "ADD(-I) / diameter",
}
_LARGEST: dict[Criterion, float] = {"mssd": 0.5, "mspd": 50.0, "vsd": 1.0, "add": 0.5}
_ANY = "all"


class TableControls:
    """Choices that decide which rows the table shows and which of them count as correct."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def build(self) -> None:
        """Add the controls."""
        gui, workspace, selection = self._context.gui, self._context.workspace, self._context.selection()
        self._method = gui.add_dropdown("Method", (_NO_METHOD,))
        self._compare = gui.add_dropdown("Compare with", (_NOTHING,), visible=False)
        self._criterion = gui.add_dropdown(
            "Correct if", tuple(CRITERIA.values()), initial_value=CRITERIA[selection.criterion]
        )
        self._threshold = gui.add_slider(
            "below", 0.0, _LARGEST[selection.criterion], _LARGEST[selection.criterion] / 50, selection.threshold
        )
        with gui.add_folder("Filter", expand_by_default=False):
            dataset = workspace.dataset
            self._status = gui.add_dropdown("Result", get_args(Status), initial_value=selection.filter.status)
            self._object = gui.add_dropdown("Object", (_ANY, *map(str, dataset.obj_ids)), initial_value=_ANY)
            self._scene = gui.add_dropdown("Scene", (_ANY, *map(str, dataset.scene_ids)), initial_value=_ANY)
            self._visible = gui.add_multi_slider("Visible [%]", 0, 100, 1, (0, 100))
        self._summary = gui.add_html("")
        self._leaderboard = gui.add_button(
            "Leaderboard", hint="Scores of all methods (key 3)", icon=viser.Icon.TROPHY, color="gray"
        )
        self._wire()

    def update(self, table: Table | None) -> None:
        """Make the controls say what is in force, and sum the table up."""
        names, now = self._context.workspace.method_names, self._context.selection()
        wanted = now.filter
        _set(self._criterion, CRITERIA[now.criterion])
        if self._threshold.max != _LARGEST[now.criterion]:
            self._threshold.max = _LARGEST[now.criterion]
            self._threshold.step = _LARGEST[now.criterion] / 50
        _set(self._threshold, now.threshold)
        if names:
            self._offer(names)
            _set(self._method, names[now.method])
            _set(self._compare, _NOTHING if now.compare is None else names[now.compare])
        _set(self._status, wanted.status)
        _set(self._object, _ANY if wanted.obj_id is None else str(wanted.obj_id))
        _set(self._scene, _ANY if wanted.scene_id is None else str(wanted.scene_id))
        _set(self._visible, (round(wanted.visible_min * 100), round(wanted.visible_max * 100)))
        text = "comparing estimates with ground truth …" if table is None else table.summary
        self._summary.content = html.block(f"<b>{html.escape(text)}</b>")

    def _offer(self, names: tuple[str, ...]) -> None:
        """List the methods, of which more may have been opened since."""
        if self._method.options != names:
            self._method.options = names
            self._compare.options = (_NOTHING, *names)
            self._compare.visible = len(names) > 1

    def _wire(self) -> None:
        change = self._context.change
        kinds = {label: criterion for criterion, label in CRITERIA.items()}

        def on(control: Any, apply: Any) -> None:
            def changed(event: viser.GuiEvent) -> None:
                if event.client is not None:  # not our own update
                    apply(event.target.value)

            control.on_update(changed)

        self._leaderboard.on_click(lambda _: self._context.command("leaderboard"))
        on(self._method, lambda value: change(method=self._index(value) or 0))
        on(self._compare, lambda value: change(compare=self._index(value)))
        on(self._criterion, lambda value: change(criterion=kinds[value]))
        on(self._threshold, self._set_threshold)
        on(self._status, lambda value: change(filter={"status": value}))
        on(self._object, lambda value: change(filter={"obj_id": None if value == _ANY else int(value)}))
        on(self._scene, lambda value: change(filter={"scene_id": None if value == _ANY else int(value)}))
        on(self._visible, lambda value: change(filter={"visible_min": value[0] / 100, "visible_max": value[1] / 100}))

    def _index(self, name: str) -> int | None:
        names = self._context.workspace.method_names
        return names.index(name) if name in names else None

    def _set_threshold(self, value: float) -> None:
        changed = self._context.selection().with_threshold(float(value))
        self._context.change(thresholds=changed.thresholds)


_NOTHING: str = "nothing"
_NO_METHOD: str = "none: ground truth only"
assert set(CRITERIA) == set(DEFAULT_THRESHOLDS)


def _set(control: Any, value: Any) -> None:
    if control.value != value:
        control.value = value
