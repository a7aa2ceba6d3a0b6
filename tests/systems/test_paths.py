"""Facts about paths in Meshcat: meshes, drawings, recordings."""

from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.geometry import Meshcat, Rgba, Sphere
from scipy.spatial import ConvexHull

from fmp_drake.errors import SystemsError
from fmp_drake.primitives import Demonstration
from fmp_drake.systems.page import paths
from fmp_drake.systems.page.paths import (
    BAND_DESCENT,
    BAND_SIDES,
    LIFT,
    AddPathToRecording,
    covariance_band,
    draw_demonstrations,
    draw_line,
    draw_rod,
    lifted,
    rod_mesh,
)

RED = Rgba(1, 0, 0, 1)
PATHS = arrays(float, (7, 3), elements=st.floats(-1, 1, width=32))
LINE = np.stack([np.linspace(0, 0.4, 9), np.zeros(9), np.zeros(9)], axis=1)


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


def triangles(mesh):
    """Return the corners (F, 3, 3) of the triangles of a mesh."""
    vertices, faces = mesh
    assert faces.dtype == np.int32
    assert 0 <= faces.min() <= faces.max() < vertices.shape[1]
    return vertices.T[faces.T]


def normals(corners):
    """Return the normals of triangles, as long as twice their areas."""
    one, two, three = np.moveaxis(corners, 1, 0)
    return np.cross(two - one, three - one)


@settings(max_examples=60, deadline=None)
@given(PATHS)
def test_a_rod_has_the_given_radius_along_the_path(path):
    vertices, _ = rod_mesh(path, 0.02)
    rings = vertices.T.reshape(7, 6, 3)
    assert np.all(np.isfinite(rings))
    assert_allclose(
        np.linalg.norm(rings - path[:, np.newaxis], axis=2), 0.02, rtol=1e-9
    )


def test_a_rod_is_round_and_its_faces_look_outwards():
    corners = triangles(rod_mesh(LINE, 0.01))
    middle = corners.mean(axis=1)
    outwards = normals(corners) * middle * [0, 1, 1]
    assert np.all(outwards.sum(axis=1) > 0)
    # The mantle of a hexagonal prism.
    area = np.linalg.norm(normals(corners), axis=1).sum() / 2
    assert_allclose(area, 6 * 0.01 * 0.4)


def test_a_rod_may_thin_out():
    vertices, _ = rod_mesh(LINE, np.linspace(0, 0.02, 9))
    rings = vertices.T.reshape(9, 6, 3) - LINE[:, np.newaxis]
    assert_allclose(np.linalg.norm(rings, axis=2)[:, 0], np.linspace(0, 0.02, 9))


def test_a_path_straight_up_and_one_at_rest_have_rods():
    for path in (LINE[:, [1, 2, 0]], np.zeros((3, 3))):
        vertices, _ = rod_mesh(path, 0.01)
        rings = vertices.T.reshape(len(path), 6, 3) - path[:, np.newaxis]
        assert_allclose(np.linalg.norm(rings, axis=2), 0.01)


def test_a_band_is_the_ellipse_of_two_deviations():
    covariance = np.diag([0.01**2, 0.03**2, 1.0])
    covariance[0, 1] = covariance[1, 0] = 0.5 * 0.01 * 0.03
    path = np.zeros((2, 3))
    vertices, _ = covariance_band(path, [covariance] * 2)
    flat = vertices[:2].T
    covariance[:2, :2] += 2.5e-4**2 * np.eye(2)  # The least semi-axis is 0.5 mm.
    squared = np.einsum("ni,ij,nj->n", flat, np.linalg.inv(covariance[:2, :2]), flat)
    assert_allclose(squared, 4.0, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(PATHS, st.integers(0, 2**31))
def test_each_piece_of_a_band_is_the_hull_of_its_two_ellipses(path, seed):
    factors = np.random.default_rng(seed).normal(size=(7, 3, 3)) * 0.1
    covariances = factors @ factors.transpose(0, 2, 1)
    sides = 240  # With few sides a polygon is smaller than a thin ellipse.
    with patch.object(paths, "BAND_SIDES", sides):
        mesh = covariance_band(path, covariances)
    corners = triangles(mesh).reshape(6, sides - 2, 3, 3)
    angle = np.linspace(0, 2 * np.pi, 100)
    ring = np.stack([np.cos(angle), np.sin(angle)])
    for i, piece in enumerate(corners):
        assert np.all(normals(piece)[:, 2] > -1e-12)  # Seen from above.
        points = [
            path[j, :2]
            + 2
            * (
                np.linalg.cholesky(covariances[j][:2, :2] + 6.25e-8 * np.eye(2)) @ ring
            ).T
            for j in (i, i + 1)
        ]
        hull = ConvexHull(np.concatenate(points)).volume  # In 2D: its area.
        assert_allclose(normals(piece)[:, 2].sum() / 2, hull, rtol=0.02)


def test_a_band_lies_flat_and_descends_so_that_overlaps_are_drawn_once():
    path = LINE + np.array([0, 0, 0.01])
    vertices, _ = covariance_band(path, [1e-4 * np.eye(3)] * 9)
    heights = vertices[2].reshape(8, BAND_SIDES)
    assert_allclose(np.ptp(heights, axis=1), 0, atol=1e-15)
    assert_allclose(np.diff(heights[:, 0]), -BAND_DESCENT)
    assert_allclose(heights[-1], 0.01)


def test_points_below_the_surface_are_drawn_on_it():
    points = np.array([[0.1, 0.2, -0.01], [0.1, 0.2, 0.03]])
    assert_allclose(lifted(points), [[0.1, 0.2, LIFT], [0.1, 0.2, 0.03 + LIFT]])
    assert points[0, 2] == -0.01


def test_one_point_is_not_a_path(meshcat):
    for draw in (
        lambda path, points: draw_line(meshcat, path, points, color=RED),
        lambda path, points: draw_rod(meshcat, path, points, radius=0.01, color=RED),
    ):
        draw("path", np.zeros((1, 3)))
        assert not meshcat.HasPath("path")
        draw("path", np.eye(2, 3))
        assert meshcat.HasPath("path")
        meshcat.Delete("path")


def test_demonstrations_replace_those_drawn_before(meshcat):
    draw_demonstrations(meshcat, "demonstrations", [LINE, LINE])
    assert meshcat.HasPath("demonstrations/1")
    draw_demonstrations(meshcat, "demonstrations", [LINE])
    assert meshcat.HasPath("demonstrations/0")
    assert not meshcat.HasPath("demonstrations/1")


def test_paths_that_are_not_points_in_space_are_refused_with_their_shape(meshcat):
    with pytest.raises(
        SystemsError, match=r"a path of shape \(9, 2\); expected \(N, 3"
    ):
        draw_demonstrations(meshcat, "demonstrations", [LINE[:, :2]])
    recording = Demonstration(time=np.arange(9.0), values=LINE)
    with pytest.raises(SystemsError, match="a path: <Demonstration"):
        draw_demonstrations(meshcat, "demonstrations", [recording])
    with pytest.raises(SystemsError, match=r"NaN or infinite numbers in a path\."):
        draw_demonstrations(
            meshcat, "demonstrations", [np.where(LINE > 0, LINE, np.nan)]
        )
    with pytest.raises(
        SystemsError, match=r"points of shape \(9, 3\); expected \(8, 3"
    ):
        AddPathToRecording(
            meshcat, "path", times=np.arange(8.0), points=LINE, color=RED
        )


@pytest.mark.parametrize("seconds", [0.1, 4.0, 1000.0])
def test_each_part_of_a_path_appears_once_it_was_passed(seconds, monkeypatch):
    lines, since = {}, {}
    monkeypatch.setattr(
        paths,
        "draw_line",
        lambda _, path, points, **__: lines.update({path: points}),
    )
    monkeypatch.setattr(
        paths,
        "show_during",
        lambda _, path, **when: since.update({path: when["since"]}),
    )
    meshcat = Meshcat()
    meshcat.StartRecording()
    meshcat.StopRecording()
    times = np.linspace(0.0, seconds, 1001)
    points = np.column_stack([times, np.sin(times), 0 * times])
    AddPathToRecording(
        meshcat, "path", times=times, points=points, color=Rgba(1, 0, 0, 1)
    )
    parts = list(lines.values())
    assert 1 <= len(parts) <= 300
    for part, when in zip(parts, since.values(), strict=True):
        assert part[-1, 0] == when <= part[0, 0] + max(0.26, seconds / 250)
    for a, b in pairwise(parts):
        assert_array_equal(a[-1], b[0])
    assert_array_equal(parts[0][0], points[0])
    assert_array_equal(parts[-1][-1], points[-1])


def test_a_path_of_one_point_leaves_nothing_of_an_older_one():
    meshcat = Meshcat()
    meshcat.SetObject("path/0", Sphere(0.1))
    AddPathToRecording(
        meshcat, "path", times=[0.0], points=np.zeros((1, 3)), color=Rgba(1, 0, 0, 1)
    )
    assert not meshcat.HasPath("path")
