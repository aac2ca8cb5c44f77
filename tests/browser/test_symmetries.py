"""`inspector symmetries` in the browser: candidates of a square box are looked at, accepted, refused and saved."""

import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from tiny_dataset import make_dataset

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

REPOSITORY = Path(__file__).resolve().parent.parent.parent
PATIENCE = 90.0
"""Seconds after which something that should have happened did not; software rendering on a busy machine is slow."""
SEARCH_PATIENCE = 400.0
"""Seconds for the search of two boxes; in a fresh checkout its loops are compiled first."""
CANVAS = "canvas[data-engine]"
ONLY_THE_PICTURE = f"body * {{ visibility: hidden }} {CANVAS} {{ visibility: visible !important }}"


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Box 1 has three different sides and nothing listed, box 2 is square and listed with a half turn."""
    return make_dataset(tmp_path_factory.mktemp("tiny")) / "models"


@pytest.fixture(scope="module")
def address(models: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "inspector", "symmetries", str(models), "--port", "0", "--no-browser"]
    environment = os.environ | {"PYTHONUNBUFFERED": "1", "COLUMNS": "500"}
    process = subprocess.Popen(
        command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    )
    printed: list[str] = []
    started = threading.Event()

    def read() -> None:
        for line in process.stdout or ():
            printed.append(line)
            started.set()
        started.set()

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        started.wait(PATIENCE)
        found = re.search(r"http://\S+", "".join(printed))
        assert found, "".join(printed)
        yield found[0]
    finally:
        process.terminate()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        reader.join(10)
    assert "Traceback" not in "".join(printed), "".join(printed)


@pytest.fixture(scope="module")
def open_page(chromium: "Browser", address: str) -> "Iterator[Callable[[], Page]]":
    pages: list[Page] = []
    errors: list[str] = []

    def open_one() -> "Page":
        page = chromium.new_context(viewport={"width": 1300, "height": 720}).new_page()
        page.set_default_timeout(PATIENCE * 1000)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{address}?fixedDpr=1")
        pages.append(page)
        return page

    yield open_one
    for page in pages:
        page.context.close()
    assert not errors, errors


@pytest.fixture(scope="module")
def page(open_page: "Callable[[], Page]") -> "Page":
    """With both boxes searched, looking at the first."""
    page = open_page()
    page.wait_for_function("document.querySelectorAll('.ps-badge').length === 2", timeout=SEARCH_PATIENCE * 1000)
    return page


def standings(page: "Page") -> list[str]:
    return page.eval_on_selector_all(".ps-candidate", "rows => rows.map(row => row.dataset.standing)")


def press(page: "Page", key: str, until: str) -> None:
    """Press a key and wait for a text in the window."""
    page.keyboard.press(key)
    page.wait_for_function("text => document.body.innerText.includes(text)", arg=until)


def picture(page: "Page") -> np.ndarray:
    """The 3D picture alone, RGB."""
    box = page.locator(CANVAS).bounding_box()
    assert box is not None
    shot = page.screenshot(clip=box, style=ONLY_THE_PICTURE)  # type: ignore[arg-type]
    return cv2.cvtColor(cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB).astype(int)


def orange(image: np.ndarray) -> int:
    """Pixels in the colour of the turned self."""
    red, green, blue = image[..., 0], image[..., 1], image[..., 2]
    return int(((red > green + 25) & (green > blue + 15)).sum())


def red(image: np.ndarray) -> int:
    """Pixels in the colour of the largest distances."""
    return int(((image[..., 0] > 130) & (image[..., 1] < 90) & (image[..., 2] < 100)).sum())


def eventually(check: Callable[[], bool], page: "Page") -> None:
    end = time.monotonic() + PATIENCE
    while not check():
        assert time.monotonic() < end, page.locator("body").inner_text()
        page.wait_for_timeout(200)


def test_candidates_are_accepted_by_key_closed_and_saved_and_every_browser_sees_it(
    page: "Page", open_page, models: Path
):
    path = models / "models_info.json"
    before = path.read_text()
    other = open_page()
    press(page, "ArrowRight", "object 2, candidate 1 of")
    assert "4-fold about z" in page.locator(".pi-legend").inner_text()
    assert "C2: 2-fold" in page.locator(".ps-result").inner_text()  # a part of it is listed
    press(page, "+", "C4: 4-fold")
    press(page, "n", "candidate 2 of")
    press(page, "a", "D4: 4-fold and flips")
    shown = standings(page)
    assert shown.count("follows") == 3  # two more flips, and no other candidate within epsilon
    other.wait_for_function("document.body.innerText.includes('not saved yet')")
    assert standings(other) == shown
    assert json.loads(path.read_text()) == json.loads(before)
    press(page, "s", "saved 1 object to models_info.json; before: models_info.json.bak")
    other.wait_for_function("document.body.innerText.includes('as in models_info.json')")
    assert len(json.loads(path.read_text())["2"]["symmetries_discrete"]) == 7
    assert (models / "models_info.json.bak").read_text() == before
    page.locator(".ps-candidate").nth(2).click()
    page.wait_for_function("document.body.innerText.includes('candidate 3 of')")
    press(page, "r", "is refused, but follows from those accepted")
    press(page, "u", "undone: object 2")
    press(page, "u", "C2: 2-fold")


def test_the_picture_shows_the_turned_self_in_turn_and_where_it_is_off(page: "Page"):
    press(page, "ArrowLeft", "object 1, candidate 1 of")
    page.locator(".ps-candidate", has_text="4-fold").first.click()  # of a box with three different sides: 10 mm off
    page.keyboard.press("1")
    eventually(lambda: orange(picture(page)) > 3000, page)
    page.keyboard.press("3")
    eventually(lambda: orange(picture(page)) < 0.2 * picture(page).shape[0] ** 2 and red(picture(page)) > 300, page)
    page.keyboard.press("2")
    seen = set()

    def both() -> bool:
        seen.add(orange(picture(page)) > 2000)
        return len(seen) == 2

    eventually(both, page)
    page.keyboard.press("1")
    press(page, "]", "180°")
    slider = page.get_by_label("angle")
    slider.fill("45")
    eventually(lambda: "45°" in page.locator(".ps-angle").inner_text(), page)


def test_an_object_of_which_all_is_refused_says_so(page: "Page"):
    page.locator(".ps-object", has_text="object 2").click()
    page.wait_for_function("document.body.innerText.includes('object 2, candidate 1 of')")
    press(page, "r", "none accepted")
    assert "no symmetry" in page.locator(".ps-result").inner_text()
    press(page, "u", "undone: object 2")
    assert "C2: 2-fold" in page.locator(".ps-result").inner_text()
