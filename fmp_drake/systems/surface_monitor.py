"""A system that watches whether anything hard is below a surface."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number, finite_array
from fmp_drake.systems.impedance.status import STATUS_SIZE, StatusFlag

type FloatArray = NDArray[np.float64]

TOLERANCE = 0.01
"""Depth in m up to which something hard may sink in: half the thickness of a board."""


class SurfaceMonitor(LeafSystem):
    """Says how deep the deepest hard point is below a surface, within its edges.

    Nothing should ever be there: what is hard has gone through the board then, or is on
    its way. What is pressed on the board sinks in a little, as contact is compliant: an
    eraser by 0.1 mm on its face and by 4 mm on a corner that bears 80 N. More than
    `TOLERANCE` is reported in the status.

    Input port ``body_poses``: abstract, list of `RigidTransform` X_WBody; the plant's.
    Output ports, both discrete state:

    - ``penetration`` (1,): depth of the deepest point, m; 0 where none is below.
    - ``status`` (6,): `StatusFlag.BELOW_SURFACE` in the place of the flags, or 0, and
      zeros; to be added to the controller's status.

    Parameters
    ----------
    surface : Frame
        B: origin at the centre of the surface, z outward.
    size : array_like, shape (2,)
        Edges of the surface along x and y of B, m.
    bodies : array_like of int, shape (N,)
        Index of the body that each point is fixed to.
    points : array_like, shape (N, 3)
        In the frames of their bodies, m.
    radii : array_like, shape (N,)
        Of the balls around the points, m.
    period : float
        Between two looks, s.

    Raises
    ------
    SystemsError
        If the arrays do not fit together or a number is out of range.

    Examples
    --------
    >>> from pydrake.multibody.plant import MultibodyPlant
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> stick = plant.AddRigidBody("stick")
    >>> plant.Finalize()
    >>> monitor = SurfaceMonitor(
    ...     surface=plant.world_frame(),
    ...     size=(1.0, 1.0),
    ...     bodies=[stick.index()],
    ...     points=[[0.0, 0.0, 0.0]],
    ...     radii=[0.01],
    ... )
    >>> context = monitor.CreateDefaultContext()
    >>> poses = [RigidTransform(), RigidTransform([0.1, 0.0, 0.004])]
    >>> _ = monitor.get_input_port().FixValue(context, poses)
    >>> monitor.ExecuteForcedEvents(context)
    >>> round(float(monitor.GetOutputPort("penetration").Eval(context)[0]), 6)
    0.006
    """

    def __init__(
        self,
        *,
        surface: Frame,
        size: ArrayLike,
        bodies: ArrayLike,
        points: ArrayLike,
        radii: ArrayLike,
        period: float = 0.02,
    ) -> None:
        super().__init__()
        self.set_name("surface_monitor")
        check_number(period, "period", above=0, unit="s", error=SystemsError)
        self._half = finite_array(size, "size", (2,), error=SystemsError) / 2
        self._radii = finite_array(radii, "radii", error=SystemsError)
        n = self._radii.size
        self._points = finite_array(points, "points", (n, 3), error=SystemsError)
        indices = finite_array(bodies, "bodies", (n,), error=SystemsError)
        self._bodies, self._owner = np.unique(indices.astype(int), return_inverse=True)
        self._surface = int(surface.body().index()), surface.GetFixedPoseInBodyFrame()
        self._poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        for name, length in (("penetration", 1), ("status", STATUS_SIZE)):
            self.DeclareStateOutputPort(name, self.DeclareDiscreteState(length))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)
        self.DeclareForcedDiscreteUpdateEvent(self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        poses: Any = self._poses.Eval(context)
        board, X_BoardB = self._surface
        X_BW = (poses[board] @ X_BoardB).inverse()
        X_BBody = np.array(
            [(X_BW @ poses[body]).GetAsMatrix34() for body in self._bodies]
        )
        depth = deepest(X_BBody[self._owner], self._points, self._radii, self._half)
        below = StatusFlag.BELOW_SURFACE if depth > TOLERANCE else 0
        values.set_value(0, np.array([depth]))
        values.get_mutable_value(1)[0] = below


def deepest(
    X_BBody: FloatArray, points: FloatArray, radii: FloatArray, half: FloatArray
) -> float:
    """Return how far the deepest of N balls is below z = 0 of B within a rectangle.

    Parameters
    ----------
    X_BBody : ndarray, shape (N, 3, 4)
        Rotation and translation of each ball's body.
    points : ndarray, shape (N, 3)
        The balls' centres in the frames of their bodies, m.
    radii : ndarray, shape (N,)
        m.
    half : ndarray, shape (2,)
        Half the edges of the rectangle, m.

    Returns
    -------
    float
        m; 0 where none is below.
    """
    lowest = np.einsum("ni,ni->n", X_BBody[:, 2, :3], points) + X_BBody[:, 2, 3] - radii
    below = lowest < 0.0
    if not below.any():
        return 0.0
    place = np.einsum("nij,nj->ni", X_BBody[below, :2, :3], points[below])
    within = np.all(np.abs(place + X_BBody[below, :2, 3]) < half, axis=1)
    return float(np.max(-lowest[below][within], initial=0.0))
