"""Facts about surfaces of constant curvature."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fmp_drake.systems.surface.surface import (
    Surface,
    angular_motion,
    moving_frame,
    place,
    point,
    project,
    quaternion,
    quaternion_product,
    rotation,
    rotation_matrix,
)

SURFACES = {
    "plane": Surface(),
    "cylinder along x": Surface(0.0, 1 / 0.3),
    "trough along x": Surface(0.0, -1 / 0.4),
    "cylinder along y": Surface(1 / 0.25, 0.0),
    "dome": Surface(1 / 0.3, 1 / 0.3),
    "bowl": Surface(-1 / 0.35, -1 / 0.35),
}
each_surface = pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)
coordinate = st.floats(-0.25, 0.25)


def skew(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


@each_surface
@settings(max_examples=30)
@given(u=coordinate, v=coordinate, h=st.floats(-0.05, 0.1))
def test_projection_undoes_placement(surface, u, v, h):
    uvh = np.array([[u, v, h]])
    p = place(surface, uvh)[0]
    np.testing.assert_allclose(project(surface, p, uvh[0, :2]), uvh[0], atol=1e-12)


def test_far_side_of_a_pipe_is_half_way_round():
    pipe = Surface(0.0, 5.0)
    p = np.array([0.1, 0.0, -0.4])
    for sign in (-1, 1):
        uvh = project(pipe, p, np.array([0.0, sign * 0.6]))
        np.testing.assert_allclose(uvh, [0.1, sign * np.pi / 5, 0.0], atol=1e-12)


@each_surface
def test_normal_is_perpendicular_to_both_ways_along_the_surface(surface):
    u, v, step = 0.11, -0.07, 1e-6
    normal = rotation(surface, u, v)[:, 2]
    for du, dv in ((step, 0), (0, step)):
        tangent = (point(surface, u + du, v + dv) - point(surface, u - du, v - dv)) / (
            2 * step
        )
        assert abs(tangent @ normal) < 1e-8


@each_surface
def test_lines_from_the_middle_keep_their_length(surface):
    ways = np.linspace(0, 1, 2001)[:, None] * np.array([[0.15, 0.1, 0.0]])
    length = np.sum(np.linalg.norm(np.diff(place(surface, ways), axis=0), axis=1))
    assert length == pytest.approx(np.hypot(0.15, 0.1), abs=1e-7)


def test_a_cylinder_keeps_every_length():
    t = np.linspace(0, 2 * np.pi, 4001)
    uvh = np.column_stack([0.1 * np.cos(t), 0.08 * np.sin(2 * t), 0 * t])
    p = place(Surface(0.0, 4.0), uvh)
    flat, bent = (np.sum(np.linalg.norm(np.diff(x, axis=0), axis=1)) for x in (uvh, p))
    assert bent == pytest.approx(flat, rel=1e-6)


@pytest.mark.parametrize(
    ("surface", "uv", "expected"),
    [
        # A quarter round a pipe of 0.3 m, to the side y: the point is level with the axis.
        (Surface(0.0, 1 / 0.3), (0.1, 0.3 * np.pi / 2), (0.1, 0.3, -0.3)),
        (Surface(1 / 0.3, 0.0), (0.3 * np.pi / 2, 0.1), (0.3, 0.1, -0.3)),
        # Half a right angle up the wall of a bowl.
        (
            Surface(-2.0, -2.0),
            (0.5 * np.pi / 4, 0.0),
            (0.5 * np.sqrt(0.5), 0.0, 0.5 * (1 - np.sqrt(0.5))),
        ),
    ],
)
def test_points_match_the_geometry(surface, uv, expected):
    np.testing.assert_allclose(point(surface, *uv), expected, atol=1e-12)


def test_normal_leads_out_of_a_dome_and_to_the_middle_of_a_bowl():
    np.testing.assert_allclose(
        rotation(Surface(2.0, 2.0), 0.5 * np.pi / 4, 0.0)[:, 2],
        [np.sqrt(0.5), 0, np.sqrt(0.5)],
        atol=1e-12,
    )
    assert rotation(Surface(-2.0, -2.0), 0.1, 0.0)[0, 2] < 0


def test_a_pipe_is_wound_round():
    pipe = Surface(0.0, 1 / 0.05)
    turns = np.array([0.02, 3 * pipe.circumference[1] + 0.01, 0.004])
    p = place(pipe, turns[None])[0]
    np.testing.assert_allclose(project(pipe, p, turns[:2] + 0.05), turns, atol=1e-12)
    np.testing.assert_allclose(project(pipe, p, np.zeros(2))[1], 0.01, atol=1e-12)


@each_surface
def test_velocity_and_acceleration_of_the_frame_are_derivatives(surface):
    def way(t):
        uv = np.array([0.1 * np.cos(2 * t), 0.08 * np.sin(3 * t)])
        rate = np.array([-0.2 * np.sin(2 * t), 0.24 * np.cos(3 * t)])
        return uv, rate, np.array([-0.4 * np.cos(2 * t), -0.72 * np.sin(3 * t)])

    step = 1e-5
    for t in (0.0, 0.4, 1.7):
        before, at, after = (
            moving_frame(surface, *way(t + d)) for d in (-step, 0, step)
        )
        R, p, V, A = at
        np.testing.assert_allclose(
            (after[1] - before[1]) / (2 * step), V[3:], atol=1e-8
        )
        R_rate = (after[0] - before[0]) / (2 * step)
        np.testing.assert_allclose(R_rate, skew(V[:3]) @ R, atol=1e-8)
        np.testing.assert_allclose((after[2] - before[2]) / (2 * step), A, atol=1e-7)
        np.testing.assert_allclose(p, point(surface, *way(t)[0]), atol=1e-15)


def test_sagitta_is_the_gap_under_the_tool():
    pipe = Surface(0.0, 1 / 0.3)
    assert pipe.sagitta((0.12, 0.0)) == 0.0
    edge = 0.3 - np.sqrt(0.3**2 - 0.025**2)
    assert pipe.sagitta((0.12, 0.05)) == pytest.approx(edge, rel=0.01)


vectors = st.lists(st.floats(-2, 2), min_size=3, max_size=3).map(np.array)


@given(phi=vectors, psi=vectors)
def test_rotations_agree_with_scipy(phi, psi):
    first, second = Rotation.from_rotvec(phi), Rotation.from_rotvec(psi)
    np.testing.assert_allclose(rotation_matrix(phi), first.as_matrix(), atol=1e-12)
    product = quaternion_product(quaternion(phi), quaternion(psi))
    expected = (first * second).as_matrix()
    actual = Rotation.from_quat(product, scalar_first=True).as_matrix()
    np.testing.assert_allclose(actual, expected, atol=1e-12)


@given(phi=vectors, rate=vectors, acceleration=vectors)
def test_angular_motion_is_the_derivative_of_the_rotation(phi, rate, acceleration):
    def at(t):
        return phi + rate * t + acceleration * t**2 / 2, rate + acceleration * t

    step = 1e-5
    omega, alpha = angular_motion(phi, rate, acceleration)
    R_rate = (rotation_matrix(at(step)[0]) - rotation_matrix(at(-step)[0])) / (2 * step)
    np.testing.assert_allclose(R_rate, skew(omega) @ rotation_matrix(phi), atol=1e-6)
    after, before = (angular_motion(*at(d), acceleration)[0] for d in (step, -step))
    np.testing.assert_allclose((after - before) / (2 * step), alpha, atol=1e-6)
