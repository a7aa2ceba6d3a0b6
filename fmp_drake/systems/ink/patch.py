"""Contact patch and motion of the eraser on the board, from the plant's outputs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from fmp_drake.systems.ink.grid import WEAR_CONSTANT
from fmp_drake.systems.ink.rubbing import Cells, Patch, PlanarMotion, exposure, wear
from fmp_drake.systems.surface.surface import (
    PLANE,
    Surface,
    project,
    project_all,
    rotation,
)

type FloatArray = NDArray[np.float64]

_DIFFERENCE = 1e-5  # Step of central differences, s.


def read_patch(
    surfaces: Sequence[ContactSurface],
    X_WB: RigidTransform,
    motion: PlanarMotion,
    curvature: Surface = PLANE,
) -> tuple[Patch, FloatArray]:
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
    vertices: list[FloatArray] = []
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
            # The longest step of an update: 1 us for each vertex.
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


def rectangle(outline: FloatArray) -> Patch:
    """Return a rectangular patch of even pressure.

    Parameters
    ----------
    outline : ndarray, shape (6,)
        Smallest x and y, largest x and y (m), pressure (Pa), depth (m).
    """
    x0, y0, x1, y1, p, depth = outline
    corners = [[x0, y0, p], [x1, y0, p], [x1, y1, p], [x0, y1, p]]
    return Patch(np.array(corners), np.array([0, 4]), depth)


def compile_rubbing(cells: Cells) -> None:
    """Compile the wear of the ink, by one use on a board that is not kept."""
    rest = PlanarMotion(*[0.0] * len(PlanarMotion._fields))
    rubbing = exposure(cells, rectangle(np.zeros(6)), rest, rest, 0.0).ravel()
    wear(rubbing.copy(), rubbing, WEAR_CONSTANT)


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
    near: FloatArray | None = None,
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
    along = R_BW @ X_WE.rotation().matrix()[:, 0]
    w_BE = R_BW @ (V_WE.rotational() - V_WB.rotational())
    if curvature.is_plane:
        (x, y, z), (v_x, v_y, v_z) = p_BE, v_BE
        yaw = np.arctan2(along[1], along[0])
        return PlanarMotion(time, x, y, yaw, v_x, v_y, w_BE[2], -z, -v_z)
    near = np.zeros(2) if near is None else near

    def coordinates(seconds: float) -> FloatArray:
        uvh = project(curvature, p_BE + seconds * v_BE, near)
        axis = along + seconds * np.cross(w_BE, along)
        cos, sin, _ = rotation(curvature, uvh[0], uvh[1]).T @ axis
        return np.array([uvh[0], uvh[1], np.arctan2(sin, cos), -uvh[2]])

    change = coordinates(_DIFFERENCE) - coordinates(-_DIFFERENCE)
    change[2] = (change[2] + np.pi) % (2 * np.pi) - np.pi
    x, y, yaw, depth = coordinates(0.0)
    v_x, v_y, yaw_rate, sinking = change / (2 * _DIFFERENCE)
    return PlanarMotion(time, x, y, yaw, v_x, v_y, yaw_rate, depth, sinking)
