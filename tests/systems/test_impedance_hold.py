"""Facts about the model that stands in for the law between its full updates."""

import numpy as np
import pytest
from arm_loop import (
    Q_START,
    X_WT_FLAT,
    ArmLoop,
    make_arm,
    pose_in_task,
    quaternion,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

import fmp_drake.systems.operational_space_impedance_controller as controller_module
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.friction import FrictionConfig, SigmoidFriction
from fmp_drake.systems.impedance.hold import HeldModel, ModelHold, reach_of
from fmp_drake.systems.impedance.status import StatusFlag
from fmp_drake.systems.impedance.walls import (
    JointLimits,
    JointWallConfig,
    wall_torque,
)
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)

# Groups of the controller's discrete state.
TORQUE, STATUS, MODEL = 0, 1, 3
PERIOD = 0.001
MODEL_PERIOD = 0.01
LIMIT = np.array([80.0, 10.0])


def make_hold(**changes):
    settings = {
        "lower": -LIMIT,
        "upper": LIMIT,
        "max_change": 0.9,
        "control_period": PERIOD,
        "model_period": MODEL_PERIOD,
    }
    return ModelHold(**(settings | changes))


def model(
    torque=(5.0, -2.0), *, rate=(0.0, 0.0), curve=(0.0, 0.0), slope=None, state=None
):
    return HeldModel(
        np.array(torque),
        np.zeros((4, 2)) if slope is None else slope,
        np.array(rate),
        np.array(curve),
        np.zeros(4) if state is None else state,
        np.array([0.05, 0.05, 0.3, 0.3]),
    )


def pack(hold, held, *, time=0.0, before=None):
    return hold.pack(held, time=time, before=hold.empty() if before is None else before)


# The model in its vector.


def test_the_model_is_linear_in_state_and_quadratic_in_time():
    rng = np.random.default_rng(0)
    slope, state = rng.normal(size=(4, 2)), rng.normal(size=4)
    hold = make_hold()
    rate, curve = (30.0, -10.0), (700.0, 900.0)
    held = model(rate=rate, curve=curve, slope=slope, state=state)
    vector = pack(hold, held, time=2.0)
    moved = 0.01 * rng.normal(size=4)
    expected = np.array([5.0, -2.0]) + moved @ slope
    expected += 0.004 * np.array(rate) + 0.004**2 * np.array(curve)
    found = hold.torque(vector, time=2.004, state=state + moved, previous=expected)
    assert_allclose(found, expected)


@pytest.mark.parametrize(
    ("time", "state", "previous"),
    [
        (2.010, [0, 0, 0, 0], [5, -2]),  # too old
        (1.999, [0, 0, 0, 0], [5, -2]),  # another run
        (2.001, [0.051, 0, 0, 0], [5, -2]),
        (2.001, [0, 0, 0, -0.31], [5, -2]),
        (2.001, [0.04, 0, 0.2, 0], [5, -2]),  # both a little
        (2.001, [0, np.nan, 0, 0], [5, -2]),
        (2.001, [0, 0, 0, np.inf], [5, -2]),
        (2.001, [0, 0, 0, 0], [5.91, -2]),  # too fast a change
    ],
)
def test_a_full_update_is_due(time, state, previous):
    hold = make_hold()
    vector = pack(hold, model(), time=2.0)
    arguments = {"time": 2.001, "state": np.zeros(4), "previous": np.array([5.0, -2.0])}
    assert hold.torque(vector, **arguments) is not None
    assert hold.serves(vector, 2.001)
    with np.errstate(invalid="ignore"):
        found = hold.torque(
            vector,
            time=time,
            state=np.array(state, dtype=float),
            previous=np.array(previous, dtype=float),
        )
    assert found is None or not hold.serves(vector, time)


@pytest.mark.parametrize(
    ("torque", "allowed"),
    [([60.0, 6.0], True), ([80.1, 0.0], False), ([0.0, -10.1], False)],
)
def test_a_full_update_is_due_at_an_effort_limit(torque, allowed):
    hold = make_hold()
    vector = pack(hold, model(torque))
    found = hold.torque(
        vector, time=0.001, state=np.zeros(4), previous=np.array(torque)
    )
    assert (found is not None) == allowed


def test_no_model_is_held_where_every_update_is_a_full_one():
    assert make_hold().used
    assert not make_hold(model_period=PERIOD).used
    assert not make_hold(model_period=0.2 * PERIOD).used


def test_the_time_since_the_last_full_update_is_whole_control_periods():
    hold = make_hold()
    assert hold.elapsed(hold.empty(), time=0.3) == PERIOD
    vector = hold.empty(0.3)
    for time, expected in ((0.301, 1), (0.3100001, 10), (0.3, 1), (0.5, 1), (0.2, 1)):
        assert hold.elapsed(vector, time=time) == expected * PERIOD


def test_friction_is_compensated_at_the_present_speed():
    config = FrictionConfig(height=[1.0] * 2, slope=[10.0] * 2, shift=[0.0] * 2)
    friction = SigmoidFriction.of(config, n=2)
    hold = make_hold(friction=friction)
    v = np.array([0.1, -0.2])
    found = hold.torque(
        pack(hold, model()),
        time=0.001,
        state=np.r_[0, 0, v],
        previous=np.array([5.0, -2.0]),
    )
    assert_allclose(found, np.array([5.0, -2.0]) + friction.torque(v))


def test_what_a_model_missed_drifts_on_in_the_next():
    """The law is 5 + 20 t + 300 t², the models know of no rate."""
    hold = make_hold()

    def law(t):
        return np.array([5 + 20 * t + 300 * t * t, -2.0])

    vector = pack(hold, model(law(0.0)))
    vector = pack(hold, model(law(0.01)), time=0.01, before=vector)
    found = hold.torque(vector, time=0.012, state=np.zeros(4), previous=law(0.011))
    # A backward difference: 300 t² is followed at its mean slope of 3 Nm/s.
    assert_allclose(found, law(0.01) + np.array([0.002 * 23, 0]))
    # The next difference is of the law as well, not of the model with its drift.
    vector = pack(hold, model(law(0.02)), time=0.02, before=vector)
    found = hold.torque(vector, time=0.022, state=np.zeros(4), previous=law(0.021))
    assert_allclose(found, law(0.02) + np.array([0.002 * 29, 0]))


def test_a_jump_does_not_drift_on():
    hold = make_hold()
    vector = pack(hold, model((9.0, -2.0)), time=0.01, before=pack(hold, model()))
    found = hold.torque(
        vector, time=0.015, state=np.zeros(4), previous=np.array([9.0, -2.0])
    )
    assert_array_equal(found, [9.0, -2.0])


LIMITS = JointLimits.between(
    np.array([-1.0, -2.0]),
    np.array([2.0, 2.5]),
    speed=np.array([2.0, 1.0]),
    effort=np.array([10.0, 5.0]),
)


@given(st.integers(0, 10**6))
def test_no_wall_and_no_brake_is_within_reach_of_a_model(seed):
    rng = np.random.default_rng(seed)
    walls = JointWallConfig()
    q, v = rng.uniform([-1, -2], [2, 2.5]), rng.uniform(-1.8, 1.8, 2)
    reach = reach_of(walls, LIMITS, q=q, v=v)
    if reach is None:
        return
    direction = rng.normal(size=4)
    moved = np.array(reach) * direction / np.linalg.norm(direction)
    found = wall_torque(
        walls, LIMITS, q=q + moved[:2], v=v + moved[2:], inertia=np.ones(2)
    )
    assert found is None


# The model of the law.


class Still:
    """A controller at rest on its target, after one full update."""

    def __init__(self, *, model_period=MODEL_PERIOD, damping_ratio=0.7):
        self.plant = make_arm()
        config = ImpedanceConfig(
            model_period=model_period,
            damping_ratio=damping_ratio,
            posture_damping_ratio=0.9,
        )
        self.controller = OperationalSpaceImpedanceController(
            self.plant,
            end_effector=self.plant.GetFrameByName("eraser_tip"),
            X_WT=X_WT_FLAT,
            config=config,
            q_posture=Q_START,
        )
        self.context = self.controller.CreateDefaultContext()
        X_TE = pose_in_task(self.plant, Q_START, X_WT_FLAT)
        self.p = X_TE.translation()
        self.fix(
            state=np.r_[Q_START, np.zeros(7)],
            desired_position=self.p,
            desired_orientation=quaternion(X_TE.rotation()),
            desired_velocity=np.zeros(3),
            desired_acceleration=np.zeros(3),
            feedforward_wrench=np.zeros(6),
        )

    def fix(self, **inputs):
        for name, value in inputs.items():
            self.controller.GetInputPort(name).FixValue(self.context, value)

    def update(self):
        return self.controller.EvalUniquePeriodicDiscreteUpdate(self.context)

    def step(self):
        values = self.update()
        for group in range(values.num_groups()):
            self.context.SetDiscreteState(group, values.value(group).copy())
        self.context.SetTime(self.context.get_time() + PERIOD)

    def torque(self, x):
        self.fix(state=x)
        return self.update().value(TORQUE).copy()


def test_small_motions_feel_the_same_stiffness_and_damping_as_from_the_law():
    held, every = Still(), Still(model_period=PERIOD)
    held.step()
    every.step()
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = np.r_[Q_START, np.zeros(7)] + rng.normal(size=14) * (
            [1e-4] * 7 + [1e-3] * 7
        )
        expected = every.torque(x)
        assert np.abs(expected).max() > 1e-3
        assert_allclose(held.torque(x), expected, atol=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize("damping_ratio", [0.4, 1.0])
def test_the_poles_of_the_held_loop_have_the_chosen_damping(damping_ratio):
    still = Still(damping_ratio=damping_ratio)
    still.step()
    plant_context = still.plant.CreateDefaultContext()
    x0, h = np.r_[Q_START, np.zeros(7)], 1e-5
    still.plant.SetPositions(plant_context, Q_START)
    M = still.plant.CalcMassMatrix(plant_context)
    slope = np.column_stack(
        [
            (still.torque(x0 + h * dx) - still.torque(x0 - h * dx)) / (2 * h)
            for dx in np.eye(14)
        ]
    )
    A = np.block([[np.zeros((7, 7)), np.eye(7)], [np.linalg.solve(M, slope)]])
    poles = np.linalg.eigvals(A)
    ratios = np.sort(-poles.real / np.abs(poles))
    expected = np.sort([damping_ratio] * 12 + [0.9] * 2)
    # Two equal real poles are found to the root of the rounding.
    assert_allclose(ratios, expected, atol=1e-3)


def test_a_moving_target_is_extrapolated():
    v, a = np.array([0.3, -0.2, 0.1]), np.array([2.0, 1.0, -1.0])
    held, every = Still(), Still(model_period=PERIOD)
    for still in (held, every):
        # The first update is rate-limited.
        for _ in range(40):
            still.fix(desired_velocity=v, desired_acceleration=a)
            still.step()
    while held.update().value(MODEL)[0] != held.context.get_time():
        held.step()
    held.step()  # A full update; the next ones are not.
    every.step()
    begin = held.update().value(TORQUE).copy()
    assert_allclose(every.update().value(TORQUE), begin, atol=1e-9)
    for k in range(1, 8):
        t = k * PERIOD
        every.fix(desired_position=every.p + v * t, desired_velocity=v + a * t)
        every.step()
        held.step()
    moved = every.update().value(TORQUE) - begin
    assert np.abs(moved).max() > 0.5
    assert_allclose(held.update().value(TORQUE) - begin, moved, atol=0.1)


# In closed loop.


def figure(t):
    """A Lissajous figure of 16 by 24 cm, up to 0.5 m/s, that begins smoothly."""
    share = 1 - np.exp(-((t / 0.5) ** 3))
    omega = 2 * np.pi * 0.6
    return share * np.array(
        [0.08 * np.sin(omega * t), 0.12 * np.sin(0.7 * omega * t), 0.0]
    )


def wiping_loop(config, *, jerk=False, **arguments):
    p = pose_in_task(make_arm(), Q_START, X_WT_FLAT).translation()
    h = 1e-3
    signals = {
        "desired_position": lambda t: p + figure(t),
        "desired_velocity": lambda t: (figure(t + h) - figure(t - h)) / (2 * h),
        "desired_acceleration": lambda t: (
            (figure(t + h) - 2 * figure(t) + figure(t - h)) / h**2
        ),
        "feedforward_wrench": lambda t: np.array([0, 0, 0, 0, 0, 10 * min(t, 1)]),
    }
    if jerk:
        acceleration, window = signals["desired_acceleration"], config.model_period
        signals["desired_jerk"] = lambda t: (
            (acceleration(t + window) - acceleration(t)) / window
        )
    return ArmLoop(signals, config=config, **arguments)


@pytest.fixture
def full_updates(monkeypatch):
    """A list that gets an element at each full update."""
    counted = []
    step = controller_module.impedance_step

    def counting(*arguments, **keywords):
        counted.append(keywords["arm"])
        return step(*arguments, **keywords)

    monkeypatch.setattr(controller_module, "impedance_step", counting)
    return counted


@pytest.fixture(scope="module")
def every_step():
    return wiping_loop(ImpedanceConfig(model_period=PERIOD)).run(4.0)


@pytest.mark.parametrize(
    ("model_period", "rms", "most"), [(0.004, 0.002, 0.03), (0.01, 0.01, 0.1)]
)
def test_the_torque_of_a_wiping_run_is_that_of_the_law(
    every_step, model_period, rms, most, full_updates
):
    held = wiping_loop(ImpedanceConfig(model_period=model_period)).run(4.0)
    assert len(full_updates) < 1.1 * 4.0 / model_period
    off = held["torque"] - every_step["torque"]
    assert np.abs(every_step["torque"]).max() > 5
    assert np.sqrt(np.mean(off**2)) < rms
    assert np.abs(off).max() < most
    moved = held["measured_position"] - every_step["measured_position"]
    assert np.abs(moved).max() < 1e-4


def test_the_jerk_of_the_target_brings_the_torque_closer_to_the_law(every_step):
    off = []
    for jerk in (False, True):
        held = wiping_loop(ImpedanceConfig(model_period=0.02), jerk=jerk).run(4.0)
        difference = held["torque"] - every_step["torque"]
        off.append(np.sqrt(np.mean(difference[100:] ** 2)))
    assert off[1] < 0.02
    assert off[1] < 0.7 * off[0]


def test_a_model_period_below_the_control_period_changes_nothing(every_step):
    logs = wiping_loop(ImpedanceConfig(model_period=0.1 * PERIOD)).run(1.0)
    for name, values in logs.items():
        assert_array_equal(values, every_step[name][: len(values)], err_msg=name)


def test_a_run_can_be_reset_and_repeated():
    loop = wiping_loop(ImpedanceConfig(), log=False)
    simulator = Simulator(loop.diagram)
    context = simulator.get_mutable_context()
    ends = []
    for _ in range(2):
        context.SetTime(0.0)
        loop.diagram.SetDefaultContext(context)
        loop.plant.SetPositions(loop.plant.GetMyMutableContextFromRoot(context), loop.q)
        simulator.Initialize()
        simulator.AdvanceTo(0.3)
        values = context.get_discrete_state()
        ends.append(
            np.concatenate([values.value(k) for k in range(values.num_groups())])
        )
    assert_array_equal(ends[0], ends[1])


def test_a_fault_is_noticed_within_a_model_period_and_watched_at_every_update(
    full_updates,
):
    p = pose_in_task(make_arm(), Q_START, X_WT_FLAT).translation()
    jump = 0.2015
    loop = ArmLoop(
        {"desired_position": lambda t: p + (t > jump) * np.array([0.2, 0, 0])}
    )
    flags = loop.run(0.3)["status"][:, 0].astype(int)
    noticed = np.argmax(flags & StatusFlag.JUMP > 0) * PERIOD
    model_period = ImpedanceConfig().model_period
    assert jump < noticed < jump + model_period + 2 * PERIOD
    before = jump / model_period
    after = (0.3 - noticed) / PERIOD
    assert len(full_updates) == pytest.approx(before + after, abs=4)


def test_a_push_that_changes_the_speed_at_once_is_computed_at_once(full_updates):
    loop = ArmLoop(load=lambda t: np.array([0, 0, 0, 0, 0, 0, 60.0 * (t > 0.1)]))
    loop.run(0.14)
    assert len(full_updates) > 0.14 / MODEL_PERIOD + 4


def test_in_front_of_a_joint_limit_every_update_is_a_full_one(full_updates):
    plant = make_arm()
    q = Q_START.copy()
    q[3] = plant.GetPositionUpperLimits()[3] - 0.09
    ArmLoop(q=q).run(0.1)
    assert len(full_updates) == 100


def test_a_state_that_is_not_finite_is_noticed_at_once():
    still = Still()
    still.fix(desired_velocity=np.array([0.1, 0.0, 0.0]))
    for _ in range(13):
        still.step()
    assert np.abs(still.update().value(TORQUE)).max() > 0.1
    still.fix(state=np.full(14, np.nan))
    values = still.update()
    assert int(values.value(STATUS)[0]) & StatusFlag.NO_STATE
    assert np.isfinite(values.value(TORQUE)).all()
