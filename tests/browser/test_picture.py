"""The picture: silhouettes and the image lie in the window where the address bar says they do."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from opened_page import OpenedPage
from silhouettes import distances, outline

from inspector.layers import ESTIMATE, GROUND_TRUTH
from pipeline.bop.assessment import assess
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import Results, read_results
from pipeline.geometry import project
from pipeline.rendering import render
from pipeline.scene import ImageKey, PoseEstimate

IMAGE = ImageKey(2, 3)
"""The one with depth."""
FILL = 0.45
"""Opacity of a filled silhouette at full opacity of the layers."""
SILHOUETTE = "display.image=0&display.witness=0&display.style=fill&display.opacity=1"
WINDOWS = [(1300, 720), (1500, 420), (1120, 800)]
"""Sizes of the browser; the panels take 864 pixels of the width."""


@pytest.fixture(scope="module")
def dataset(lmo: Path) -> Dataset:
    return open_dataset(lmo)


@pytest.fixture(scope="module")
def results(lmo: Path) -> Results:
    return read_results(lmo / "results" / "megapose_lmo-test.csv")


@pytest.fixture(scope="module")
def page(lmo: Path, serve, open_page) -> OpenedPage:
    server = serve(lmo, "--results", lmo / "results" / "megapose_lmo-test.csv")
    return open_page(server.url)


class Row(NamedTuple):
    """A row of the table with a good estimate."""

    query: str
    """How the address bar names it."""
    estimate: PoseEstimate
    u: float
    v: float
    """Middle of the object, as shares of the image's width and height."""


@pytest.fixture(scope="module")
def row(dataset: Dataset, results: Results) -> Row:
    found = assess(dataset, results)
    best = int(np.argmin(np.where(found.im_id == IMAGE.im_id, found.mssd, np.inf)))
    key = ",".join(str(int(column[best])) for column in (found.scene_id, found.im_id, found.obj_id, found.gt_index))
    estimate, camera = results.estimate(int(found.estimate[best])), dataset.camera(IMAGE)
    u, v = project(camera.K, estimate.camera_from_model[:3, 3])
    return Row(f"row={key},-1", estimate, u / (camera.width - 1), v / (camera.height - 1))


def resize(page: OpenedPage, size: tuple[int, int]) -> None:
    page.page.set_viewport_size({"width": size[0], "height": size[1]})
    page.eventually(lambda: page.canvas().height == size[1])


def colorfulness(picture: np.ndarray, color: tuple[int, int, int]) -> tuple[np.ndarray, float]:
    """How much of a layer's colour is in each pixel, and the level at the edge of what is filled."""
    strongest = int(np.argmax(color))
    values = picture[..., strongest].astype(int) - picture[..., 0]
    return values, (color[strongest] - color[0]) * FILL / 2


def check_silhouette(
    page: OpenedPage, dataset: Dataset, obj_id: int, camera_from_model: np.ndarray, color: tuple[int, int, int]
) -> None:
    """The outline in the window lies where the model projects to, up to half a pixel of the coarser of both grids."""
    camera = dataset.camera(IMAGE)
    seen = outline(*colorfulness(page.picture(), color))
    assert len(seen) > 60, "no silhouette in the picture"
    viewport = page.viewport(camera)
    found = distances(seen, viewport, dataset.model(obj_id), camera_from_model)
    unit = max(1.0, 1.0 / viewport.scale)
    off, gap = np.percentile(found.of_seen, 99), np.percentile(found.of_expected, 99)
    told = f"off by {found.of_seen.mean():.3f} px in the mean, {off:.3f} px at 99 %; gaps of {gap:.3f} px"
    assert found.of_seen.mean() < 0.4 * unit, told
    assert off < 1.0 * unit, told
    assert gap < 1.0 + 1.0 / viewport.scale, told  # points of the outline seen are a pixel of the window apart


def check_estimate(page: OpenedPage, dataset: Dataset, row: Row) -> bool:
    check_silhouette(page, dataset, row.estimate.obj_id, row.estimate.camera_from_model, ESTIMATE)
    return True


@pytest.mark.parametrize("size", WINDOWS, ids=str)
@pytest.mark.parametrize(("zoom", "aside"), [(1, None), (2.5, 0.1), (9, 0.01)], ids=["1", "2.5", "9"])
def test_the_silhouette_of_the_estimate_lies_on_the_image(
    page: OpenedPage, dataset: Dataset, row: Row, size: tuple[int, int], zoom: float, aside: float | None
):
    resize(page, size)
    center = {} if aside is None else {"center_u": f"{row.u + aside:.4g}", "center_v": f"{row.v - aside:.4g}"}
    page.show(f"{row.query}&{SILHOUETTE}&display.ground_truth=0", zoom=zoom, **center)
    page.eventually(lambda: check_estimate(page, dataset, row))


def test_the_silhouette_of_the_ground_truth_lies_on_the_image(page: OpenedPage, dataset: Dataset, row: Row):
    resize(page, WINDOWS[0])
    page.show(f"{row.query}&{SILHOUETTE}&display.estimate=0", zoom=3, center_u=f"{row.u:.4g}", center_v=f"{row.v:.4g}")
    truth = next(gt for gt in dataset.ground_truth(IMAGE) if gt.obj_id == row.estimate.obj_id)
    pose = truth.camera_from_model

    def check() -> bool:
        check_silhouette(page, dataset, truth.obj_id, pose, GROUND_TRUTH)
        return True

    page.eventually(check)


def test_keys_zoom_to_the_object_hide_the_image_and_fill_the_silhouette(page: OpenedPage, dataset: Dataset, row: Row):
    page.show(f"{row.query}&display.ground_truth=0&display.witness=0&display.opacity=1")
    page.click(0.02, 0.98)  # into the picture, where nothing is hit
    page.press("z")
    page.eventually(lambda: "zoom" in page.address())
    page.press("i")
    page.eventually(lambda: page.address().get("display.image") == "0")
    page.press("c")
    page.eventually(lambda: page.address().get("display.style") == "fill")
    assert float(page.address()["zoom"]) > 2
    page.eventually(lambda: check_estimate(page, dataset, row))


def test_dragging_and_the_wheel_keep_the_silhouette_on_the_image(page: OpenedPage, dataset: Dataset, row: Row):
    page.show(
        f"{row.query}&{SILHOUETTE}&display.ground_truth=0", zoom=3, center_u=f"{row.u:.4g}", center_v=f"{row.v:.4g}"
    )
    before = page.viewport(dataset.camera(IMAGE))
    page.move_to(0.5, 0.5)
    page.page.mouse.down()
    page.move_to(0.6, 0.55)
    page.page.mouse.up()
    page.eventually(lambda: page.address().get("center_u") != f"{row.u:.4g}")
    # The point that was taken hold of came along (the picture turns a little while it is dragged).
    page.eventually(lambda: np.allclose(page.viewport(before.camera).window_at(*before.center), (0.6, 0.55), atol=0.01))
    page.eventually(lambda: check_estimate(page, dataset, row))
    held = page.viewport(before.camera).pixel_at(0.6, 0.55)
    page.page.mouse.wheel(0, -300)
    page.eventually(lambda: float(page.address()["zoom"]) > 4)
    assert np.allclose(page.viewport(before.camera).window_at(*held), (0.6, 0.55), atol=0.01)
    page.eventually(lambda: check_estimate(page, dataset, row))


@pytest.mark.parametrize(("size", "zoom"), [(WINDOWS[0], 1.5), (WINDOWS[0], 6), (WINDOWS[2], 3)])
def test_the_image_lies_where_its_pixels_are_said_to_be(
    page: OpenedPage, dataset: Dataset, row: Row, size: tuple[int, int], zoom: float
):
    resize(page, size)
    nothing = "display.ground_truth=0&display.estimate=0&display.witness=0"
    page.show(f"{row.query}&{nothing}", zoom=zoom, center_u=0.52, center_v=0.45)
    rgb = dataset.rgb(IMAGE)
    assert rgb is not None

    def check() -> bool:
        picture, viewport = page.picture(), page.viewport(dataset.camera(IMAGE))
        size = (viewport.window_width, viewport.window_height)
        corners = np.array([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]])
        pixels = np.array([viewport.pixel_at(*corner) for corner in corners])
        (left, top), (right, bottom) = np.ceil(np.maximum(pixels.min(axis=0), 0)), np.floor(pixels.max(axis=0))
        shape = (_transformable(min(right, 639) - left), _transformable(min(bottom, 479) - top))
        # The window shows the image plane at a slant, which is a homography: four points define it.
        to_grid = cv2.getPerspectiveTransform(
            (corners * size - 0.5).astype(np.float32), (pixels - (left, top)).astype(np.float32)
        )
        seen = _gray(cv2.warpPerspective(picture, to_grid, shape))
        expected = _gray(rgb[int(top) : int(top) + shape[1], int(left) : int(left) + shape[0]])
        window = cv2.createHanningWindow(seen.shape[::-1], cv2.CV_64F)
        (du, dv), response = cv2.phaseCorrelate(expected, seen, window)
        assert response > 0.3, response
        assert np.hypot(du, dv) < 0.2, (du, dv)
        return True

    page.eventually(check)


def test_the_readout_says_what_is_under_the_mouse(page: OpenedPage, dataset: Dataset, row: Row):
    page.show(row.query, zoom=2.5, center_u=f"{row.u:.4g}", center_v=f"{row.v:.4g}")
    viewport, depth = page.viewport(dataset.camera(IMAGE)), dataset.depth(IMAGE)
    assert depth is not None
    for x, y in ((0.5, 0.5), (0.3, 0.6)):
        page.move_to(x, y)
        u, v = viewport.pixel_at(x, y)
        measured = depth[round(v), round(u)] * 1000
        said = f"u {u:7.1f}  v {v:7.1f}"
        page.eventually(lambda said=said: _about_equal(page.readout(), said))
        if measured > 0:
            assert f"depth {measured:.1f} mm" in page.readout()
            assert "camera (" in page.readout()
        else:
            assert "depth not measured here" in page.readout()


def test_the_readout_without_depth_and_outside_of_the_image(page: OpenedPage):
    page.show("row=2,47,1,0,-1")
    page.move_to(0.5, 0.5)
    page.eventually(lambda: "no depth in this image" in page.readout())
    page.move_to(0.5, 0.02)
    page.eventually(lambda: not page.page.locator(".pi-readout").is_visible())


def test_a_click_selects_the_object_under_the_mouse(page: OpenedPage, dataset: Dataset, row: Row):
    other = next(gt for gt in dataset.ground_truth(IMAGE) if gt.obj_id != row.estimate.obj_id)
    page.show(row.query)
    mask = render(dataset.model(other.obj_id), dataset.camera(IMAGE), other.camera_from_model).mask
    depths = [
        render(dataset.model(gt.obj_id), dataset.camera(IMAGE), gt.camera_from_model).depth
        for gt in dataset.ground_truth(IMAGE)
    ]
    nearest = np.min([np.where(depth > 0, depth, np.inf) for depth in depths], axis=0)
    mask &= render(dataset.model(other.obj_id), dataset.camera(IMAGE), other.camera_from_model).depth <= nearest
    inner = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    v, u = np.unravel_index(int(inner.argmax()), inner.shape)
    page.click(*page.viewport(dataset.camera(IMAGE)).window_at(float(u), float(v)))
    page.eventually(lambda: page.address()["row"] == f"2,3,{other.obj_id},{other.index},-1")
    page.eventually(lambda: f"object {other.obj_id}" in page.legend()[0])


def test_the_3d_view_shows_the_scene(page: OpenedPage, row: Row):
    page.show(row.query)
    flat = page.picture()
    page.press("2")
    page.eventually(lambda: page.address().get("view") == "scene")
    page.settled()

    def check() -> bool:
        picture = page.picture()
        assert np.abs(picture.astype(int) - flat).mean() > 10
        values, level = colorfulness(picture, GROUND_TRUTH)
        assert (values > level).sum() > 200, "no model at the ground truth"
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500, "no point cloud"
        return True

    page.eventually(check, 60)
    page.press("1")
    page.eventually(lambda: page.address().get("view", "image") == "image")
    page.eventually(lambda: np.abs(page.picture().astype(int) - flat).mean() < 1)


def test_the_3d_view_without_depth_says_so(page: OpenedPage):
    page.show("row=2,47,1,0,-1&view=scene")
    page.eventually(lambda: "no depth in this image: no point cloud" in page.legend())


def test_without_depth_the_depth_layer_says_so(page: OpenedPage):
    page.show("row=2,47,1,0,-1&display.depth=depth")
    page.eventually(lambda: any(line.startswith("no depth in this image") for line in page.legend()))


def test_the_depth_layer_has_a_scale(page: OpenedPage, row: Row):
    page.show(f"{row.query}")
    before = page.picture()
    page.press("h")
    page.eventually(lambda: page.address().get("display.depth") == "depth")
    page.eventually(lambda: any("depth" in line and " m" in line for line in page.legend()))
    page.eventually(lambda: np.abs(page.picture().astype(int) - before).mean() > 20)


def test_the_opacity_changes_the_depth_layer(page: OpenedPage, row: Row):
    page.show(f"{row.query}&display.depth=depth&display.opacity=1")
    full = page.picture().astype(int)
    page.show(f"{row.query}&display.depth=depth&display.opacity=0.2")
    page.eventually(lambda: np.abs(page.picture() - full).mean() > 10)


def test_the_picture_is_saved(page: OpenedPage, dataset: Dataset, row: Row, tmp_path: Path):
    page.show(row.query)
    with page.page.expect_download() as download:
        page.press("k")
    download.value.save_as(tmp_path / "saved.png")
    assert download.value.suggested_filename.endswith(".png")
    saved = cv2.imread(str(tmp_path / "saved.png"))
    assert saved.shape == (960, 1280, 3)  # twice the image
    rgb = dataset.rgb(IMAGE)
    assert rgb is not None
    small = cv2.cvtColor(cv2.resize(saved, (640, 480), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)
    same = np.abs(small.astype(int) - rgb).max(axis=2) <= 3
    assert 0.8 < same.mean() < 1.0  # the image, but for the outlines on it


@pytest.mark.parametrize("style", ["wireframe", "shaded"])
def test_other_styles_are_drawn(page: OpenedPage, row: Row, style: str):
    zoomed = {"zoom": 4, "center_u": f"{row.u:.4g}", "center_v": f"{row.v:.4g}"}
    page.show(f"{row.query}&display.image=0&display.witness=0&display.style={style}&display.estimate=0", **zoomed)

    def check() -> bool:
        values, level = colorfulness(page.picture(), GROUND_TRUTH)
        assert (values > level / 2).sum() > 300
        return True

    page.eventually(check)


def test_blinking_shows_ground_truth_and_estimate_in_turn(page: OpenedPage, row: Row):
    page.show(f"{row.query}&{SILHOUETTE}&display.blink=1")

    def shows(color: tuple[int, int, int]) -> bool:
        values, level = colorfulness(page.picture(), color)
        return bool((values > level).sum() > 100)

    for color in (GROUND_TRUTH, ESTIMATE) * 2:
        page.eventually(lambda color=color: shows(color))
    page.show(f"{row.query}&{SILHOUETTE}")
    page.eventually(lambda: shows(ESTIMATE))


def _transformable(size: float) -> int:
    """The largest size up to this for which OpenCV's phase correlation pads nothing: padding would shift its answer."""
    found = int(size)
    while found % 2 or cv2.getOptimalDFTSize(found) != found:
        found -= 1
    return found


def _gray(rgb: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float64)


def _about_equal(readout: str, said: str) -> bool:
    """Whether the readout begins with the numbers that are said, up to the digits that the address bar leaves out."""
    found, expected = (np.array(text.split()[1:4:2], float) for text in (readout + " " * 9, said) if text.strip())
    return bool(np.abs(found - expected).max() <= 0.3)
