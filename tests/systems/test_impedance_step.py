"""Facts about one update of the impedance controller, and about what follows it."""

import copy

import numpy as np
import pytest
from arm_loop import (
    PANDA,
    PANDA_FRICTION,
    Q_START,
    X_WT_TILTED,
    ArmLoop,
    jacobian,
    make_arm,
    pose_in_task,
    quaternion,
)
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

from fmp_drake.errors import SystemsError
from fmp_drake.systems.impedance import step as step_module
from fmp_drake.systems.impedance.algebra import Pose
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.joints import JointLimits
from fmp_drake.systems.impedance.records import (
    MEMORY,
    OPTIONAL,
    PACKED,
    PORTS,
    initial_memory,
    joint_settings,
    settings_of,
)
from fmp_drake.systems.impedance.step import impedance_step
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)

N = 7
PERIOD = 0.001


def full_config():
    """A configuration in which everything is enabled."""
    config = ImpedanceConfig()
    for part in ("force_control", "covariance_stiffness", "friction_compensation"):
        getattr(config, part).enabled = True
    config.friction_compensation = config.friction_compensation.completed(
        PANDA_FRICTION
    )
    return config


# The compiled functions and the plain ones.


def random_step(rng, ports):
    """Arguments of an update in which some of the optional ports are used."""
    limits = JointLimits.between(
        np.full(N, -2.0),
        np.full(N, 2.0),
        speed=np.full(N, 2.0),
        lower_effort=np.full(N, -80.0),
        upper_effort=np.full(N, 80.0),
    )
    settings = settings_of(
        full_config(),
        X_WT=Pose(np.eye(3), np.array([0.1, 0.2, 0.3])),
        engage_height=0.5,
        contact_height=0.0,
    )
    joints = joint_settings(full_config(), limits=limits, q_posture=np.zeros(N))
    packed = np.zeros(1, PACKED)
    for name in ports:
        packed[name] = 0.3 * rng.normal(size=packed[name].shape)
        packed[f"has_{name}"] = 1.0
    A, B = rng.normal(size=(2, N, N))
    packed["stiffness"] = 100 * np.eye(6) + A[:6, :6] @ A[:6, :6].T
    packed["covariance"] = 1e-4 * B[:3, :3] @ B[:3, :3].T
    arm = (
        True,
        rng.normal(size=2 * N),
        A @ A.T + np.eye(N),
        rng.normal(size=N),
        np.vstack([np.eye(3), rng.normal(size=3)]),
        rng.normal(size=(N, 6)),
        rng.normal(size=6),
        20 * rng.normal(size=N),
    )
    memory = initial_memory(settings[0].stiffness, tank_energy=0.1)
    return settings, joints, packed, rng.normal(size=N), memory, arm


def plain_step(monkeypatch, *arguments):
    """One update as it is written, not compiled."""
    with monkeypatch.context() as plain:
        for name, function in vars(step_module).items():
            if hasattr(function, "py_func"):
                plain.setattr(step_module, name, function.py_func)
        return impedance_step.py_func(*arguments)


def assert_equal_updates(found, known):
    for one, other in zip(found, known, strict=True):
        assert_allclose(one, other, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_compiled_update_equals_the_plain_one(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    ports = [name for name in PORTS if name not in OPTIONAL or rng.random() < 0.6]
    settings, joints, packed, previous, memory, arm = random_step(rng, ports)
    found = known = (previous, None, memory)
    for k in range(4):
        if k == 2:
            packed["desired_position"] += 1.0  # A jump.
        arguments = settings.view(np.uint8), joints, packed.view(float), k * PERIOD
        found = impedance_step(*arguments, found[0], found[2], *arm)
        known = plain_step(monkeypatch, *arguments, known[0], known[2], *arm)
        assert_equal_updates(found, known)
    assert int(found[1][0]) & StatusFlag.PROTECTIVE_STOP


@pytest.mark.parametrize(
    ("port", "value", "flag"),
    [
        ("stiffness", -np.eye(6), StatusFlag.STIFFNESS_REFUSED),
        ("covariance", -np.eye(3), StatusFlag.STIFFNESS_REFUSED),
        ("desired_velocity", np.full(3, np.nan), StatusFlag.NOT_FINITE),
    ],
)
def test_invalid_covariance_or_stiffness_leaves_the_last_stiffness(
    port, value, flag, monkeypatch
):
    settings, joints, packed, previous, memory, arm = random_step(
        np.random.default_rng(0), PORTS
    )
    packed[port] = value
    arguments = settings.view(np.uint8), joints, packed.view(float), 0.0, previous
    found = impedance_step(*arguments, memory, *arm)
    assert_equal_updates(found, plain_step(monkeypatch, *arguments, memory, *arm))
    assert int(found[1][0]) & flag
    assert_array_equal(found[2].view(MEMORY)[0].stiffness, settings[0].stiffness)


def test_an_arm_without_finite_dynamics_loses_its_torque(monkeypatch):
    settings, joints, packed, previous, memory, arm = random_step(
        np.random.default_rng(0), PORTS
    )
    known, state, _, *others = arm
    no_arm = (known, state, np.zeros((N, N)), *others)
    arguments = settings.view(np.uint8), joints, packed.view(float), 0.0, previous
    found = impedance_step(*arguments, memory, *no_arm)
    assert_equal_updates(found, plain_step(monkeypatch, *arguments, memory, *no_arm))
    assert int(found[1][0]) & StatusFlag.NO_STATE
    assert np.linalg.norm(found[0]) < np.linalg.norm(previous)


def test_one_compilation_is_sufficient_for_every_controller():
    for config in (ImpedanceConfig(), full_config(), ImpedanceConfig(damping_ratio=1)):
        simulate_ports(make_controller(config), optional_ports())
    assert len(impedance_step.signatures) == 1


# Everything acts at the very next update.


def make_controller(config=None, **settings):
    plant = make_arm()
    return OperationalSpaceImpedanceController(
        plant,
        end_effector=plant.GetFrameByName("eraser_tip"),
        X_WT=X_WT_TILTED,
        config=PANDA.complete(config or ImpedanceConfig()),
        q_posture=Q_START,
        **settings,
    )


def start_pose():
    return pose_in_task(make_arm(), Q_START, X_WT_TILTED)


def optional_ports():
    """A value for every optional port, near the pose of the start."""
    R_WT = X_WT_TILTED.rotation()
    return {
        "desired_orientation": quaternion(start_pose().rotation()),
        "desired_angular_velocity": np.array([0.01, 0.0, 0.02]),
        "desired_angular_acceleration": np.array([0.1, 0.0, 0.0]),
        "feedforward_wrench": np.array([0, 0, 0, 1.0, 0, -2.0]),
        "task_frame": np.r_[quaternion(R_WT), X_WT_TILTED.translation()],
        "task_frame_velocity": np.array([0.0, 0.0, 0.01, 0.02, 0.0, 0.0]),
        "task_frame_acceleration": np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]),
        "target_time": np.zeros(1),
        "stiffness": np.diag([20.0, 20, 3, 900, 900, 150]).ravel(),
        "covariance": (1e-4 * np.eye(3)).ravel(),
        "normal_force": np.array([7.0]),
        "desired_normal_force": np.array([8.0]),
    }


def context_of(controller, ports=()):
    context = controller.CreateDefaultContext()
    orientation = quaternion(start_pose().rotation())
    for name, value in {
        "state": np.r_[Q_START, np.zeros(N)],
        "desired_position": start_pose().translation(),
        "desired_velocity": np.zeros(3),
        "desired_acceleration": np.zeros(3),
        "desired_orientation": orientation,
        **dict(ports),
    }.items():
        controller.GetInputPort(name).FixValue(context, value)
    return context


def update(controller, context):
    """Take one control period."""
    context.SetDiscreteState(controller.EvalUniquePeriodicDiscreteUpdate(context))
    context.SetTime(context.get_time() + PERIOD)
    return StatusFlag(int(controller.GetOutputPort("status").Eval(context)[0]))


def simulate_ports(controller, ports, updates=3):
    context = context_of(controller, ports)
    for _ in range(updates):
        update(controller, context)
    return context


@pytest.mark.parametrize(
    ("port", "value", "flag"),
    [
        ("desired_position", [np.nan] * 3, StatusFlag.NOT_FINITE),
        ("desired_acceleration", [np.nan] * 3, StatusFlag.NOT_FINITE),
        ("task_frame_velocity", [np.nan] * 6, StatusFlag.NOT_FINITE),
        ("feedforward_wrench", [np.nan] * 6, StatusFlag.NOT_FINITE),
        ("desired_position", [0.0, 0.0, 9.0], StatusFlag.JUMP),
        ("task_frame", [np.nan] * 7, StatusFlag.NOT_FINITE),
        ("desired_orientation", [0.0] * 4, StatusFlag.NOT_FINITE),
        ("target_time", [-1.0], StatusFlag.STALE),
        ("state", [np.nan] * 14, StatusFlag.NO_STATE),
        ("desired_normal_force", [np.inf], StatusFlag.NOT_FINITE),
    ],
)
def test_a_fault_stops_the_arm_at_the_very_next_update(port, value, flag):
    controller = make_controller(full_config())
    context = context_of(controller, {"desired_velocity": np.array([0.1, 0, 0])})
    for _ in range(5):
        assert not update(controller, context) & StatusFlag.PROTECTIVE_STOP
    good = update(controller, copy.deepcopy(context))
    controller.GetInputPort(port).FixValue(context, np.array(value, dtype=float))
    assert not good & flag
    before = context.get_discrete_state(0).value().copy()
    flags = update(controller, context)
    assert flags & flag
    assert flags & StatusFlag.PROTECTIVE_STOP
    # An arm whose state is known is held.
    assert bool(flags & StatusFlag.NO_STATE) == (port == "state")
    assert not np.array_equal(context.get_discrete_state(0).value(), before)


@pytest.mark.parametrize("frame", [[np.nan] * 7, [0.0] * 4 + [0.1] * 3])
def test_without_a_finite_task_frame_both_measured_positions_are_in_the_assumed_one(
    frame,
):
    controller = make_controller(full_config())
    context = context_of(controller, {"task_frame": np.array(frame)})
    position = controller.GetOutputPort("measured_position").Eval(context)
    pose = controller.GetOutputPort("measured_pose").Eval(context)
    assert np.linalg.norm(position) > 0.1
    assert_allclose(pose[4:], position, atol=1e-12)


def test_lost_contact_and_a_joint_limit_are_reported_at_the_next_update():
    controller = make_controller(full_config(), engage_height=10.0)
    ports = optional_ports()
    context = simulate_ports(controller, ports)
    assert update(controller, context) & StatusFlag.FORCE_CONTROL
    controller.GetInputPort("normal_force").FixValue(context, [0.0])
    lost = [update(controller, context) for _ in range(60)]
    first = [bool(flags & StatusFlag.CONTACT_LOST) for flags in lost].index(True)
    assert first * PERIOD == pytest.approx(0.05, abs=0.002)  # The release time.
    q = Q_START.copy()
    q[1] = make_arm().GetPositionUpperLimits()[1] - 0.01
    controller.GetInputPort("state").FixValue(context, np.r_[q, np.zeros(N)])
    assert update(controller, context) & StatusFlag.JOINT_WALL


# The normal force.


def normal_force_of(controller, height, force, wrench=None, beside=0.0):
    """The force along −z of T that one more input asks for, N."""
    torques = []
    for wanted in (0.0, force):
        ports = {"desired_normal_force": np.array([wanted])}
        if wrench is not None:
            ports["feedforward_wrench"] = wrench
        x, y, _ = start_pose().translation()
        position = np.array([x + beside, y, height])
        context = context_of(controller, ports | {"desired_position": position})
        values = controller.EvalUniquePeriodicDiscreteUpdate(context)
        torques.append(values.value(0).copy())
    plant = make_arm()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, Q_START)
    J = jacobian(plant, context, X_WT_TILTED)
    return -np.linalg.lstsq(J.T, torques[1] - torques[0], rcond=None)[0]


def test_the_desired_normal_force_is_that_part_of_the_wrench():
    config = ImpedanceConfig(max_torque_rate=1e9)
    z = start_pose().translation()[2]
    # Far over a target on the surface it is twice as much, to be soon back.
    for height, wanted in ((z, 8.0 * part(z, 2 * z)), (2 * z, 0.0), (0.0, 16.0)):
        controller = make_controller(config, engage_height=2 * z)
        found = normal_force_of(controller, height, 8.0)
        assert_allclose(found, [0, 0, 0, 0, 0, wanted], atol=1e-6)
    assert_allclose(normal_force_of(controller, z, -3.0), 0.0, atol=1e-9)


def test_the_whole_normal_force_acts_up_to_the_contact_height():
    config = ImpedanceConfig(max_torque_rate=1e9)
    z = start_pose().translation()[2]
    for contact, wanted in ((0.0, 8.0 * part(z, 2 * z)), (z, 8.0), (2 * z, 8.0)):
        controller = make_controller(
            config, engage_height=2 * z, contact_height=contact
        )
        found = normal_force_of(controller, z, 8.0)
        assert_allclose(found, [0, 0, 0, 0, 0, wanted], atol=1e-6)


def test_far_from_its_target_a_low_tool_is_lifted_and_a_high_one_lowered():
    config = ImpedanceConfig(max_torque_rate=1e9)
    z = start_pose().translation()[2]
    controller = make_controller(config, engage_height=100.0)
    # Three times as far beside as the press rests, 1 mm and 30 cm over the surface.
    low = normal_force_of(controller, z - 0.001, 8.0, beside=0.3)
    high = normal_force_of(controller, z - 0.3, 8.0, beside=0.3)
    assert low[5] < 0 < high[5]


@pytest.mark.parametrize("motion", ["desired_velocity", "desired_acceleration"])
def test_motion_along_the_normal_is_fed_forward_only_as_far_as_nothing_is_pressed(
    motion,
):
    config = ImpedanceConfig(max_torque_rate=1e9)
    z = start_pose().translation()[2]
    x, y, _ = start_pose().translation()
    controller = make_controller(config, engage_height=2 * z)

    def torque(wanted, height, rise):
        ports = {
            "desired_position": np.array([x, y, height]),
            "desired_normal_force": np.array([wanted]),
            motion: np.array([0.1, 0.0, rise]),
        }
        context = context_of(controller, ports)
        values = controller.EvalUniquePeriodicDiscreteUpdate(context)
        return values.value(0).copy()

    def of_rising(wanted, height):
        return torque(wanted, height, 0.3) - torque(wanted, height, 0.0)

    free = of_rising(0.0, z)
    assert np.linalg.norm(free) > 0.1
    assert_allclose(of_rising(8.0, 0.0), 0.0, atol=1e-9)
    assert_allclose(of_rising(8.0, 2 * z), free, atol=1e-9)
    assert_allclose(of_rising(8.0, z), (1 - part(z, 2 * z)) * free, atol=1e-9)
    # Below 3 N the tool is about to lift.
    assert_allclose(of_rising(3.0, 0.0), 0.0, atol=1e-9)
    assert_allclose(of_rising(0.75, 0.0), 0.75 * free, atol=1e-9)


def part(height, engage_height):
    x = 1 - height / engage_height
    return x * x * (3 - 2 * x)


@pytest.mark.parametrize("height", [0.0, -0.01, np.nan, np.inf])
def test_an_engage_height_that_is_not_positive_is_refused(height):
    with pytest.raises(
        SystemsError, match=f"engage_height is {height}; it must be positive"
    ):
        make_controller(engage_height=height)


def test_a_contact_height_below_the_surface_is_refused():
    with pytest.raises(SystemsError, match=r"contact_height is -0\.001; it must"):
        make_controller(contact_height=-0.001)


def test_the_force_loop_stands_still_while_the_torque_is_limited():
    """And goes on where it was: nothing winds up."""
    config = full_config()
    config.force_control.proportional_gain = 0.0
    controller = make_controller(config, engage_height=10.0)
    ports = {"desired_normal_force": np.array([8.0]), "normal_force": np.array([7.0])}
    context = context_of(controller, ports)

    def surface(updates):
        flags = [update(controller, context) for _ in range(updates)]
        return flags, controller.GetOutputPort("status").Eval(context)[4]

    _, start = surface(10)
    assert start < 0
    # A wrench that no motor can make; the force along the normal stays as wanted.
    wrench = np.array([0, 0, 0, 1e4, 0, 0])
    controller.GetInputPort("feedforward_wrench").FixValue(context, wrench)
    _, limited = surface(1)
    flags, still = surface(50)
    assert all(f & StatusFlag.TORQUE_LIMITED for f in flags)
    assert all(f & StatusFlag.FORCE_CONTROL for f in flags)
    assert still == limited
    controller.GetInputPort("feedforward_wrench").FixValue(context, 0 * wrench)
    _, later = surface(20)
    assert later < still


# A Context is all that there is.


LOOKED_AT = ("measured_position", "measured_velocity", "tracking_error", "status")


def wavering(kind):
    """Signals and a configuration in which a certain part of the state matters."""
    p, R = start_pose().translation(), quaternion(start_pose().rotation())

    def position(t):
        jump = 0.3 if kind == "protective stop" and 0.02 < t < 0.04 else 0.0
        return p + np.array([0.02 * np.sin(9 * t) + jump, 0.0, 0.0])

    signals = {
        "desired_position": position,
        "desired_velocity": lambda t: np.array([0.18 * np.cos(9 * t), 0.0, 0.0]),
    }
    if kind == "stiffness":
        signals["stiffness"] = lambda t: np.diag(
            [30.0, 30, 3, *([900 + 600 * np.sin(50 * t)] * 3)]
        ).ravel()
    if kind == "force control":
        signals["desired_normal_force"] = lambda _t: np.array([5.0])
        signals["normal_force"] = lambda t: np.array([4 + np.sin(60 * t)])
    if kind == "search":
        signals["desired_normal_force"] = lambda _t: np.array([20.0])
    if kind == "moving frame":
        origin, axes = X_WT_TILTED.translation(), quaternion(X_WT_TILTED.rotation())
        signals["task_frame"] = lambda t: np.r_[
            axes, origin + np.array([0.01 * np.sin(20 * t), 0, 0])
        ]
        signals["desired_orientation"] = lambda _t: -R
    config = ImpedanceConfig()
    config.force_control.enabled = kind == "force control"
    config.watchdog.settle_time = 0.01
    return signals, config


@pytest.mark.parametrize(
    "kind",
    [
        "plain",
        "protective stop",
        "stiffness",
        "force control",
        "search",
        "moving frame",
    ],
)
def test_clone_continues_bit_identically_after_any_evaluation(kind):
    signals, config = wavering(kind)
    loop = ArmLoop(signals, config=config, X_WT=X_WT_TILTED, log=(), engage_height=10.0)
    end = 0.08

    def start():
        simulator = Simulator(loop.diagram)
        context = simulator.get_mutable_context()
        plant_context = loop.plant.GetMyMutableContextFromRoot(context)
        loop.plant.SetPositions(plant_context, Q_START)
        return simulator

    def look(context):
        own = loop.controller.GetMyContextFromRoot(context)
        for name in LOOKED_AT:
            loop.controller.GetOutputPort(name).Eval(own)

    def state(context):
        discrete = context.get_discrete_state()
        return [discrete.value(k).copy() for k in range(discrete.num_groups())]

    reference = start()
    reference.AdvanceTo(end)
    expected = state(reference.get_context())
    assert np.abs(expected[1]).max() > 0.1  # The torque.

    simulator = start()
    for time in (0.0004, 0.0137, 0.0213, 0.0291, 0.0433, 0.0518):
        simulator.AdvanceTo(time)
        look(simulator.get_context())
        context = simulator.get_context().Clone()
        if time > 0.02:
            context.DisableCaching()
        clone = Simulator(loop.diagram, context)
        look(clone.get_context())
        clone.AdvanceTo(end)
        for found, known in zip(state(clone.get_context()), expected, strict=True):
            assert_array_equal(found, known)
    simulator.AdvanceTo(end)
    for found, known in zip(state(simulator.get_context()), expected, strict=True):
        assert_array_equal(found, known)


@pytest.mark.parametrize("force", [-2000.0, 2000.0])
@pytest.mark.parametrize("axis", [3, 4, 5])
def test_the_motors_bear_the_torque_and_the_weight_within_their_efforts(axis, force):
    controller, plant = make_controller(), make_arm()
    wrench = force * np.eye(6)[axis]
    context = simulate_ports(controller, {"feedforward_wrench": wrench}, updates=150)
    at = plant.CreateDefaultContext()
    plant.SetPositions(at, Q_START)
    torque = controller.GetOutputPort("torque").Eval(context)
    borne = torque - plant.CalcGravityGeneralizedForces(at)
    loads = np.abs([torque, borne]) / plant.GetEffortUpperLimits()
    assert loads[1].max() < 1
    assert 0.98 < loads.max() <= 1
