"""Scripted disturbances: pushes and grasps of the tool at given times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array
from fmp_drake.settings import bounded, check_settings
from fmp_drake.systems.interface.callbacks import (
    declare_bodies,
    declare_spatial_forces,
    spatial_force,
)

DISTURBANCES = ("push", "grasp")

# Mass for which a grasp is critically damped, kg.
_MASS = 5.0


@dataclass(kw_only=True)
class Disturbance:
    """Disturbance of the arm at its eraser by a person, at given times.

    Attributes
    ----------
    kind : str
        `push`: a constant force. `grasp`: a hand that pulls to a point like a spring.
    start, duration : float
        s.
    every : float
        Period of its repetition, s; 0 for once.
    force : list of 3 floats
        Of a push, in B, N.
    position : list of 3 floats
        p_B of a grasp, m.
    stiffness : float
        Of a grasp, N/m; it is critically damped for a mass of 5 kg.
    max_force : float
        Greatest force of a grasp, N.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> push = Disturbance(start=2.0, every=5.0, force=[0.0, 20.0, 0.0])
    >>> scenario = Scenario(disturbances=[push])
    >>> push.is_active(2.5), push.is_active(4.0), push.is_active(7.5)
    (True, False, True)
    """

    kind: str = "push"
    start: float = bounded(0.0, least=0)
    duration: float = bounded(1.0, above=0)
    every: float = bounded(0.0, least=0)
    force: list[float] = bounded([0.0, 0.0, 0.0])
    position: list[float] = bounded([0.0, 0.0, 0.0])
    stiffness: float = bounded(1000.0, above=0)
    max_force: float = bounded(60.0, above=0)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.kind not in DISTURBANCES:
            return (
                f"a disturbance's kind is {self.kind}; choose one of: "
                f"{', '.join(DISTURBANCES)}."
            )
        if 0 < self.every < self.duration:
            return (
                f"a disturbance of {self.duration} s comes every {self.every} s; it "
                "must end before it begins again."
            )
        return ""

    def is_active(self, time: float | Array, *, after: float = 0.0) -> Any:
        """Return whether the disturbance is active, or was at most some time before.

        Parameters
        ----------
        time : float or array
            s.
        after : float
            Time after its end that counts as well, s.
        """
        since = time - self.start
        has_begun = since >= 0
        if self.every > 0:
            since = since % self.every
        return has_begun & (since < self.duration + after)

    def pull(self, displacement: Array, v: Array) -> Array:
        """Return the force of a grasp, N.

        Parameters
        ----------
        displacement, v : ndarray, shape (3,)
            From the tool to the position, m, and velocity of the tool, m/s.
        """
        damping = 2 * np.sqrt(self.stiffness * _MASS)
        force: Array = self.stiffness * displacement - damping * v
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
    disturbances : sequence of Disturbance
    X_WB : RigidTransform
        Frame of their forces and positions.

    Raises
    ------
    SystemsError
        If a disturbance has a kind or a number that is not allowed.

    Examples
    --------
    >>> from pydrake.multibody.plant import MultibodyPlant
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> tool = plant.AddRigidBody("tool")
    >>> plant.Finalize()
    >>> push = Disturbance(start=1.0, duration=0.5, force=[10.0, 0.0, 0.0])
    >>> script = ScriptedDisturbances(
    ...     grip=tool.body_frame(), disturbances=[push], X_WB=RigidTransform()
    ... )
    >>> context = script.CreateDefaultContext()
    >>> context.SetTime(1.2)
    >>> script.GetOutputPort("force").Eval(context)
    array([10.,  0.,  0.])
    """

    def __init__(
        self,
        *,
        grip: Frame,
        disturbances: Sequence[Disturbance],
        X_WB: RigidTransform,
    ) -> None:
        super().__init__()
        self.set_name("disturbances")
        for each in disturbances:
            check_settings(each, SystemsError, "disturbance ")
        # With the force of a push, or the position of a grasp, in W.
        self._script = [
            (
                replace(each),
                X_WB.rotation() @ np.array(each.force)
                if each.kind == "push"
                else X_WB @ np.array(each.position),
            )
            for each in disturbances
        ]
        self._body = int(grip.body().index())
        self._X_BodyG = grip.GetFixedPoseInBodyFrame()
        self._poses, self._velocities = declare_bodies(self)
        prerequisites = {self.time_ticket()}
        if any(each.kind == "grasp" for each in disturbances):
            prerequisites |= {self._poses.ticket(), self._velocities.ticket()}
        declare_spatial_forces(self, self._calc_forces, prerequisites)
        self.DeclareVectorOutputPort("force", 3, self._calc_vector, prerequisites)

    def _sum(self, context: Context) -> Array:
        """Return the force on the tool in W, N."""
        time = context.get_time()
        force = np.zeros(3)
        for disturbance, vector_W in self._script:
            if not disturbance.is_active(time):
                continue
            if disturbance.kind == "push":
                force = force + vector_W
            else:
                poses: Any = self._poses.Eval(context)
                velocities: Any = self._velocities.Eval(context)
                X_WBody, V_WBody = poses[self._body], velocities[self._body]
                arm = X_WBody.rotation() @ self._X_BodyG.translation()
                displacement = vector_W - (X_WBody.translation() + arm)
                v_WG = V_WBody.Shift(arm).translational()
                force = force + disturbance.pull(displacement, v_WG)
        return force

    def _calc_forces(self, context: Context, output: Any) -> None:
        force = self._sum(context)
        if not force.any():
            output.set_value([])
            return
        p_BoG = self._X_BodyG.translation()
        output.set_value([spatial_force(self._body, p_BoG, np.zeros(3), force)])

    def _calc_vector(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._sum(context))
