"""The Panda under its impedance controller in free air, with any signals as inputs."""

from collections.abc import Callable, Sequence

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from fmp_drake.station import AddRobot, LoadRobot
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)

PANDA = LoadRobot("panda")
PANDA_FRICTION = PANDA.friction
Q_START = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])
X_WT_FLAT = RigidTransform([0.5, 0, 0.1])
X_WT_TILTED = RigidTransform(RollPitchYaw(0.3, -0.4, 0.5), [0.45, 0.05, 0.2])
# What a test looks at; each takes a tenth of the time of a simulation.
LOGGED = ("state", "torque", "tracking_error", "status")
Signal = Callable[[float], np.ndarray]


def make_arm(*, gravity: bool = True, stops: bool = True) -> MultibodyPlant:
    """The arm and its eraser; without stops the joints may leave their ranges."""
    plant = MultibodyPlant(time_step=0.001)
    robot = AddRobot(plant, PANDA)
    for instance in (robot.arm, robot.tool):
        plant.set_gravity_enabled(instance, gravity)
    if not stops:
        for index in plant.GetJointIndices(robot.arm):
            joint = plant.get_joint(index)
            if joint.num_positions():
                joint.set_position_limits([-np.inf], [np.inf])
    plant.Finalize()
    return plant


def configurations(n: int, *, seed: int = 1) -> list[np.ndarray]:
    """Poses all over the workspace, away from limits and from singularities."""
    plant = make_arm()
    context = plant.CreateDefaultContext()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < n:
        q = rng.uniform(lower + 0.3, upper - 0.3)
        plant.SetPositions(context, q)
        J = jacobian(plant, context)
        weighted = J * np.array([0.25] * 3 + [1.0] * 3)[:, None]
        mobility = weighted @ np.linalg.solve(plant.CalcMassMatrix(context), weighted.T)
        if 1 / np.linalg.eigvalsh(mobility)[0] < 60:
            found.append(q)
    return found


def jacobian(plant, context, X_WT: RigidTransform | None = None) -> np.ndarray:
    """The Jacobian of E's twist, in the axes of T."""
    E, W = plant.GetFrameByName("eraser_tip"), plant.world_frame()
    J = plant.CalcJacobianSpatialVelocity(
        context, JacobianWrtVariable.kV, E, np.zeros(3), W, W
    )
    if X_WT is None:
        return J
    return np.kron(np.eye(2), X_WT.rotation().matrix().T) @ J


def pose_in_task(plant, q, X_WT: RigidTransform) -> RigidTransform:
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    X_WE = plant.GetFrameByName("eraser_tip").CalcPoseInWorld(context)
    return X_WT.inverse() @ X_WE


def quaternion(R) -> np.ndarray:
    return R.ToQuaternion().wxyz()


class Signals(LeafSystem):
    """Vectors as functions of time, or of time and the arm's state."""

    def __init__(self, signals: dict[str, tuple[int, Signal]], n: int) -> None:
        super().__init__()
        self._state = self.DeclareVectorInputPort("state", 2 * n)
        for name, (size, function) in signals.items():
            required = function.__code__.co_argcount - len(function.__defaults__ or ())
            if required == 1:
                tickets = {self.time_ticket()}

                def calc(context, output, function=function):
                    output.SetFromVector(function(context.get_time()))
            else:
                tickets = {self.time_ticket(), self._state.ticket()}

                def calc(context, output, function=function):
                    state = self._state.Eval(context)
                    output.SetFromVector(function(context.get_time(), state))

            self.DeclareVectorOutputPort(name, size, calc, tickets)


class Push(LeafSystem):
    """A wrench on E, torque and force, in the world."""

    def __init__(self, plant: MultibodyPlant) -> None:
        super().__init__()
        E = plant.GetFrameByName("eraser_tip")
        self._body = E.body().index()
        self._p = E.GetFixedPoseInBodyFrame().translation()
        self._wrench = self.DeclareVectorInputPort("wrench", 6)
        self.DeclareAbstractOutputPort(
            "forces",
            lambda: Value[list[ExternallyAppliedSpatialForce]](),
            self._calc,
            {self._wrench.ticket()},
        )

    def _calc(self, context, output):
        wrench = self._wrench.Eval(context)
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._body
        force.p_BoBq_B = self._p
        force.F_Bq_W = SpatialForce(wrench[:3], wrench[3:])
        output.set_value([force])


class ArmLoop:
    """Arm, controller, signals and a push; logs of every millisecond.

    Signals are functions of the time, or of the time and the arm's state. What is
    not given rests at the pose of the start; optional inputs stay unconnected.
    `push` is a wrench in the world, `load` a generalized force. `log` names outputs of
    the controller, `state` and `push`.
    """

    def __init__(
        self,
        signals: dict[str, Signal] | None = None,
        *,
        config: ImpedanceConfig | None = None,
        q: np.ndarray = Q_START,
        X_WT: RigidTransform = X_WT_FLAT,
        q_posture: np.ndarray | None = None,
        push: Signal | None = None,
        load: Signal | None = None,
        engage_height: float = 0.01,
        stops: bool = True,
        log: Sequence[str] = LOGGED,
    ) -> None:
        self.q = np.array(q, dtype=float)
        self.X_TE = pose_in_task(make_arm(), q, X_WT)
        config = PANDA.complete(config or ImpedanceConfig())
        resting = {
            "desired_orientation": quaternion(self.X_TE.rotation()),
            "desired_position": self.X_TE.translation(),
            "desired_velocity": np.zeros(3),
            "desired_acceleration": np.zeros(3),
        }
        moving = dict(signals or {})

        builder = DiagramBuilder()
        self.plant = builder.AddSystem(make_arm(gravity=False, stops=stops))
        self.controller = builder.AddSystem(
            OperationalSpaceImpedanceController(
                model := make_arm(),
                end_effector=model.GetFrameByName("eraser_tip"),
                X_WT=X_WT,
                config=config,
                q_posture=self.q if q_posture is None else q_posture,
                engage_height=engage_height,
            )
        )
        sized = {
            name: (self.controller.GetInputPort(name).size(), function)
            for name, function in moving.items()
        }
        sized |= {"push": (6, push)} if push else {}
        sized |= {"load": (7, load)} if load else {}
        source = builder.AddSystem(Signals(sized, 7))
        state = self.plant.get_state_output_port()
        for system in (source, self.controller):
            builder.Connect(state, system.GetInputPort("state"))
        for name in moving:
            builder.Connect(
                source.GetOutputPort(name), self.controller.GetInputPort(name)
            )
        for name in resting.keys() - moving.keys():
            constant = builder.AddSystem(ConstantVectorSource(resting[name]))
            builder.Connect(
                constant.get_output_port(), self.controller.GetInputPort(name)
            )
        builder.Connect(
            self.controller.GetOutputPort("torque"),
            self.plant.get_actuation_input_port(),
        )
        if push:
            pusher = builder.AddSystem(Push(self.plant))
            builder.Connect(source.GetOutputPort("push"), pusher.get_input_port())
            builder.Connect(
                pusher.get_output_port(),
                self.plant.get_applied_spatial_force_input_port(),
            )
        if load:
            builder.Connect(
                source.GetOutputPort("load"),
                self.plant.get_applied_generalized_force_input_port(),
            )
        ports = {"state": state}
        if push:
            ports["push"] = source.GetOutputPort("push")
        for name in set(log) - {*ports}:
            ports[name] = self.controller.GetOutputPort(name)
        self._logs = {
            name: LogVectorOutput(ports[name], builder, 0.001) for name in log
        }
        self.diagram = builder.Build()

    def run(self, duration: float, *, v: np.ndarray | None = None, stop=None) -> dict:
        """Simulate from q; logs of every millisecond, one row each."""
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        plant_context = self.plant.GetMyMutableContextFromRoot(context)
        self.plant.SetPositions(plant_context, self.q)
        if v is not None:
            self.plant.SetVelocities(plant_context, v)
        if stop is not None:
            simulator.set_monitor(
                lambda root: (
                    EventStatus.ReachedTermination(self.diagram, "")
                    if stop(root)
                    else EventStatus.DidNothing()
                )
            )
        simulator.AdvanceTo(duration)
        return {
            name: log.FindLog(context).data().T.copy()
            for name, log in self._logs.items()
        }

    def power(self, logs: dict) -> np.ndarray:
        """Power that the push brings into the arm at each time, W."""
        plant = make_arm()
        context = plant.CreateDefaultContext()
        power = np.empty(len(logs["state"]))
        for k, (state, push) in enumerate(
            zip(logs["state"], logs["push"], strict=True)
        ):
            plant.SetPositionsAndVelocities(context, state)
            power[k] = push @ (jacobian(plant, context) @ state[7:])
        return power
