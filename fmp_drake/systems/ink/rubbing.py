"""Wear of the ink in the cells of a board under a sliding contact patch.

Patch and motion of the eraser are read from the plant's outputs. Compiled loops run over
the cells. B is the board frame, see `InkGrid`.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array, Indices
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.surface.surface import (
    PLANE,
    Surface,
    project,
    project_all,
    rotation,
)

WEAR_CONSTANT = 20.0
"""Wear constant c of the ink in Pa m; see `wear`.

A felt of 0.12 m x 0.05 m pressed with 10 N carries 10 / 0.006 = 1667 Pa. When
it moves across a cell along its short side, the exposure of that cell is
1667 Pa x 0.05 m = 83 Pa m and exp(-83 / 20) = 1.6 % of its ink remains; one
stroke at 10 N therefore removes more than 95 %. It takes 5.5 N to get below
the 10 % that count as clean, and a light touch of 3 N leaves 29 %.
"""

LONGEST_STEP = 0.00125
"""Greatest length of a step of the patch along its path, m."""

STRIPE_PITCH = 0.02
"""Distance between the stripes in which a felt wears out, m."""

# Offset of the cell centres, in cells, so that none lies on an edge between two
# polygons: in symmetric scenes whole rows of them would.
_OFFSET = 1.37e-7
_SMALLEST_AREA = 1e-8  # In cells; a smaller polygon is degenerate in projection.
_DIFFERENCE = 1e-5  # Step of central differences, s.


class PlanarMotion(NamedTuple):
    """Position, velocity and depth of the eraser on the board at an instant.

    Attributes
    ----------
    time : float
        s.
    x, y, yaw : float
        Position of the eraser's frame E in B (m), and angle of its x axis about z of B
        (rad).
    v_x, v_y, yaw_rate : float
        Their rates, relative to the board (m/s, rad/s).
    depth, sinking : float
        Penetration of E into the board (m), and its rate (m/s).
    """

    time: float
    x: float
    y: float
    yaw: float
    v_x: float
    v_y: float
    yaw_rate: float
    depth: float
    sinking: float


class Patch(NamedTuple):
    """A contact patch, projected on the board: convex polygons that do not overlap.

    Attributes
    ----------
    vertices : ndarray, shape (num_vertices, 3)
        Position relative to the eraser, in E rotated about z of B by the yaw (x and y, m),
        and pressure (Pa), which is linear on each polygon. The polygons follow one
        another; the vertices of each are in order around it.
    starts : ndarray of int, shape (num_polygons + 1,)
        Index of the first vertex of each polygon, and the number of vertices.
    depth : float
        Penetration of the eraser at the same instant, m.
    """

    vertices: Array
    starts: Indices
    depth: float


class Cells(NamedTuple):
    """The cells of an `InkGrid`: corner (m), edge lengths (m) and numbers of cells."""

    corner_x: float
    corner_y: float
    pitch_x: float
    pitch_y: float
    n_x: int
    n_y: int

    @classmethod
    def of(cls, grid: InkGrid) -> Self:
        """Return the cells of a grid."""
        (x, y), (pitch_x, pitch_y) = grid.corner.tolist(), grid.pitch.tolist()
        return cls(x, y, pitch_x, pitch_y, grid.shape[1], grid.shape[0])


@compiled
def exposure(
    cells: Cells, patch: Patch, before: PlanarMotion, now: PlanarMotion, worn: float
) -> Array:
    """Return the integral of pressure times sliding speed of each cell over an interval.

    The patch follows the cubic through position and velocity at both instants, in steps
    of `LONGEST_STEP` or less. Its pressure is proportional to the penetration of the
    eraser: an eraser that lands or is lifted rubs only while it is in contact.

    Parameters
    ----------
    cells : Cells
    patch : Patch
    before, now : PlanarMotion
        The eraser at the two instants.
    worn : float
        Worn fraction of the felt, from 0 to 1. The felt wears out in straight stripes
        across its length, `STRIPE_PITCH` apart, one of them in the middle. A worn stripe
        bears pressure but removes no ink.

    Returns
    -------
    ndarray, shape (ny, nx)
        Pa m.
    """
    result = np.zeros((cells.n_y, cells.n_x))
    h = now.time - before.time
    # The shorter of the two directions of rotation.
    rotation = (now.yaw - before.yaw + math.pi) % (2.0 * math.pi) - math.pi
    length = max(
        math.hypot(now.x - before.x, now.y - before.y),
        h * math.hypot(now.v_x, now.v_y),
        h * math.hypot(before.v_x, before.v_y),
    )
    steps = max(1, math.ceil(length / LONGEST_STEP))
    u = np.empty(len(patch.vertices))
    v = np.empty(len(patch.vertices))
    for step in range(steps):
        s = (step + 0.5) / steps
        x, v_x = _cubic(s, h, before.x, now.x, before.v_x, now.v_x)
        y, v_y = _cubic(s, h, before.y, now.y, before.v_y, now.v_y)
        yaw, rate = _cubic(
            s, h, before.yaw, before.yaw + rotation, before.yaw_rate, now.yaw_rate
        )
        cos, sin = math.cos(yaw), math.sin(yaw)
        seconds = h / steps
        if patch.depth > 0.0:
            depth, _ = _cubic(
                s, h, before.depth, now.depth, before.sinking, now.sinking
            )
            seconds *= max(depth / patch.depth, 0.0)
        # In units of cells, with whole numbers at the cells' centres.
        for i in range(len(u)):
            dx, dy = patch.vertices[i, 0], patch.vertices[i, 1]
            p_x = x + cos * dx - sin * dy
            p_y = y + sin * dx + cos * dy
            u[i] = (p_x - cells.corner_x) / cells.pitch_x - 0.5 + _OFFSET
            v[i] = (p_y - cells.corner_y) / cells.pitch_y - 0.5 + _OFFSET
        for k in range(len(patch.starts) - 1):
            begin, end = patch.starts[k], patch.starts[k + 1]
            level, slope_u, slope_v = _plane(u, v, patch.vertices[:, 2], begin, end)
            lowest, highest = v[begin], v[begin]
            for i in range(begin, end):
                lowest, highest = min(lowest, v[i]), max(highest, v[i])
            for row in range(
                max(math.ceil(lowest), 0), min(math.ceil(highest), cells.n_y)
            ):
                left, right = _crossings(u, v, begin, end, row)
                for column in range(
                    max(math.ceil(left), 0), min(math.ceil(right), cells.n_x)
                ):
                    pressure = level + slope_u * column + slope_v * row
                    dx = cells.corner_x + (column + 0.5) * cells.pitch_x - x
                    dy = cells.corner_y + (row + 0.5) * cells.pitch_y - y
                    stripe = (cos * dx + sin * dy) / STRIPE_PITCH
                    if pressure > 0.0 and 2.0 * abs(stripe - round(stripe)) >= worn:
                        speed = math.hypot(v_x - rate * dy, v_y + rate * dx)
                        result[row, column] += pressure * speed * seconds
    return result


@compiled
def _cubic(
    s: float, h: float, x0: float, x1: float, v0: float, v1: float
) -> tuple[float, float]:
    """Return position and velocity after a fraction s of h seconds."""
    dx = x1 - x0
    a = h * (v0 + v1) - 2.0 * dx
    b = 3.0 * dx - h * (2.0 * v0 + v1)
    position = x0 + s * (h * v0 + s * (b + s * a))
    return position, v0 + s * (2.0 * b + 3.0 * s * a) / h


@compiled
def _plane(
    u: Array, v: Array, p: Array, begin: int, end: int
) -> tuple[float, float, float]:
    """Return a polygon's pressure as level and slopes, by the divergence theorem."""
    area = slope_u = slope_v = 0.0
    j = end - 1
    for i in range(begin, end):
        area += u[j] * v[i] - u[i] * v[j]
        slope_u += (p[j] + p[i]) * (v[i] - v[j])
        slope_v -= (p[j] + p[i]) * (u[i] - u[j])
        j = i
    if abs(area) < _SMALLEST_AREA:
        return 0.0, 0.0, 0.0
    slope_u /= area
    slope_v /= area
    return p[begin] - slope_u * u[begin] - slope_v * v[begin], slope_u, slope_v


@compiled
def _crossings(
    u: Array, v: Array, begin: int, end: int, row: int
) -> tuple[float, float]:
    """Return the least and greatest u of a convex polygon in a row of cells."""
    left, right = np.inf, -np.inf
    j = end - 1
    for i in range(begin, end):
        if (v[i] < row) != (v[j] < row):
            crossing = u[i] + (row - v[i]) * (u[j] - u[i]) / (v[j] - v[i])
            left, right = min(left, crossing), max(right, crossing)
        j = i
    return left, right


@compiled
def wear(ink: Array, exposure: Array) -> None:
    """Reduce the ink in place, by the exact solution of d(ink)/dt = -ink p v / c.

    Parameters
    ----------
    ink : ndarray, shape (num_cells,)
        From 0 to 1.
    exposure : ndarray, shape (num_cells,)
        Integral of pressure times sliding speed over time, Pa m.

    Notes
    -----
    The wear constant c is `WEAR_CONSTANT`.

    Archard's law: the rate of wear is proportional to pressure times sliding
    speed; here also to the ink that is left, which makes steps compose exactly.
    J. F. Archard, "Contact and rubbing of flat surfaces", J. Appl. Phys. 24,
    1953.
    """
    for i in range(len(ink)):
        if exposure[i] > 0.0:
            ink[i] *= math.exp(-exposure[i] / WEAR_CONSTANT)


def read_patch(
    surfaces: Sequence[ContactSurface],
    X_WB: RigidTransform,
    motion: PlanarMotion,
    curvature: Surface = PLANE,
) -> tuple[Patch, Array]:
    """Return the contact surfaces of triangles or polygons, projected on the board.

    Parameters
    ----------
    surfaces : sequence of ContactSurface
        At least one.
    X_WB : RigidTransform
        The board.
    motion : PlanarMotion
        The eraser at the same instant.
    curvature : Surface
        Of the board; on a curved one x and y are coordinates along it.

    Returns
    -------
    patch : Patch
    outline : ndarray, shape (6,)
        The rectangle that encloses it, see `rectangle`.
    """
    vertices: list[Array] = []
    pressure: list[float] = []
    counts: list[int] = []
    areas: list[float] = []
    vertex: Any
    field: Any
    for surface in surfaces:
        if surface.is_triangle():
            triangles, field = surface.tri_mesh_W(), surface.tri_e_MN()
            faces = [[f.vertex(i) for i in range(3)] for f in triangles.triangles()]
            vertex = triangles.vertex
        else:
            polygons, field = surface.poly_mesh_W(), surface.poly_e_MN()
            faces, vertex = _faces(polygons.face_data()), polygons.vertex
        counts += map(len, faces)
        areas += map(surface.area, range(len(faces)))
        for face in faces:
            # The slowest part of an update: 1 us for each vertex.
            vertices += map(vertex, face)
            pressure += map(field.EvaluateAtVertex, face)
    p_W = np.concatenate(vertices).reshape(-1, 3)
    X_BE = RigidTransform(
        RotationMatrix.MakeZRotation(motion.yaw), np.array([motion.x, motion.y, 0.0])
    )
    if curvature.is_plane:
        X_WE = X_WB @ X_BE
        values = (p_W - X_WE.translation()) @ X_WE.rotation().matrix()
    else:
        p_B = (p_W - X_WB.translation()) @ X_WB.rotation().matrix()
        uvh = project_all(curvature, p_B, X_BE.translation()[:2])
        values = (uvh - X_BE.translation()) @ X_BE.rotation().matrix()
    values[:, 2] = pressure
    starts = np.concatenate([[0], np.cumsum(counts)])
    means = np.add.reduceat(values[:, 2], starts[:-1]) / counts
    low, high = (f(values[:, :2], axis=0) for f in (np.min, np.max))
    even = means @ areas / np.prod(high - low)
    outline = np.array([*low, *high, even, motion.depth])
    return Patch(values, starts, motion.depth), outline


def rectangle(outline: Array) -> Patch:
    """Return a rectangular patch of uniform pressure.

    Parameters
    ----------
    outline : ndarray, shape (6,)
        Smallest x and y, largest x and y (m), pressure (Pa), depth (m).
    """
    x0, y0, x1, y1, p, depth = outline
    corners = [[x0, y0, p], [x1, y0, p], [x1, y1, p], [x0, y1, p]]
    return Patch(np.array(corners), np.array([0, 4]), depth)


def compile_rubbing(cells: Cells) -> None:
    """Compile the wear of the ink by one call with a temporary board."""
    rest = PlanarMotion(*[0.0] * len(PlanarMotion._fields))
    rubbing = exposure(cells, rectangle(np.zeros(6)), rest, rest, 0.0).ravel()
    wear(rubbing.copy(), rubbing)


def _faces(face_data: list[int]) -> list[list[int]]:
    """Split counted polygons into lists of vertices."""
    faces = []
    i = 0
    while i < len(face_data):
        count = face_data[i]
        faces.append(face_data[i + 1 : i + 1 + count])
        i += 1 + count
    return faces


def planar_motion(
    *,
    time: float,
    X_WB: RigidTransform,
    V_WB: SpatialVelocity,
    X_WE: RigidTransform,
    V_WE: SpatialVelocity,
    curvature: Surface = PLANE,
    near: Array | None = None,
) -> PlanarMotion:
    """Return the motion of the eraser over the board from poses and spatial velocities.

    On a curved board x and y are coordinates along it, see `Surface`. Around a pipe they
    repeat with each revolution; those nearest to `near`, shape (2,), m, are returned. The
    yaw is about the local normal.
    """
    R_BW = X_WB.rotation().matrix().T
    p_BE_W = X_WE.translation() - X_WB.translation()
    p_BE = R_BW @ p_BE_W
    v_BE = R_BW @ (V_WE.translational() - V_WB.Shift(p_BE_W).translational())
    long_axis = R_BW @ X_WE.rotation().matrix()[:, 0]
    w_BE = R_BW @ (V_WE.rotational() - V_WB.rotational())
    if curvature.is_plane:
        (x, y, z), (v_x, v_y, v_z) = p_BE, v_BE
        yaw = np.arctan2(long_axis[1], long_axis[0])
        return PlanarMotion(time, x, y, yaw, v_x, v_y, w_BE[2], -z, -v_z)
    near = np.zeros(2) if near is None else near

    def coordinates(seconds: float) -> Array:
        uvh = project(curvature, p_BE + seconds * v_BE, near)
        axis = long_axis + seconds * np.cross(w_BE, long_axis)
        cos, sin, _ = rotation(curvature, uvh[0], uvh[1]).T @ axis
        return np.array([uvh[0], uvh[1], np.arctan2(sin, cos), -uvh[2]])

    change = coordinates(_DIFFERENCE) - coordinates(-_DIFFERENCE)
    change[2] = (change[2] + np.pi) % (2 * np.pi) - np.pi
    x, y, yaw, depth = coordinates(0.0)
    v_x, v_y, yaw_rate, sinking = change / (2 * _DIFFERENCE)
    return PlanarMotion(time, x, y, yaw, v_x, v_y, yaw_rate, depth, sinking)
