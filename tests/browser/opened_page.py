"""What a person sees and does in an opened inspector, in the words of the tests."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeVar
from urllib.parse import parse_qsl, urlencode, urlsplit

import cv2
import numpy as np

from inspector.viewport import Viewport
from pipeline.scene import Camera

if TYPE_CHECKING:
    from playwright.sync_api import Locator, Page

T = TypeVar("T")
PATIENCE = 30.0
"""Seconds after which something that should have happened did not; software rendering on a busy machine is slow."""
ROW_HEIGHT = 26
"""CSS pixels of a row of the table."""
CANVAS = "canvas[data-engine]"
ONLY_THE_PICTURE = f"body * {{ visibility: hidden }} {CANVAS} {{ visibility: visible !important }}"


class Box(NamedTuple):
    """The picture's place in the window, CSS pixels."""

    x: float
    y: float
    width: float
    height: float


class OpenedPage:
    """A browser window with the inspector in it."""

    def __init__(self, page: "Page", url: str) -> None:
        self.page = page
        self.url = url
        self.errors: list[str] = []
        """Exceptions in the page's scripts."""
        page.set_default_timeout(PATIENCE * 1000)
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    # ---------------------------------------------------------------- what is seen
    def address(self) -> dict[str, str]:
        """The parameters in the address bar, without those for viser."""
        pairs = parse_qsl(urlsplit(self.page.url).query, keep_blank_values=True)
        return {name: value for name, value in pairs if name != "fixedDpr"}

    def rows(self) -> list[list[str]]:
        """Texts of the cells of the table's rows that exist in the page (those in sight and some around them)."""
        return self.page.evaluate(
            "[...document.querySelectorAll('.pi-row')].map(r => [...r.children].map(c => c.textContent))"
        )

    def selected(self) -> int:
        """Position of the selected row in the table, -1 where none is in the page."""
        found = self.page.locator(".pi-row[aria-selected=true]")
        return int(found.first.get_attribute("data-position") or -1) if found.count() else -1

    def legend(self) -> list[str]:
        return self.page.locator(".pi-legend-line").all_inner_texts()

    def readout(self) -> str:
        return self.page.locator(".pi-readout").inner_text()

    def text(self) -> str:
        """Everything that is written in the window."""
        return self.page.locator("body").inner_text()

    def panel(self) -> str:
        """The texts of our own in the tabs that are open."""
        return "\n".join(self.page.locator(".pi-block:visible").all_inner_texts())

    def canvas(self) -> Box:
        return Box(
            *self.page.evaluate(
                f"(() => {{ const b = document.querySelector('{CANVAS}').getBoundingClientRect();"
                "return [b.left, b.top, b.width, b.height] })()"
            )
        )

    def picture(self) -> np.ndarray:
        """The picture alone as RGB, one pixel per CSS pixel."""
        found = self.page.screenshot(clip=self.canvas()._asdict(), style=ONLY_THE_PICTURE)  # type: ignore[arg-type]
        return cv2.cvtColor(cv2.imdecode(np.frombuffer(found, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)

    def viewport(self, camera: Camera) -> Viewport:
        """How the image is shown, by the address bar and the size of the window."""
        address, box = self.address(), self.canvas()
        center = [float(address.get(name, 0.5)) for name in ("center_u", "center_v")]
        pixel = (center[0] * (camera.width - 1), center[1] * (camera.height - 1))
        return Viewport(camera, round(box.width), round(box.height), float(address.get("zoom", 1)), pixel)

    # ---------------------------------------------------------------- what is done
    def open(self, query: str = "") -> None:
        """Load the page and wait until the table, the picture and all numbers are there."""
        self.page.goto(f"{self.url}?fixedDpr=1{'&' if query else ''}{query}")
        self.settled()

    def close(self) -> None:
        """Close the window: drawing in software takes a core for every window that is open."""
        self.page.context.close()

    def reload(self) -> None:
        self.page.reload()
        self.settled()

    def show(self, query: str = "", **more: object) -> None:
        """Go to another address without loading the page again, as the browser's back button does."""
        query = "&".join(part for part in (query, urlencode(more, safe=",")) if part)
        self.page.evaluate(
            "query => { history.pushState(null, '', '?fixedDpr=1&' + query); dispatchEvent(new PopStateEvent('popstate')) }",
            query,
        )
        self.settled()

    def settled(self) -> None:
        """Wait until nothing is on its way: the table is complete and the server has shown what was asked."""
        self.page.wait_for_function(
            "document.querySelector('.pi-legend-line') !== null"
            " && document.querySelector('.pi-progress').childElementCount === 0"
            " && !document.querySelector('.pi-overlay').classList.contains('pi-busy')"
        )

    def press(self, key: str) -> None:
        self.page.keyboard.press(key)

    def click_row(self, position: int) -> None:
        top = ROW_HEIGHT * (position - 3)  # only rows in sight and some around them exist in the page
        self.page.evaluate("top => { document.querySelector('.pi-body').scrollTop = top }", top)
        self.page.locator(f".pi-row[data-position='{position}']").click()
        self.eventually(lambda: self.selected() == position)

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name, exact=True).click()

    def control(self, label: str) -> "Locator":
        """The line of a panel that holds the control with a label."""
        return self.page.locator(".mantine-Flex-root").filter(has=self.page.get_by_text(label, exact=True)).last

    def choose(self, label: str, option: str) -> None:
        """Pick an option of a dropdown."""
        self.control(label).get_by_role("combobox").click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def move_to(self, x: float, y: float) -> None:
        """Put the mouse over the picture, at shares 0..1 of its width and height."""
        box = self.canvas()
        self.page.mouse.move(box.x + x * box.width, box.y + y * box.height)

    def click(self, x: float, y: float) -> None:
        """Click on the picture, at shares 0..1 of its width and height."""
        box = self.canvas()
        self.page.mouse.click(box.x + x * box.width, box.y + y * box.height)

    def eventually(self, check: Callable[[], T], seconds: float = PATIENCE) -> T:
        """Wait until a check neither fails nor is false, and return what it gives."""
        end = time.monotonic() + seconds
        while True:
            try:
                found = check()
                assert found is not False and found is not None, f"still {found}; {self.page.url}"  # noqa: PT018
                return found
            except AssertionError:
                if time.monotonic() > end:
                    raise
                self.page.wait_for_timeout(100)
