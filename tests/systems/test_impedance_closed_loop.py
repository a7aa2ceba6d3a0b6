"""Facts about the measured impedance: stiffness, damping, energy, limits.

The figures are saved as a table in out/impedance.md. Configurations of the arm,
task frames and the axes of the stiffness are random, from fixed seeds.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_loop import (
    LOGGED,
    PANDA_FRICTION,
    Q_START,
    ArmLoop,
    configurations,
    jacobian,
    make_arm,
    pose_in_task,
    quaternion,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from scipy.spatial.transform import Rotation

from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import StatusFlag
from fmp_drake.systems.impedance.joints import (
    SigmoidFriction,
    friction_torque,
)
from fmp_drake.systems.impedance.stiffness import EnergyTankConfig
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)

pytestmark = pytest.mark.slow

OUT = Path(__file__).resolve().parents[2] / "out" / "impedance.md"
POSES = 10
NO_LIMIT = 1e9


@pytest.fixture(scope="module")
def table():
    """Rows of the table, written when the module is done."""
    rows: dict[str, str] = {}
    yield rows
    OUT.parent.mkdir(exist_ok=True)
    lines = ["| what | measured |", "|---|---|"]
    OUT.write_text(
        "\n".join([*lines, *(f"| {k} | {v} |" for k, v in rows.items())]) + "\n",
        encoding="utf-8",
    )


class Rest:
    """The controller at one pose, and the plant, without a simulation."""

    def __init__(self, q, *, seed, damping_ratio=0.7):
        rng = np.random.default_rng(seed)
        rotation = Rotation.random(random_state=rng).as_matrix()
        self.X_WT = RigidTransform(RotationMatrix(rotation), rng.normal(size=3))
        self.plant = make_arm()
        self.q = q
        self.config = ImpedanceConfig(
            translational_stiffness=[1500.0, 600.0, 200.0],
            rotational_stiffness=[30.0, 15.0, 5.0],
            damping_ratio=damping_ratio,
            posture_damping_ratio=0.9,
            max_torque_rate=NO_LIMIT,
            stiffness_time_constant=0.0,
            tank=EnergyTankConfig(initial_energy=1e6, capacity=1e6),
        )
        # The axes of the stiffness are random too; it comes in at its port.
        axes = Rotation.random(random_state=rng).as_matrix()
        turn = np.kron(np.eye(2), axes)
        self.K = turn @ self.config.stiffness() @ turn.T
        self.X_TE = pose_in_task(self.plant, q, self.X_WT)
        self.controller = OperationalSpaceImpedanceController(
            self.plant,
            end_effector=self.plant.GetFrameByName("eraser_tip"),
            X_WT=self.X_WT,
            config=self.config,
            q_posture=q,
        )
        self.context = self.controller.CreateDefaultContext()
        self.plant_context = self.plant.CreateDefaultContext()
        for name, value in {
            "desired_position": self.X_TE.translation(),
            "desired_orientation": quaternion(self.X_TE.rotation()),
            "desired_velocity": np.zeros(3),
            "desired_acceleration": np.zeros(3),
            "stiffness": self.K.ravel(),
        }.items():
            self.controller.GetInputPort(name).FixValue(self.context, value)

    def torque(self, x):
        self.controller.GetInputPort("state").FixValue(self.context, x)
        return self.controller.EvalUniquePeriodicDiscreteUpdate(self.context).value(0)

    def balance(self, q, wrench_T):
        """Torque that is left at rest under a wrench from outside, in T."""
        self.plant.SetPositions(self.plant_context, q)
        J = jacobian(self.plant, self.plant_context, self.X_WT)
        return self.torque(np.r_[q, np.zeros(7)]) + J.T @ wrench_T

    def displacement(self, wrench_T):
        """Where the tool comes to rest under a wrench: -tracking_error."""
        q, h = self.q.copy(), 1e-6
        for _ in range(6):
            slope = np.column_stack(
                [
                    (
                        self.balance(q + h * d, wrench_T)
                        - self.balance(q - h * d, wrench_T)
                    )
                    / (2 * h)
                    for d in np.eye(7)
                ]
            )
            q -= np.linalg.solve(slope, self.balance(q, wrench_T))
        assert np.abs(self.balance(q, wrench_T)).max() < 1e-6
        error = self.controller.GetOutputPort("tracking_error").Eval(self.context)
        return -np.array(error)

    def poles(self):
        """Eigenvalues of the closed loop, by finite differences."""
        plant, context = self.plant, self.plant_context

        def derivative(x):
            plant.SetPositionsAndVelocities(context, x)
            force = self.torque(x) - plant.CalcBiasTerm(context)
            return np.r_[x[7:], np.linalg.solve(plant.CalcMassMatrix(context), force)]

        x0, h = np.r_[self.q, np.zeros(7)], 1e-5
        columns = [
            (derivative(x0 + h * d) - derivative(x0 - h * d)) / (2 * h)
            for d in np.eye(14)
        ]
        return np.linalg.eigvals(np.column_stack(columns))

    def unit_mass_poles(self):
        """Eigenvalues of the task's motion with D = 2 sqrt(K)."""
        self.plant.SetPositions(self.plant_context, self.q)
        J = jacobian(self.plant, self.plant_context, self.X_WT)
        mobility = J @ np.linalg.solve(
            self.plant.CalcMassMatrix(self.plant_context), J.T
        )
        values, axes = np.linalg.eigh(self.K)
        D = axes @ np.diag(2 * np.sqrt(values)) @ axes.T
        return np.linalg.eigvals(
            np.block(
                [
                    [np.zeros((6, 6)), np.eye(6)],
                    [-mobility @ self.K, -mobility @ D],
                ]
            )
        )


@pytest.fixture(scope="module")
def rests():
    return [Rest(q, seed=k) for k, q in enumerate(configurations(POSES))]


def test_the_realised_stiffness_is_within_2_percent_everywhere(rests, table):
    """Static wrenches that displace the tool by 5 mm and 1 degree, both ways."""
    worst, cross = 0.0, 0.0
    for rest in rests:
        for axis in range(6):
            for sign in (1, -1):
                x = np.zeros(6)
                x[axis] = sign * (np.radians(1) if axis < 3 else 0.005)
                found = rest.displacement(rest.K @ x)
                worst = max(worst, abs(found[axis] / x[axis] - 1))
                weight = np.sqrt(np.diag(rest.K))
                cross = max(
                    cross,
                    np.linalg.norm(weight * (found - x)) / np.linalg.norm(weight * x),
                )
    table["realised stiffness, worst of 6 directions, 10 poses and frames"] = (
        f"{100 * worst:.2f} % off (all directions together {100 * cross:.2f} %)"
    )
    assert worst < 0.02
    assert cross < 0.03


def test_the_realised_damping_ratio_is_within_5_percent_everywhere(rests, table):
    worst = 0.0
    for rest in rests:
        poles = rest.poles()
        ratio = -poles.real / np.abs(poles)
        posture = np.argsort(np.abs(ratio - 0.9))[:2]
        worst = max(worst, np.abs(np.delete(ratio, posture) / 0.7 - 1).max())
    table["realised damping ratio, worst of 6 modes, 10 poses and frames"] = (
        f"{100 * worst:.2f} % off 0.7"
    )
    assert worst < 0.05


def test_twice_the_root_of_the_stiffness_does_not_give_a_damping_ratio(rests, table):
    """D = 2 sqrt(K), which is meant to be critical."""
    low, high = np.inf, 0.0
    for rest in rests:
        poles = rest.unit_mass_poles()
        ringing = poles[poles.imag > 1e-6]
        low = min(low, (-ringing.real / np.abs(ringing)).min())
        # Two real poles -a, -b of one mode have (a + b) / (2 sqrt(a b)).
        real = np.sort(-poles[np.abs(poles.imag) <= 1e-6].real)
        if len(real):
            spread = (real[0] + real[-1]) / (2 * np.sqrt(real[0] * real[-1]))
            high = max(high, spread)
    table["the same with D = 2 sqrt(K), meant to be 1"] = f"{low:.2f} to {high:.0f}"
    assert low < 0.5
    assert high > 2


# The nullspace.


def test_a_nullspace_torque_hardly_moves_the_tool(table):
    """The posture's torque for 0.3 s, and the same past the projector."""
    worst = 0.0
    for k, q in enumerate(configurations(3, seed=5)):
        rng = np.random.default_rng(k)
        q_posture = q + 0.15 * rng.choice([-1, 1], size=7)
        model = make_arm()
        context = model.CreateDefaultContext()

        def posture_torque(
            _t, state, q_posture=q_posture, model=model, context=context
        ):
            model.SetPositionsAndVelocities(context, state)
            M = model.CalcMassMatrix(context)
            return M @ (25 * (q_posture - state[:7]) - 10 * state[7:])

        projected = ArmLoop(q=q, q_posture=q_posture).run(0.3)
        direct = ArmLoop(
            q=q,
            config=ImpedanceConfig(posture_frequency=0.0),
            load=posture_torque,
        ).run(0.3)
        moved = [
            np.abs(logs["tracking_error"][:, 3:]).max() for logs in (projected, direct)
        ]
        worst = max(worst, moved[0] / moved[1])
    table["tool moved by a nullspace torque, of what it does unprojected"] = (
        f"{100 * worst:.2f} %"
    )
    assert worst < 0.01


# Energy.


def restless_push(t):
    """A push of up to 30 N and 3 Nm that never rests."""
    phase = np.array([1.0, 1.7, 2.3, 1.3, 2.9, 0.7])
    size = np.array([3.0, 3.0, 1.0, 30.0, 30.0, 20.0])
    return size * np.sin(2 * np.pi * phase * t + phase)


@pytest.mark.parametrize("environment", ["pushing", "absorbing"])
def test_a_moving_arm_without_a_reference_motion_generates_no_energy(
    environment, table
):
    """The arm starts moving; what it had is all that it may give back."""
    given_back = -np.inf
    for k, q in enumerate(configurations(3, seed=7)):
        v = 0.4 * np.random.default_rng(k).normal(size=7)
        plant = make_arm()
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, q)
        kinetic = 0.5 * v @ plant.CalcMassMatrix(context) @ v

        def absorb(_t, state, plant=plant, context=context):
            plant.SetPositions(context, state[:7])
            twist = jacobian(plant, context) @ state[7:]
            return -np.array([0.3] * 3 + [20.0] * 3) * twist

        def push(t, state, absorb=absorb):
            return restless_push(t) if environment == "pushing" else absorb(t, state)

        loop = ArmLoop(q=q, push=push, log=("state", "push"))
        energy = np.cumsum(loop.power(loop.run(1.5, v=v))) * 0.001
        given_back = max(given_back, -energy.min() / kinetic)
    table[f"energy given to an environment that is {environment}, of the start's"] = (
        f"{100 * max(given_back, 0):.0f} %"
    )
    assert given_back < 1


def pumped(tank):
    """A stiffness that is high whenever the spring pulls back, to pump energy in.

    After a push, the environment is a damper that takes energy out.
    """
    plant = make_arm()
    context = plant.CreateDefaultContext()
    E = plant.GetFrameByName("eraser_tip")
    plant.SetPositions(context, Q_START)
    p_start = np.array(E.CalcPoseInWorld(context).translation())

    def motion(state):
        plant.SetPositionsAndVelocities(context, state)
        V = E.CalcSpatialVelocityInWorld(context).translational()
        return E.CalcPoseInWorld(context).translation() - p_start, V

    def stiffness(_t, state):
        x, v = motion(state)
        k = 2500.0 if x @ v < 0 else 300.0
        return np.diag([30.0, 30, 30, k, k, k]).ravel()

    def push(t, state):
        force = np.array([25.0, 0, 10.0]) if t < 0.3 else -15 * motion(state)[1]
        return np.r_[np.zeros(3), force]

    config = ImpedanceConfig(
        damping_ratio=0.05,
        stiffness_time_constant=0.003,
        translational_stiffness=[300.0, 300.0, 300.0],
        tank=tank,
    )
    logged = ("state", "push", "status")
    loop = ArmLoop({"stiffness": stiffness}, config=config, push=push, log=logged)
    logs = loop.run(4.0)
    return np.cumsum(loop.power(logs)) * 0.001, logs["status"]


def test_a_changing_stiffness_gives_no_more_than_the_tank_had(table):
    tank = EnergyTankConfig(initial_energy=0.2, capacity=0.4)
    energy, status = pumped(tank)
    open_energy, _ = pumped(EnergyTankConfig(initial_energy=1e6, capacity=1e6))
    table["energy taken out of a pumped stiffness in 4 s, tank of 0.2 J"] = (
        f"{max(0.0, -energy.min()):.2f} J (without the tank {-open_energy.min():.1f} J)"
    )
    assert energy.min() > -tank.initial_energy
    assert open_energy.min() < -5 * tank.initial_energy
    flags = status[:, 0].astype(int)
    assert np.any(flags & StatusFlag.TANK_EMPTY)


# Limits.

LIMITED = ("state", "torque")
MEASURED = ("measured_position", "measured_velocity")


def check_limits(logs, plant):
    torque, state = logs["torque"], logs["state"]
    assert np.isfinite(torque).all()
    assert np.isfinite(state).all()
    rate = np.abs(np.diff(torque, axis=0)).max() / 0.001
    share = np.max(np.abs(torque) / plant.GetEffortUpperLimits())
    q = state[:, :7]
    room = np.minimum(
        plant.GetPositionUpperLimits() - q, q - plant.GetPositionLowerLimits()
    ).min()
    assert rate <= 1000
    assert share <= 1 + 1e-12
    assert room > 0
    return rate, share, room


def flags_seen(logs):
    return StatusFlag(int(np.bitwise_or.reduce(logs["status"][:, 0].astype(int))))


@pytest.fixture(scope="module")
def worst_limits(table):
    figures = []
    yield figures
    rate, share, room = np.array(figures).T
    table["torque rate, greatest under steps, pushes, NaN, stale, singular"] = (
        f"{rate.max():.0f} Nm/s"
    )
    table["torque, greatest part of its limit"] = f"{share.max():.3f}"
    table["room to the joints' limits, smallest (stops removed)"] = (
        f"{room.min():.4f} rad"
    )


def disturbed(p, kind):
    """Desired position and velocity that are good but from 0.5 to 1 s."""

    def position(t):
        bad = 0.5 <= t < 1.0
        if kind == "jump" and bad:
            return p + np.array([0.2, -0.2, 0.1])
        if kind == "not finite" and bad:
            return np.array([np.nan, 0.0, 0.0] if t < 0.75 else [0.0, np.inf, 0.0])
        if kind == "huge" and bad:
            return np.array([0.0, 1e200, 0.0])
        return p

    def velocity(t):
        return np.array([0.3 if kind == "stale" and 0.5 <= t < 1.0 else 0.0, 0, 0])

    return {"desired_position": position, "desired_velocity": velocity}


@pytest.mark.parametrize("speed", [0.3, 4.0, 1e11])
def test_a_stop_does_not_follow_the_velocity_of_a_frame_that_stands_still(speed):
    X_WT = RigidTransform([0.5, 0, 0.1])
    frame = np.array([1.0, 0, 0, 0, *X_WT.translation()])
    signals = {
        "task_frame": lambda _: frame,
        "task_frame_velocity": lambda t: np.array([0, 0, 0, 0, 0, speed * (t > 0.05)]),
    }
    loop = ArmLoop(signals, X_WT=X_WT, log=("state", "status", "measured_position"))
    logs = loop.run(0.6)
    assert any(flags & StatusFlag.PROTECTIVE_STOP for flags in flags_seen(logs))
    moved = logs["measured_position"] - logs["measured_position"][0]
    assert np.max(np.linalg.norm(moved, axis=1)) < 0.03
    assert np.max(np.abs(logs["state"][:, 7:])) < 1.2


@pytest.mark.parametrize(
    ("kind", "flag"),
    [
        ("jump", StatusFlag.JUMP),
        ("not finite", StatusFlag.NOT_FINITE),
        ("huge", StatusFlag.NOT_FINITE),
        ("stale", StatusFlag.STALE),
    ],
)
def test_a_bad_target_causes_a_stop_and_a_recovery(kind, flag, worst_limits):
    plant = make_arm()
    p = pose_in_task(plant, Q_START, RigidTransform([0.5, 0, 0.1])).translation()
    logged = (*LIMITED, "status", "measured_position")
    logs = ArmLoop(disturbed(p, kind), stops=False, log=logged).run(3.0)
    worst_limits.append(check_limits(logs, plant))
    seen = flags_seen(logs)
    assert flag | StatusFlag.PROTECTIVE_STOP | StatusFlag.RECOVER in seen
    moved = np.linalg.norm(logs["measured_position"] - p, axis=1)
    # A stale target drags the arm along until it is found out.
    assert moved.max() < (0.2 if kind == "jump" else 0.03)
    assert moved[-1] < 1e-3
    assert logs["status"][-1, 1] == 1.0


def test_a_target_with_a_time_is_stale_when_it_is_old(worst_limits):
    plant = make_arm()
    loop = ArmLoop({"target_time": lambda t: np.array([min(t, 0.3)])}, stops=False)
    logs = loop.run(0.6)
    worst_limits.append(check_limits(logs, plant))
    held = logs["status"][:, 0].astype(int) & StatusFlag.STALE > 0
    assert np.argmax(held) / 1000 == pytest.approx(0.4, abs=0.005)
    assert held[-1]


def test_state_that_is_not_finite_takes_the_torque_to_zero_and_back():
    rest = Rest(Q_START, seed=0)
    rest.config.max_torque_rate = 900.0
    controller = OperationalSpaceImpedanceController(
        rest.plant,
        end_effector=rest.plant.GetFrameByName("eraser_tip"),
        X_WT=rest.X_WT,
        config=rest.config,
        q_posture=Q_START,
    )
    context = controller.CreateDefaultContext()
    for name, value in {
        "desired_position": rest.X_TE.translation() + 0.02,
        "desired_velocity": np.zeros(3),
        "desired_acceleration": np.zeros(3),
    }.items():
        controller.GetInputPort(name).FixValue(context, value)
    good = np.r_[Q_START, np.zeros(7)]
    torques, modes = [], []
    for k in range(400):
        state = np.full(14, np.nan) if 50 <= k < 150 else good
        controller.GetInputPort("state").FixValue(context, state)
        for name in ("measured_position", "measured_velocity", "tracking_error"):
            controller.GetOutputPort(name).Eval(context)
        context.SetDiscreteState(controller.EvalUniquePeriodicDiscreteUpdate(context))
        torques.append(context.get_discrete_state(0).value().copy())
        modes.append(int(context.get_discrete_state(1).value()[0]))
    assert np.isfinite(torques).all()
    assert np.abs(np.diff(torques, axis=0)).max() <= 0.9 + 1e-9
    assert np.abs(torques[49]).max() > 1
    assert np.abs(torques[149]).max() == 0
    assert modes[100] & StatusFlag.NO_STATE
    assert modes[151] & StatusFlag.PROTECTIVE_STOP
    assert not modes[-1] & StatusFlag.PROTECTIVE_STOP


@pytest.mark.parametrize("axis", range(3))
def test_a_push_of_50_newtons_is_withstood_and_recovered_from(axis, worst_limits):
    def push(t):
        wrench = np.zeros(6)
        wrench[3 + axis] = 50.0 if 0.2 <= t < 0.7 else -50.0 if 0.9 <= t < 1.2 else 0.0
        return wrench

    logs = ArmLoop(push=push, stops=False).run(3.0)
    worst_limits.append(check_limits(logs, make_arm()))
    assert np.abs(logs["tracking_error"][-1]).max() < 0.01


SINGULAR = {
    "stretched": np.array([0.0, 0.5, 0.0, -0.12, 0.0, 1.7, 0.8]),
    "wrist": np.array([0.0, -0.4, 0.0, -2.0, 0.0, 0.02, 0.8]),
    "shoulder": np.array([0.3, 0.0, 0.2, -1.6, 0.0, 1.6, 0.8]),
    "folded": np.array([0.0, 1.6, 0.0, -3.0, 0.0, 3.6, 0.8]),
}


@pytest.mark.parametrize("pose", SINGULAR)
def test_limits_hold_at_singular_poses_under_steps_and_pushes(pose, worst_limits):
    """Targets step by 4 cm, which the watchdog lets through, with 50 N beside."""
    plant = make_arm()
    q = SINGULAR[pose]
    p = pose_in_task(plant, q, RigidTransform([0.5, 0, 0.1])).translation()
    rng = np.random.default_rng(3)
    steps = 0.04 / np.sqrt(3) * rng.choice([-1, 1], size=(20, 3))
    pushes = rng.normal(size=(20, 3))
    pushes *= 50 / np.linalg.norm(pushes, axis=1)[:, None]

    def position(t):
        return p + 0.5 * steps[int(t / 0.2) % 20] if t < 1.5 else p

    def push(t):
        return np.r_[np.zeros(3), pushes[int(t / 0.3) % 20] if t < 1.5 else np.zeros(3)]

    logs = ArmLoop(
        {"desired_position": position}, q=q, push=push, stops=False, log=LIMITED
    ).run(3.0)
    worst_limits.append(check_limits(logs, plant))
    assert np.abs(logs["state"][-1, 7:]).max() < 0.2


@pytest.mark.parametrize("joint", range(7))
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("how", ["thrown", "pushed"])
def test_the_walls_keep_every_joint_inside(joint, side, how, worst_limits):
    """Thrown at its limit at 80 % of full speed, or pushed there by 50 N."""
    plant = make_arm()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    limit = upper if side > 0 else lower
    q = Q_START.copy()
    q[joint] = limit[joint] - side * 0.5
    v = np.zeros(7)
    if how == "thrown":
        v[joint] = 0.8 * side * plant.GetVelocityUpperLimits()[joint]
    context = plant.CreateDefaultContext()

    def push(t, state):
        plant.SetPositions(context, state[:7])
        direction = side * jacobian(plant, context)[3:, joint]
        length = np.linalg.norm(direction)
        pushing = how == "pushed" and t < 0.6 and length > 0.05
        force = 50 * direction / length if pushing else np.zeros(3)
        return np.r_[np.zeros(3), force]

    logs = ArmLoop(q=q, push=push, stops=False, log=LIMITED).run(0.7, v=v)
    worst_limits.append(check_limits(logs, plant))


# Orientations.


def test_the_sign_of_a_quaternion_does_not_matter():
    X_TE = pose_in_task(make_arm(), Q_START, RigidTransform([0.5, 0, 0.1]))
    wxyz = quaternion(X_TE.rotation())

    def blinking(t):
        return wxyz if int(1000 * t) % 2 else -2 * wxyz

    logs = ArmLoop({"desired_orientation": blinking}).run(0.2)
    assert np.abs(logs["torque"]).max() < 1e-9
    assert np.abs(logs["tracking_error"]).max() < 1e-9


def test_a_target_that_turns_past_180_degrees_gives_no_jump(table):
    """The tool is too weak to follow; it is not pulled the other way at 180."""
    X_TE = pose_in_task(make_arm(), Q_START, RigidTransform([0.5, 0, 0.1]))
    speed = np.radians(120)

    def orientation(t):
        angle = min(speed * t, np.radians(240))
        return quaternion(X_TE.rotation() @ RotationMatrix.MakeZRotation(angle))

    # Something holds the joint that would turn.
    def clamp(_t, state):
        load = np.zeros(7)
        load[6] = -2000 * (state[6] - Q_START[6]) - 20 * state[13]
        return load

    loop = ArmLoop({"desired_orientation": orientation}, load=clamp)
    logs = loop.run(2.5)
    angle = np.degrees(np.linalg.norm(logs["tracking_error"][:, :3], axis=1))
    assert angle.max() > 179
    change = np.abs(np.diff(logs["torque"][300:], axis=0)).max()
    table["torque change per ms while the target turns through 180 degrees"] = (
        f"{change:.4f} Nm at most"
    )
    assert change < 0.05


def test_a_turning_target_is_followed_all_the_way_round():
    """There and back by 150 degrees about the board's normal: joint 7's range."""
    X_TE = pose_in_task(make_arm(), Q_START, RigidTransform([0.5, 0, 0.1]))
    amplitude, omega = np.radians(75), 1.2

    def angle(t):
        return amplitude * (1 - np.cos(omega * t)), amplitude * omega * np.sin(
            omega * t
        )

    signals = {
        "desired_orientation": lambda t: quaternion(
            RotationMatrix.MakeZRotation(angle(t)[0]) @ X_TE.rotation()
        ),
        "desired_angular_velocity": lambda t: np.array([0, 0, angle(t)[1]]),
        "desired_angular_acceleration": lambda t: np.array(
            [0, 0, amplitude * omega**2 * np.cos(omega * t)]
        ),
    }
    logs = ArmLoop(signals).run(5.2)
    error = np.linalg.norm(logs["tracking_error"][200:], axis=1)
    assert error.max() < np.radians(2)


# A frame that moves.


def test_a_moving_task_frame_carries_the_tool(table):
    """The board swings and turns; the target rests on it."""
    omega = 2 * np.pi * 0.4
    p_WT0 = np.array([0.5, 0, 0.1])

    def frame(t):
        s = np.sin(omega * t) ** 3
        R = RollPitchYaw(0.2 * s, -0.15 * s, 0.3 * s).ToRotationMatrix()
        return R, p_WT0 + np.array([0.03, 0.05, 0.02]) * s

    def pose(t):
        R, p = frame(t)
        return np.r_[quaternion(R), p]

    def twist(t):
        h = 1e-4
        (R1, p1), (R2, p2) = frame(t - h), frame(t + h)
        turn = Rotation.from_matrix(R2.matrix() @ R1.matrix().T).as_rotvec()
        return np.r_[turn, p2 - p1] / (2 * h)

    errors = {}
    for name, signals in {
        "with": {
            "task_frame": pose,
            "task_frame_velocity": twist,
            "task_frame_acceleration": lambda t: (
                (twist(t + 1e-3) - twist(t - 1e-3)) / 2e-3
            ),
        },
        "without": {"task_frame": pose},
    }.items():
        logs = ArmLoop(signals).run(2.5)
        errors[name] = np.linalg.norm(logs["tracking_error"][:, 3:], axis=1).max()
        assert not flags_seen(logs) & StatusFlag.PROTECTIVE_STOP
    table["tool on a task frame that swings 6 cm and 20 degrees at 0.4 Hz"] = (
        f"{1000 * errors['with']:.1f} mm at most "
        f"({1000 * errors['without']:.1f} mm without the frame's velocity)"
    )
    assert errors["with"] < 0.5 * errors["without"]
    assert errors["with"] < 0.02


# Compliance.


def test_the_covariance_makes_the_arm_compliant_and_stiff():
    config = ImpedanceConfig()
    config.covariance_stiffness.enabled = True
    covariance = np.diag([1e-8, 0.2**2, 1e-8])
    push = np.array([0, 0, 0, 4.0, 4.0, 0])
    logs = ArmLoop(
        {"covariance": lambda _t: covariance.ravel()},
        config=config,
        push=lambda _t: push,
    ).run(2.5)
    x, y = -logs["tracking_error"][-1, 3:5]
    assert 4.0 / x == pytest.approx(1500, rel=0.02)
    assert 4.0 / y == pytest.approx(312, rel=0.02)
    assert not flags_seen(logs) & StatusFlag.PROTECTIVE_STOP


def test_stiffness_that_is_not_positive_definite_is_refused():
    def stiffness(t):
        diagonal = np.array([30.0, 30, 30, 500, 500, 500])
        return np.diag(diagonal).ravel() * (1 if t < 0.5 else -1)

    push = np.array([0, 0, 0, 0, 2.0, 0])
    logs = ArmLoop({"stiffness": stiffness}, push=lambda _t: push).run(1.5)
    assert flags_seen(logs) & StatusFlag.STIFFNESS_REFUSED
    assert 2.0 / -logs["tracking_error"][-1, 4] == pytest.approx(500, rel=0.02)


# Friction.


def test_compensated_friction_leaves_a_smaller_error(table):
    friction = SigmoidFriction.of(PANDA_FRICTION, n=7)
    p = pose_in_task(make_arm(), Q_START, RigidTransform([0.5, 0, 0.1])).translation()
    omega = np.pi

    def wave(t):
        s, c = np.sin(omega * t), np.cos(omega * t)
        d = np.array([0.06, 0.08, 0.03])
        return p + d * (1 - c), d * omega * s, d * omega**2 * c

    signals = {
        "desired_position": lambda t: wave(t)[0],
        "desired_velocity": lambda t: wave(t)[1],
        "desired_acceleration": lambda t: wave(t)[2],
    }
    rms = []
    for enabled in (False, True):
        config = ImpedanceConfig(
            friction_compensation=replace(PANDA_FRICTION, enabled=enabled, gain=0.9)
        )
        logs = ArmLoop(
            signals,
            config=config,
            load=lambda _t, state: -friction_torque(friction, state[7:]),
        ).run(3.0)
        error = logs["tracking_error"][1000:, 3:]
        rms.append(np.sqrt((error**2).sum(axis=1).mean()))
    table["tracking in free air with joint friction, rms"] = (
        f"{1000 * rms[0]:.2f} mm, compensated {1000 * rms[1]:.2f} mm"
    )
    assert rms[1] < 0.4 * rms[0]


# Optional inputs.


def optional_inputs(seed):
    rng = np.random.default_rng(seed)
    K = np.diag([30.0, 30, 30, 800, 800, 800])
    return {
        "desired_orientation": rng.normal(size=4),
        "desired_angular_velocity": rng.normal(size=3),
        "desired_angular_acceleration": rng.normal(size=3),
        "task_frame": rng.normal(size=7),
        "task_frame_velocity": 0.1 * rng.normal(size=6),
        "task_frame_acceleration": 0.1 * rng.normal(size=6),
        "target_time": np.zeros(1),
        "stiffness": (K + 20 * np.ones((6, 6)) * seed).ravel(),
        "covariance": (1e-4 * (seed + 1) * np.eye(3)).ravel(),
        "normal_force": np.array([5.0 + seed]),
        "desired_normal_force": np.array([4.0 + seed]),
    }


def test_every_optional_input_is_followed_with_and_without_caching():
    """One after the other: each matters, and none is stale."""
    plant = make_arm()
    config = ImpedanceConfig(max_torque_rate=NO_LIMIT)
    config.covariance_stiffness.enabled = True
    config.force_control.enabled = True
    config.force_control.rest_distance = 10.0  # The frames of below are anywhere.
    config.stiffness_time_constant = 0.0
    config.tank = EnergyTankConfig(initial_energy=1e6, capacity=1e6)
    config.watchdog.max_start_distance = 10.0
    controller = OperationalSpaceImpedanceController(
        plant,
        end_effector=plant.GetFrameByName("eraser_tip"),
        X_WT=RigidTransform(),
        config=config,
        q_posture=Q_START,
        engage_height=10.0,
    )
    cached, uncached = (controller.CreateDefaultContext() for _ in range(2))
    uncached.DisableCaching()
    for context in (cached, uncached):
        for name, value in {
            "state": np.r_[Q_START, 0.1 * np.ones(7)],
            "desired_position": np.array([0.3, 0.1, 0.5]),
            "desired_velocity": np.zeros(3),
            "desired_acceleration": np.zeros(3),
            "feedforward_wrench": np.array([0, 0, 0, 0, 0, -8.0]),
        }.items():
            controller.GetInputPort(name).FixValue(context, value)
    first, second = optional_inputs(0), optional_inputs(1)
    results = []
    for name in [None, *first, *second]:
        late = len(results) > len(first)
        for context in (cached, uncached):
            if name:
                value = (second if late else first)[name]
                controller.GetInputPort(name).FixValue(context, value)
        states = [
            controller.EvalUniquePeriodicDiscreteUpdate(context)
            for context in (cached, uncached)
        ]
        for k in range(3):
            np.testing.assert_array_equal(states[0].value(k), states[1].value(k))
        for name_ in ("measured_position", "measured_velocity", "tracking_error"):
            port = controller.GetOutputPort(name_)
            np.testing.assert_array_equal(port.Eval(cached), port.Eval(uncached))
        results.append(states[0].value(0).copy())
    # A target made at time 0 is as fresh as one without a time.
    changed = np.abs(np.diff(results, axis=0)).max(axis=1) > 1e-9
    names = [*first, *second]
    assert {n for n, c in zip(names, changed, strict=True) if not c} == {"target_time"}


def test_two_runs_with_a_fault_are_identical():
    plant = make_arm()
    p = pose_in_task(plant, Q_START, RigidTransform([0.5, 0, 0.1])).translation()
    loop = ArmLoop(disturbed(p, "jump"), log=(*LOGGED, *MEASURED))
    first, second = loop.run(0.9), loop.run(0.9)
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])
