"""The address bar: reload, links from colleagues, links from another server, nonsense."""

from pathlib import Path

import pytest
from opened_page import OpenedPage
from tiny_dataset import make_dataset, perfect

from pipeline.bop.results import write_results


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = make_dataset(tmp_path_factory.mktemp("data") / "tiny")
    write_results(root / "perfect_tiny-test.csv", perfect())
    return root


@pytest.fixture(scope="module")
def page(root: Path, serve, open_page) -> OpenedPage:
    return open_page(serve(root, "--results", root / "perfect_tiny-test.csv").url)


LOOK = "row=1,0,2,2,-1&view=image&zoom=2.5&center_u=0.4&center_v=0.7&criterion=mspd&tau_mm=7.5&dark=0&filter.obj_id=2&display.style=fill"


def test_a_reload_restores_what_was_seen(page: OpenedPage):
    page.show(LOOK)
    page.eventually(lambda: page.address().get("zoom") == "2.5")
    page.eventually(lambda: "perfect: MSSD 0.0 mm" in " ".join(page.legend()))
    page.settled()
    before, picture = page.address(), page.eventually(lambda: _still(page))
    page.reload()
    page.eventually(lambda: page.address() == before)
    assert before["row"] == "1,0,2,2,-1"
    page.eventually(lambda: {row[1] for row in page.rows()} == {"2"})
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 0 · object 2")
    page.eventually(lambda: abs(page.picture().astype(int) - picture).mean() < 1)
    page.eventually(lambda: page.control("Correct if").get_by_role("combobox").input_value() == "MSPD [px]")
    assert page.page.evaluate("getComputedStyle(document.documentElement).colorScheme") == "light"


def test_a_link_opens_the_same_view_in_another_browser(page: OpenedPage, open_page):
    page.show("row=1,1,1,0,-1&view=scene&eye=-0.2,-0.1,0.05,0.01,0.02,0.3&display.points=0")
    address = page.eventually(lambda: page.address() if "eye" in page.address() else None)
    other = open_page(page.url, page.page.url.split("&", 1)[1])
    other.eventually(lambda: other.address() == address)
    other.eventually(lambda: other.legend()[0] == "scene 1 · image 1 · object 1")
    other.eventually(lambda: abs(other.picture().astype(int) - page.picture()).mean() < 2)
    other.close()


def test_the_address_names_only_what_is_not_usual(page: OpenedPage):
    page.show("row=1,1,1,0,-1&zoom=1&view=image&criterion=mssd")
    page.eventually(lambda: page.address() == {"row": "1,1,1,0,-1"})


@pytest.mark.parametrize(
    "query",
    [
        "method=7",
        "compare=9",
        "compare=-1&method=-3",
        "filter.obj_id=999",
        "filter.scene_id=-5",
        "filter.visible_min=70&filter.visible_max=-3",
        "criterion=vsd&thresholds=-5,1e9,9,1e-9",
        "tau_mm=-20&delta_mm=1e8",
        "zoom=1e9&center_u=-1&center_v=2",
        "display.opacity=7&display.wipe_position=-9&display.wipe=1",
        "sort=nonsense&view=upside-down&display.depth=deep",
        "display.recorded=no/such/entity",
        "row=1,0,2,2&zoom=&=&&&%ff%00",
        "row=99999999999999999999999,0,2,2,-1",
    ],
)
def test_a_link_from_elsewhere_opens_a_page_that_works(page: OpenedPage, query: str):
    page.show(query)
    page.eventually(lambda: not any("could not be shown" in line for line in page.legend()))
    page.show(f"{query}&row=1,1,1,0,-1")
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 1 · object 1")
    page.show("row=1,0,2,2,-1")
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 0 · object 2")
    page.eventually(lambda: len(page.rows()) == 4)
    page.tab("Target")
    page.eventually(lambda: "1 / 0" in page.page.locator(".pi-numbers:visible").first.inner_text())


@pytest.mark.parametrize(
    "row", ["1,77,1,0,-1", "9,0,1,0,-1", "1,0,99,0,-1", "1,0,1,55,-1", "1,0,1,-1,5", "-1,-1,-1,-1,-1"]
)
def test_a_row_that_is_not_there_is_told_in_one_line_and_others_open(page: OpenedPage, row: str):
    page.show("row=1,1,1,0,-1")
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 1 · object 1")
    page.show(f"row={row}")
    page.eventually(lambda: page.legend()[0] != "scene 1 · image 1 · object 1")
    assert not any("could not be shown" in line or "Traceback" in line for line in page.legend())
    page.move_to(0.5, 0.5)  # hovering must not fail either
    page.press("z")
    page.show("row=1,0,2,2,-1")
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 0 · object 2")


def _still(page: OpenedPage):
    """A picture that did not change since the last look."""
    first = page.picture()
    second = page.picture()
    return second.astype(int) if (first == second).all() else None
