"""Facts about the skill as a system that chooses the sample that wipes most."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Player
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink.grid import CoverageChoice, InkGrid

TICK = 0.05
REMAP = 1.75  # (T - K) / rate
GRID = InkGrid(size=(0.5, 0.7), cell=0.01)
CHOICE = CoverageChoice(grid=GRID, footprint=(0.12, 0.05), candidates=8)
OUTPUTS = ("position", "velocity", "acceleration", "weights", "component", "remaps")


@pytest.fixture(scope="module")
def skill(wiping_demonstration):
    """A skill of three channels, T = 40, K = 5, 20 Hz: re-mapped every 1.75 s."""
    return FourierMovementPrimitive(n_steps=40, overlap=5, n_components=4).fit(
        [wiping_demonstration]
    )


@pytest.fixture
def system(skill):
    return make_system(skill)


def make_system(skill, **options):
    options = {"sample": True, "seed": 3, "choice": CHOICE, "margin": None} | options
    return FourierPrimitiveSystem(skill, **options)


def left_half():
    """Return ink on the board's half of negative y."""
    ink = GRID.full()
    ink[GRID.shape[0] // 2 :] = 0.0
    return ink


def start_of(system):
    return system.player.skill.extent_.mean(axis=0)


def simulator_of(system, *, ink=None, **inputs):
    """Return an initialised simulator, its inputs fixed."""
    context = system.CreateDefaultContext()
    inputs = {"measured_position": start_of(system)} | inputs
    if ink is not None:
        inputs["ink"] = ink.ravel()
    for name, value in inputs.items():
        system.GetInputPort(name).FixValue(context, value)
    simulator = Simulator(system, context)
    simulator.Initialize()
    return simulator


def at_remap(simulator, number=1):
    """Go on to a re-mapping, and return the state after it."""
    simulator.AdvanceTo(number * REMAP + 1e-9)
    return simulator.get_system().playback_state(simulator.get_context())


def at_start(simulator):
    return simulator.get_system().playback_state(simulator.get_context())


def shown(simulator, names=OUTPUTS):
    system, context = simulator.get_system(), simulator.get_context()
    return np.concatenate([system.GetOutputPort(n).Eval(context) for n in names])


def record(simulator, until=4.0, every=0.03):
    rows = []
    for i in range(round(until / every) + 1):
        simulator.AdvanceTo(i * every)
        rows.append(shown(simulator))
    return np.array(rows)


def candidates(system, state):
    """Return the targets to choose from, and the positions that each leads to."""
    player = system.player
    gaussian = player.skill.components_[state.component]
    rng = np.random.default_rng([state.seed, state.remaps])
    targets = gaussian.sample(rng, CHOICE.candidates, with_noise=False)
    ticks = player.skill.n_steps - 1 - state.step
    played = [player.plan(player.retarget(state, t), ticks)[0][1:] for t in targets]
    return targets, np.array(played)


def best_target(system, state, ink):
    """Return which candidate wipes most, and its weights."""
    targets, paths = candidates(system, state)
    best = int(np.argmax(CHOICE.wiped(ink, paths)))
    return best, targets[best]


def test_port_for_the_ink_is_there_with_a_choice_only(system, skill):
    assert system.num_input_ports() == 4
    assert system.GetInputPort("ink").size() == GRID.num_cells
    assert not make_system(skill, choice=None).HasInputPort("ink")


def test_no_output_feeds_the_ink_through(system):
    port = system.GetInputPort("ink").get_index()
    for output in range(system.num_output_ports()):
        assert not system.HasDirectFeedthrough(port, output)


def test_start_and_every_remapping_track_the_candidate_that_wipes_most(system):
    ink = left_half()
    simulator = simulator_of(system, ink=ink)
    state = at_start(simulator)
    best, target = best_target(system, state, ink)
    assert_allclose(state.target, target, atol=1e-12)
    chosen = [best]
    for number in range(1, 7):
        # Another half of the board each time.
        ink = left_half()[:: (-1) ** number]
        system.GetInputPort("ink").FixValue(
            simulator.get_mutable_context(), ink.ravel()
        )
        state = at_remap(simulator, number)
        assert state.remaps == number
        best, target = best_target(system, state, ink)
        assert_allclose(state.target, target, atol=1e-12)
        chosen.append(best)
    assert len(set(chosen)) > 2


@pytest.mark.parametrize("number", [2, 5])
def test_choice_follows_the_remaining_ink(system, number):
    state = at_start(simulator_of(system, ink=GRID.full()))
    targets, paths = candidates(system, state)
    inner = tuple(np.array(CHOICE.footprint) - 2 * CHOICE.margin)
    ink = GRID.swept_area(paths[number], inner, height=CHOICE.height).astype(float)
    state = at_start(simulator_of(system, ink=ink))
    assert_allclose(state.target, targets[number], atol=1e-12)


def test_another_sample_is_tracked_than_without_a_choice(system, skill):
    one = at_start(simulator_of(system, ink=left_half()))
    two = at_start(simulator_of(make_system(skill, choice=None)))
    assert one.component == two.component
    assert not np.allclose(one.target, two.target)


@pytest.mark.parametrize("tempo", [1.0, 0.9, 1.7])
def test_choice_makes_no_jump_of_position_and_velocity(system, tempo):
    simulator = simulator_of(system, ink=left_half(), tempo=tempo)
    remaps = []
    for i in range(1, 150):
        # AdvanceTo stops before the events of its last instant.
        simulator.AdvanceTo(i * TICK)
        before = shown(simulator, ("position", "velocity"))
        simulator.AdvancePendingEvents()
        assert_allclose(shown(simulator, ("position", "velocity")), before, atol=1e-9)
        remaps.append(shown(simulator, ("remaps",))[0])
    assert remaps[-1] == round(150 * TICK * tempo / REMAP - 0.5)


def test_plan_leads_along_the_choice(system):
    simulator = simulator_of(system, ink=left_half())
    at_remap(simulator)
    plan = shown(simulator, ("plan",)).reshape(-1, 3)
    for i in range(1, 30):
        simulator.AdvanceTo(REMAP + i * TICK)
        assert_allclose(shown(simulator, ("position",)), plan[i], atol=1e-6)


def test_means_are_not_affected_and_need_no_ink(skill):
    with_choice = record(simulator_of(make_system(skill, sample=False)))
    without = make_system(skill, sample=False, choice=None)
    assert_array_equal(with_choice, record(simulator_of(without)))


def test_port_for_samples_switches_the_choice_off(system, skill):
    off = record(simulator_of(system, sample=0.0))
    without = make_system(skill, choice=None)
    assert_array_equal(off, record(simulator_of(without, sample=0.0)))
    on = record(simulator_of(system, ink=left_half(), sample=1.0))
    assert_array_equal(on, record(simulator_of(system, ink=left_half())))
    assert not np.array_equal(on, off)


def test_remapping_of_a_pushed_robot_chooses_a_sample_too(skill):
    system = make_system(skill, push_threshold=0.02, push_dwell=0.2)
    pushed = start_of(system) + np.array([0.05, 0.0, 0.0])
    simulator = simulator_of(system, ink=left_half(), measured_position=pushed)
    simulator.AdvanceTo(1.0)
    state = system.playback_state(simulator.get_context())
    assert shown(simulator, ("remaps",))[1] >= 1
    best = best_target(system, state, left_half())[1]
    assert_allclose(state.target, best, atol=1e-12)


def test_two_runs_are_identical(system, skill):
    first = record(simulator_of(system, ink=left_half()))
    assert_array_equal(record(simulator_of(system, ink=left_half())), first)
    twin = make_system(skill)
    assert_array_equal(record(simulator_of(twin, ink=left_half())), first)
    other = make_system(skill, seed=4)
    assert not np.array_equal(record(simulator_of(other, ink=left_half())), first)


def test_interleaved_contexts_are_independent(system):
    inks = (left_half(), left_half()[::-1])
    alone = [record(simulator_of(system, ink=ink)) for ink in inks]
    pair = [simulator_of(system, ink=ink) for ink in inks]
    rows = ([], [])
    for i in range(len(alone[0])):
        for simulator, out in zip(pair, rows, strict=True):
            simulator.AdvanceTo(i * 0.03)
            out.append(shown(simulator))
    assert_array_equal(rows[0], alone[0])
    assert_array_equal(rows[1], alone[1])
    assert not np.array_equal(rows[0], rows[1])


def test_caching_makes_no_difference(system):
    cached = record(simulator_of(system, ink=left_half()))
    simulator = simulator_of(system, ink=left_half())
    simulator.get_mutable_context().DisableCaching()
    assert_array_equal(record(simulator), cached)


def test_remapping_leaves_the_input_context_unchanged(system):
    simulator = simulator_of(system, ink=left_half())
    simulator.AdvanceTo(REMAP)
    context, other = simulator.get_context(), simulator.get_context().Clone()
    values = context.get_discrete_state()
    before = [values.value(i).copy() for i in range(values.num_groups())]
    updated = system.EvalUniquePeriodicDiscreteUpdate(context)
    other.get_mutable_discrete_state().SetFrom(updated)
    assert system.playback_state(other).remaps == 1
    for i, value in enumerate(before):
        assert_array_equal(values.value(i), value)


def test_forgotten_ink_is_an_error_that_names_port_and_system(system):
    with pytest.raises(RuntimeError, match=r"ink.*fourier_primitive.*not connected"):
        simulator_of(system)


def test_choice_does_not_lift_the_tool_farther_than_demonstrated():
    time = np.arange(1200) * TICK
    rng = np.random.default_rng(0)
    width, height = rng.normal([0.1, 0.03], [0.01, 0.005], (20, 2))[
        np.arange(1200) // 60
    ].T
    phase = 2 * np.pi * time / 3
    loops = [
        width * np.cos(phase),
        width * np.sin(phase),
        height * np.sin(phase / 2) ** 2,
    ]
    skill = FourierMovementPrimitive(model="phase").fit(
        Demonstration(time=time, values=np.column_stack(loops))
    )
    player = Player(skill, sample=True, margin=0.1)
    state = player.start(skill.extent_.mean(axis=0))
    ink = GRID.full()
    past = skill.synthesize(state.weights)[: skill.overlap]
    expected = skill.synthesize(skill.expected(state.component, past))
    chosen, drawn = (
        np.array(
            [
                skill.synthesize(tracked(replace(state, seed=seed)).target) - expected
                for seed in range(30)
            ]
        ).std(axis=(0, 1))
        for tracked in (
            lambda state: CHOICE.tracked(player, state, ink),
            player.track_sample,
        )
    )
    assert np.all(chosen[:2] > 1.5 * drawn[:2])
    assert chosen[2] < 1.3 * drawn[2]
