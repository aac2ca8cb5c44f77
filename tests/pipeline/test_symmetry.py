import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.exceptions import FormatError
from pipeline.symmetry import symmetry_transforms

HALF_TURN_Z = [-1, 0, 0, 10, 0, -1, 0, 20, 0, 0, 1, 30, 0, 0, 0, 1]


def test_an_object_without_symmetries_has_the_identity_only():
    assert np.array_equal(symmetry_transforms({"diameter": 100.0}), np.eye(4)[None])


def test_discrete_symmetries_follow_the_identity_in_metres():
    found = symmetry_transforms({"symmetries_discrete": [HALF_TURN_Z]})
    assert found.shape == (2, 4, 4)
    assert np.array_equal(found[0], np.eye(4))
    assert found[1][:3, 3] == pytest.approx([0.01, 0.02, 0.03])
    assert np.array_equal(np.diag(found[1]), [-1, -1, 1, 1])


def test_a_continuous_symmetry_has_the_315_steps_of_bop():
    found = symmetry_transforms({"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]})
    assert len(found) == 315
    expected = Rotation.from_rotvec([0, 0, 2 * np.pi / 315]).as_matrix()
    assert found[1][:3, :3] == pytest.approx(expected, abs=1e-15)
    assert len(symmetry_transforms({"symmetries_continuous": [{"axis": [0, 0, 1]}]}, max_step=0.1)) == 32


def test_points_of_the_axis_stay_where_they_are():
    axis, offset = np.array([1.0, 2.0, -0.5]), np.array([10.0, -20.0, 5.0])
    found = symmetry_transforms({"symmetries_continuous": [{"axis": list(axis), "offset": list(offset)}]})
    on_axis = offset / 1000 + 0.3 * axis
    moved = found[:, :3, :3] @ on_axis + found[:, :3, 3]
    assert moved == pytest.approx(np.tile(on_axis, (315, 1)), abs=1e-12)


def test_a_step_moves_no_vertex_by_more_than_the_given_share_of_the_diameter():
    found = symmetry_transforms({"symmetries_continuous": [{"axis": [0, 1, 0]}]}, max_step=0.01)
    rim = np.array([0.5, 0, 0, 1])  # of an object of diameter 1
    assert np.linalg.norm((found[1] - found[0]) @ rim) <= 0.01


def test_every_discrete_symmetry_is_followed_by_every_continuous_one():
    info = {"symmetries_discrete": [HALF_TURN_Z], "symmetries_continuous": [{"axis": [1, 0, 0], "offset": [0, 0, 4]}]}
    found = symmetry_transforms(info)
    continuous = symmetry_transforms({"symmetries_continuous": info["symmetries_continuous"]})
    discrete = symmetry_transforms({"symmetries_discrete": info["symmetries_discrete"]})
    assert len(found) == 630
    assert np.array_equal(found[0], np.eye(4))
    for i, j in ((0, 7), (1, 0), (1, 100)):
        assert found[i * 315 + j] == pytest.approx(continuous[j] @ discrete[i], abs=1e-15)


@pytest.mark.parametrize(
    ("info", "message"),
    [
        ({"symmetries_discrete": [[1, 0, 0]]}, r"symmetries_discrete holds \[1, 0, 0\]; expected 16 finite numbers"),
        ({"symmetries_continuous": [{"axis": [0, 0, 0]}]}, "give a direction that is not zero"),
        ({"symmetries_continuous": [[0, 0, 1]]}, "write it as an axis and an offset of 3 numbers"),
        ({"symmetries_continuous": [{"axis": [0, 0, float("nan")]}]}, "axis of symmetries_continuous holds"),
    ],
)
def test_a_bad_entry_is_named(info, message):
    with pytest.raises(FormatError, match=message):
        symmetry_transforms(info)
