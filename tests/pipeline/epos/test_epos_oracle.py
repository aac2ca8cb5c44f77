"""The oracle in the place of the network, and what recordings lead to with other thresholds."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_dataset import FIRST, make_dataset

from pipeline.bop.dataset import open_dataset
from pipeline.epos.config import CorrespondenceConfig
from pipeline.epos.oracle import OracleNoise, OracleSettings, disturbed, make_oracle, record_oracle
from pipeline.epos.recomputing import correspondences_from, inliers, potential, residuals
from pipeline.exceptions import InputError
from pipeline.recording import Probabilities, RecordingReader
from pipeline.run import Run

OBJ_ID = 1


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> RecordingReader:
    """The first image of the tiny dataset, as the oracle sees it with 8 fragments."""
    folder = tmp_path_factory.mktemp("oracle")
    run = record_oracle(make_dataset(folder / "tiny"), folder / "run", images=1, settings=OracleSettings(fragments=8))
    assert Run.open(run).finished_images() == (FIRST,)
    return RecordingReader.open(Run.open(run).recording_path(FIRST))


def test_oracle_records_all_that_a_network_would_and_the_targets(recorded):
    kinds = recorded.kinds()
    names = ("fragments", "fragment_model", "correspondences", "hypotheses", "fitting", "targets/fragments")
    assert {f"epos/{name}/{obj_id}" for name in names for obj_id in (1, 2)} <= set(kinds)
    shown = recorded.read("epos/targets/object")
    assert (shown.values.shape, shown.cell_px) == ((12, 16), 4)
    assert set(np.unique(shown.values)) == {0, 1, 2}
    targets = recorded.read(f"epos/targets/fragments/{OBJ_ID}").columns
    assert set(targets["instance"]) == {0, 1}  # two boxes of this kind
    np.testing.assert_array_equal(targets["pixels"], targets["cells"] * 4 + 1.5)
    fragments = recorded.read(f"epos/fragments/{OBJ_ID}")
    np.testing.assert_array_equal(fragments.cells, targets["cells"])
    own = fragments.points_in_model[np.arange(len(targets["fragment"])), targets["fragment"]]
    np.testing.assert_allclose(own, targets["points_in_model"], atol=1e-4)
    assert "the ground truth stands in the place of the network" in {text.text for text in recorded.read_all("log")}


def test_symmetric_fragments_are_equally_likely(recorded):
    """Box 2 looks the same turned by half about z: two fragments share each cell, or one that is its own twin."""
    values = recorded.read("epos/fragments/2").values
    assert set(np.unique(values)) <= {0, 0.5, 1}
    assert (values == 0.5).any()


def test_recorded_probabilities_give_the_recorded_correspondences(recorded):
    a, b = recorded.read("epos/object_probability"), recorded.read(f"epos/fragments/{OBJ_ID}")
    given = potential(recorded.read(f"epos/correspondences/{OBJ_ID}"))
    again = correspondences_from(b, OBJ_ID, objects=a)
    np.testing.assert_array_equal(again.pixels, given.pixels)
    np.testing.assert_array_equal(again.fragment_ids, given.fragment_ids)
    np.testing.assert_allclose(again.points_in_model, given.points_in_model, atol=1e-4)
    np.testing.assert_allclose(again.confidence, given.confidence, atol=1e-3)
    model = recorded.read(f"epos/fragment_model/{OBJ_ID}").columns
    config = CorrespondenceConfig(regression=False)
    centred = correspondences_from(b, OBJ_ID, centers=model["centre_in_model"], config=config)
    np.testing.assert_array_equal(centred.points_in_model, model["centre_in_model"][centred.fragment_ids])


def test_thresholds_select():
    values = np.array([[0.5, 0.3, 0.2], [0.9, 0.05, 0.05]], np.float16)
    cells, points = np.array([[1, 0], [2, 1]], np.int16), np.arange(18, dtype=np.float16).reshape(2, 3, 3)
    b = Probabilities(values, cells, (2, 4), 4, ("0", "1", "2"), points)
    a = Probabilities(np.array([[0.4, 0.6], [0.8, 0.2]], np.float16), cells, (2, 4), 4, ("background", "7"))

    def found(tau_a: float, tau_b: float) -> list[tuple[int, int]]:
        c = correspondences_from(b, 7, objects=a, config=CorrespondenceConfig(tau_a, tau_b))
        assert c.fragment_ids is not None
        return list(zip(c.pixel_ids.tolist(), c.fragment_ids.tolist(), strict=True))

    assert found(0.1, 0.5) == [(1, 0), (1, 1), (6, 0)]
    assert found(0.1, 0.3) == [(1, 0), (1, 1), (1, 2), (6, 0)]
    assert found(0.3, 0.5) == [(1, 0), (1, 1)]
    whole = correspondences_from(b, 7)
    np.testing.assert_allclose(whole.confidence, [0.5, 0.3, 0.9], atol=1e-3)  # a is 1 where it was not recorded
    with pytest.raises(
        InputError, match="object 9: is not in the recorded object probabilities; available: background, 7"
    ):
        correspondences_from(b, 9, objects=a)
    with pytest.raises(InputError, match="no 3D points of the fragments were recorded"):
        correspondences_from(replace(b, points_in_model=None), 7)
    with pytest.raises(InputError, match="without regression the fragments' centres are needed"):
        correspondences_from(b, 7, config=CorrespondenceConfig(regression=False))


def test_inliers_are_the_best_of_each_pixel_below_the_threshold(recorded):
    c, K = potential(recorded.read(f"epos/correspondences/{OBJ_ID}")), recorded.view.K
    truth = next(truth for truth in recorded.ground_truth() if truth.obj_id == OBJ_ID).camera_from_model
    errors = residuals(c, K, truth)
    rows = inliers(c, K, truth, tau_r=2.0)
    assert len(rows) > 5
    assert len(set(c.pixel_ids[rows])) == len(rows)
    for row in rows:
        assert errors[row] == errors[c.pixel_ids == c.pixel_ids[row]].min() < 2.0
    assert set(c.pixel_ids[errors < 2.0]) == set(c.pixel_ids[rows])
    behind = truth.copy()
    behind[2, 3] = -1.0
    assert np.isinf(residuals(c, K, behind)).all()


def test_noise_is_as_large_as_told(tmp_path):
    estimator = make_oracle(OracleSettings(fragments=8), open_dataset(make_dataset(tmp_path / "tiny")))
    image = estimator.oracle.dataset.image(FIRST)
    exact = estimator.oracle.see(image).about(0, 1, 0.1)
    many = replace(
        exact,
        **{
            name: np.tile(getattr(exact, name), (40, *[1] * (getattr(exact, name).ndim - 1)))
            for name in ("cells", "object_probability", "fragment_probability", "coordinates")
        },
    )
    rng = np.random.default_rng(0)
    assert len(disturbed(many, OracleNoise(lost=0.3), rng).cells) == pytest.approx(0.7 * len(many.cells), rel=0.1)
    moved = disturbed(many, OracleNoise(coordinates=0.2), rng).coordinates - many.coordinates
    assert moved.std() == pytest.approx(0.2, rel=0.05)
    doubted = disturbed(many, OracleNoise(doubted=0.4), rng).fragment_probability
    changed = (doubted != many.fragment_probability).any(axis=1).mean()
    assert changed == pytest.approx(0.4 * 7 / 8, abs=0.05)  # of eight fragments one is the right one
    np.testing.assert_allclose(doubted.sum(axis=1), 1, atol=1e-6)
    untouched = disturbed(many, OracleNoise(), rng)
    np.testing.assert_array_equal(untouched.coordinates, many.coordinates)
    with pytest.raises(InputError, match=r"oracle: lost is 1\.5; expected 0 to 1"):
        OracleNoise(lost=1.5)
