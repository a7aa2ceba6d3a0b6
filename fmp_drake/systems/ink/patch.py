"""What an ink board reads of a plant: the contact patch and the eraser's motion."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from fmp_drake.systems.ink.rubbing import Patch, PlanarMotion

type FloatArray = NDArray[np.float64]


def read_patch(
    surfaces: Sequence[ContactSurface], X_WB: RigidTransform, motion: PlanarMotion
) -> tuple[Patch, FloatArray]:
    """Read contact surfaces of triangles or polygons, projected on the board.

    Parameters
    ----------
    surfaces : sequence of ContactSurface
        At least one.
    X_WB : RigidTransform
        The board.
    motion : PlanarMotion
        The eraser at the same instant.

    Returns
    -------
    patch : Patch
    outline : ndarray, shape (6,)
        The rectangle around it, see `rectangle`.
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
    X_WE = X_WB @ RigidTransform(
        RotationMatrix.MakeZRotation(motion.yaw), np.array([motion.x, motion.y, 0.0])
    )
    values = np.concatenate(vertices).reshape(-1, 3) - X_WE.translation()
    values = values @ X_WE.rotation().matrix()
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
) -> PlanarMotion:
    """Find how the eraser moves over the board from poses and spatial velocities."""
    R_BW = X_WB.rotation().matrix().T
    p_BE_W = X_WE.translation() - X_WB.translation()
    x, y, z = R_BW @ p_BE_W
    v_x, v_y, v_z = R_BW @ (V_WE.translational() - V_WB.Shift(p_BE_W).translational())
    cos, sin, _ = R_BW @ X_WE.rotation().matrix()[:, 0]
    yaw_rate = R_BW[2] @ (V_WE.rotational() - V_WB.rotational())
    yaw = np.arctan2(sin, cos)
    return PlanarMotion(time, x, y, yaw, v_x, v_y, yaw_rate, -z, -v_z)
