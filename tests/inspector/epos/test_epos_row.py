"""What the view of EPOS computes from a recording, here of a method that is not ours."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from third_party_method import CELL_PX, corners
from tiny_dataset import ANNOTATED, FIRST, SECOND

from inspector.epos.choice import NO_PIXEL, EposChoice
from inspector.epos.colors import UNLIT, extent_of, fragment_colors, lit
from inspector.epos.figures import as_many
from inspector.epos.layers import GridLayer, layer_of
from inspector.epos.recording import EposRecording
from inspector.epos.row import EposRow
from inspector.epos.telling import about_cell, about_matches, header
from inspector.epos.thresholds import Thresholds, thresholds_of
from inspector.opening import open_workspace
from inspector.selection import RowKey
from pipeline.recording import Probabilities, RecordingReader
from pipeline.run import Run
from pipeline.scene import Camera, ImageKey


def on_box_2(row: EposRow) -> tuple[float, float]:
    """A pixel that shows box 2."""
    assert row.recording.fragments is not None
    u, v = row.recording.fragments.cells[len(row.recording.fragments.cells) // 2] * CELL_PX
    return float(u), float(v)


def layer(row: EposRow) -> GridLayer:
    found = layer_of(row, 1.0)
    assert isinstance(found, GridLayer), found
    return found


def test_a_clicked_pixel_has_the_distribution_that_was_logged(row_of):
    row = row_of()
    clicked = row_of(pixel=on_box_2(row))
    assert clicked.cell is not None
    assert sorted(clicked.cell.probabilities.tolist())[-2:] == pytest.approx([1 / 2.12] * 2, abs=1e-3)
    assert clicked.cell.certainty == pytest.approx(0.9)
    assert clicked.weights is not None
    assert np.count_nonzero(clicked.weights > 0.99) == 2, "both of the corners that look alike are lit"
    assert clicked.candidates is not None
    first, second = clicked.candidates[0]
    assert first[:2] == pytest.approx(-second[:2]), "its points are half a turn apart"


def test_a_pixel_beside_the_object_says_so(row_of):
    row = row_of(pixel=(0.0, 0.0))
    assert row.cell is None
    assert row.weights is None
    assert "Pixel 0, 0: object 2 is not likely here" in about_cell(row)


@pytest.mark.parametrize("offset", [0.0, CELL_PX - 1.0])
def test_all_pixels_of_a_cell_are_that_cell(row_of, offset):
    u, v = on_box_2(row_of())
    cell = row_of(pixel=(u + offset, v + offset)).cell
    assert cell is not None
    assert cell.center == (u + 0.5, v + 0.5)


def test_fragments_have_the_colours_of_their_places(row_of):
    row = row_of()
    assert row.model is not None
    shares = (corners(2) - row.model.vertices.min(axis=0)) / np.ptp(row.model.vertices, axis=0)
    assert np.array_equal(row.colors, (25 + 230 * shares).astype(np.uint8))


def test_without_centres_colours_are_spread():
    colors = fragment_colors(None, None, 5)
    assert len(np.unique(colors, axis=0)) == 5


def test_only_what_is_meant_is_lit():
    colors = np.array([[200, 0, 0], [0, 200, 0]], np.uint8)
    shown = lit(colors, np.array([1.0, 0.0]))
    assert shown.tolist() == [[200, 0, 0], list(UNLIT)]
    assert lit(colors, None) is colors


def test_a_flat_box_has_colours_too():
    flat = np.array([[0.0, 0, 0], [1, 1, 0]])
    assert extent_of(flat).colors(flat)[:, 2].tolist() == [25, 25]


def test_uncertainty_is_told_as_equally_likely_fragments():
    assert as_many(np.full(8, 1 / 8)) == pytest.approx(8)
    assert as_many(np.array([1.0, 0, 0])) == pytest.approx(1)
    assert as_many(np.zeros(3)) == 0


@pytest.mark.parametrize("name", ["object", "objects", "fragments", "points", "confidence"])
def test_layers_cover_the_object_and_nothing_else(row_of, name):
    row = row_of(layer=name)
    assert row.recording.fragments is not None
    found = layer(row)
    shown = found.pixels[..., 3] > 60
    x, y = row.recording.fragments.cells.T
    assert shown[y, x].all()
    others = np.ones(shown.shape, bool)
    others[y, x] = False
    if name == "objects":  # also the boxes of the other kind
        assert [text for text, _ in found.notes] == ["object 1", "object 2"]
    else:
        assert not shown[others].any()


def test_predicted_points_have_the_colours_of_their_places(row_of):
    row = row_of(layer="points")
    fragments = row.recording.fragments
    assert fragments is not None
    assert row.extent is not None
    assert row.recording.likeliest is not None
    k = len(fragments.cells) // 2
    point = fragments.points_in_model[k, row.recording.likeliest[k]]
    x, y = fragments.cells[k]
    assert layer(row).pixels[y, x, :3].tolist() == row.extent.colors(point).tolist()


def test_a_fragment_is_shown_where_it_is_believed_to_be(row_of):
    pixel = on_box_2(row_of())
    cell = row_of(pixel=pixel).cell
    assert cell is not None
    fragment = int(cell.probabilities.argmax())
    found = layer(row_of(fragment=fragment))
    x, y = int(pixel[0]) // CELL_PX, int(pixel[1]) // CELL_PX
    assert found.pixels[y, x, 3] == 255
    assert f"fragment {fragment}" in [text for text, _ in found.notes]


def test_a_fragment_that_the_object_does_not_have_is_none(row_of):
    assert row_of(fragment=8).fragment is None
    assert layer_of(row_of(fragment=99), 1.0) is None


def test_what_was_not_logged_is_said_in_one_line_and_the_rest_works(row_of):
    row = row_of(layer="coordinates")  # this method has no sizes of fragments
    assert "3D fragment coordinates of object 2 were not recorded" in str(layer_of(row, 1.0))
    assert "Not recorded: hypotheses." in header(row)
    second = row_of(RowKey(*SECOND, 1, 0, -1), layer="fragments")
    assert "Not recorded: fragment centres, correspondences, hypotheses." in header(second)
    assert layer(second).pixels.any()
    assert second.matches is not None
    assert not second.matches.recorded, "they follow from the probabilities"


def test_recorded_correspondences_are_inliers_of_the_true_pose(row_of):
    matches = row_of().matches
    assert matches is not None
    assert matches.recorded
    assert len(matches.links) == 2 * matches.pixels
    assert len(matches.inliers) == matches.pixels
    assert matches.residuals[matches.inliers].max() < 1.5
    assert matches.quality > 0.8
    assert not len(matches.unexplained)


def test_a_higher_tau_a_leaves_none(row_of):
    assert len(row_of(tau_a=0.85).matches.links) == len(row_of().matches.links)
    none = row_of(tau_a=0.95).matches
    assert not none.recorded
    assert len(none.links) == none.pixels == none.quality == 0
    assert '<b class="">0</b>' in about_matches(row_of(tau_a=0.95))


def test_a_lower_tau_b_takes_all_fragments(row_of):
    usual, all_of_them = row_of().matches, row_of(tau_b=0.0).matches
    assert len(all_of_them.links) == 8 * usual.pixels
    assert len(all_of_them.inliers) == usual.pixels


def test_tau_r_decides_which_are_inliers(row_of):
    counts = [len(row_of(tau_r=value).matches.inliers) for value in (0.01, 0.5, 1.5)]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_before_there_are_estimates_the_ground_truth_is_the_pose(row_of):
    row = row_of()
    assert row.pose is not None
    assert row.pose.name == "the ground truth"
    assert row.pose.camera_from_model == pytest.approx(ANNOTATED[FIRST][2][1], abs=1e-6)


def test_thresholds_come_from_the_settings_of_the_run(workspace, tmp_path):
    assert thresholds_of(workspace) == (0.1, 0.5, 4.0), "this run names none"
    config = {"deep": {"min_fragment_probability": 0.25}, "inlier_threshold_px": 3}
    with Run.create(tmp_path / "run", dataset=workspace.dataset, method="other", config=config):
        pass
    assert thresholds_of(open_workspace(tmp_path / "run")) == Thresholds(0.1, 0.25, 3.0)


def test_a_row_of_another_image_forgets_pixel_and_hypothesis():
    choice = EposChoice(layer="points", pixel=(4.0, 5.0), fragment=3, hypothesis=7, tau_a=0.2)
    assert choice.elsewhere(same_image=True) == replace(choice, fragment=None, hypothesis=None)
    assert choice.elsewhere(same_image=False).pixel == NO_PIXEL


def recorded(folder: Path, **records) -> RecordingReader:
    """A recording of one image with these records at `epos/NAME`."""
    key = ImageKey(1, 0)
    camera = Camera(np.array([[80.0, 0, 32], [0, 80, 24], [0, 0, 1]]), 64, 48)
    with Run.create(folder / "run", dataset=Named(), method="odd") as run:
        with run.recorder(key, camera) as recorder:
            for name, record in records.items():
                recorder.log(f"epos/{name.replace('__', '/')}", record)
        run.add(key, [])
        return RecordingReader.open(run.recording_path(key))


class Named(NamedTuple):
    """Stands for a dataset where only its name counts."""

    name: str = "odd"
    split: str = "test"
    root: Path = Path("odd")


def test_numbers_that_are_none_and_cells_beyond_the_grid_are_left_out(tmp_path):
    values = np.array([[np.nan, 1.0], [0.5, 0.5], [0.2, 0.8]])
    cells = np.array([[0, 0], [-1, 1], [-1, 2]])
    found = EposRecording(recorded(tmp_path, fragments__1=Probabilities(values, cells, (3, 4), 4)), 1)
    assert found.fragments is not None
    assert found.fragments.values.tolist() == [[0.0, 1.0]]
    assert found.certainty is not None
    assert found.certainty.tolist() == [1.0]
    assert found.centers is None
