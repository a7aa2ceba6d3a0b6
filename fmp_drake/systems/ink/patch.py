"""The patch of an eraser on a board: its shape, its motion, what it rubs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity

from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink.sweep import Sweep, sweep

type FloatArray = NDArray[np.float64]

LONGEST_STEP = 0.0025
"""Longest step in metres in which a patch is led along its way."""

STRIPE_PITCH = 0.02
"""Distance in metres of the stripes in which a felt wears out."""


# Where a point is at five times, in half periods from the middle on, for velocities 1
# at the start, in the middle and at the end: the integral of the parabola.
_TIMES = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
_WAY = np.column_stack(
    [
        _TIMES**3 / 6.0 - _TIMES**2 / 4.0,
        _TIMES - _TIMES**3 / 3.0,
        _TIMES**3 / 6.0 + _TIMES**2 / 4.0,
    ]
)


class PlanarMotion(NamedTuple):
    """The eraser's motion in the plane of the board.

    Attributes
    ----------
    p_WB, R_WB : ndarray, shapes (3,) and (3, 3)
        Position (metres) and orientation of B in W.
    p_BE : ndarray, shape (2,)
        Foot of the eraser's body origin on the board, in metres.
    x_B : ndarray, shape (2,)
        The eraser's x axis, seen from above.
    velocity : ndarray, shape (3,)
        Velocity relative to the board in B of the eraser's point at the foot (x
        and y, m/s), and turning rate about z of B (rad/s).
    """

    p_WB: FloatArray
    R_WB: FloatArray
    p_BE: FloatArray
    x_B: FloatArray
    velocity: FloatArray


def read_patch(surface: ContactSurface, motion: PlanarMotion) -> FloatArray:
    """Read a contact surface, projected on the board.

    Parameters
    ----------
    surface : ContactSurface
        Of triangles or polygons, in W.
    motion : PlanarMotion
        At the same time.

    Returns
    -------
    ndarray, shape (4, num_vertices)
        x and y in B (metres), pressure (Pa) and number of the polygon, polygon by
        polygon.
    """
    index: range | list[int]
    if surface.is_triangle():
        triangles = surface.tri_mesh_W()
        field = surface.tri_e_MN()
        faces = triangles.triangles()
        index = [face.vertex(i) for face in faces for i in range(3)]
        owner = np.repeat(np.arange(len(faces)), 3)
        vertices = [*map(triangles.vertex, index)]
        pressure = [*map(field.EvaluateAtVertex, index)]
    else:
        mesh = surface.poly_mesh_W()
        linear = surface.poly_e_MN()
        index, counts = _in_order(mesh.face_data())
        owner = np.repeat(np.arange(len(counts)), counts)
        # The longest step of an update: 0.7 us for each vertex.
        vertices = [*map(mesh.vertex, index)]
        pressure = [*map(linear.EvaluateAtVertex, index)]
    patch = np.empty((4, len(index)))
    R_WB = motion.R_WB[:, :2]
    p_WV = np.concatenate(vertices).reshape(-1, 3)
    patch[:2] = (p_WV @ R_WB - motion.p_WB @ R_WB).T
    patch[2] = pressure
    patch[3] = owner
    return patch


def join_patches(patches: list[FloatArray]) -> FloatArray:
    """Put patches side by side; each has at least one polygon."""
    first = 0.0
    for patch in patches:
        patch[3] += first
        first = patch[3, -1] + 1.0
    return patches[0] if len(patches) == 1 else np.hstack(patches)


def _in_order(face_data: list[int]) -> tuple[list[int], list[int]]:
    """Split counted polygons into indices, polygon by polygon, and counts."""
    index: list[int] = []
    counts: list[int] = []
    i = 0
    while i < len(face_data):
        count = face_data[i]
        index += face_data[i + 1 : i + 1 + count]
        counts.append(count)
        i += 1 + count
    return index, counts


def planar_motion(
    *,
    X_WB: RigidTransform,
    X_WBoard: RigidTransform,
    X_WE: RigidTransform,
    V_WBoard: SpatialVelocity,
    V_WE: SpatialVelocity,
) -> PlanarMotion:
    """Find how the eraser moves over the board.

    Parameters
    ----------
    X_WB : RigidTransform
        Pose of the board frame B.
    X_WBoard, X_WE : RigidTransform
        Poses of the bodies of board and eraser.
    V_WBoard, V_WE : SpatialVelocity
        Their spatial velocities.
    """
    p_WB, R_WB = X_WB.translation(), X_WB.rotation().matrix()
    p_WE = X_WE.translation()
    w_Board = V_WBoard.rotational()
    arm = (p_WE - X_WBoard.translation()).tolist()
    v_W = V_WE.translational() - V_WBoard.translational() - _cross(w_Board, arm)
    rows = np.array([p_WE - p_WB, V_WE.rotational() - w_Board, v_W])
    (px, py, pz), (wx, wy, wz), (vx, vy, _) = (rows @ R_WB).tolist()
    x_B = X_WE.rotation().matrix()[:, 0] @ R_WB[:, :2]
    # From the body's origin down to its point in the plane z = 0.
    return PlanarMotion(
        p_WB=p_WB,
        R_WB=R_WB,
        p_BE=np.array([px, py]),
        x_B=x_B,
        velocity=np.array([vx - wy * pz, vy + wx * pz, wz]),
    )


def rubbing(
    grid: InkGrid,
    patch: FloatArray,
    *,
    p_BE: FloatArray,
    x_B: FloatArray,
    velocities: FloatArray,
    period: float,
    worn: float = 0.0,
) -> Sweep:
    """Find how much a patch has rubbed the cells it came over.

    The patch moves as the parabola through the three velocities says, and is looked
    at every `LONGEST_STEP` or closer.

    Parameters
    ----------
    grid : InkGrid
        The cells.
    patch : ndarray, shape (4, num_vertices)
        In the middle of the period, see `read_patch`.
    p_BE, x_B : ndarray, shape (2,)
        See `PlanarMotion`; in the middle of the period.
    velocities : ndarray, shape (3, 3)
        See `PlanarMotion`; at the start, in the middle and at the end, row by row.
    period : float
        In seconds.
    worn : float
        See `worn_felt`.

    Returns
    -------
    Sweep
        With pressure times path in Pa m in place of the pressure.
    """
    way = _WAY @ (0.5 * period * velocities)
    x, y, _ = way.T
    arc = np.hypot(x[1:] - x[:-1], y[1:] - y[:-1]).cumsum()
    length = float(arc[-1])
    places = max(1, math.ceil(length / LONGEST_STEP))
    passed = (np.arange(places) + 0.5) * (length / places)
    knots = np.concatenate([[0.0], arc])
    offsets = np.array([np.interp(passed, knots, x), np.interp(passed, knots, y)]).T
    rows, columns, pressure = sweep(
        grid, patch[:2].T, patch[2], patch[3], offsets=offsets
    )
    x = grid.x[columns] - p_BE[0]
    y = (grid.y[rows] - p_BE[1])[:, np.newaxis]
    path: FloatArray | float = 0.0
    for dx, dy, turn in (way[0].tolist(), way[-1].tolist()):
        # Of the eraser's point that passes the cell half-way, in each half.
        along_x = dx - turn * (y - 0.5 * dy)
        along_y = dy + turn * (x - 0.5 * dx)
        path = path + np.sqrt(along_x * along_x + along_y * along_y)
    pressure *= path
    if worn > 0.0:
        p_E = x_B[1] * y + x_B[0] * x
        shift = offsets @ x_B
        pressure *= worn_felt(p_E - shift[:, np.newaxis, np.newaxis], worn).mean(axis=0)
    return Sweep(rows, columns, pressure)


def worn_felt(x_E: ArrayLike, worn: float) -> FloatArray:
    """Tell how much of the rubbing is left at points of a worn felt.

    The felt has gone in straight stripes across its length, `STRIPE_PITCH` apart,
    one in the middle. It still bears pressure there, but rubs nothing off.

    Parameters
    ----------
    x_E : array_like
        Position along the eraser's x axis in metres, 0 in the middle.
    worn : float
        Share of the felt that has gone, from 0 to 1: the stripes' width over
        their distance.

    Returns
    -------
    ndarray, same shape
        1 where the felt rubs, 0 where it has gone.
    """
    x = np.asarray(x_E, dtype=float) / STRIPE_PITCH
    return np.where(2.0 * np.abs(x - np.rint(x)) >= worn, 1.0, 0.0)


def _cross(a: FloatArray, b: list[float]) -> FloatArray:
    """Return a x b; NumPy's own takes ten times as long."""
    ax, ay, az = a.tolist()
    bx, by, bz = b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
