"""Scripted disturbances: pushes and grasps of the tool at given times."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.systems.interface.callbacks import (
    declare_bodies,
    declare_cache,
    eval_cache,
    weakly,
)

# Mass for which a grasp is critically damped, kg.
_MASS = 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """A constant force on the tool during an interval.

    Attributes
    ----------
    start, duration : float
        s.
    every : float
        Period of its repetition, s; 0 for once.
    force : ndarray, shape (3,)
        In W, N.

    Examples
    --------
    >>> push = Push(start=2.0, duration=1.0, every=5.0, force=np.array([0.0, 20.0, 0.0]))
    >>> push.acts(2.5), push.acts(4.0), push.acts(7.5)
    (True, False, True)
    """

    start: float
    duration: float
    every: float = 0.0
    force: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def acts(self, time: float) -> bool:
        """Return whether the push is active at a time, s."""
        since = time - self.start
        if self.every > 0 and since >= 0:
            since %= self.every
        return 0 <= since < self.duration


@dataclass(frozen=True, kw_only=True, eq=False)
class Grasp(Push):
    """A grasp that pulls the tool to a point like a spring of limited force.

    Its constant `force` is added.

    Attributes
    ----------
    point : ndarray, shape (3,)
        In W, m.
    stiffness : float
        N/m; it is critically damped for a mass of 5 kg.
    max_force : float
        N.

    Examples
    --------
    >>> grasp = Grasp(
    ...     start=2.0,
    ...     duration=1.0,
    ...     point=np.array([0.5, 0.0, 0.1]),
    ...     stiffness=1000.0,
    ...     max_force=60.0,
    ... )
    >>> grasp.pull(np.array([0.48, 0.0, 0.1]), np.zeros(3)).round(6)
    array([20.,  0.,  0.])
    """

    point: NDArray[np.float64]
    stiffness: float
    max_force: float

    def pull(
        self, p: NDArray[np.float64], v: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the force, N, on a tool at p (m) with the velocity v (m/s), in W."""
        damping = 2 * np.sqrt(self.stiffness * _MASS)
        force: NDArray[np.float64] = self.stiffness * (self.point - p) - damping * v
        size = float(np.linalg.norm(force))
        return force * min(1.0, self.max_force / max(size, 1e-9))


class ScriptedDisturbances(LeafSystem):
    """Forces of a list of pushes and grasps on the tool of an arm.

    Input ports
    -----------
    body_poses, body_spatial_velocities
        Abstract: the plant's; only a grasp needs them.

    Output ports
    ------------
    spatial_forces
        Abstract, list of `ExternallyAppliedSpatialForce`: for the plant.
    force : (3,)
        Their sum, in W, N.

    Parameters
    ----------
    grip : Frame
        Of the plant; the forces act at its origin.
    disturbances : sequence of Push or Grasp

    Examples
    --------
    >>> from pydrake.multibody.plant import MultibodyPlant
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> tool = plant.AddRigidBody("tool")
    >>> plant.Finalize()
    >>> push = Push(start=1.0, duration=0.5, force=np.array([10.0, 0.0, 0.0]))
    >>> script = ScriptedDisturbances(grip=tool.body_frame(), disturbances=[push])
    >>> context = script.CreateDefaultContext()
    >>> context.SetTime(1.2)
    >>> script.GetOutputPort("force").Eval(context)
    array([10.,  0.,  0.])
    """

    def __init__(self, *, grip: Frame, disturbances: Sequence[Push]) -> None:
        super().__init__()
        self.set_name("disturbances")
        self._disturbances = tuple(disturbances)
        self._body = grip.body().index()
        self._X_BodyG = grip.GetFixedPoseInBodyFrame()
        self._poses, self._velocities = declare_bodies(self)
        prerequisites = {self.time_ticket()}
        if any(isinstance(disturbance, Grasp) for disturbance in self._disturbances):
            prerequisites |= {self._poses.ticket(), self._velocities.ticket()}
        self._force = declare_cache(
            self, "force of the disturbances", self._calc, prerequisites
        )
        force = {self.cache_entry_ticket(self._force)}
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            alloc=lambda: Value[list[ExternallyAppliedSpatialForce]]([]),
            calc=weakly(self._calc_forces),
            prerequisites_of_calc=force,
        )
        self.DeclareVectorOutputPort(
            "force",
            3,
            self._calc_vector,
            prerequisites_of_calc=force,
        )

    def _calc(self, context: Any, value: Any) -> None:
        time = context.get_time()
        force = np.zeros(3)
        for disturbance in self._disturbances:
            if not disturbance.acts(time):
                continue
            force = force + disturbance.force
            if isinstance(disturbance, Grasp):
                poses: Any = self._poses.Eval(context)
                velocities: Any = self._velocities.Eval(context)
                X_WBody = poses[self._body]
                arm = X_WBody.rotation().multiply(self._X_BodyG.translation())
                V = velocities[self._body]
                v = V.translational() + np.cross(V.rotational(), arm)
                force = force + disturbance.pull(X_WBody.translation() + arm, v)
        value.set_value(force)

    def _calc_forces(self, context: Any, output: Any) -> None:
        force: Any = eval_cache(self, self._force, context)
        if not force.any():
            output.set_value([])
            return
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = self._body
        applied.p_BoBq_B = self._X_BodyG.translation()
        applied.F_Bq_W = SpatialForce(np.zeros(3), force)
        output.set_value([applied])

    def _calc_vector(self, context: Context, output: BasicVector) -> None:
        force: Any = eval_cache(self, self._force, context)
        output.SetFromVector(force)
