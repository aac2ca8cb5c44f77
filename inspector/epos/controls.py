"""The controls of the tab: layer, correspondences with their thresholds, and the replay of the search."""

import asyncio
from typing import Any

import viser

from inspector import html
from inspector.epos.choice import NO_PIXEL, EposLayer, EposLinkColor, EposLinks
from inspector.epos.row import EposRow
from inspector.epos.thresholds import Thresholds
from inspector.views import Context

LAYERS: dict[EposLayer, str] = {
    "off": "nothing",
    "fragments": "fragments",
    "coordinates": "3D fragment coordinates",
    "points": "predicted 3D points",
    "confidence": "confidence",
    "object": "this object's probability",
    "objects": "most likely object",
}
LINKS: dict[EposLinks, str] = {"off": "none", "inliers": "inliers", "outliers": "outliers", "all": "all"}
COLORS: dict[EposLinkColor, str] = {"residual": "re-projection error", "confidence": "confidence"}
SECONDS_PER_STEP = 0.25
"""Of the replay."""
BACK, PLAY, NEXT, BEST = "◀", "Play", "▶", "Next best"


class EposControls:
    """Adds the controls to the tab and keeps them equal to the choice."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._row: EposRow | None = None
        self._playing = False

    def build_layer(self) -> None:
        """Add what stands first in the tab."""
        gui = self._context.gui
        self._layer = gui.add_dropdown("Over the image", tuple(LAYERS.values()), hint="What the network believed")
        self._layer.on_update(lambda event: self._chosen("layer", event, LAYERS))

    def build_links(self) -> None:
        """Add the folder of correspondences."""
        gui, usual = self._context.gui, Thresholds(0.1, 0.5, 4.0)
        self.counts = gui.add_html("")
        self._links = gui.add_dropdown("Draw", tuple(LINKS.values()), hint="Which of them are drawn; as lines in 3D")
        self._color = gui.add_dropdown("Coloured by", tuple(COLORS.values()))
        self._tau: dict[str, Any] = {
            "tau_a": gui.add_slider("τa", 0.0, 0.99, 0.01, usual.tau_a, hint="Probability that the object needs"),
            "tau_b": gui.add_slider(
                "τb", 0.0, 0.99, 0.01, usual.tau_b, hint="Probability of a fragment, relative to the likeliest"
            ),
            "tau_r": gui.add_slider(
                "τr [px]", 0.5, 20.0, 0.5, usual.tau_r, hint="Re-projection error below which a pixel is explained"
            ),
        }
        self._reset = gui.add_button("Thresholds of the run", visible=False, color="gray")
        self._beside = gui.add_button(
            "Image and model in 3D",
            hint="The image and a copy of the model side by side, without the measured points (U)",
        )
        self._links.on_update(lambda event: self._chosen("links", event, LINKS))
        self._color.on_update(lambda event: self._chosen("color", event, COLORS))
        for name, slider in self._tau.items():
            slider.on_update(lambda event, name=name: self._moved(name, event))
        self._reset.on_click(lambda _: self._context.change(epos=dict.fromkeys(self._tau)))

    def build_search(self) -> None:
        """Add the folder of the search."""
        gui = self._context.gui
        self.plot = gui.add_html("")
        self._step = gui.add_slider("Hypothesis", 0, 1, 1, 0, hint="In the order of the search; 0: the row's estimate")
        self._replay = gui.add_button_group("Replay", (BACK, PLAY, NEXT, BEST))
        self.story = gui.add_html("")
        self._step.on_update(self._stepped)
        self._replay.on_click(self._replayed)

    def on_beside(self, callback: Any) -> None:
        """Say what happens when a person asks for image and model in 3D."""
        self._beside.on_click(lambda _: callback())

    def update(self, row: EposRow) -> None:
        """Make the controls say what is in force."""
        self._row = row
        now = self._context.selection().epos  # may be newer than the row: do not fight with a hand on a slider
        _set(self._layer, LAYERS[now.layer])
        _set(self._links, LINKS[now.links])
        _set(self._color, COLORS[now.color])
        for name, value in row.of_run.moved(now)._asdict().items():
            _set(self._tau[name], value)
        self._reset.visible = (now.tau_a, now.tau_b, now.tau_r) != (None, None, None)
        search = row.search
        self._step.visible = self._replay.visible = search is not None
        if search is not None:
            if self._step.max != len(search):
                self._step.max = len(search)
            _set(self._step, 0 if now.hypothesis is None else min(now.hypothesis + 1, len(search)))

    def can_move(self, maps: bool, links: bool) -> None:
        """Say whether other thresholds lead to anything else."""
        for name, slider in self._tau.items():
            slider.disabled = not (links if name == "tau_r" else maps)

    def _chosen(self, name: str, event: viser.GuiEvent, names: dict[Any, str]) -> None:
        if event.client is not None:  # not our own update
            value = next(key for key, text in names.items() if text == event.target.value)
            self._context.change(epos={name: value})

    def _moved(self, name: str, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._context.change(epos={name: float(event.target.value)})

    def _stepped(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._playing = False
            self.show(int(event.target.value) - 1)

    def show(self, index: int) -> None:
        """Show a hypothesis; -1 for the estimate of the row."""
        self._context.change(epos={"hypothesis": None if index < 0 else index})

    async def _replayed(self, event: viser.GuiEvent) -> None:
        search = None if self._row is None else self._row.search
        now = self._context.selection().epos.hypothesis
        playing, self._playing = self._playing, False
        if search is None:
            return
        if event.target.value == BEST:
            self.show(search.next_best(now))
        elif event.target.value == PLAY:
            if not playing:
                await self._play()
        else:
            step = 1 if event.target.value == NEXT else -1
            self.show(min((-1 if now is None else now) + step, len(search) - 1))

    async def _play(self) -> None:
        """Go through the search from where it stands, from the start after the end, until somebody intervenes."""
        row = self._row
        assert row is not None
        assert row.search is not None
        now = self._context.selection().epos.hypothesis
        begin = 0 if now is None or now >= len(row.search) - 1 else now
        self._playing = True
        for stop in row.search.stops[row.search.stops >= begin].tolist():
            self.show(stop)
            await asyncio.sleep(SECONDS_PER_STEP)
            if not self._playing or self._context.selection().epos.hypothesis != stop:
                break
        self._playing = False

    def clear(self) -> None:
        """Forget the clicked pixel and the chosen fragment."""
        self._context.change(epos={"pixel": NO_PIXEL, "fragment": None})


def _set(control: Any, value: Any) -> None:
    if control.value != value:
        control.value = value


def block(*lines: str, dim: bool = False) -> str:
    """Lines of text as HTML."""
    return html.block(*(html.paragraph(line, dim=dim) for line in lines if line))
