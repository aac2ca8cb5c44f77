"""VSD taken apart, on the image of LM-O that has depth: the sliders change the number and the figure."""

from pathlib import Path

import pytest
from opened_page import OpenedPage

from pipeline.bop.assessment import assess
from pipeline.bop.dataset import open_dataset
from pipeline.bop.results import read_results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.scene import ImageKey

ROW = ImageKey(2, 3)


@pytest.fixture(scope="module")
def page(lmo: Path, serve, open_page) -> OpenedPage:
    server = serve(lmo, "--results", lmo / "results" / "megapose_lmo-test.csv")
    return open_page(server.url)


@pytest.fixture(scope="module")
def expected(lmo: Path):
    """VSD of the row by tau and delta in millimetres, and the row as the address bar names it."""
    dataset, results = open_dataset(lmo), read_results(lmo / "results" / "megapose_lmo-test.csv")
    rows = assess(dataset, results)
    row = next(i for i in range(len(rows)) if rows.im_id[i] == 3 and 0.003 < rows.mssd[i] < 0.05)
    model, depth = dataset.model(int(rows.obj_id[row])), dataset.depth(ROW)
    found = results.estimate(int(rows.estimate[row])).camera_from_model
    truth = next(gt for gt in dataset.ground_truth(ROW) if gt.index == rows.gt_index[row]).camera_from_model
    assert depth is not None

    def value(tau_mm: float, delta_mm: float) -> str:
        camera, share = dataset.camera(ROW), tau_mm / 1000 / model.diameter
        values = vsd_of_poses(model, camera, found, truth, depth, [share], delta_mm / 1000).values
        return f"{values[0]:.3f}"

    return value, f"row=2,3,{rows.obj_id[row]},{rows.gt_index[row]},-1"


def shown(page: OpenedPage) -> str:
    """The number that the tab says."""
    return page.page.locator(".pi-numbers b:visible").first.inner_text()


def figure(page: OpenedPage) -> list[str]:
    return page.page.eval_on_selector_all(".pi-figure img", "images => images.map(i => i.src)")


def test_the_value_is_that_of_the_error_function(page: OpenedPage, expected):
    value, row = expected
    page.show(row)
    page.tab("VSD")
    page.eventually(lambda: shown(page) == value(20, 15))


@pytest.mark.parametrize(
    ("label", "name", "begin", "other"), [("tau [mm]", "tau_mm", 20.0, 15.0), ("delta [mm]", "delta_mm", 15.0, 20.0)]
)
def test_moving_a_slider_by_keys_changes_the_value(
    page: OpenedPage, expected, label: str, name: str, begin: float, other: float
):
    value, row = expected
    page.show(row)
    page.tab("VSD")
    before = page.eventually(lambda: figure(page) or None)
    slider = page.control(label).get_by_role("slider")
    slider.focus()
    for _ in range(20):
        page.press("ArrowLeft")
    page.eventually(lambda: page.address().get(name) == f"{begin - 10:g}")
    changed = value(begin - 10, other) if name == "tau_mm" else value(other, begin - 10)
    assert changed != value(20, 15)
    page.eventually(lambda: shown(page) == changed)
    page.eventually(lambda: figure(page) != before)
    assert page.selected() >= 0  # the keys moved the slider, not the row
    assert page.address()["row"] == row.removeprefix("row=")


def test_dragging_a_slider_changes_the_value(page: OpenedPage, expected):
    value, row = expected
    page.show(row)
    page.tab("VSD")
    page.eventually(lambda: shown(page) == value(20, 15))
    thumb = page.control("tau [mm]").get_by_role("slider").bounding_box()
    assert thumb is not None
    x, y = thumb["x"] + thumb["width"] / 2, thumb["y"] + thumb["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    for step in range(1, 12):
        page.page.mouse.move(x + 10 * step, y)
    page.page.mouse.up()
    tau = float(page.eventually(lambda: page.address().get("tau_mm")))
    page.eventually(lambda: float(page.address()["tau_mm"]) > 50)
    page.eventually(lambda: shown(page) == value(float(page.address()["tau_mm"]), 15))
    assert tau > 20


def test_the_figure_shows_all_quantities(page: OpenedPage, expected):
    page.show(expected[1])
    page.tab("VSD")
    captions = page.eventually(lambda: page.page.locator(".pi-figure figcaption").all_inner_texts() or None)
    assert len(captions) == 8
    for text in (
        "measured distance",
        "visible at the estimate",
        "visible at the ground truth",
        "estimate minus ground truth",
    ):
        assert any(text in caption for caption in captions)
    sizes = page.page.eval_on_selector_all(
        ".pi-figure img", "images => images.map(i => [i.naturalWidth, i.naturalHeight])"
    )
    assert len({tuple(size) for size in sizes}) == 1
    assert min(sizes[0]) > 10


def test_without_depth_it_says_what_is_missing_and_what_is_not(page: OpenedPage):
    page.show("row=2,47,1,0,-1")
    page.tab("VSD")
    page.eventually(lambda: "VSD needs depth, and this image has none" in page.text())
    assert figure(page) == []
    page.tab("Target")
    page.eventually(lambda: "MSSD" in page.page.locator(".pi-numbers:visible").last.inner_text())


def test_the_table_has_vsd_for_the_image_with_depth_only(page: OpenedPage):
    page.show("sort=vsd")

    def check() -> bool:
        cells = page.rows()
        known = [row for row in cells if row[4] != "–"]
        return {row[0] for row in known} == {"2 / 3"} and cells[: len(known)] == known

    page.eventually(check)
