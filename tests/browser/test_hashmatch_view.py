"""HashMatch at work in the tab: stages, windows, swarms and verdicts of a small run, in a real browser."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from opened_page import OpenedPage
from parts_dataset import COARSE, make_parts_dataset

from inspector.hashmatch.heat import counted
from pipeline.bop.dataset import open_dataset
from pipeline.explaining import recorded_explanations
from pipeline.hashmatch.window_report import RecordedMatching
from pipeline.recording import Recorder, RecordingReader
from pipeline.run import Run
from pipeline.scene import ImageKey

KEY, OTHER = ImageKey(1, 0), ImageKey(1, 1)
ROW = "row=1,0,1,0,-1"
PATIENCE = 300


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the command over two small images."""
    root = tmp_path_factory.mktemp("parts")
    dataset = make_parts_dataset(root / "parts")
    arguments = [
        dataset,
        *COARSE,
        "--images",
        "0",
        "1",
        "--workers",
        "1",
        "--cache",
        root / "cache",
        "--out",
        root / "run",
    ]
    command = [sys.executable, "-m", "inspector", "run", "hashmatch", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return root / "run"


@pytest.fixture(scope="module")
def reader(run: Path) -> RecordingReader:
    return RecordingReader.open(Run.open(run).recording_path(KEY))


@pytest.fixture(scope="module")
def matching(reader: RecordingReader) -> RecordedMatching:
    return RecordedMatching(reader)


@pytest.fixture(scope="module")
def page(run: Path, serve, open_page) -> OpenedPage:
    opened = open_page(serve(run).url, ROW)
    opened.tab("HashMatch")
    return opened


def tab(page: OpenedPage) -> str:
    return page.panel()


def choose(page: OpenedPage, part: str) -> None:
    """Click what chooses a part of an address in the tab."""
    page.page.locator(f"[data-choose*='{part}']:visible").first.click()


def legend_says(page: OpenedPage, text: str) -> None:
    page.eventually(lambda: any(text in line for line in page.legend()))


def at(page: OpenedPage, reader: RecordingReader, u: float, v: float) -> tuple[float, float]:
    """Where a pixel of the image is on the picture, shares of its size."""
    camera = reader.view.camera
    assert camera is not None
    viewport = page.viewport(camera)
    left, top = viewport.pixel_at(0, 0)
    right, bottom = viewport.pixel_at(1, 1)
    return (u - left) / (right - left), (v - top) / (bottom - top)


def test_the_funnel_shows_the_counts_of_all_stages(page: OpenedPage, matching: RecordedMatching):
    page.show(ROW)
    counts = [
        counted(count.candidates).replace("<sup>", "").replace("</sup>", "")
        for count in matching.stage_counts().values()
    ]
    page.eventually(lambda: page.page.locator(".pi-hm-funnel b").all_inner_texts() == counts)
    sizes = page.page.eval_on_selector_all(".pi-hm-funnel img", "images => images.map(image => image.naturalWidth)")
    assert len(sizes) == 5
    assert min(sizes) > 50


def test_a_click_on_a_stage_draws_its_candidates_and_another_hides_them(page: OpenedPage, matching: RecordedMatching):
    page.show(ROW)
    before = page.eventually(page.picture)
    choose(page, "hashmatch.stage=hashing")
    count = matching.stage_counts()["hashing"]
    legend_says(page, f"hashing: {counted(count.candidates, markup=False)} candidates")
    legend_says(page, "candidates per pixel")
    assert page.address()["hashmatch.stage"] == "hashing"
    page.eventually(lambda: np.abs(page.picture().astype(int) - before).mean() > 5)
    choose(page, "hashmatch.stage=off")
    page.eventually(lambda: "hashmatch.stage" not in page.address())
    page.eventually(lambda: np.abs(page.picture().astype(int) - before).mean() < 1)


def test_a_level_of_the_pyramid_has_its_own_candidates(page: OpenedPage, matching: RecordedMatching):
    page.show(f"{ROW}&hashmatch.stage=hashing")
    levels = [level for level in matching.levels if matching.stage_counts(level)["hashing"].candidates]
    choose(page, f"hashmatch.level={levels[0]}")
    count = matching.stage_counts(levels[0])["hashing"].candidates
    legend_says(page, f"hashing, level {levels[0]}: {counted(count, markup=False)} candidates")
    choose(page, "hashmatch.level=none")
    legend_says(page, "hashing: ")


def test_a_level_that_is_not_there_is_said(page: OpenedPage):
    page.show(f"{ROW}&hashmatch.stage=hashing&hashmatch.level=77")
    legend_says(page, "there is no level 77; levels of this image:")


def test_a_click_into_the_image_shows_the_window_its_templates_and_tests(
    page: OpenedPage, reader: RecordingReader, matching: RecordedMatching
):
    page.show(f"{ROW}&hashmatch.stage=verification")
    report = matching.window_of(0)
    page.click(*at(page, reader, *report.center))
    page.eventually(lambda: page.address().get("hashmatch.part") == "window")
    u, v = (float(number) for number in page.address()["hashmatch.pixel"].split(","))
    expected = matching.window_at(u, v)
    assert abs(u - report.center[0]) < 1
    page.eventually(lambda: expected.verdict in tab(page))
    page.eventually(lambda: page.page.locator(".pi-hm-votes > div").count() >= len(expected.votes))
    votes = [int(text) for text in page.page.locator(".pi-hm-votes b").all_inner_texts()]
    assert votes[: len(expected.votes)] == [vote.votes for vote in expected.votes]
    best = expected.farthest
    assert best is not None
    for fraction in best.fractions:
        assert f"{fraction:.2f} of 0.60" in tab(page)
    assert page.page.locator(".pi-hm-pair img").count() == 2
    legend_says(page, f"template {best.template} of object {best.obj_id}")


def test_another_template_of_the_window_is_a_click_away(page: OpenedPage, matching: RecordedMatching):
    report = matching.window_of(0)
    place = ",".join(f"{number:.6g}" for number in report.center)
    page.show(
        f"{ROW}&hashmatch.part=window&hashmatch.scene_id=1&hashmatch.im_id=0&hashmatch.pixel={place}&hashmatch.level={report.level}"
    )
    before = page.eventually(lambda: page.page.locator(".pi-hm-pair img").last.get_attribute("src"))
    other = next(i for i, vote in enumerate(report.votes) if vote != report.farthest)
    page.page.locator(".pi-hm-votes > div").nth(other).click()
    page.eventually(lambda: f"Template {report.votes[other].template} of object" in tab(page))
    page.eventually(lambda: page.page.locator(".pi-hm-pair img").last.get_attribute("src") != before)
    choose(page, "hashmatch.test=4")
    page.eventually(lambda: page.address().get("hashmatch.test") == "4")
    page.eventually(lambda: "T4 surface distance" in page.page.locator(".pi-hm-caption b").last.inner_text())


def test_shift_click_still_selects_an_object(page: OpenedPage, reader: RecordingReader):
    page.show(f"{ROW}&hashmatch.stage=hashing")
    other = next(truth for truth in open_dataset_of(reader).ground_truth(KEY) if truth.obj_id == 2)
    camera = reader.view.camera
    assert camera is not None
    u, v, depth = camera.K @ other.camera_from_model[:3, 3]
    page.page.keyboard.down("Shift")
    page.click(*at(page, reader, u / depth, v / depth))
    page.page.keyboard.up("Shift")
    page.eventually(lambda: page.address()["row"].startswith("1,0,2,"))
    assert "hashmatch.pixel" not in page.address()


def open_dataset_of(reader: RecordingReader):
    return open_dataset(reader.path.parent.parent.parent / "parts")


def test_the_verdict_on_the_instance_and_its_checks_are_shown(page: OpenedPage, reader: RecordingReader):
    page.show(ROW)
    explanation = recorded_explanations(reader)[0]
    page.eventually(lambda: explanation.verdict in page.page.locator(".pi-hm-verdict").first.inner_text())
    page.eventually(lambda: page.page.locator(".pi-hm-check").count() > 8)
    names = page.page.locator(".pi-hm-check > span:nth-child(2)").all_inner_texts()
    for name in ("objectness", "hashing", "T1 size", "T2 normals", "T3 gradients", "T4 surface distance", "T5 color"):
        assert name in names
    page.page.locator(".pi-hm-check", has_text="objectness").click()
    window = explanation.details["window"]
    legend_says(page, f"window at level {window['level']}")
    legend_says(page, "objectness, level")
    page.page.locator(".pi-hm-check", has_text="T3 gradients").click()
    page.eventually(lambda: "traced" in page.page.locator(".pi-hm-votes > .pi-hm-on").first.inner_text())
    assert f"Template {explanation.details['template']['row']} of object 1" in tab(page)


def test_the_slider_over_iterations_changes_the_picture(page: OpenedPage):
    page.show(f"{ROW}&hashmatch.part=swarm")
    legend_says(page, "particles of iteration 14: score")
    after = page.eventually(page.picture)
    slider = page.control("iteration").get_by_role("slider")
    slider.focus()
    page.press("Home")
    page.eventually(lambda: page.address().get("hashmatch.iteration") == "0")
    legend_says(page, "particles of iteration 0: score")
    page.eventually(lambda: (np.abs(page.picture().astype(int) - after).max(axis=-1) > 40).sum() > 50)
    page.eventually(lambda: "iteration 0 of 14: 20 particles" in tab(page))
    assert "MSSD" in tab(page)
    choose(page, "hashmatch.iteration=7")
    legend_says(page, "particles of iteration 7: score")


def test_the_swarm_in_3d_is_drawn_between_both_poses(page: OpenedPage):
    page.show(f"{ROW}&hashmatch.part=swarm&view=scene&display.points=0&hashmatch.iteration=0")
    legend_says(page, "particles of iteration 0: score")
    begun = page.eventually(page.picture)
    page.show(f"{ROW}&hashmatch.part=swarm&view=scene&display.points=0&hashmatch.iteration=14")
    legend_says(page, "particles of iteration 14: score")
    page.eventually(lambda: (np.abs(page.picture().astype(int) - begun).max(axis=-1) > 40).sum() > 50)


def test_a_reload_shows_the_same_window(page: OpenedPage, matching: RecordedMatching):
    detection = len(matching.stage_counts()) - 1
    query = f"{ROW}&hashmatch.stage=nms&hashmatch.part=window&hashmatch.scene_id=1&hashmatch.im_id=0&hashmatch.detection={detection}"
    page.show(query)
    report = matching.window_of(detection)
    page.eventually(lambda: report.verdict in tab(page))
    page.reload()
    page.tab("HashMatch")
    page.eventually(lambda: report.verdict in tab(page))
    assert page.address()["hashmatch.detection"] == str(detection)


def test_a_detection_that_is_not_there_is_said_in_one_line(page: OpenedPage):
    page.show(f"{ROW}&hashmatch.part=window&hashmatch.scene_id=1&hashmatch.im_id=0&hashmatch.detection=999999")
    page.eventually(lambda: "detection 999999 is not in" in tab(page))
    legend_says(page, "detection 999999 is not in")


def test_the_window_of_one_image_is_not_shown_in_another(page: OpenedPage):
    page.show("row=1,1,1,0,-1&hashmatch.part=window&hashmatch.scene_id=1&hashmatch.im_id=0&hashmatch.pixel=100,80")
    page.eventually(lambda: "Click into the image to look into the window there" in tab(page))
    assert not any("window at level" in line for line in page.legend())


def test_damaged_and_partial_recordings_say_so(run: Path, tmp_path: Path, serve, open_page):
    copy = Path(shutil.copytree(run, tmp_path / "run"))
    damaged, partial = (Run.open(copy).recording_path(key) for key in (KEY, OTHER))
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged.write_bytes(content)
    key, camera = RecordingReader.open(partial).key, RecordingReader.open(partial).view.camera
    partial.unlink()
    partial.with_name(f"{partial.name}.sha256").unlink()
    with Recorder(partial, "id", key, camera) as recorder:
        recorder.text("diagnosis/0/verdict", "nothing else")
        recorder.heatmap("hashmatch/hashing", np.ones((4, 4)), cell_px=60)
    page = open_page(serve(copy).url, f"{ROW}&hashmatch.stage=hashing")
    page.tab("HashMatch")
    page.eventually(lambda: damaged.name in tab(page))
    legend_says(page, damaged.name)
    page.show("row=1,1,1,0,-1&hashmatch.stage=hashing")
    page.eventually(lambda: "Stages of HashMatch were not recorded for this image." in tab(page))


def test_a_run_of_another_method_has_no_tab(run: Path, tmp_path: Path, serve, open_page):
    made = subprocess.run(
        [sys.executable, "-m", "inspector", "record", run.parent / "parts", run / "results.csv", "--out", tmp_path / "other"],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stdout + made.stderr
    page = open_page(serve(tmp_path / "other").url)
    page.tab("Target")
    assert page.page.get_by_role("tab", name="HashMatch").count() == 0
