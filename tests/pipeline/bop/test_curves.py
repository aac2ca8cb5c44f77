import numpy as np
import pytest

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.curves import curves, curves_by, visibility_bins
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.evaluation.scores import FoundInstances, average_recalls
from pipeline.bop.results import read_results
from tests.conftest import REPOSITORY


def instances(fractions: list[float], found: list[int], vsd: np.ndarray | None = None) -> FoundInstances:
    """Instances of objects 1 and 2 in turn, each found by MSSD from a threshold on, by MSPD never."""
    n = len(fractions)
    mssd = np.arange(10) >= np.array(found)[:, None]
    ids = np.arange(n)
    return FoundInstances(ids, ids, 1 + ids % 2, ids, np.array(fractions), mssd, np.zeros_like(mssd), vsd)


def test_recalls_over_thresholds():
    found = curves(instances([1.0] * 4, [0, 5, 5, 10]))
    assert found.count == 4
    assert found.mssd.tolist() == [0.25] * 5 + [0.75] * 5
    assert found.mspd.tolist() == [0.0] * 10
    assert found.vsd is None
    assert found.vsd_by_visibility is None


def test_each_object_has_its_curves():
    found = curves_by(instances([1.0] * 4, [0, 10, 0, 5]), np.array([1, 2, 1, 2]))
    assert {obj_id: curve.mssd[-1] for obj_id, curve in found.items()} == {1: 1.0, 2: 0.5}
    assert found[2].count == 2


def test_average_recall_over_visibility_with_the_number_of_instances():
    found = curves(instances([0.05, 0.95, 0.97, 1.0, np.nan], [10, 0, 5, 10, 0]))
    assert found.per_visibility.tolist() == [1, 0, 0, 0, 0, 0, 0, 0, 0, 3]
    assert found.mssd_by_visibility[[0, 9]].tolist() == [0.0, 0.5]
    assert np.isnan(found.mssd_by_visibility[1:9]).all()


def test_limits_of_the_bins():
    fractions = np.array([0.0, 0.1, 0.2, 0.3, 0.7, 0.999, 1.0, np.nan, 0.29999])
    assert visibility_bins(fractions).tolist() == [0, 1, 2, 3, 7, 9, 9, -1, 2]


def test_curves_of_the_demo_average_to_the_scores():
    demo = REPOSITORY / "assets" / "demo"
    results = read_results(demo / "results" / "perturbed-2_demo-test.csv")
    evaluation = evaluate(open_dataset(demo), results)
    scores, found = average_recalls(evaluation.instances), curves(evaluation.instances)
    assert found.vsd is not None
    assert found.vsd_by_visibility is not None
    assert found.vsd.shape == (10, 10)
    for curve, over, score in (
        (found.mssd, found.mssd_by_visibility, scores.mssd),
        (found.mspd, found.mspd_by_visibility, scores.mspd),
        (found.vsd, found.vsd_by_visibility, scores.vsd),
    ):
        assert (np.diff(curve, axis=-1) >= 0).all()
        assert curve.mean() == pytest.approx(score, abs=1e-12)
        weighted = np.nansum(over * found.per_visibility) / found.per_visibility.sum()
        assert weighted == pytest.approx(score, abs=1e-12)  # all fractions are known here
    assert (np.diff(found.vsd, axis=0) >= 0).all()  # a larger tolerance finds more
