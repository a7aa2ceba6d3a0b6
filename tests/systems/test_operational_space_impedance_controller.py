"""Facts about the operational-space impedance controller as a system."""

import copy
import gc
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from arm_loop import (
    PANDA,
    Q_START,
    X_WT_FLAT,
    X_WT_TILTED,
    jacobian,
    make_arm,
    pose_in_task,
)
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    ExternallyAppliedSpatialForce,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    JacobianWrtVariable,
    PrismaticJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    Adder,
    ConstantValueSource,
    ConstantVectorSource,
    LogVectorOutput,
)
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.systems.impedance.algebra import Pose, task_error
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.joints import (
    FrictionConfig,
    JointWallConfig,
    rate_scale,
    torque_scale,
)
from fmp_drake.systems.impedance.law import ArmDynamics, impedance_law
from fmp_drake.systems.impedance.records import values_of
from fmp_drake.systems.impedance.step import impedance_step
from fmp_drake.systems.interface.arm_model import (
    ArmModel,
    check_limits,
    checked_posture,
)
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)

pytestmark = pytest.mark.slow

NO_LIMIT = 1e9


def make_controller(
    plant: MultibodyPlant,
    config: ImpedanceConfig | None = None,
    X_WT: RigidTransform = X_WT_FLAT,
    q_posture: np.ndarray | None = Q_START,
) -> OperationalSpaceImpedanceController:
    return OperationalSpaceImpedanceController(
        plant,
        end_effector=plant.GetFrameByName("eraser_tip"),
        X_WT=X_WT,
        config=config or PANDA.complete(ImpedanceConfig()),
        q_posture=q_posture,
    )


@pytest.fixture(scope="module")
def plant() -> MultibodyPlant:
    return make_arm()


@pytest.fixture(scope="module")
def controller(plant) -> OperationalSpaceImpedanceController:
    return make_controller(plant, X_WT=X_WT_TILTED)


def random_inputs(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = Q_START + 0.2 * rng.normal(size=7)
    return {
        "state": np.r_[q, 0.3 * rng.normal(size=7)],
        "desired_position": pose_in_task(make_arm(), q, X_WT_TILTED).translation()
        + 0.01 * rng.normal(size=3),
        "desired_velocity": 0.3 * rng.normal(size=3),
        "desired_acceleration": rng.normal(size=3),
        "feedforward_wrench": rng.normal(size=6),
    }


def fix(system, context, inputs) -> None:
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)


def outputs(system, context) -> dict[str, np.ndarray]:
    ports = [system.get_output_port(i) for i in range(system.num_output_ports())]
    return {port.get_name(): np.array(port.Eval(context)) for port in ports}


def updated_torque(system, context) -> np.ndarray:
    values = system.EvalUniquePeriodicDiscreteUpdate(context)
    return values.value(0).copy()


def expected_values(plant, config, X_WT, inputs, previous):
    """Every output and the next torque, from Drake's plant and the pure law."""
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, inputs["state"])
    E, W = plant.GetFrameByName("eraser_tip"), plant.world_frame()
    arguments = (context, JacobianWrtVariable.kV, E, np.zeros(3), W, W)
    turn = np.kron(np.eye(2), X_WT.rotation().matrix().T)
    J = turn @ plant.CalcJacobianSpatialVelocity(*arguments)
    v = inputs["state"][7:]
    X_TE = X_WT.inverse() @ E.CalcPoseInWorld(context)
    error = task_error.py_func(
        Pose(X_TE.rotation().matrix(), X_TE.translation()),
        Pose(config.desired_rotation(), inputs["desired_position"]),
    )
    torque = impedance_law.py_func(
        values_of(config),
        ArmDynamics(
            v=v,
            M=plant.CalcMassMatrix(context),
            Cv=plant.CalcBiasTerm(context),
            J=J,
            Jdot_v=turn @ plant.CalcBiasSpatialAcceleration(*arguments).get_coeffs(),
        ),
        stiffness=config.stiffness(),
        error=error,
        desired_twist=np.r_[np.zeros(3), inputs["desired_velocity"]],
        desired_acceleration=np.r_[np.zeros(3), inputs["desired_acceleration"]],
        feedforward_wrench=inputs["feedforward_wrench"],
        posture_error=Q_START - inputs["state"][:7],
    ).torque
    limit = plant.GetEffortUpperLimits()
    weight = plant.CalcGravityGeneralizedForces(context)
    lower = np.maximum(-limit, weight - 0.99 * limit)
    upper = np.minimum(limit, weight + 0.99 * limit)
    torque = torque_scale(torque, lower, upper) * torque
    change = torque - previous
    most = config.max_torque_rate * config.control_period
    V_WE = E.CalcSpatialVelocityInWorld(context).translational()
    return {
        "torque": previous + rate_scale(change, most) * change,
        "measured_position": X_TE.translation(),
        "measured_velocity": X_WT.rotation().matrix().T @ V_WE,
        "measured_pose": np.r_[
            X_TE.rotation().ToQuaternion().wxyz(), X_TE.translation()
        ],
        "tracking_error": error,
    }


# Ports and contexts


def test_ports_have_names_and_sizes(controller):
    inputs = [controller.get_input_port(i) for i in range(controller.num_input_ports())]
    assert {port.get_name(): port.size() for port in inputs} == {
        "state": 14,
        "desired_position": 3,
        "desired_velocity": 3,
        "desired_acceleration": 3,
        "feedforward_wrench": 6,
        "desired_orientation": 4,
        "desired_angular_velocity": 3,
        "desired_angular_acceleration": 3,
        "task_frame": 7,
        "task_frame_velocity": 6,
        "task_frame_acceleration": 6,
        "target_time": 1,
        "stiffness": 36,
        "covariance": 9,
        "normal_force": 1,
        "desired_normal_force": 1,
    }
    context = controller.CreateDefaultContext()
    fix(controller, context, random_inputs(0))
    sizes = {name: value.size for name, value in outputs(controller, context).items()}
    assert sizes == {
        "torque": 7,
        "measured_position": 3,
        "measured_velocity": 3,
        "measured_pose": 7,
        "tracking_error": 6,
        "status": 6,
        "last_fault": 1,
    }
    assert controller.get_name() == "operational_space_impedance_controller"


def test_only_measurements_feed_through(controller):
    through = {
        (controller.get_input_port(i).get_name(), port.get_name())
        for i in range(controller.num_input_ports())
        for j in range(controller.num_output_ports())
        if controller.HasDirectFeedthrough(i, j)
        for port in [controller.get_output_port(j)]
    }
    assert through == {
        ("state", "measured_position"),
        ("state", "measured_velocity"),
        ("state", "tracking_error"),
        ("state", "measured_pose"),
        ("task_frame", "measured_pose"),
        ("desired_position", "tracking_error"),
        ("desired_orientation", "tracking_error"),
        ("task_frame", "measured_position"),
        ("task_frame", "measured_velocity"),
        ("task_frame", "tracking_error"),
        ("task_frame_velocity", "measured_velocity"),
    }


def test_the_torque_is_zero_at_first(controller):
    context = controller.CreateDefaultContext()
    torque = controller.GetOutputPort("torque").Eval(context)
    np.testing.assert_array_equal(torque, np.zeros(7))


def test_the_torque_is_updated_every_control_period(plant):
    controller = make_controller(plant, ImpedanceConfig(control_period=0.002))
    timing = controller.GetUniquePeriodicDiscreteUpdateAttribute()
    assert (timing.period_sec(), timing.offset_sec()) == (0.002, 0.0)


@pytest.mark.parametrize("max_torque_rate", [1000.0, NO_LIMIT])
def test_outputs_and_update_equal_the_pure_functions(plant, max_torque_rate):
    config = ImpedanceConfig(max_torque_rate=max_torque_rate)
    controller = make_controller(plant, config, X_WT_TILTED)
    context = controller.CreateDefaultContext()
    for seed in range(5):
        inputs = random_inputs(seed)
        previous = np.random.default_rng(seed).normal(size=7)
        context.SetDiscreteState(0, previous)
        fix(controller, context, inputs)
        expected = expected_values(plant, config, X_WT_TILTED, inputs, previous)
        found = outputs(controller, context) | {
            "torque": updated_torque(controller, context)
        }
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, atol=1e-9, err_msg=name)


def test_an_update_leaves_its_context_unchanged(controller):
    context = controller.CreateDefaultContext()
    inputs = random_inputs(1)
    fix(controller, context, inputs)
    before = outputs(controller, context)
    first = updated_torque(controller, context)
    assert np.abs(first).max() > 0.5
    for name, value in inputs.items():
        np.testing.assert_array_equal(
            controller.GetInputPort(name).Eval(context), value
        )
    for name, value in outputs(controller, context).items():
        np.testing.assert_array_equal(value, before[name])
    np.testing.assert_array_equal(updated_torque(controller, context), first)


@pytest.mark.parametrize("clone", [False, True])
def test_interleaved_contexts_are_independent(controller, clone):
    first, second = random_inputs(2), random_inputs(3)

    def alone(inputs):
        context = controller.CreateDefaultContext()
        fix(controller, context, inputs)
        return outputs(controller, context), updated_torque(controller, context)

    expected = {id(first): alone(first), id(second): alone(second)}
    a = controller.CreateDefaultContext()
    fix(controller, a, first)
    outputs(controller, a)
    b = copy.deepcopy(a) if clone else controller.CreateDefaultContext()
    fix(controller, b, second)
    outputs(controller, b)
    for context, inputs in ((a, first), (b, second), (a, first)):
        torque = updated_torque(controller, context)
        np.testing.assert_array_equal(torque, expected[id(inputs)][1])
        for name, value in outputs(controller, context).items():
            np.testing.assert_array_equal(value, expected[id(inputs)][0][name])


def test_outputs_follow_their_inputs_with_and_without_caching(controller):
    cached = controller.CreateDefaultContext()
    uncached = controller.CreateDefaultContext()
    uncached.DisableCaching()
    start, target = random_inputs(4), random_inputs(5)
    for context in (cached, uncached):
        fix(controller, context, start)
    for name in (None, *target):
        for context in (cached, uncached):
            if name:
                fix(controller, context, {name: target[name]})
        np.testing.assert_array_equal(
            updated_torque(controller, cached), updated_torque(controller, uncached)
        )
        fresh = outputs(controller, uncached)
        for port, value in outputs(controller, cached).items():
            np.testing.assert_array_equal(value, fresh[port])


@pytest.mark.parametrize(
    "forgotten",
    [
        "state",
        "desired_position",
        "desired_velocity",
        "desired_acceleration",
    ],
)
def test_a_forgotten_input_is_named(controller, forgotten):
    context = controller.CreateDefaultContext()
    inputs = random_inputs(6)
    del inputs[forgotten]
    fix(controller, context, inputs)
    pattern = (
        rf"port {forgotten} of ::operational_space_impedance_controller has no value"
    )
    with pytest.raises(SystemsError, match=pattern):
        controller.EvalUniquePeriodicDiscreteUpdate(context)


def test_the_config_is_read_once(plant):
    config = ImpedanceConfig()
    controller = make_controller(plant, config)
    context = controller.CreateDefaultContext()
    fix(controller, context, random_inputs(8))
    before = updated_torque(controller, context)
    config.translational_stiffness[0] = 1.0
    config.orientation[0] = 0.0
    fix(controller, context, random_inputs(8))
    np.testing.assert_array_equal(updated_torque(controller, context), before)


# What the constructor refuses

TWO_JOINTS = """
<robot name="planar">
  <link name="base"/>
  <link name="upper">
    <inertial><mass value="1"/><origin xyz="0.2 0 0"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="lower">
    <inertial><mass value="1"/><origin xyz="0.2 0 0"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="shoulder" type="continuous">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>
    <origin xyz="0.4 0 0"/><limit lower="0.5" upper="2.5" effort="5" velocity="9"/>
  </joint>
  <transmission type="SimpleTransmission"><joint name="shoulder"/>
    <actuator name="shoulder_motor"/></transmission>
  <transmission type="SimpleTransmission"><joint name="elbow"/>
    <actuator name="elbow_motor"/></transmission>
</robot>
"""

PASSIVE_JOINT = """
  <link name="tip">
    <inertial><mass value="1"/><origin xyz="0.1 0 0"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="wrist" type="continuous">
    <parent link="lower"/><child link="tip"/><axis xyz="0 0 1"/>
  </joint>
"""


def planar_plant(text: str = TWO_JOINTS, *, finalize: bool = True) -> MultibodyPlant:
    plant = MultibodyPlant(time_step=0.001)
    Parser(plant).AddModelsFromString(text, "urdf")
    if finalize:
        plant.Finalize()
    return plant


def make_planar(plant: MultibodyPlant, **kwargs) -> OperationalSpaceImpedanceController:
    return OperationalSpaceImpedanceController(
        plant,
        end_effector=plant.GetFrameByName("lower"),
        X_WT=RigidTransform(),
        **{"config": ImpedanceConfig()} | kwargs,
    )


def test_an_arm_of_two_joints_is_controlled_too_by_the_same_compiled_code():
    controller = make_planar(planar_plant())
    make_controller(make_arm())
    assert len(impedance_step.signatures) == 1
    context = controller.CreateDefaultContext()
    inputs = {
        "state": [0.0, 1.5, 0.0, 0.0],
        "desired_position": [0.4, 0.1, 0.0],
        "desired_velocity": np.zeros(3),
        "desired_acceleration": np.zeros(3),
        "feedforward_wrench": np.zeros(6),
    }
    fix(controller, context, inputs)
    torque = updated_torque(controller, context)
    assert torque.shape == (2,)
    assert torque[0] > 0


def test_the_default_posture_is_the_middle_of_the_ranges():
    plant = planar_plant()
    given, default = make_planar(plant, q_posture=[0.0, 1.5]), make_planar(plant)
    torques = []
    for controller in (given, default):
        context = controller.CreateDefaultContext()
        inputs = {
            port.get_name(): np.full(port.size(), 0.1)
            for port in map(controller.get_input_port, range(5))
        }
        fix(controller, context, inputs)
        torques.append(updated_torque(controller, context))
    np.testing.assert_array_equal(*torques)


@pytest.mark.parametrize(
    ("lower", "upper", "posture"),
    [(0.5, np.inf, 1.5), (-3.0, np.inf, 0.0), (-np.inf, 0.2, -0.8)],
)
def test_the_default_posture_is_a_radian_from_the_only_limit_of_a_joint(
    lower, upper, posture
):
    plant = planar_plant(finalize=False)
    plant.GetJointByName("elbow").set_position_limits([lower], [upper])
    plant.Finalize()
    np.testing.assert_allclose(checked_posture(plant, None), [0.0, posture])


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ((0.0, 0.0), r"elbow has the limits 0 and 0 rad; .* more than 0\.2 rad apart"),
        ((0.5, 0.66), r"elbow has the limits 0\.5 and 0\.66 rad.*walls\.width = 0\.1"),
    ],
)
def test_a_joint_whose_range_the_limit_springs_fill_is_refused(limits, words):
    plant = planar_plant(finalize=False)
    lower, upper = limits
    plant.GetJointByName("elbow").set_position_limits([lower], [upper])
    plant.Finalize()
    with pytest.raises(SystemsError, match=words):
        make_planar(plant)
    if upper > lower:
        walls = JointWallConfig(width=0.05)
        make_planar(plant, config=ImpedanceConfig(walls=walls))


def test_limits_of_a_prismatic_joint_are_in_metres():
    plant = MultibodyPlant(0.001)
    body = plant.AddRigidBody(
        "cart", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1)
    )
    plant.AddJoint(
        PrismaticJoint(
            name="slide",
            frame_on_parent=plant.world_frame(),
            frame_on_child=body.body_frame(),
            axis=[1.0, 0.0, 0.0],
            pos_lower_limit=0.0,
            pos_upper_limit=0.1,
        )
    )
    plant.Finalize()
    with pytest.raises(SystemsError, match=r"0 and 0\.1 m; .* 0\.2 m apart"):
        check_limits(plant, 0.1)


@pytest.mark.parametrize("limits", [(0.0, 0.0), (0.0, 2.0)])
def test_a_joint_that_may_not_move_is_refused(limits):
    plant = planar_plant(finalize=False)
    plant.GetJointByName("elbow").set_velocity_limits(*([limit] for limit in limits))
    plant.Finalize()
    with pytest.raises(SystemsError, match=r"elbow has the velocity limits 0 and "):
        make_planar(plant)


def test_the_speed_limit_of_a_joint_is_the_lower_one_of_its_directions():
    plant = planar_plant(finalize=False)
    plant.GetJointByName("elbow").set_velocity_limits([-0.5], [2.0])
    plant.Finalize()
    speed = make_planar(plant).limits.speed
    assert speed[plant.GetJointByName("elbow").velocity_start()] == 0.5


def test_an_arm_on_a_free_base_is_refused():
    lines = TWO_JOINTS.splitlines()
    free = "\n".join(line for line in lines if 'name="weld"' not in line)
    with pytest.raises(SystemsError, match="9 positions and 8 velocities"):
        make_planar(planar_plant(free))


def test_a_joint_without_a_motor_is_refused():
    passive = TWO_JOINTS.replace("</robot>", PASSIVE_JOINT + "</robot>")
    with pytest.raises(SystemsError, match=r"each of its 3 joints.*it has 2"):
        make_planar(planar_plant(passive))


def test_an_arm_without_motors_is_refused():
    passive = re.sub(
        r"<transmission.*?</transmission>", "", TWO_JOINTS, flags=re.DOTALL
    )
    with pytest.raises(SystemsError, match=r"order shoulder, elbow; it has 0\.$"):
        make_planar(planar_plant(passive))


def test_friction_of_another_arm_is_refused_by_the_name_of_its_setting():
    friction = FrictionConfig(enabled=True, height=[1.0], slope=[1.0], shift=[0.0])
    config = ImpedanceConfig(friction_compensation=friction)
    with pytest.raises(SystemsError, match=r"^friction_compensation\.height must be 2"):
        make_planar(planar_plant(TWO_JOINTS), config=config)


def test_motors_in_another_order_than_the_joints_are_refused_with_both_orders():
    shoulder, elbow = (
        f"""  <transmission type="SimpleTransmission"><joint name="{name}"/>
    <actuator name="{name}_motor"/></transmission>
"""
        for name in ("shoulder", "elbow")
    )
    assert shoulder + elbow in TWO_JOINTS
    plant = planar_plant(TWO_JOINTS.replace(shoulder + elbow, elbow + shoulder))
    order = "order shoulder, elbow; it has 2: elbow, shoulder"
    with pytest.raises(SystemsError, match=order):
        make_planar(plant)


def second_arm(plant: MultibodyPlant) -> None:
    other = TWO_JOINTS.replace("planar", "other")
    Parser(plant).AddModelsFromString(other, "urdf")


def coupled_joints(plant: MultibodyPlant) -> None:
    shoulder, elbow = (plant.GetJointByName(name) for name in ("shoulder", "elbow"))
    plant.AddCouplerConstraint(shoulder, elbow, gear_ratio=1.0)


@pytest.mark.parametrize(
    ("edit", "end_effector", "words"),
    [
        (second_arm, "lower", "shoulder does not move end_effector lower; .* one arm"),
        (coupled_joints, "lower", r"has constraints \(1\).*; it must have none"),
        (None, "world", "shoulder does not move end_effector world"),
        (None, "base", "shoulder does not move end_effector base"),
        (None, "upper", "elbow does not move end_effector upper"),
    ],
)
def test_a_plant_of_more_than_an_arm_and_its_tool_is_refused(edit, end_effector, words):
    plant = planar_plant(finalize=False)
    arm = plant.GetModelInstanceByName("planar")
    if edit is not None:
        edit(plant)
    plant.Finalize()
    frame = plant.world_frame()
    if end_effector != "world":
        frame = plant.GetFrameByName(end_effector, arm)
    with pytest.raises(SystemsError, match=words):
        ArmModel(plant, frame)


def test_a_wall_that_does_not_move_may_be_in_the_plant():
    plant = planar_plant(finalize=False)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    wall = plant.AddRigidBody("wall", plant.AddModelInstance("room"), inertia)
    plant.WeldFrames(plant.world_frame(), wall.body_frame())
    plant.Finalize()
    assert make_planar(plant).GetOutputPort("torque").size() == 2


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"plant": "planar"}, "plant is 'planar'; its type must be MultibodyPlant"),
        ({"end_effector": "lower"}, "end_effector is 'lower'; its type must be Frame"),
        ({"X_WT": np.eye(4)}, r"X_WT is array\(.*; its type must be RigidTransform"),
        ({"config": {}}, "config is {}; its type must be ImpedanceConfig"),
        ({"config": None}, "config is None; its type must be ImpedanceConfig"),
        ({"config": ImpedanceConfig(walls=None)}, "walls is None; its type must be J"),
        ({"q_posture": "home"}, "q_posture: 'home' cannot be read"),
    ],
)
def test_an_argument_of_another_type_is_named_with_the_expected_type(wrong, words):
    plant = planar_plant()
    arguments = {
        "plant": plant,
        "end_effector": plant.GetFrameByName("lower"),
        "X_WT": RigidTransform(),
        "config": ImpedanceConfig(),
    }
    with pytest.raises(SystemsError, match=words):
        OperationalSpaceImpedanceController(**arguments | wrong)


def test_the_frame_of_another_plant_is_refused():
    plant, other = planar_plant(), planar_plant()
    with pytest.raises(SystemsError, match="lower is a frame of another plant"):
        ArmModel(plant, other.GetFrameByName("lower"))


def test_a_plant_that_is_not_finalized_is_refused():
    with pytest.raises(SystemsError, match="finalized"):
        make_planar(planar_plant(finalize=False))


@pytest.mark.parametrize("q", [[0.0], [0.0, 0.4], [np.nan, 1.0], [[0.0, 1.0]]])
def test_a_posture_outside_the_ranges_is_refused(q):
    with pytest.raises(SystemsError, match=r"2 angles between .*0\.5.*2\.5"):
        make_planar(planar_plant(), q_posture=np.array(q))


def test_a_config_that_cannot_be_used_is_refused(plant):
    with pytest.raises(SystemsError, match="damping_ratio"):
        make_controller(plant, ImpedanceConfig(damping_ratio=np.nan))


# The closed loop


class Motion(LeafSystem):
    """Desired position, velocity and acceleration as a function of time."""

    def __init__(self, function: Callable[[float], np.ndarray]) -> None:
        super().__init__()
        for row, name in enumerate(("position", "velocity", "acceleration")):
            self.DeclareVectorOutputPort(
                name,
                3,
                lambda context, output, row=row: output.SetFromVector(
                    function(context.get_time())[row]
                ),
                {self.time_ticket()},
            )


def hold(position) -> Callable[[float], np.ndarray]:
    return lambda _: np.array([position, np.zeros(3), np.zeros(3)])


class ClosedLoop:
    """The Panda and its controller in one diagram, with logs of every output."""

    def __init__(
        self,
        motion: Callable[[float], np.ndarray],
        *,
        config: ImpedanceConfig | None = None,
        X_WT: RigidTransform = X_WT_FLAT,
        q_posture: np.ndarray = Q_START,
        feedforward_wrench=(0, 0, 0, 0, 0, 0),
        external_wrench_T=(0, 0, 0, 0, 0, 0),
        gravity: bool = False,
    ) -> None:
        builder = DiagramBuilder()
        self.plant = builder.AddSystem(make_arm(gravity=gravity))
        self.controller = builder.AddSystem(
            make_controller(make_arm(), config, X_WT, q_posture)
        )
        source = builder.AddSystem(Motion(motion))
        wrench = builder.AddSystem(ConstantVectorSource(feedforward_wrench))
        state = self.plant.get_state_output_port()
        torque = self.controller.GetOutputPort("torque")
        for name in ("position", "velocity", "acceleration"):
            builder.Connect(
                source.GetOutputPort(name),
                self.controller.GetInputPort(f"desired_{name}"),
            )
        builder.Connect(
            wrench.get_output_port(),
            self.controller.GetInputPort("feedforward_wrench"),
        )
        builder.Connect(state, self.controller.GetInputPort("state"))
        if gravity:
            self._model = make_arm()  # InverseDynamics does not keep it alive.
            compensation = builder.AddSystem(
                InverseDynamics(
                    self._model,
                    InverseDynamics.InverseDynamicsMode.kGravityCompensation,
                )
            )
            adder = builder.AddSystem(Adder(2, 7))
            builder.Connect(state, compensation.get_input_port_estimated_state())
            builder.Connect(torque, adder.get_input_port(0))
            builder.Connect(compensation.get_output_port(), adder.get_input_port(1))
            torque = adder.get_output_port()
        builder.Connect(torque, self.plant.get_actuation_input_port())
        self._connect_push(builder, X_WT, external_wrench_T)
        self._logs = {
            name: LogVectorOutput(self.controller.GetOutputPort(name), builder, 0.001)
            for name in ("torque", "tracking_error", "measured_position")
        }
        self._logs["state"] = LogVectorOutput(state, builder, 0.001)
        self.diagram = builder.Build()

    def _connect_push(self, builder, X_WT, wrench_T) -> None:
        E = self.plant.GetFrameByName("eraser_tip")
        push = ExternallyAppliedSpatialForce()
        push.body_index = E.body().index()
        push.p_BoBq_B = E.GetFixedPoseInBodyFrame().translation()
        torque, force = np.reshape(wrench_T, (2, 3)) @ X_WT.rotation().matrix().T
        push.F_Bq_W = SpatialForce(torque, force)
        source = builder.AddSystem(
            ConstantValueSource(Value[list[ExternallyAppliedSpatialForce]]([push]))
        )
        builder.Connect(
            source.get_output_port(), self.plant.get_applied_spatial_force_input_port()
        )

    def run(
        self, duration: float, *, q: np.ndarray = Q_START, caching: bool = True
    ) -> dict[str, np.ndarray]:
        """Simulate from rest at q; logs of every millisecond, one row each."""
        simulator = Simulator(self.diagram)
        context: Context = simulator.get_mutable_context()
        if not caching:
            context.DisableCaching()
        self.plant.SetPositions(self.plant.GetMyMutableContextFromRoot(context), q)
        simulator.AdvanceTo(duration)
        return {
            name: log.FindLog(context).data().T.copy()
            for name, log in self._logs.items()
        }


def circle(t: float) -> np.ndarray:
    radius, omega = 0.12, 2 * np.pi * 0.6
    s, c = np.sin(omega * t), np.cos(omega * t)
    return np.array(
        [
            [-0.05 + radius * c, radius * s, 0.2],
            [-radius * omega * s, radius * omega * c, 0],
            [-radius * omega**2 * c, -radius * omega**2 * s, 0],
        ]
    )


@pytest.fixture(scope="module")
def p_start(plant) -> np.ndarray:
    return pose_in_task(plant, Q_START, X_WT_FLAT).translation()


def test_two_simulations_and_one_without_caching_are_identical():
    loop = ClosedLoop(circle)
    runs = [loop.run(0.2), loop.run(0.2), loop.run(0.2, caching=False)]
    assert np.abs(runs[0]["torque"]).max() > 5
    for first, second in pairwise(runs):
        for name, values in first.items():
            np.testing.assert_array_equal(values, second[name])


def test_the_diagram_keeps_the_controller_and_its_plant_alive():
    diagram = ClosedLoop(circle).diagram
    gc.collect()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.01)
    controller = diagram.GetSubsystemByName("operational_space_impedance_controller")
    context = controller.GetMyContextFromRoot(simulator.get_context())
    assert np.abs(controller.GetOutputPort("torque").Eval(context)).max() > 5


def test_a_circle_in_free_air_is_tracked_within_a_millimetre():
    error = ClosedLoop(circle).run(3.5)["tracking_error"][2000:]
    rms = np.sqrt(np.mean(error**2, axis=0))
    assert np.linalg.norm(rms[3:]) < 1e-3
    assert np.linalg.norm(rms[:3]) < np.radians(0.6)


def test_the_arm_rests_under_gravity_that_is_compensated_elsewhere(p_start):
    logs = ClosedLoop(hold(p_start), gravity=True).run(0.5)
    assert np.abs(logs["torque"]).max() < 1e-6
    assert np.abs(logs["tracking_error"]).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(6))
def test_the_realised_stiffness_is_the_configured_one(plant, axis):
    X_WT = X_WT_TILTED
    X_TE = pose_in_task(plant, Q_START, X_WT)
    rpy = RollPitchYaw(X_TE.rotation()).vector()
    config = ImpedanceConfig(orientation=list(rpy))
    K = np.diag(config.stiffness())
    wrench = np.zeros(6)
    wrench[axis] = K[axis] * (0.03 if axis < 3 else 0.005)
    loop = ClosedLoop(
        hold(X_TE.translation()), config=config, X_WT=X_WT, external_wrench_T=wrench
    )
    error = loop.run(4.0)["tracking_error"][-1]
    np.testing.assert_allclose(-error * K, wrench, atol=0.01 * wrench[axis])


def test_the_feedforward_wrench_balances_an_opposite_push(p_start):
    wrench = np.array([0.2, -0.1, 0.05, 3.0, -2.0, 5.0])
    loop = ClosedLoop(
        hold(p_start), feedforward_wrench=wrench, external_wrench_T=-wrench
    )
    error = loop.run(2.0)["tracking_error"][-1]
    np.testing.assert_allclose(error, 0, atol=1e-5)


@pytest.mark.parametrize("damping_ratio", [0.4, 0.8])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_poles_of_the_closed_loop_have_the_chosen_damping(damping_ratio, seed):
    """Six pairs with the task's ratio and one with the posture's, anywhere."""
    plant = make_arm()
    q0 = Q_START + 0.3 * np.random.default_rng(seed).normal(size=7)
    X_TE = pose_in_task(plant, q0, X_WT_TILTED)
    config = ImpedanceConfig(
        damping_ratio=damping_ratio,
        posture_damping_ratio=0.6,
        posture_frequency=5.0,
        max_torque_rate=NO_LIMIT,
        orientation=list(RollPitchYaw(X_TE.rotation()).vector()),
    )
    controller = make_controller(plant, config, X_WT_TILTED, q0)
    context = controller.CreateDefaultContext()
    plant_context = plant.CreateDefaultContext()
    rest = {name: 0 * value for name, value in random_inputs(0).items()}
    fix(controller, context, rest | {"desired_position": X_TE.translation()})

    def derivative(x):
        controller.GetInputPort("state").FixValue(context, x)
        plant.SetPositionsAndVelocities(plant_context, x)
        torque = updated_torque(controller, context)
        force = torque - plant.CalcBiasTerm(plant_context)
        return np.r_[x[7:], np.linalg.solve(plant.CalcMassMatrix(plant_context), force)]

    x0, h = np.r_[q0, np.zeros(7)], 1e-5
    columns = [
        (derivative(x0 + h * dx) - derivative(x0 - h * dx)) / (2 * h)
        for dx in np.eye(14)
    ]
    poles = np.linalg.eigvals(np.column_stack(columns))
    ratios = -poles.real / np.abs(poles)
    posture = np.isclose(ratios, 0.6, atol=1e-3)
    assert posture.sum() == 2
    np.testing.assert_allclose(np.abs(poles[posture]), 5.0, rtol=1e-3)
    np.testing.assert_allclose(ratios[~posture], damping_ratio, atol=1e-3)


@pytest.mark.parametrize("axis", range(3))
def test_a_step_does_not_overshoot_at_critical_damping(p_start, axis):
    step = np.zeros(3)
    step[axis] = 0.004
    logs = ClosedLoop(hold(p_start + step)).run(1.5)
    moved = logs["measured_position"][:, axis] - p_start[axis]
    assert moved.max() < 1.02 * step[axis]


@pytest.mark.slow
@pytest.mark.parametrize("mode", range(6))
def test_overshoot_of_every_mode_follows_its_damping_ratio(plant, p_start, mode):
    """A start displaced along one mode: its coordinate rings, the others rest."""
    ratio = 0.4
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, Q_START)
    J = jacobian(plant, context)
    Lambda = np.linalg.inv(J @ np.linalg.solve(plant.CalcMassMatrix(context), J.T))
    K = ImpedanceConfig().stiffness()
    squared, shapes = eigh(K, Lambda)
    shape = shapes[:, mode] / np.abs(shapes[:, mode]).max() * 0.01
    R_TE = Rotation.from_rotvec(shape[:3]) * Rotation.from_matrix(
        pose_in_task(plant, Q_START, X_WT_FLAT).rotation().matrix()
    )
    config = ImpedanceConfig(
        damping_ratio=ratio, orientation=list(R_TE.as_euler("xyz"))
    )
    error = ClosedLoop(hold(p_start + shape[3:]), config=config).run(1.5)[
        "tracking_error"
    ]
    amplitudes = error @ Lambda @ shapes  # Qᵀ Λ Q = I
    ringing = amplitudes[:, mode] / amplitudes[0, mode]
    ideal = np.exp(-np.pi * ratio / np.sqrt(1 - ratio**2))
    assert -ringing.min() == pytest.approx(ideal, abs=0.04)
    half_period = np.pi / np.sqrt(squared[mode] * (1 - ratio**2))
    assert np.argmin(ringing) / 1000 == pytest.approx(half_period, rel=0.1)
    others = np.delete(amplitudes, mode, axis=1)
    assert np.abs(others).max() < 0.06 * np.abs(amplitudes[0, mode])


def test_torque_and_its_rate_stay_in_their_limits_after_a_far_step(plant, p_start):
    config = PANDA.complete(
        ImpedanceConfig(translational_stiffness=[5000.0] * 3, max_translation_error=1.0)
    )
    loop = ClosedLoop(hold(p_start + np.array([0.3, 0.2, -0.3])), config=config)
    logs = loop.run(0.3)
    torque, context = logs["torque"], plant.CreateDefaultContext()
    borne = torque.copy()
    for k, q in enumerate(logs["state"][:, :7]):
        plant.SetPositions(context, q)
        borne[k] -= plant.CalcGravityGeneralizedForces(context)
    limit = plant.GetEffortUpperLimits()
    np.testing.assert_array_equal(torque[0], 0)
    assert np.max(np.abs(torque) / limit) <= 1 + 1e-9
    assert 0.98 < np.max(np.abs(borne) / limit) <= 1
    changes = np.abs(np.diff(torque, axis=0)).max(axis=1)
    most = config.max_torque_rate * config.control_period
    assert changes.max() <= most + 1e-9
    assert np.sum(changes > most - 1e-9) > 10


def test_the_clip_bounds_the_speed_of_a_start_far_from_the_target(p_start):
    logs = ClosedLoop(hold(p_start + np.array([0.2, 0.25, -0.2]))).run(3.0)
    speed = np.linalg.norm(np.diff(logs["measured_position"], axis=0), axis=1) / 0.001
    assert speed.max() < 1.7
    assert np.abs(logs["tracking_error"][-1]).max() < 5e-3


def test_a_target_out_of_reach_is_approached_without_a_runaway(p_start):
    # The first target is too far: the arm moves to it as slowly as after a stop, 7.5 s.
    logs = ClosedLoop(hold(p_start + np.array([1.0, 0.0, 0.0]))).run(9.0)
    speed = np.abs(logs["state"][:, 7:])
    assert speed.max() < 4
    assert speed[-500:].max() < 0.1
    assert logs["measured_position"][-1, 0] > p_start[0] + 0.15


def nullspace_direction(plant, q) -> np.ndarray:
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    direction: np.ndarray = np.linalg.svd(jacobian(plant, context))[2][-1]
    return direction


def test_the_elbow_moves_without_moving_the_eraser(plant, p_start):
    z = nullspace_direction(plant, Q_START)
    logs = ClosedLoop(hold(p_start), q_posture=Q_START + 0.4 * z).run(3.0)
    q = logs["state"][:, :7]
    assert (q[-1] - q[0]) @ z > 0.3
    error = np.abs(logs["tracking_error"])
    assert error[:, 3:].max() < 5e-4
    assert error[:, :3].max() < np.radians(0.5)


def test_the_eraser_turns_back_from_the_antipode(p_start):
    """It starts turned by 179 degrees about the board's normal."""
    config = ImpedanceConfig(
        orientation=[np.pi, 0.0, np.radians(179)],
        rotational_stiffness=[30.0, 30.0, 30.0],
    )
    error = ClosedLoop(hold(p_start), config=config).run(3.0)["tracking_error"]
    angle = np.linalg.norm(error[:, :3], axis=1)
    assert angle[0] == pytest.approx(np.radians(179))
    assert angle[-1] < np.radians(1)
    assert np.all(np.diff(angle[100:]) < 1e-4)
    assert np.linalg.norm(error[:, 3:], axis=1).max() < 0.02


def test_a_stiffer_config_displaces_the_tool_less(p_start):
    push = np.array([0, 0, 0, 0, 0, 2.0])
    soft = ImpedanceConfig()
    hard = replace(soft, translational_stiffness=[1500.0, 1500.0, 800.0])
    moved = [
        ClosedLoop(hold(p_start), config=config, external_wrench_T=push).run(2.0)[
            "measured_position"
        ][-1, 2]
        - p_start[2]
        for config in (soft, hard)
    ]
    assert moved[0] / moved[1] == pytest.approx(4.0, rel=0.02)
