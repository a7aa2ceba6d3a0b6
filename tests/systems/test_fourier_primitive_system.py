"""Facts about the skill as a Drake system."""

import copy

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.errors import SkillError, SystemsError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Keypoint,
    LqrTracker,
    Player,
)
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem

OUTPUTS = {
    "motion": 6,
    "position": 2,
    "velocity": 2,
    "acceleration": 2,
    "covariance": 4,
    "weights": 48,
    "component": 1,
    "plan": 62,
    "plan_covariance": 124,
    "remaps": 2,
    "measurement_age": 1,
}
TICK = 0.1
REMAP = 2.0  # (T - K) / rate of `small_skill`


@pytest.fixture(scope="module")
def system(small_skill):
    """The system of a skill with T = 24, K = 4, D = 2, 10 Hz."""
    return FourierPrimitiveSystem(small_skill)


@pytest.fixture(scope="module")
def start(small_skill):
    """A start 5 cm outside what was demonstrated."""
    return small_skill.extent_[1] + 0.05


@pytest.fixture(scope="module")
def recorded(small_skill, start):
    """A system that plays means (False) or samples (True), and its `record` of 6.3 s."""
    systems = {
        sample: FourierPrimitiveSystem(small_skill, sample=sample)
        for sample in (False, True)
    }
    return {k: (s, record(simulator_at(s, start), 6.3)) for k, s in systems.items()}


def context_at(system, measured, time=0.0):
    context = system.CreateDefaultContext()
    context.SetTime(time)
    system.GetInputPort("measured_position").FixValue(context, measured)
    return context


def simulator_at(system, measured, time=0.0):
    simulator = Simulator(system, context_at(system, measured, time))
    simulator.Initialize()
    return simulator


def outputs(system, context):
    return {n: system.GetOutputPort(n).Eval(context).copy() for n in OUTPUTS}


def assert_same_outputs(one, two):
    for name in OUTPUTS:
        assert np.array_equal(one[name], two[name]), name


def expected_outputs(player, state):
    motion = player.motion(state)
    return {
        "motion": motion.ravel(),
        "position": motion[0],
        "velocity": motion[1],
        "acceleration": motion[2],
        "covariance": player.variation(state).ravel(),
        "weights": player.weights(state),
        "component": [state.component],
        "remaps": [state.remaps, 0],
        "measurement_age": [0.0],
    }


def record(simulator, until, every=0.03):
    """Return all outputs along a simulation, sampled between and at ticks."""
    system, context = simulator.get_system(), simulator.get_context()
    rows, count = [], round((until - context.get_time()) / every)
    begin = context.get_time()
    for i in range(count + 1):
        simulator.AdvanceTo(begin + i * every)
        rows.append(np.concatenate(list(outputs(system, context).values())))
    return np.array(rows)


# Ports --------------------------------------------------------------------


def test_ports_have_names_and_sizes(system):
    assert system.get_name() == "fourier_primitive"
    assert system.num_input_ports() == 3
    for name, size in {"measured_position": 2, "tempo": 1, "sample": 1}.items():
        assert system.GetInputPort(name).size() == size
    assert system.num_output_ports() == len(OUTPUTS)
    for name, size in OUTPUTS.items():
        assert system.GetOutputPort(name).size() == size


def test_no_output_feeds_through(system):
    for output in range(system.num_output_ports()):
        for port in range(system.num_input_ports()):
            assert not system.HasDirectFeedthrough(port, output)


def test_all_of_its_values_are_discrete_state(system):
    context = system.CreateDefaultContext()
    assert context.num_continuous_states() == 0
    assert context.num_abstract_states() == 0
    assert context.num_total_states() > 0


def test_default_context_rests_at_the_mean_of_the_skill(system, small_skill):
    context = system.CreateDefaultContext()
    likeliest = small_skill.components_[0].mean
    rest = small_skill.synthesize(likeliest).mean(axis=0)
    assert_allclose(system.GetOutputPort("position").Eval(context), rest)
    assert_allclose(system.GetOutputPort("velocity").Eval(context), 0, atol=1e-12)
    assert np.all(rest > small_skill.extent_[0])
    assert np.all(rest < small_skill.extent_[1])


# Against the pure playback -------------------------------------------------


@pytest.mark.parametrize("sample", [False, True])
def test_outputs_are_the_players_at_and_between_ticks(small_skill, start, sample):
    options = {"sample": sample, "seed": 5, "tracker": LqrTracker(time_constant=1)}
    system = FourierPrimitiveSystem(small_skill, **options)
    player = Player(small_skill, **options)
    simulator = simulator_at(system, start)
    context = simulator.get_context()
    first = player.start(start)
    for i in range(1, 200):
        now = i * 0.0337
        simulator.AdvanceTo(now)
        state = player.advance(first, now)
        got = outputs(system, context)
        for name, value in expected_outputs(player, state).items():
            assert_allclose(got[name], value, atol=1e-9, err_msg=name)
    assert state.remaps == 3


def test_outputs_at_an_instant_do_not_depend_on_its_events(system, start):
    # Before the events of an instant the state is a tick old: the same motion.
    simulator = simulator_at(system, start)
    for i in range(1, 45):
        simulator.AdvanceTo(i * TICK)
        before = outputs(system, simulator.get_context())
        simulator.AdvancePendingEvents()
        after = outputs(system, simulator.get_context())
        assert_allclose(after["position"], before["position"], atol=1e-9)
        assert_allclose(after["velocity"], before["velocity"], atol=1e-9)


def test_position_is_continuous_at_1_khz(system, start):
    simulator = simulator_at(system, start)
    port, context = system.GetOutputPort("position"), simulator.get_context()
    position, speed = [], []
    for i in range(4500):
        simulator.AdvanceTo(i * 1e-3)
        position.append(port.Eval(context).copy())
        speed.append(system.GetOutputPort("velocity").Eval(context).copy())
    slope = np.diff(position, axis=0) / 1e-3
    assert_allclose(slope, (np.array(speed)[1:] + speed[:-1]) / 2, atol=1e-3)


def test_player_is_that_of_the_arguments(small_skill):
    system = FourierPrimitiveSystem(small_skill, sample=True, seed=7)
    assert system.player.skill is small_skill
    assert system.player.sample
    assert system.player.seed == 7


# Events -------------------------------------------------------------------


def test_tick_and_remapping_of_one_instant_both_happen_once(system, start):
    simulator = simulator_at(system, start)
    context = simulator.get_context()
    for cycle in range(1, 6):
        simulator.AdvanceTo(cycle * REMAP)
        simulator.AdvancePendingEvents()
        state = system.playback_state(context)
        assert (state.step, state.remaps) == (3, cycle)
        simulator.AdvanceTo(cycle * REMAP + TICK)
        simulator.AdvancePendingEvents()
        assert system.playback_state(context).step == 4


def test_remapping_happens_every_t_minus_k_ticks(system, start):
    simulator = simulator_at(system, start)
    instants, last = [], 0
    for i in range(1, 121):
        simulator.AdvanceTo(i * TICK)
        simulator.AdvancePendingEvents()
        remaps = system.playback_state(simulator.get_context()).remaps
        if remaps > last:
            instants.append(i * TICK)
            last = remaps
    assert_allclose(instants, REMAP * np.arange(1, 7))


def test_mixture_remaps_every_5_and_a_half_seconds(wiping_mixture):
    system = FourierPrimitiveSystem(wiping_mixture)
    simulator = simulator_at(system, wiping_mixture.extent_.mean(axis=0))
    for time, remaps in ((5.45, 0), (5.501, 1), (10.95, 1), (11.001, 2)):
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        assert system.playback_state(simulator.get_context()).remaps == remaps


def test_phase_is_a_port_where_the_skill_has_one(wiping_mixture, wiping_skill):
    assert not FourierPrimitiveSystem(wiping_mixture).HasOutputPort("phase")
    system = FourierPrimitiveSystem(wiping_skill)
    simulator = simulator_at(system, wiping_skill.extent_.mean(axis=0))
    port, phases = system.GetOutputPort("phase"), []
    for time in np.arange(3.0, 15.0, 0.03):
        simulator.AdvanceTo(time)
        phases.append(port.Eval(simulator.get_context())[0])
    assert 0 <= min(phases) <= max(phases) < 2 * np.pi
    turns = np.unwrap(phases)[-1] - phases[0]
    expected = 2 * np.pi * 12.0 / wiping_skill.period_
    assert turns == pytest.approx(expected, rel=0.15)


def groups(context):
    """Return a copy of all discrete state."""
    values = context.get_discrete_state()
    return [values.value(i).copy() for i in range(values.num_groups())]


def test_tick_leaves_the_input_context_unchanged(system, start):
    context = simulator_at(system, start).get_mutable_context()
    context.SetTime(TICK)
    before, shown = groups(context), outputs(system, context)
    updated = system.EvalUniquePeriodicDiscreteUpdate(context)
    assert not np.array_equal(updated.value(0), before[0])
    for one, two in zip(groups(context), before, strict=True):
        assert np.array_equal(one, two)
    assert_same_outputs(outputs(system, context), shown)


def test_remapping_leaves_the_input_context_unchanged(system, start):
    simulator = simulator_at(system, start)
    simulator.AdvanceTo(REMAP)
    context, other = simulator.get_context(), simulator.get_context().Clone()
    before, shown = groups(context), outputs(system, context)
    updated = system.EvalUniquePeriodicDiscreteUpdate(context)
    other.get_mutable_discrete_state().SetFrom(updated)
    assert system.playback_state(other).remaps == 1
    assert not np.array_equal(groups(other)[0], before[0])
    for one, two in zip(groups(context), before, strict=True):
        assert np.array_equal(one, two)
    assert_same_outputs(outputs(system, context), shown)


@pytest.mark.parametrize("rate", [7.0, 30.0, 60.0])
def test_ticks_of_any_rate_meet_their_remappings_for_long(small_skill, rate):
    # The instants of the two periodic events may differ in the last digit.
    skill = copy.copy(small_skill).set_params(rate=rate)
    system = FourierPrimitiveSystem(skill)
    simulator = simulator_at(system, skill.extent_.mean(axis=0))
    simulator.AdvanceTo((200 * 20 + 7.5) / rate)
    state = system.playback_state(simulator.get_context())
    assert (state.step, state.remaps) == (10, 200)


def test_state_is_not_read_from_the_context_of_the_diagram(small_skill, start):
    builder = DiagramBuilder()
    for i in range(2):
        primitive = FourierPrimitiveSystem(small_skill)
        builder.AddNamedSystem(f"primitive_{i}", primitive)
        source = builder.AddSystem(ConstantVectorSource(start))
        builder.Connect(source.get_output_port(), primitive.get_input_port(0))
    context = builder.Build().CreateDefaultContext()
    # It would be that of the first primitive.
    with pytest.raises(RuntimeError, match="Context"):
        primitive.playback_state(context)
    assert primitive.playback_state(primitive.GetMyContextFromRoot(context)).remaps == 0


def test_other_weights_are_played_by_a_running_system(system, small_skill, start):
    simulator = simulator_at(system, start)
    simulator.AdvanceTo(0.63)
    context = simulator.get_mutable_context()
    moved = small_skill.extent_.mean(axis=0) + np.array([0.01, 0.0])
    keypoint = Keypoint(step=12, values=moved)
    target = small_skill.map_keypoints([keypoint]).weights
    motion = system.GetOutputPort("motion").Eval(context).copy()
    state = system.player.retarget(system.playback_state(context), target)
    system.set_playback_state(context, state)
    changed = system.GetOutputPort("motion").Eval(context)
    assert_allclose(changed[:4], motion[:4], atol=1e-12)  # Position and velocity.
    simulator.AdvanceTo(1.9)
    assert np.array_equal(system.playback_state(context).target, target)
    expected = system.player.motion(system.player.advance(state, 1.9 - 0.63))
    found = system.GetOutputPort("motion").Eval(context)
    assert_allclose(found, expected.ravel(), atol=1e-9)


def test_simulation_begins_with_a_playback_that_was_stored(system, start):
    player = system.player
    stored = player.advance(player.start(start), 5.55)
    context = context_at(system, start + 0.03, time=2.0)
    system.set_playback_state(context, stored)
    simulator = Simulator(system, context)
    for time in (2.0, 2.07, 4.33):
        simulator.AdvanceTo(time)
        expected = player.motion(player.advance(stored, time - 2.0))
        found = system.GetOutputPort("motion").Eval(context)
        assert_allclose(found, expected.ravel(), atol=1e-9)


def test_playback_of_another_skill_is_not_stored(system, start, wiping_mixture):
    context = simulator_at(system, start).get_mutable_context()
    other = Player(wiping_mixture).start(wiping_mixture.extent_.mean(axis=0))
    before = groups(context)
    with pytest.raises(SystemsError, match="give a playback of the same skill"):
        system.set_playback_state(context, other)
    with pytest.raises(SkillError, match="PlaybackState"):
        system.set_playback_state(context, start)
    for one, two in zip(groups(context), before, strict=True):
        assert np.array_equal(one, two)


def test_state_taken_from_a_context_does_not_change_later(system, start):
    simulator = simulator_at(system, start)
    state = system.playback_state(simulator.get_context())
    arrays = (state.weights, state.target, state.history, state.offset)
    before = [array.copy() for array in arrays]
    simulator.AdvanceTo(1.05)
    for one, two in zip(arrays, before, strict=True):
        assert np.array_equal(one, two)


# Independence and repeatability ---------------------------------------------


def test_interleaved_contexts_are_independent(recorded, start):
    system, rows = recorded[False]
    alone = [rows[:151], record(simulator_at(system, -start), 4.5)]
    one, two = simulator_at(system, start), simulator_at(system, -start)
    rows = ([], [])
    for i in range(151):
        for simulator, out in zip((one, two), rows, strict=True):
            simulator.AdvanceTo(i * 0.03)
            values = outputs(system, simulator.get_context()).values()
            out.append(np.concatenate(list(values)))
    assert np.array_equal(rows[0], alone[0])
    assert np.array_equal(rows[1], alone[1])
    assert not np.array_equal(rows[0], rows[1])


@pytest.mark.parametrize("sample", [False, True])
def test_two_simulations_are_identical(small_skill, recorded, start, sample):
    system, first = recorded[sample]
    assert np.array_equal(record(simulator_at(system, start), 6.3), first)
    twin = FourierPrimitiveSystem(small_skill, sample=sample)
    assert np.array_equal(record(simulator_at(twin, start), 6.3), first)


@pytest.mark.parametrize("sample", [False, True])
def test_simulator_that_is_reset_runs_the_same_again(recorded, start, sample):
    system, first = recorded[sample]
    simulator = simulator_at(system, start)
    simulator.AdvanceTo(6.3)
    simulator.get_mutable_context().SetTime(0.0)
    simulator.Initialize()
    assert np.array_equal(record(simulator, 6.3), first)


def test_clone_of_a_context_shows_the_same_and_stays(system, start):
    simulator = simulator_at(system, start)
    simulator.AdvanceTo(3.02)
    clone = simulator.get_context().Clone()
    shown = outputs(system, simulator.get_context())
    simulator.AdvanceTo(4.0)
    assert_same_outputs(outputs(system, clone), shown)


ODD_INSTANTS = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.3, 20))


@pytest.mark.parametrize("tempo", [0.5, 0.9, 1.0, 1.37])
@pytest.mark.parametrize("threshold", [None, 0.02])
def test_cloned_context_continues_identically(small_skill, start, tempo, threshold):
    system = FourierPrimitiveSystem(small_skill, sample=True, push_threshold=threshold)
    context = context_at(system, start)
    system.GetInputPort("tempo").FixValue(context, tempo)
    simulator = Simulator(system, context)
    clones, expected = [], []

    def look():
        expected.append((context.get_time(), outputs(system, context), groups(context)))

    for instant in ODD_INSTANTS:
        simulator.AdvanceTo(instant)
        look()
        clones.append(context.Clone())
    simulator.AdvanceTo(np.ceil(ODD_INSTANTS[-1] / TICK) * TICK)
    clones.append(context.Clone())
    simulator.AdvancePendingEvents()
    clones.append(context.Clone())
    simulator.AdvanceTo(ODD_INSTANTS[-1] + 0.777)
    look()
    # The first one to the end, as the last ones, and all others to the next instant.
    nexts = [-1, *range(2, len(expected)), -1, -1]
    for clone, i in zip(clones, nexts, strict=True):
        end, shown, state = expected[i]
        Simulator(system, clone).AdvanceTo(end)
        assert_same_outputs(outputs(system, clone), shown)
        for one, two in zip(groups(clone), state, strict=True):
            assert np.array_equal(one, two)


def test_a_context_is_restored_after_drake_has_set_its_integrator(system, start):
    simulator = simulator_at(system, start)
    simulator.AdvanceTo(2.35)
    saved = simulator.get_context().Clone()
    simulator.AdvanceTo(5.0)
    other = Simulator(system)
    config = SimulatorConfig(integration_scheme="runge_kutta3")
    # Drake sets the time of the context that it finds to 0.
    other.get_mutable_context().SetTimeStateAndParametersFrom(saved)
    ApplySimulatorConfig(config, other)
    assert other.get_context().get_time() == 0.0
    other.get_mutable_context().SetTimeStateAndParametersFrom(saved)
    fix = system.GetInputPort("measured_position").FixValue
    fix(other.get_mutable_context(), start)
    other.AdvanceTo(5.0)
    assert_same_outputs(
        outputs(system, other.get_context()), outputs(system, simulator.get_context())
    )


def test_caching_makes_no_difference(recorded, start):
    system, cached = recorded[False]
    context = context_at(system, start)
    context.DisableCaching()
    simulator = Simulator(system, context)
    simulator.Initialize()
    assert np.array_equal(record(simulator, 4.5), cached[:151])


def test_outputs_follow_time_and_state_not_the_input(system, start):
    context = simulator_at(system, start).get_mutable_context()
    before = outputs(system, context)
    system.GetInputPort("measured_position").FixValue(context, start + 1)
    assert_same_outputs(outputs(system, context), before)
    context.SetTime(0.05)
    after = outputs(system, context)
    assert not np.array_equal(after["position"], before["position"])
    assert np.array_equal(after["component"], before["component"])


def test_outputs_follow_the_state_while_time_stands_still(system, start):
    context = simulator_at(system, start).get_mutable_context()
    other = simulator_at(system, -start).get_context()
    assert not np.array_equal(groups(context)[0], groups(other)[0])
    outputs(system, context)  # Into the cache.
    context.get_mutable_discrete_state().SetFrom(other.get_discrete_state())
    assert_same_outputs(outputs(system, context), outputs(system, other))


# Start --------------------------------------------------------------------


def test_starts_at_rest_where_the_robot_is(system, start):
    simulator = simulator_at(system, start)
    got = outputs(system, simulator.get_context())
    assert_allclose(got["position"], start, atol=1e-12)
    assert_allclose(got["velocity"], 0, atol=1e-12)


def test_input_is_read_only_at_initialisation(recorded, start):
    system, still = recorded[False]
    simulator = simulator_at(system, start)
    context = simulator.get_mutable_context()
    system.GetInputPort("measured_position").FixValue(context, start + 1)
    assert np.array_equal(record(simulator, 4.5), still[:151])


@pytest.mark.parametrize("t0", [2.0, 0.03, 1.0001, 17.77])
def test_starts_at_any_time(system, small_skill, start, t0):
    player = Player(small_skill)
    first = player.start(start)
    simulator = simulator_at(system, start, t0)
    for i in range(120):
        simulator.AdvanceTo(t0 + i * 0.0433)
        got = system.GetOutputPort("position").Eval(simulator.get_context())
        state = player.advance(first, i * 0.0433)
        assert_allclose(got, player.motion(state)[0], atol=1e-7)
    assert state.remaps == 2


@pytest.mark.parametrize("name", ["sample", "soft_start"])
@pytest.mark.parametrize("value", ["yes", 3, np.array([True, False]), np.array([True])])
def test_option_that_is_not_a_bool_is_refused(name, value, small_skill):
    with pytest.raises(SystemsError, match=rf"{name} is .*; it must be True or False"):
        FourierPrimitiveSystem(small_skill, **{name: value})


def test_start_that_is_not_finite_is_refused(system):
    words = r"fourier_primitive: the measured position is \[.* nan\]; it must be from"
    with pytest.raises(SystemsError, match=words):
        simulator_at(system, [0.0, np.nan])


@pytest.mark.parametrize("far", [1e11, -1e11, 9.0])
def test_start_far_from_the_demonstrations_is_refused(system, start, far):
    with pytest.raises(SystemsError, match="near the demonstrations"):
        simulator_at(system, [start[0], far])


def test_a_tool_in_the_air_is_near_a_movement_with_an_almost_constant_force():
    time = np.arange(0, 12, 0.05)
    waves = 0.1 * np.cos(3 * time), 0.1 * np.sin(3 * time), 0 * time
    recording = Demonstration(
        time=time,
        values=np.column_stack([*waves, 9 + 0.1 * np.sin(6 * time)]),
        channels=("x", "y", "z", "force"),
        units=("m", "m", "m", "N"),
    )
    system = FourierPrimitiveSystem(FourierMovementPrimitive().fit(recording))
    simulator_at(system, [0.1, 0.0, 0.05, 0.0])
    with pytest.raises(SystemsError, match="near the demonstrations"):
        simulator_at(system, [0.1, 0.0, 0.05, 1e4])


def test_forgotten_input_is_an_error_that_names_port_and_system(system):
    with pytest.raises(
        RuntimeError, match=r"measured_position.*fourier_primitive.*not connected"
    ):
        Simulator(system).Initialize()


# Tempo ----------------------------------------------------------------------


def played_at(system, start, tempo, until, every=0.01):
    """Return position, velocity and acceleration, (samples, 3, D), at a tempo of t."""
    context = context_at(system, start)
    port = system.GetInputPort("tempo")
    port.FixValue(context, tempo(0.0))
    simulator = Simulator(system, context)
    simulator.Initialize()
    rows = []
    for i in range(round(until / every) + 1):
        port.FixValue(context, tempo(i * every))
        simulator.AdvanceTo(i * every)
        names = ("position", "velocity", "acceleration")
        rows.append([system.GetOutputPort(n).Eval(context).copy() for n in names])
    return np.array(rows)


@pytest.mark.parametrize("tempo", [0.0, 0.5, 0.9, 1.0, 1.37, 2.0])
def test_tempo_is_that_of_the_player(small_skill, start, tempo):
    system = FourierPrimitiveSystem(small_skill)
    played = played_at(system, start, lambda _: tempo, 4.2)
    player = Player(small_skill)
    first = player.start(start, tempo=tempo)
    # From seconds before, and not from the start each time.
    states = [first]
    for i in range(1, len(played)):
        passed = i % 100 or 100
        states.append(player.advance(states[i - passed], 0.01 * passed))
    expected = np.array([player.motion(state) for state in states])
    assert_allclose(played[:, :2], expected[:, :2], atol=1e-6)


def test_soft_start_follows_the_demonstrated_path_from_rest():
    t = np.arange(1200) / 20
    circles = np.stack([np.cos(2 * t), np.sin(2 * t)], axis=1)
    windows = np.stack([circles[i : i + 120] for i in range(0, 1080, 5)])
    skill = FourierMovementPrimitive(n_components=16).fit(windows)
    off, speed = {}, {}
    for soft in (False, True):
        system = FourierPrimitiveSystem(skill, soft_start=soft)
        motion = played_at(system, np.array([1.0, 0.0]), lambda _: 1.0, 1.5)
        off[soft] = np.abs(np.hypot(*motion[:, 0].T) - 1).max()
        speed[soft] = np.hypot(*motion[:, 1].T)
    assert off[True] < 0.05
    assert off[False] > 0.15
    assert speed[True][0] < 1e-9
    assert_allclose(speed[True][50:], 2.0, atol=0.1)


def test_changing_tempo_makes_no_jump_of_position_and_velocity(system, start):
    motion = played_at(system, start, lambda t: 1 + np.sin(0.9 * t), 8, every=0.002)
    velocity = np.diff(motion[:, 0], axis=0) / 0.002
    assert_allclose(velocity, (motion[1:, 1] + motion[:-1, 1]) / 2, atol=2e-4)
    acceleration = np.diff(motion[:, 1], axis=0) / 0.002
    between = (motion[1:, 2] + motion[:-1, 2]) / 2
    assert np.median(np.abs(acceleration - between)) < 1e-3


def test_tempo_of_zero_pauses_the_movement(system, start):
    motion = played_at(system, start, lambda t: float(not 2 <= t < 5), 7)
    # The tempo comes down to 0 within a quarter of a second; offsets go on.
    still = motion[400:500]
    assert np.ptp(still[:, 0], axis=0).max() < 1e-3
    assert_allclose(still[:, 1], 0, atol=2e-3)
    assert np.ptp(motion[500:, 0], axis=0).max() > 0.01


def test_blend_is_shorter_only_while_the_tempo_is_high(system, start):
    simulator = simulator_at(system, start)
    context, found = simulator.get_mutable_context(), []
    for tempo, until in [(4.0, 2.0), (1.0, 4.0)]:
        system.GetInputPort("tempo").FixValue(context, tempo)
        simulator.AdvanceTo(until)
        found.append(system.playback_state(context).blend_time)
    assert found == pytest.approx([0.1, 0.4])


@pytest.mark.parametrize("tempo", [-0.1, 4.5, np.nan])
def test_tempo_that_cannot_be_is_refused(system, start, tempo):
    context = context_at(system, start)
    system.GetInputPort("tempo").FixValue(context, tempo)
    with pytest.raises(SystemsError, match=r"tempo is .* at least 0 and at most 4"):
        Simulator(system, context).Initialize()


# Samples or means -------------------------------------------------------------


def test_port_chooses_between_samples_and_means(small_skill, start):
    def run(value, sample):
        system = FourierPrimitiveSystem(small_skill, sample=sample, seed=3)
        context = context_at(system, start)
        if value is not None:
            system.GetInputPort("sample").FixValue(context, value)
        simulator = Simulator(system, context)
        simulator.Initialize()
        return record(simulator, 6.5)

    # The start tracks what the parameter says, later re-mappings what the port says.
    assert np.array_equal(run(1.0, True), run(None, True))
    means = run(None, False)
    assert np.array_equal(run(0.0, False), means)
    assert not np.array_equal(run(1.0, False), means)


def test_port_that_is_neither_samples_nor_means_is_refused(system, start):
    context = context_at(system, start)
    system.GetInputPort("sample").FixValue(context, np.nan)
    with pytest.raises(SystemsError, match=r"the sample is nan; it must be a finite"):
        Simulator(system, context).Initialize()


# Plan -------------------------------------------------------------------------


@pytest.mark.parametrize("sample", [False, True])
def test_plan_equals_the_later_motion(small_skill, start, sample):
    system = FourierPrimitiveSystem(small_skill, sample=sample, plan_seconds=2.5)
    simulator = simulator_at(system, start)
    context = simulator.get_context()
    simulator.AdvanceTo(0.71)
    plan = system.GetOutputPort("plan").Eval(context).reshape(-1, 2).copy()
    tubes = system.GetOutputPort("plan_covariance").Eval(context).reshape(-1, 4).copy()
    assert plan.shape == (26, 2)
    for i in range(1, 26):
        simulator.AdvanceTo(0.7 + i * TICK + 1e-9)
        got = system.GetOutputPort("position").Eval(context)
        assert_allclose(got, plan[i], atol=1e-6)
        covariance = system.GetOutputPort("covariance").Eval(context)
        errors = (tubes[i] - covariance).reshape(2, 2)
        assert np.all(np.linalg.eigvalsh(errors) > -1e-9)


# The reactive mode ---------------------------------------------------------------


@pytest.fixture
def reactive(small_skill):
    return FourierPrimitiveSystem(small_skill, push_threshold=0.02, push_dwell=0.3)


def pushed(system, start, offset, until, *, begin=1.0, end=1.0, every=0.02):
    """Play while the robot is an offset (D,) off its path from begin to end."""
    simulator = simulator_at(system, start)
    context = simulator.get_mutable_context()
    rows = []
    for i in range(round(until / every) + 1):
        now = i * every
        simulator.AdvanceTo(now)
        desired = system.GetOutputPort("position").Eval(context).copy()
        off = np.asarray(offset) if begin <= now < end else np.zeros(2)
        system.GetInputPort("measured_position").FixValue(context, desired + off)
        rows.append([*desired, *system.GetOutputPort("remaps").Eval(context)])
    return np.array(rows)


def test_robot_on_its_path_is_played_as_without_the_reactive_mode(
    system, reactive, start
):
    calm = pushed(reactive, start, [0.003, 0.002], 4.5, end=9, every=0.005)
    assert np.array_equal(calm, pushed(system, start, [0, 0], 4.5, every=0.005))


def test_movement_waits_for_a_short_push_and_then_continues(system, reactive, start):
    short = pushed(reactive, start, [0.1, 0], 2.9, end=1.25)
    assert short[-1, 3] == 0
    free = pushed(system, start, [0, 0], 2.9)
    # Where it is now, it was before without the push.
    late = np.linalg.norm(free[:, :2] - short[-1, :2], axis=1)
    assert late[:-5].min() < 0.005
    assert 0.1 < 0.02 * (len(late) - 1 - np.argmin(late)) < 0.4


def test_push_is_mapped_after_the_dwell_and_again_while_it_lasts(reactive, start):
    rows = pushed(reactive, start, [0.05, 0.0], 3.5, end=2.15)
    instants = 0.02 * (np.flatnonzero(np.diff(rows[:, 3])) + 1)
    assert len(instants) == 3
    # At the ticks at which the push was seen for 0.3 s; the dwell then counts anew.
    assert_allclose(instants, [1.3, 1.7, 2.1], atol=0.11)


def test_reactive_remapping_makes_the_desired_motion_no_jump(reactive, start):
    rows = pushed(reactive, start, [0.05, -0.03], 5, end=2.5, every=0.004)
    assert rows[-1, 3] > 2
    step = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)
    again = np.flatnonzero(np.diff(rows[:, 3]))
    assert step[again].max() < 2 * np.median(step)
    assert np.abs(np.diff(rows[:, :2], n=2, axis=0)).max() < 2e-4


def test_reactive_remapping_continues_from_the_pushed_robot(reactive, small_skill):
    # Held near one end of the demonstrated range, the movement comes there.
    low, high = small_skill.extent_
    simulator = simulator_at(reactive, (low + high) / 2)
    context = simulator.get_mutable_context()
    held = high - 0.1 * (high - low)
    away = []
    for i in range(1, 200):
        reactive.GetInputPort("measured_position").FixValue(context, held)
        simulator.AdvanceTo(0.1 * i)
        desired = reactive.GetOutputPort("position").Eval(context)
        away.append(np.linalg.norm(desired - held))
    system = FourierPrimitiveSystem(small_skill)
    simulator, unled = simulator_at(system, (low + high) / 2), []
    for i in range(667):
        simulator.AdvanceTo(0.03 * i)
        desired = system.GetOutputPort("position").Eval(simulator.get_context())
        unled.append(np.linalg.norm(desired - held))
    assert np.mean(away[20:]) < 0.5 * np.mean(unled[60:])


def with_hole(system, start, value, length, *, begin=1.0, until=4.0):
    """Play while the measurement is wrong from begin on for a length, s."""
    simulator = simulator_at(system, start)
    context = simulator.get_mutable_context()
    rows = []
    for i in range(round(until / 0.02) + 1):
        now = 0.02 * i
        simulator.AdvanceTo(now)
        position, age = (
            system.GetOutputPort(name).Eval(context).copy()
            for name in ("position", "measurement_age")
        )
        is_hole = begin <= now < begin + length
        measured = [value, 0.0] if is_hole else position
        system.GetInputPort("measured_position").FixValue(context, measured)
        rows.append(np.r_[now, position, age])
    return np.array(rows), outputs(system, context)["remaps"]


@pytest.fixture(scope="module")
def tolerant(small_skill, start):
    """A system whose threshold the movement itself does not reach in a hole, and its run."""
    system = FourierPrimitiveSystem(small_skill, push_threshold=1.0)
    return system, with_hole(system, start, np.nan, 0.0)[0]


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e11, -1e11])
@pytest.mark.parametrize("length", [0.15, 1.5])
def test_short_gap_of_the_measurement_is_bridged_and_a_long_one_stops_the_movement(
    tolerant, start, value, length
):
    system, free = tolerant
    rows, remaps = with_hole(system, start, value, length)
    assert np.all(np.isfinite(rows))
    assert remaps[1] == 0
    time, path, age = rows[:, 0], rows[:, 1:3], rows[:, 3]
    in_hole = (time > 1.11) & (time < 1.0 + length)
    assert_allclose(age[in_hole], time[in_hole] - 1.0, atol=0.11)
    assert not np.any(age[(time < 1.0) | (time > 1.11 + length)])
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if length < 0.5:
        assert_allclose(path, free[:, 1:3], atol=1e-12)
        return
    assert_allclose(path[time < 1.5], free[time < 1.5, 1:3], atol=1e-12)
    assert step[(time[1:] > 2.0) & (time[1:] < 2.5)].max() < 1e-3
    # It goes on afterwards, without a jump.
    assert step[time[1:] > 3.0].max() > 1e-3
    assert (
        step.max() < 1.5 * np.linalg.norm(np.diff(free[:, 1:3], axis=0), axis=1).max()
    )


def test_seconds_and_threshold_must_be_positive(small_skill):
    for name in ("push_threshold", "push_dwell", "plan_seconds"):
        for value in (0.0, -1.0, np.nan):
            with pytest.raises(SystemsError, match=f"{name} is .* must be positive"):
                FourierPrimitiveSystem(small_skill, **{name: value})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"plan_seconds": 1e9}, r"plan_seconds is 1000000000\.0 s; .* at most 600"),
        ({"choice": 3}, r"choice is 3; its type must be CoverageChoice"),
    ],
)
def test_an_option_that_cannot_be_used_is_named(small_skill, options, words):
    with pytest.raises(SystemsError, match=words):
        FourierPrimitiveSystem(small_skill, **options)


# In a diagram ---------------------------------------------------------------


def test_plays_in_a_diagram_with_its_output_fed_back(small_skill, start):
    # No feedthrough: measuring its own output is no algebraic loop.
    builder = DiagramBuilder()
    system = builder.AddSystem(FourierPrimitiveSystem(small_skill))
    builder.Connect(
        system.GetOutputPort("position"), system.GetInputPort("measured_position")
    )
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(4.5)
    context = system.GetMyContextFromRoot(simulator.get_context())
    assert system.playback_state(context).remaps == 2

    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(start))
    system = builder.AddSystem(FourierPrimitiveSystem(small_skill))
    builder.Connect(source.get_output_port(), system.GetInputPort("measured_position"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(4.5)
    context = system.GetMyContextFromRoot(simulator.get_context())
    alone = simulator_at(FourierPrimitiveSystem(small_skill), start)
    alone.AdvanceTo(4.5)
    assert_same_outputs(
        outputs(system, context), outputs(alone.get_system(), alone.get_context())
    )


@pytest.mark.parametrize("begin", [-3.3, 0.0, 100.02])
def test_motion_does_not_depend_on_when_a_simulation_begins(small_skill, start, begin):
    system = FourierPrimitiveSystem(small_skill)
    context = system.CreateDefaultContext()
    context.SetTime(begin)
    system.GetInputPort("measured_position").FixValue(context, start)
    simulator = Simulator(system, context)
    simulator.Initialize()
    simulator.AdvanceTo(begin + 4.0)
    player = Player(small_skill)
    expected = player.motion(player.advance(player.start(start), 4.0))
    for order, name in enumerate(("position", "velocity")):
        found = system.GetOutputPort(name).Eval(context)
        assert_allclose(found, expected[order], atol=1e-9)


def test_soft_start_takes_the_same_time_whenever_a_simulation_begins(small_skill):
    moved = []
    for begin in (0.0, 5.0, 0.3, 0.7):  # Multiples of the tick, some of them rounded.
        system = FourierPrimitiveSystem(small_skill, soft_start=True)
        simulator = simulator_at(system, small_skill.extent_[0], begin)
        simulator.AdvanceTo(begin + 0.55)
        position = system.GetOutputPort("position").Eval(simulator.get_context())
        moved.append(position - small_skill.extent_[0])
    assert np.linalg.norm(moved[0]) > 1e-4
    assert_allclose(moved[1:], [moved[0]] * 3, atol=1e-9)


def test_motion_long_after_the_last_event_is_that_of_the_playback(small_skill, start):
    system = FourierPrimitiveSystem(small_skill)
    context = system.CreateDefaultContext()
    system.GetInputPort("measured_position").FixValue(context, start)
    simulator = Simulator(system, context)
    simulator.AdvanceTo(1.05)
    context.SetTime(4.0)
    expected = Player(small_skill).motion(system.playback_state(context))[0]
    assert_allclose(system.GetOutputPort("position").Eval(context), expected)
