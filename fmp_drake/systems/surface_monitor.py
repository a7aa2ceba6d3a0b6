"""Supervision of a board: hard parts below its surface, and contacts of the arm."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, finite_array
from fmp_drake.systems.impedance.controller_status import STATUS_SIZE, StatusFlag
from fmp_drake.systems.surface.surface import PLANE, Surface, project_all

TOLERANCE = 0.01
"""Greatest tolerated penetration of a hard point, m: half the thickness of a board."""

# Time between two updates, s.
_PERIOD = 0.02


class SurfaceMonitor(LeafSystem):
    """Depth of the deepest hard point below a board's surface, within its edges.

    A hard point there has passed through the board, or is about to. Contact is compliant,
    so a small penetration is normal: 0.1 mm for the face of an eraser and 4 mm for a
    corner under 80 N. The status reports more than `TOLERANCE`, and a contact of the
    board with any link except the tool. A sphere of the arm that is wholly behind the
    board does not count.

    Input port ``body_poses``: abstract, list of `RigidTransform` X_WBody; the plant's.
    Output ports, both discrete state:

    - ``penetration`` (1,): depth of the deepest point, m; 0 where none is below.
    - ``status`` (6,): `StatusFlag.BELOW_SURFACE` and `StatusFlag.ARM_TOUCHES` in the
      place of the flags, or 0, and zeros; to be added to the controller's status.

    Parameters
    ----------
    surface : Frame
        B: origin at the centre of the surface, z outward.
    box : array_like, shape (2, 3)
        Lower and upper corner of the board, in B, or in (u, v, h) where it is curved, m.
    curvature : Surface
        Of the board.
    bodies : array_like of int, shape (N,)
        Index of the body that each point is fixed to.
    points : array_like, shape (N, 3)
        In the frames of their bodies, m.
    radii : array_like, shape (N,)
        Of the spheres around the points, m.
    on_arm : array_like of bool, shape (N,)
        Whether a sphere belongs to the arm, which must not touch the board.

    Raises
    ------
    SystemsError
        If the arrays do not fit together or a number is out of range.

    Examples
    --------
    >>> from pydrake.multibody.plant import MultibodyPlant
    >>> from fmp_drake.systems import ImpedanceStatus
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> stick = plant.AddRigidBody("stick")
    >>> plant.Finalize()
    >>> monitor = SurfaceMonitor(
    ...     surface=plant.world_frame(),
    ...     box=[[-0.5, -0.5, -0.02], [0.5, 0.5, 0.0]],
    ...     bodies=[stick.index()],
    ...     points=[[0.0, 0.0, 0.0]],
    ...     radii=[0.01],
    ...     on_arm=[True],
    ... )
    >>> context = monitor.CreateDefaultContext()
    >>> poses = [RigidTransform(), RigidTransform([0.1, 0.0, 0.004])]
    >>> _ = monitor.get_input_port().FixValue(context, poses)
    >>> monitor.ExecuteForcedEvents(context)
    >>> round(float(monitor.GetOutputPort("penetration").Eval(context)[0]), 6)
    0.006
    >>> status = monitor.GetOutputPort("status").Eval(context)
    >>> ImpedanceStatus.from_vector(status).flags.name
    'ARM_TOUCHES'
    """

    def __init__(
        self,
        *,
        surface: Frame,
        box: ArrayLike,
        bodies: ArrayLike,
        points: ArrayLike,
        radii: ArrayLike,
        on_arm: ArrayLike,
        curvature: Surface = PLANE,
    ) -> None:
        super().__init__()
        self.set_name("surface_monitor")
        self._box = finite_array(box, "box", (2, 3), error=SystemsError)
        self._top = max(0.0, float(self._box[1, 2]))
        self._radii = finite_array(radii, "radii", error=SystemsError)
        self._curvature = curvature
        n = self._radii.size
        self._points = finite_array(points, "points", (n, 3), error=SystemsError)
        on_arm = finite_array(on_arm, "on_arm", (n,), error=SystemsError)
        self._on_arm = on_arm.astype(bool)
        indices = finite_array(bodies, "bodies", (n,), error=SystemsError)
        self._bodies, self._owner = np.unique(indices.astype(int), return_inverse=True)
        self._surface = int(surface.body().index()), surface.GetFixedPoseInBodyFrame()
        self._poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        for name, length in (("penetration", 1), ("status", STATUS_SIZE)):
            self.DeclareStateOutputPort(name, self.DeclareDiscreteState(length))
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._update)
        self.DeclareForcedDiscreteUpdateEvent(self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        poses: Any = self._poses.Eval(context)
        board, X_BoardB = self._surface
        X_WB = poses[board] @ X_BoardB
        X_WBody = np.array([poses[body].GetAsMatrix34() for body in self._bodies])
        p_W = moved(X_WBody[self._owner], self._points)
        p_B = (p_W - X_WB.translation()) @ X_WB.rotation().matrix()
        p = along(self._curvature, p_B)
        depth, touches = 0.0, False
        if np.any(p[:, 2] < self._radii + self._top):  # Else all are above the board.
            # Links may always be behind the board, as at a bowl beside the arm's base.
            arm = self._on_arm
            is_behind = arm & (p[:, 2] < self._box[0, 2] - self._radii)
            depth = deepest(p[~is_behind], self._radii[~is_behind], self._box)
            gaps = clearances(p[arm], self._radii[arm], self._box)
            touches = bool(np.any(gaps < 0))
        flags = StatusFlag.BELOW_SURFACE * (depth > TOLERANCE)
        values.set_value(0, np.array([depth]))
        values.get_mutable_value(1)[0] = flags + StatusFlag.ARM_TOUCHES * touches


def moved(X: Array, p: Array) -> Array:
    """Return points (..., 3) in another frame, by its poses X, shape (..., 3, 4)."""
    return (X[..., :3] @ p[..., None])[..., 0] + X[..., 3]


def along(curvature: Surface, p_B: Array) -> Array:
    """Return points (..., 3) in the coordinates (u, v, h) of a surface, m."""
    if curvature.is_plane:
        return p_B
    uvh = project_all(curvature, p_B.reshape(-1, 3), np.zeros(2))
    return uvh.reshape(p_B.shape)


def deepest(p: Array, radii: Array, box: Array) -> float:
    """Return the depth of the deepest of N spheres below z = 0, within a board's edges.

    Parameters
    ----------
    p : ndarray, shape (N, 3)
        Centres of the spheres in the coordinates of the board, m.
    radii : ndarray, shape (N,)
        m.
    box : ndarray, shape (2, 3)
        Lower and upper corner of the board, m.

    Returns
    -------
    float
        m; 0 where none is below.
    """
    is_within = np.all((p > box[0])[:, :2] & (p < box[1])[:, :2], axis=1)
    return float(np.max((radii - p[:, 2])[is_within], initial=0.0))


def clearances(p: Array, radii: Array, box: Array) -> Array:
    """Return the distances of spheres from a box, m; negative inside it.

    Parameters
    ----------
    p : ndarray, shape (..., N, 3)
        Centres of the spheres, m.
    radii : ndarray, shape (N,)
        m.
    box : ndarray, shape (2, 3)
        Lower and upper corner, m.

    Returns
    -------
    ndarray, shape (..., N)
    """
    gap = np.maximum(box[0] - p, p - box[1])
    depth = np.minimum(np.max(gap, axis=-1), 0.0)
    return np.linalg.norm(np.maximum(gap, 0.0), axis=-1) + depth - radii
