"""Facts about forces and orientations that were recorded apart from the position."""

import numpy as np
import pytest
import recorded_files as files
from numpy.testing import assert_allclose

from fmp_drake.primitives import read_demonstrations
from fmp_drake.primitives.data.channels import FORCE_COMPONENTS, ROTATION_CHANNELS
from fmp_drake.primitives.data.orientation import rotations_of


def forces(found):
    return found.select(FORCE_COMPONENTS).values


def rotation_errors(found, known):
    vectors = found.select(ROTATION_CHANNELS).values
    return (rotations_of(vectors, found.rotation_reference) * known.inv()).magnitude()


@pytest.mark.parametrize("name", ["f", "ft_raw", "force_torque", "ee_force_torque"])
def test_six_numbers_of_a_sensor_are_a_force_and_a_torque(name, tmp_path):
    arrays = {"time": files.TIME, "ee_pos": files.PATH}
    wrench = np.hstack([files.FORCE, files.PATH])
    np.savez(tmp_path / "d.npz", **arrays, **{name: wrench}, stiff=wrench)
    (found,), (remark,) = read_demonstrations([tmp_path / "d.npz"])
    assert f"{name}_1 to {name}_6 are a force and a torque" in remark
    assert "stiff_1" in found.channels
    assert_allclose(forces(found), files.FORCE)


@pytest.mark.parametrize("name", ["rotvec", "ee_rotation_vector", "axis_angle"])
def test_an_array_of_rotation_vectors_is_an_orientation(name, tmp_path):
    arrays = {"time": files.TIME, "ee_pos": files.PATH, name: files.TURNS.as_rotvec()}
    np.savez(tmp_path / "d.npz", **arrays)
    (found,), _ = read_demonstrations([tmp_path / "d.npz"])
    assert np.max(rotation_errors(found, files.TURNS)) < 1e-6


@pytest.mark.parametrize("rows", [3, 4])
def test_matrices_of_a_reflection_are_not_a_pose(rows, tmp_path):
    mirrored = files.matrices()[:, :rows] * [1, 1, -1, 1]
    np.savez(tmp_path / "d.npz", time=files.TIME, pose=mirrored)
    (found,), _ = read_demonstrations([tmp_path / "d.npz"])
    assert found.channels == tuple(f"pose_{i}" for i in range(1, 4 * rows + 1))
