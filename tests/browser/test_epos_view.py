"""The tab of EPOS in real Chromium: on a run whose network is the ground truth, and on one of a method of somebody else."""

from pathlib import Path

import numpy as np
import pytest
from opened_page import OpenedPage
from third_party_method import make_run
from tiny_dataset import FIRST, SECOND, make_dataset

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.epos.oracle import record_oracle
from pipeline.epos.recomputing import correspondences_from
from pipeline.recording import Correspondences, Hypotheses, Probabilities, RecordingReader
from pipeline.run import Run
from pipeline.scene import ImageKey

ROUND = 1
"""The demo's part with a continuous symmetry."""
TURNED_IN_2 = "1,0,3,2,-1"
"""The row of a part that looks alike after each quarter turn."""


@pytest.fixture(scope="module")
def run(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_oracle(demo, tmp_path_factory.mktemp("epos") / "run", images=1)


@pytest.fixture(scope="module")
def dataset(demo: Path) -> Dataset:
    return open_dataset(demo)


@pytest.fixture(scope="module")
def key(run: Path) -> ImageKey:
    return Run.open(run).finished_images()[0]


@pytest.fixture(scope="module")
def reader(run: Path, key: ImageKey) -> RecordingReader:
    return RecordingReader.open(Run.open(run).recording_path(key))


@pytest.fixture(scope="module")
def row(dataset: Dataset, key: ImageKey) -> str:
    """The address of the row of the round part."""
    index = next(gt.index for gt in dataset.ground_truth(key) if gt.obj_id == ROUND)
    return f"row={key.scene_id},{key.im_id},{ROUND},{index},-1"


@pytest.fixture(scope="module")
def page(run: Path, serve, open_page) -> OpenedPage:
    opened = open_page(serve(run).url)
    opened.tab("EPOS")
    return opened


@pytest.fixture(scope="module")
def foreign_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of another method."""
    folder = tmp_path_factory.mktemp("foreign")
    return make_run(folder / "run", open_dataset(make_dataset(folder / "tiny")))


@pytest.fixture(scope="module")
def foreign(foreign_run: Path, serve, open_page) -> OpenedPage:
    opened = open_page(serve(foreign_run).url)
    opened.tab("EPOS")
    return opened


def middle(fragments: Probabilities) -> tuple[float, float]:
    """A pixel in the middle of the cells of a record."""
    near = np.abs(fragments.cells - fragments.cells.mean(axis=0)).sum(axis=1).argmin()
    u, v = fragments.cells[near] * fragments.cell_px + fragments.cell_px // 2
    return float(u), float(v)


def click_pixel(page: OpenedPage, dataset: Dataset, key: ImageKey, pixel: tuple[float, float]) -> None:
    x, y = page.viewport(dataset.camera(key)).window_at(*pixel)
    page.click(x, y)


def bars(page: OpenedPage) -> list[str]:
    """What the bars say of themselves: fragment and probability."""
    return page.page.locator(".pi-epos-bar:not(.pi-epos-dim) title").all_text_contents()


def count(page: OpenedPage, name: str) -> str:
    """A number of the tab by the word before it."""
    return page.page.locator(".pi-numbers:visible span", has_text=name).first.evaluate("e => e.nextSibling.textContent")


def set_slider(page: OpenedPage, label: str, value: float) -> None:
    box = page.control(label).get_by_role("textbox")
    box.fill(f"{value:g}")
    box.press("Enter")


# -------------------------------------------------------------------- layers
def test_a_chosen_layer_is_drawn_and_explained(page: OpenedPage, row: str):
    page.show(row, follow=1)
    page.eventually(lambda: "object 1" in page.panel())
    before = page.picture()
    page.choose("Over the image", "fragments")
    page.eventually(lambda: page.address().get("epos.layer") == "fragments")
    page.eventually(lambda: any("fragment's centre x" in line for line in page.legend()))
    page.eventually(lambda: (np.abs(page.picture().astype(int) - before) > 60).mean() > 0.01)
    page.choose("Over the image", "nothing")
    page.eventually(lambda: (np.abs(page.picture().astype(int) - before) > 60).mean() < 0.001)


@pytest.mark.parametrize(
    ("layer", "explained"),
    [
        ("3D fragment coordinates", "x in the fragment"),
        ("predicted 3D points", "predicted point's x"),
        ("confidence", "confidence a·b of the likeliest fragment"),
        ("this object's probability", "probability of object 1"),
        ("most likely object", "object 3"),
    ],
)
def test_every_layer_has_its_legend(page: OpenedPage, row: str, layer: str, explained: str):
    page.show(row)
    page.choose("Over the image", layer)
    page.eventually(lambda: any(line.startswith(explained) for line in page.legend()))


# -------------------------------------------------------------------- a pixel, a fragment
def test_a_clicked_pixel_has_the_ring_of_a_round_part_as_equal_bars(page, row, dataset, key, reader):
    fragments = reader.read(f"epos/fragments/{ROUND}", Probabilities)
    pixel, camera = middle(fragments), dataset.camera(key)
    center = {"center_u": pixel[0] / (camera.width - 1), "center_v": pixel[1] / (camera.height - 1)}
    page.show(row, **{"epos.layer": "fragments", "zoom": 6, **center})
    page.eventually(lambda: "object 1" in page.panel())
    page.eventually(lambda: any("fragment's centre x" in line for line in page.legend()))
    click_pixel(page, dataset, key, pixel)
    page.eventually(lambda: len(bars(page)) > 5)
    cell = np.flatnonzero((fragments.cells == np.floor((np.array(pixel) + 0.5) / 4)).all(axis=1))[0]
    expected = fragments.values[cell].astype(np.float32)
    assert len(bars(page)) == np.count_nonzero(expected > 0.5 * expected.max())
    assert len({text.split(": ")[1] for text in bars(page)}) == 1, "all equally likely"
    page.eventually(lambda: "equally likely fragments" in page.panel())
    page.reload()  # and all of that is in the address
    page.tab("EPOS")
    page.eventually(lambda: len(bars(page)) == np.count_nonzero(expected > 0.5 * expected.max()))


def test_a_click_on_the_model_shows_where_the_fragment_is_believed_to_be(page: OpenedPage, row: str):
    page.show(row, follow=1)
    image = page.page.locator(".pi-epos-sides img").first
    page.eventually(lambda: image.is_visible())
    box = image.bounding_box()
    assert box is not None
    image.click(position={"x": box["width"] / 2, "y": box["height"] / 2})
    page.eventually(lambda: page.address().get("epos.fragment", "none") != "none")
    fragment = page.address()["epos.fragment"]
    page.eventually(lambda: any(f"probability of fragment {fragment} here" in line for line in page.legend()))
    page.page.get_by_role("button", name="Show all fragments").click()
    page.eventually(lambda: "epos.fragment" not in page.address())


def test_a_bar_leads_to_its_fragment(page, row, reader):
    u, v = middle(reader.read(f"epos/fragments/{ROUND}", Probabilities))
    page.show(row, **{"epos.layer": "fragments", "epos.pixel": f"{u:g},{v:g}"})
    page.eventually(lambda: len(bars(page)) > 5)
    fragment = bars(page)[3].split()[1].rstrip(":")
    page.page.locator(".pi-epos-bar").nth(3).click()
    page.eventually(lambda: page.address().get("epos.fragment") == fragment)
    page.eventually(lambda: page.page.locator(".pi-epos-chosen").count() == 1)


# -------------------------------------------------------------------- correspondences
def test_thresholds_recompute_at_once(page: OpenedPage, row: str, reader: RecordingReader):
    recorded = reader.read(f"epos/correspondences/{ROUND}", Correspondences)
    page.show(row)
    page.eventually(lambda: count(page, "correspondences") == str(len(recorded.pixels)))
    before = int(count(page, "inliers"))
    set_slider(page, "τr [px]", 1.0)
    page.eventually(lambda: int(count(page, "inliers")) < before)
    fragments = reader.read(f"epos/fragments/{ROUND}", Probabilities)
    every = len(correspondences_from(fragments, ROUND, objects=reader.read("epos/object_probability")).pixels)
    assert every == len(recorded.pixels)
    set_slider(page, "τb", 0.0)
    page.eventually(lambda: "a pixel, anew" in page.panel())
    set_slider(page, "τa", 0.99)
    page.eventually(lambda: page.address().get("epos.tau_a") == "0.99")
    page.page.get_by_role("button", name="Thresholds of the run").click()
    page.eventually(lambda: int(count(page, "inliers")) == before)


def test_image_and_model_stand_side_by_side_in_3d(page: OpenedPage):
    page.show(f"row={TURNED_IN_2}")
    page.page.get_by_role("button", name="Image and model in 3D").click()
    page.eventually(lambda: page.address().get("view") == "scene")
    page.eventually(lambda: any(line.startswith("lines: 100 of") for line in page.legend()))
    page.eventually(lambda: _vivid(page).any(axis=0).mean() > 0.1)
    page.click(0.74, 0.44)
    page.eventually(lambda: page.address().get("epos.fragment", "none") != "none")


def _vivid(page: OpenedPage) -> np.ndarray:
    """Pixels of strong blue in the right half: of the copy of the model."""
    _, green, blue = np.moveaxis(page.picture()[:, int(page.canvas().width / 2) :].astype(int), 2, 0)
    return (blue > 150) & (blue > green + 60)


# -------------------------------------------------------------------- the search
def test_the_search_is_replayed(page: OpenedPage, row: str, reader: RecordingReader):
    hypotheses = reader.read(f"epos/hypotheses/{ROUND}", Hypotheses)
    page.show(row)
    step = int(np.flatnonzero([label.startswith("optimized") for label in hypotheses.labels])[0])
    set_slider(page, "Hypothesis", step + 1)
    said = f"{step + 1} of {len(hypotheses.quality)}: optimized"
    page.eventually(lambda: said in page.panel())
    page.eventually(lambda: f"to {hypotheses.quality[step]:.3f}" in page.panel())
    page.eventually(lambda: any(line.startswith("before local optimization") for line in page.legend()))
    page.page.get_by_role("button", name="▶").click()
    page.eventually(lambda: page.address().get("epos.hypothesis") == str(step + 1))
    assert "why it stopped" in page.panel()
    page.reload()
    page.tab("EPOS")
    page.eventually(lambda: f"{step + 2} of {len(hypotheses.quality)}" in page.panel())
    page.page.get_by_role("button", name="Play").click()
    page.eventually(lambda: int(page.address()["epos.hypothesis"]) > step + 3)
    page.page.get_by_role("button", name="Play").click()


# -------------------------------------------------------------------- other images, other runs
def test_an_image_without_a_recording_says_so(page: OpenedPage, dataset: Dataset, key: ImageKey):
    other = next(image for image in dataset.images() if image != key)
    page.show(f"row={other.scene_id},{other.im_id},{ROUND},0,-1", **{"epos.layer": "fragments"})
    page.eventually(lambda: "The run has no recording of this image" in page.panel())
    page.eventually(lambda: any("no recording of this image" in line for line in page.legend()))


def test_without_a_run_there_is_no_tab(demo: Path, serve, open_page):
    plain = open_page(serve(demo).url)
    assert "EPOS" not in plain.page.get_by_role("tab").all_inner_texts()
    plain.close()


def test_another_methods_beliefs_are_shown(foreign: OpenedPage):
    foreign.show(f"row={FIRST.scene_id},{FIRST.im_id},2,2,-1&epos.layer=fragments&epos.links=all")
    foreign.eventually(lambda: "Not recorded: hypotheses." in foreign.panel())
    foreign.eventually(lambda: "2.0 a pixel, fitted" in foreign.panel())
    foreign.eventually(lambda: any("fragment's centre x" in line for line in foreign.legend()))
    foreign.eventually(lambda: "of the estimate, 100%" in foreign.panel())


def test_of_another_method_what_was_logged_works(foreign: OpenedPage):
    foreign.show(f"row={SECOND.scene_id},{SECOND.im_id},1,0,-1&epos.layer=coordinates")
    foreign.eventually(lambda: any("were not recorded" in line for line in foreign.legend()))
    foreign.choose("Over the image", "fragments")
    foreign.eventually(lambda: not any("were not recorded" in line for line in foreign.legend()))
    foreign.eventually(lambda: "a pixel, anew" in foreign.panel())


def test_a_damaged_recording_is_named(foreign: OpenedPage, foreign_run: Path):
    path = Run.open(foreign_run).recording_path(SECOND)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    foreign.show(f"row={SECOND.scene_id},{SECOND.im_id},1,0,-1&epos.layer=points")
    foreign.eventually(lambda: any(path.name in line for line in foreign.legend()))
    foreign.show(f"row={FIRST.scene_id},{FIRST.im_id},2,2,-1&epos.layer=points")
    foreign.eventually(lambda: any("predicted point's x" in line for line in foreign.legend()))
