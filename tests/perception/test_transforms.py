"""Rotations in other words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perception import transforms

angles = st.floats(-np.pi, np.pi) | st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi / 2])


@given(angles, angles, angles)
def test_a_rotation_is_the_quaternion_that_scipy_has_for_it(roll: float, pitch: float, yaw: float) -> None:
    matrix = transforms.from_euler(roll, pitch, yaw, (1.0, -2.0, 3.0))
    ours, theirs = np.array(transforms.to_quaternion(matrix)), Rotation.from_matrix(matrix[:3, :3]).as_quat()
    assert min(abs(ours - theirs).max(), abs(ours + theirs).max()) < 1e-12
    assert ours.max() > abs(ours).max() - 1e-12
    np.testing.assert_allclose(transforms.from_quaternion(ours, (1.0, -2.0, 3.0)), matrix, atol=1e-14)


@given(st.tuples(*[st.floats(-5, 5)] * 4).filter(lambda quaternion: np.linalg.norm(quaternion) > 1e-3))
def test_any_quaternion_is_the_rotation_that_scipy_makes_of_it(quaternion: tuple[float, ...]) -> None:
    matrix = transforms.from_quaternion(quaternion)
    np.testing.assert_allclose(matrix[:3, :3], Rotation.from_quat(quaternion).as_matrix(), atol=1e-14)
    assert (matrix[:3, 3] == 0).all()
    assert (matrix[3] == (0, 0, 0, 1)).all()


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (np.nan, 0, 0, 1)])
def test_what_is_no_rotation_is_refused(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="expected a quaternion of some length"):
        transforms.from_quaternion(quaternion)
