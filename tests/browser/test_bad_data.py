"""Names that try to be HTML, and files that are damaged: the page stays whole and says what is wrong."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from opened_page import OpenedPage
from tiny_dataset import ANNOTATED, BARE, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

from inspector.panels.recording import RecordingView
from pipeline.bop.dataset import open_dataset
from pipeline.bop.results import write_results
from pipeline.replay import Replay
from pipeline.run import Run
from pipeline.running import run_estimator

HTML = "<img src=x onerror=document.body.dataset.taken=1>"
"""Runs if it is ever parsed as HTML; has no slash, so that it can be part of a file's name."""


def taken(page: OpenedPage) -> bool:
    return page.page.evaluate(
        "document.body.dataset.taken !== undefined || document.querySelector('img[src=x]') !== null"
    )


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "tiny")


@pytest.fixture
def opened(serve, open_page) -> Iterator[Callable[..., OpenedPage]]:
    """Serves what it is given and opens it, for one test."""
    pages: list[OpenedPage] = []

    def open_one(*arguments: str | Path, query: str = "") -> OpenedPage:
        pages.append(open_page(serve(*arguments).url, query))
        return pages[-1]

    yield open_one
    for page in pages:
        page.close()


def test_names_from_data_are_text(tmp_path: Path, opened):
    root = make_dataset(tmp_path / f"set{HTML}")
    for name, results in ((f"{HTML}_tiny-test.csv", perfect()), (f"b{HTML}_tiny-test.csv", results_of())):
        write_results(root / name, results)
    (root / "models" / "obj_000002.ply").write_text(HTML)
    page = opened(root, "--results", root / f"{HTML}_tiny-test.csv", "--results", root / f"b{HTML}_tiny-test.csv")
    page.show("row=1,1,1,0,-1")
    assert any(HTML in line for line in page.legend())
    for tab in ("Target", "VSD", "Curves", "Layers", RecordingView.title, "Data"):
        page.tab(tab)
        page.eventually(lambda: page.panel() or None)
        assert not taken(page), tab
    page.eventually(lambda: HTML in page.text())
    page.page.get_by_role("button", name="Ask the doctor").click()
    page.eventually(lambda: "Findings" in page.text())
    page.page.locator("input[role=combobox]").first.click()
    page.eventually(lambda: page.page.get_by_role("option").count() > 0)
    assert not taken(page)


def test_a_damaged_image_is_named_and_the_others_are_shown(tiny: Path, opened):
    path = tiny / "test" / "000001" / "rgb" / "000000.png"
    path.write_bytes(path.read_bytes()[:300])
    write_results(tiny / "perfect_tiny-test.csv", perfect())
    page = opened(tiny, "--results", tiny / "perfect_tiny-test.csv", query="row=1,0,1,0,-1")
    page.eventually(lambda: any("000000.png" in line for line in page.legend()))
    page.tab("Target")
    page.tab("VSD")
    page.move_to(0.5, 0.5)
    page.show("row=1,1,1,0,-1")
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 1 · object 1")
    page.tab("Target")
    page.eventually(lambda: "1 / 1" in page.page.locator(".pi-numbers:visible").first.inner_text())
    page.show("row=1,0,1,0,-1")
    page.eventually(lambda: any("000000.png" in line for line in page.legend()))
    # Numbers of the row before must not stand under this one.
    page.eventually(lambda: "1 / 1" not in page.panel())


def test_a_depth_image_of_another_size_costs_only_what_needs_it(tiny: Path, opened):
    import cv2

    path = tiny / "test" / "000001" / "depth" / "000000.png"
    cv2.imwrite(str(path), np.full((20, 30), 4000, np.uint16))
    write_results(tiny / "perfect_tiny-test.csv", perfect())
    page = opened(tiny, "--results", tiny / "perfect_tiny-test.csv", query="row=1,0,1,0,-1&display.depth=depth")
    page.move_to(0.5, 0.5)
    page.tab("VSD")
    page.press("h")
    page.show("row=1,0,1,0,-1&view=scene")
    page.show("row=1,1,1,0,-1")
    page.eventually(lambda: page.legend()[0] == "scene 1 · image 1 · object 1")
    page.tab("VSD")
    page.eventually(lambda: "mean VSD" in page.text())
    page.tab("Data")
    page.eventually(lambda: "30 x 20 pixels" in page.text())


def test_poses_behind_the_camera_and_very_far_away_are_rows_like_others(tiny: Path, opened):
    behind = moved(ANNOTATED[FIRST][0][1], z=-3.0)
    far = moved(ANNOTATED[SECOND][0][1], z=1e6)
    write_results(tiny / "m_tiny-test.csv", results_of(claim(SECOND, 1, far), claim(FIRST, 1, behind)))
    page = opened(tiny, "--results", tiny / "m_tiny-test.csv")
    for row in ("1,1,1,0,-1", "1,0,1,0,-1", "1,0,1,1,-1"):
        for view in ("image", "scene"):
            page.show(f"row={row}&view={view}")
            page.eventually(lambda row=row: page.legend()[0].startswith(f"scene 1 · image {row[2]}"))
            page.move_to(0.5, 0.5)
    for tab in ("Target", "VSD", "Curves"):
        page.tab(tab)
    assert not any("could not be shown" in line for line in page.legend())


def test_objects_outside_of_the_image_do_no_harm(tiny: Path, opened):
    path = tiny / "test" / "000001" / "scene_gt.json"
    truth = json.loads(path.read_text())
    truth["0"][1]["cam_t_m2c"] = [9000.0, 0.0, 500.0]
    path.write_text(json.dumps(truth))
    write_results(tiny / "perfect_tiny-test.csv", perfect())
    page = opened(tiny, "--results", tiny / "perfect_tiny-test.csv")
    for instance in (0, 1):
        for view in ("view=image", "view=scene", "display.masks=1&display.wipe=1", "display.style=fill"):
            page.show(f"row=1,0,1,{instance},-1&display.others=1&{view}")
            page.eventually(lambda: page.legend()[0] == "scene 1 · image 0 · object 1")
        page.press("z")
        page.move_to(0.5, 0.5)


def test_images_without_ground_truth_show_their_estimates(tiny: Path, opened):
    pose = ANNOTATED[SECOND][0][1]
    write_results(tiny / "m_tiny-test.csv", results_of(claim(BARE, 1, pose, 0.9), claim(BARE, 2, pose, 0.4)))
    page = opened(tiny, "--results", tiny / "m_tiny-test.csv", query="filter.scene_id=2")
    page.eventually(lambda: sorted(row[1] for row in page.rows()) == ["1", "2"])
    page.click_row(0)
    page.eventually(lambda: page.legend()[0].startswith("scene 2 · image 5"))
    page.tab("VSD")
    page.eventually(lambda: "VSD needs a ground-truth pose" in page.text())
    page.tab("Target")
    page.eventually(lambda: "no annotated instance for this row" in page.text())


def test_a_run_shows_its_recording_and_a_damaged_one_is_named(tiny: Path, tmp_path: Path, opened):
    dataset = open_dataset(tiny)
    with Run.create(tmp_path / "run", dataset=dataset, method="m") as run:
        run_estimator(Replay(dataset, perfect()), dataset, run)
    path = run.recording_path(SECOND)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    page = opened(run.root, query="row=1,0,1,0,-1")
    page.tab(RecordingView.title)
    page.eventually(lambda: "distance_difference" in page.text())
    page.choose("As a layer", "vsd/0/cost")
    page.eventually(lambda: page.address().get("display.recorded") == "vsd/0/cost")
    page.eventually(lambda: any("cost" in line for line in page.legend()))
    page.show("row=1,1,1,0,-1&display.recorded=vsd/0/cost")
    page.eventually(lambda: any(path.name in line for line in page.legend()))
    page.eventually(lambda: path.name in page.panel())
    assert any("object 1" in line for line in page.legend())  # the rest of the picture is there


def test_a_growing_run_is_followed(tiny: Path, tmp_path: Path, opened):
    dataset = open_dataset(tiny)
    with Run.create(tmp_path / "run", dataset=dataset, method="m") as run:
        page = opened(run.root, query="row=1,1,1,0,-1")
        page.eventually(lambda: {row[-1] for row in page.rows()} == {"missing"})
        page.tab("Target")
        page.eventually(lambda: "gave no estimate for this instance" in page.text())
        run.add(SECOND, [claim(SECOND, 1, ANNOTATED[SECOND][0][1])])
        page.eventually(lambda: "correct" in {row[-1] for row in page.rows()})
        page.eventually(lambda: any("MSSD 0.0 mm" in line for line in page.legend()))
        page.eventually(lambda: "gave no estimate for this instance" not in page.text())
