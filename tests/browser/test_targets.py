"""The table on the demo: worst first, sorted, filtered, walked through by mouse and keys; and two people at once."""

from pathlib import Path

import numpy as np
import pytest
from opened_page import OpenedPage

from inspector.panels.recording import RecordingView
from pipeline.bop.assessment import Assessment, assess
from pipeline.bop.dataset import open_dataset
from pipeline.bop.results import read_results


@pytest.fixture(scope="module")
def files(demo: Path) -> list[Path]:
    return sorted((demo / "results").glob("*.csv"))


@pytest.fixture(scope="module")
def rows(demo: Path, files: list[Path]) -> Assessment:
    """What the table should say of the first method."""
    return assess(open_dataset(demo), read_results(files[0]))


@pytest.fixture(scope="module")
def server(demo: Path, serve):
    return serve()  # without arguments: the demo


@pytest.fixture(scope="module")
def page(server, open_page) -> OpenedPage:
    return open_page(server.url)


def column(page: OpenedPage, index: int) -> list[float]:
    """Numbers of a column of the table, infinite for none."""
    texts = [row[index].lstrip("~") for row in page.rows()]
    return [float(text.replace("∞", "inf").replace("–", "inf")) for text in texts]


def results(page: OpenedPage) -> set[str]:
    """What stands in the last column."""
    return {row[-1] for row in page.rows()}


def test_it_opens_on_the_worst_target(page: OpenedPage, rows: Assessment):
    page.show("")
    page.eventually(lambda: page.selected() == 0)
    share = np.where(np.isfinite(rows.mssd), rows.mssd / rows.diameter, -1)
    worst = int(np.argmax(share))
    cells = page.rows()[0]
    assert cells[0] == f"{rows.scene_id[worst]} / {rows.im_id[worst]}"
    assert cells[1] == str(rows.obj_id[worst])
    assert float(cells[5]) == pytest.approx(rows.mssd[worst] * 1000, abs=0.6)
    assert page.address()["row"].startswith(f"{rows.scene_id[worst]},{rows.im_id[worst]},{rows.obj_id[worst]},")
    assert f"object {rows.obj_id[worst]}" in page.legend()[0]
    assert f"MSSD {rows.mssd[worst] * 1000:.1f} mm" in " ".join(page.legend())
    assert f"{rows.scene_id[worst]}/{rows.im_id[worst]}" in page.page.title()


def test_a_click_selects_a_row(page: OpenedPage):
    page.click_row(4)
    image, obj_id = page.rows()[4][:2]
    scene_id, im_id = image.split(" / ")
    page.eventually(lambda: page.address()["row"].startswith(f"{scene_id},{im_id},{obj_id},"))
    page.eventually(lambda: page.legend()[0] == f"scene {scene_id} · image {im_id} · object {obj_id}")
    page.tab("Target")
    page.eventually(lambda: f"{scene_id} / {im_id}" in page.page.locator(".pi-numbers").first.inner_text())


def test_keys_walk_through_the_rows(page: OpenedPage):
    page.click_row(2)
    for key, position in (("n", 3), ("ArrowDown", 4), ("p", 3), ("ArrowUp", 2), ("ArrowUp", 1), ("p", 0), ("p", 0)):
        page.press(key)
        page.eventually(lambda position=position: page.selected() == position)


def test_arrows_walk_through_the_images(page: OpenedPage):
    page.show("sort=image&descending=0&row=1,0,0,0,-1")  # no such row
    page.click_row(0)
    first = page.rows()[0][0]
    page.press("ArrowRight")
    page.eventually(lambda: page.selected() > 0)
    second = page.rows()[page.selected()][0]
    assert second != first
    page.press("ArrowLeft")
    page.eventually(lambda: page.selected() == 0)


def test_a_click_on_a_header_sorts(page: OpenedPage):
    page.show("")
    for header, index in (("MSPD", 6), ("score", 3), ("obj", 1)):
        cell = page.page.locator(".pi-head .pi-cell").filter(has_text=header)
        cell.click()
        first_way = page.eventually(lambda cell=cell: next((m for m in "▾▴" if m in cell.inner_text()), None))
        page.eventually(lambda index=index: _is_sorted(column(page, index)))
        cell.click()
        page.eventually(lambda cell=cell, first_way=first_way: first_way not in cell.inner_text())
        page.eventually(lambda index=index: _is_sorted(column(page, index)))


def test_filters_choose_rows(page: OpenedPage, rows: Assessment):
    page.show("")
    obj_id = int(rows.obj_id[0])
    page.page.get_by_text("Filter", exact=True).click()
    page.choose("Object", str(obj_id))
    page.eventually(lambda: page.address().get("filter.obj_id") == str(obj_id))
    page.eventually(lambda: {row[1] for row in page.rows()} == {str(obj_id)})
    page.choose("Result", "missing")
    page.eventually(lambda: page.address().get("filter.status") == "missing")
    instances = (rows.obj_id == obj_id) & (rows.gt_index >= 0)
    missing = int(np.count_nonzero(instances & np.isinf(rows.mssd)))
    page.eventually(lambda: f"0 of {missing} correct" in page.text() if missing else "no rows" in page.text())
    page.choose("Object", "all")
    page.choose("Result", "all")
    page.eventually(lambda: "filter.status" not in page.address())
    page.page.get_by_text("Filter", exact=True).click()


def test_the_summary_counts_correct_instances_and_follows_the_threshold(page: OpenedPage, rows: Assessment):
    instances = rows.gt_index >= 0
    for threshold in (0.1, 0.2):
        page.show(f"thresholds={threshold},20,0.3,0.1&compare=none")
        correct = int(np.count_nonzero(rows.mssd[instances] / rows.diameter[instances] < threshold))
        page.eventually(lambda n=correct: f"{n} of {instances.sum()} correct" in page.text())


def test_the_criterion_can_be_chosen(page: OpenedPage, rows: Assessment):
    page.show("compare=none")
    page.choose("Correct if", "MSPD [px]")
    page.eventually(lambda: page.address().get("criterion") == "mspd")
    correct = int(np.count_nonzero(rows.mspd[rows.gt_index >= 0] < 20))
    page.eventually(lambda: f"{correct} of " in page.text())
    page.choose("Correct if", "MSSD / diameter")
    page.eventually(lambda: "criterion" not in page.address())


def test_the_table_scrolls_to_its_end(page: OpenedPage, rows: Assessment):
    page.show("")

    def at_the_end() -> bool:
        page.page.evaluate("document.querySelector('.pi-body').scrollTop = 1e9")
        return page.page.locator(f".pi-row[data-position='{len(rows) - 1}']").is_visible()

    page.eventually(at_the_end)
    assert page.page.locator(".pi-row").count() < 120
    page.click_row(len(rows) - 1)


def test_two_methods_are_compared(page: OpenedPage, demo: Path, files: list[Path]):
    if len(files) < 2:
        pytest.skip("the demo has one results file")
    page.show("filter.status=fixed")
    page.eventually(lambda: results(page) == {"fixed"})
    page.show("filter.status=broken")
    page.eventually(lambda: results(page) == {"broken"})
    broken = page.page.locator(".pi-spacer").evaluate("e => e.style.height")  # as many rows
    page.show("")
    page.click(0.02, 0.98)
    page.press("r")  # swaps the methods: what was broken becomes fixed
    page.eventually(lambda: page.address().get("method") == "1")
    page.show("method=1&compare=0&filter.status=fixed")
    page.eventually(lambda: results(page) == {"fixed"})
    page.eventually(lambda: page.page.locator(".pi-spacer").evaluate("e => e.style.height") == broken)


def test_help_and_the_command_palette(page: OpenedPage):
    page.show("zoom=3")
    page.click(0.02, 0.98)
    page.press("?")
    page.eventually(lambda: "Keys and commands" in page.text() and "Zoom to the object" in page.text())
    page.page.get_by_role("button", name="Close", exact=True).click()
    page.eventually(lambda: "Keys and commands" not in page.text())
    page.press("Control+k")
    page.page.get_by_placeholder("Search commands").fill("Fit the image")
    page.page.get_by_text("Fit the image into the window").click()
    page.eventually(lambda: "zoom" not in page.address())


def test_dark_and_light(page: OpenedPage):
    page.show("")

    def scheme() -> str:
        return page.page.evaluate("getComputedStyle(document.documentElement).colorScheme")

    page.click(0.02, 0.98)
    before = page.eventually(lambda: scheme() == "dark" and scheme())
    page.press("y")
    page.eventually(lambda: scheme() != before)
    page.eventually(lambda: page.address().get("dark") == "0")
    page.press("y")
    page.eventually(lambda: scheme() == before)


def test_every_tab_shows_something(page: OpenedPage, demo: Path):
    page.show("")
    for tab, text in (
        ("Curves", "Correct instances over the threshold"),
        ("Layers", "Models as"),
        (RecordingView.title, "No run is open"),
        ("Data", demo.name),
        ("VSD", "tau"),
        ("Target", "What is looked at"),
    ):
        page.tab(tab)
        page.eventually(lambda text=text: text in page.text())


def test_the_doctor_answers(page: OpenedPage):
    page.tab("Data")
    page.page.get_by_role("button", name="Ask the doctor").click()
    page.eventually(lambda: "Findings" in page.text(), 60)
    page.tab("Target")


def test_two_browsers_have_their_own_state(page: OpenedPage, server, open_page):
    page.show("zoom=2")
    page.click_row(3)
    mine = page.address()
    other = open_page(server.url)
    other.eventually(lambda: other.selected() == 0)
    other.click_row(6)
    other.press("2")
    other.eventually(lambda: other.address().get("view") == "scene")
    page.click_row(3)
    assert page.address() == mine
    page.eventually(lambda: page.selected() == 3)
    other.eventually(lambda: other.selected() == 6)
    other.close()


def _is_sorted(values: list[float]) -> bool:
    known = [value for value in values if np.isfinite(value)]
    return known in (sorted(known), sorted(known, reverse=True)) and not np.isfinite(values[len(known) :]).any()
