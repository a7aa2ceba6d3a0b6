"""Facts about running a simulation with the page's buttons, without a browser."""

import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from fmp_drake.runs.simulation_loop import RunButtons, advance, reset


class Walk(LeafSystem):
    """A random walk of its own seed, which calls someone at given times."""

    def __init__(self, calls=None, *, first=0.05):
        super().__init__()
        self._calls = calls or {}
        self._state = self.DeclareDiscreteState(np.array([0.0, 3.0]))
        self.DeclareStateOutputPort("walk", self._state)
        self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.1, self._step)
        self.DeclarePeriodicPublishEvent(0.1, first, self._call)

    def _step(self, context, values):
        x, seed = context.get_discrete_state(0).value()
        seed = (16807 * seed) % 2147483647
        values.set_value(0, np.array([x + seed / 2147483647 - 0.5, seed]))

    def _call(self, context):
        self._calls.pop(round(context.get_time(), 3), lambda: None)()


class Clicks:
    """In place of a Meshcat's buttons."""

    def __init__(self):
        self.clicks = {}
        self.added, self.asked = [], 0
        # What happens at the nth question about a pause.
        self.at = {}

    def AddButton(self, name, keycode):
        self.added.append((name, keycode))
        self.clicks[name] = 0

    def DeleteButton(self, name, strict):
        assert not strict
        del self.clicks[name]

    def GetButtonClicks(self, name):
        if name == RunButtons.PAUSE:
            self.asked += 1
            self.at.pop(self.asked, lambda: None)()
        return self.clicks[name]

    def click(self, name):
        self.clicks[name] += 1


def run(*arguments, **options):
    """Advance to the end; return the times of the stretches."""
    return list(advance(*arguments, **options))


def make(calls=None, *, nested=False):
    builder = DiagramBuilder()
    walk = builder.AddSystem(Walk(calls))
    log = LogVectorOutput(walk.get_output_port(), builder, 0.1)
    diagram: Diagram = builder.Build()
    if nested:
        outer = DiagramBuilder()
        outer.AddSystem(diagram)
        diagram = outer.Build()
    return Simulator(diagram), log


def walked(simulator, log):
    log = log.FindLog(simulator.get_context())
    return log.sample_times().copy(), log.data().copy()


@pytest.fixture
def clicks():
    return Clicks()


@pytest.mark.parametrize("nested", [False, True])
def test_a_reset_run_is_identical_to_the_first(nested):
    simulator, log = make(nested=nested)
    runs = []
    for _ in range(2):
        run(simulator, 2.0)
        runs.append(walked(simulator, log))
        reset(simulator)
        assert simulator.get_context().get_time() == 0.0
    assert len(runs[0][0]) == 21
    for one, two in zip(*runs, strict=True):
        assert_array_equal(one, two)


def test_a_click_on_reset_begins_again(clicks):
    calls = {0.95: lambda: clicks.click(RunButtons.RESET)}
    simulator, log = make(calls)
    resets = []
    run(
        simulator,
        2.0,
        meshcat=clicks,
        on_reset=lambda: resets.append(simulator.get_context().get_time()),
    )
    assert resets == [0.0]
    uninterrupted, other = make()
    run(uninterrupted, 2.0)
    expected = walked(uninterrupted, other)
    for one, two in zip(walked(simulator, log), expected, strict=True):
        assert_array_equal(one, two)


def test_pause_stops_the_simulation_and_a_reset_returns_to_the_start(clicks):
    calls = {0.55: lambda: clicks.click(RunButtons.PAUSE)}
    simulator, _ = make(calls)
    times = []
    # Questions 1 to 6 come before the six stretches up to 0.6 s.
    for question in (8, 9, 14):
        clicks.at[question] = lambda: times.append(simulator.get_context().get_time())
    clicks.at[10] = lambda: clicks.click(RunButtons.RESET)
    clicks.at[15] = lambda: clicks.click(RunButtons.PAUSE)
    yielded = list(advance(simulator, 1.0, meshcat=clicks))
    assert times == pytest.approx([0.6, 0.6, 0.0])
    # The caller can end a pause.
    assert yielded.count(pytest.approx(0.6)) > 2
    assert simulator.get_context().get_time() == 1.0


def test_a_run_does_not_catch_up_after_a_pause(clicks):
    calls = {0.05: lambda: clicks.click(RunButtons.PAUSE)}
    simulator, _ = make(calls)
    simulator.set_target_realtime_rate(1.0)
    # 25 looks at the buttons, 20 ms apart.
    clicks.at[27] = lambda: clicks.click(RunButtons.PAUSE)
    start = time.monotonic()
    run(simulator, 0.5, meshcat=clicks)
    # 0.1 s, a pause of 0.5 s, and 0.4 s.
    assert time.monotonic() - start > 0.9


def test_a_run_does_not_catch_up_after_a_compilation():
    simulator, _ = make({0.05: lambda: time.sleep(1.0)})
    simulator.set_target_realtime_rate(1.0)
    start = time.monotonic()
    run(simulator, 0.5)
    # 1.0 s, and 0.4 s.
    assert time.monotonic() - start > 1.3


def test_a_run_does_not_catch_up_after_a_compilation_at_its_first_instant(clicks):
    """As where the first outputs compile: before the clock of the loop has begun."""
    simulator = Simulator(Walk({0.0: lambda: time.sleep(0.5)}, first=0.0))
    simulator.set_target_realtime_rate(1.0)
    times = advance(simulator, 0.6, meshcat=clicks)
    next(times)
    begin = time.monotonic()
    assert list(times)[-1] == pytest.approx(0.6)
    # It would take hardly any time otherwise.
    assert time.monotonic() - begin > 0.4


def test_the_buttons_are_there_while_the_run_is(clicks):
    simulator, _ = make()
    run(simulator, 0.5, meshcat=clicks)
    assert clicks.added == [
        (RunButtons.PAUSE, "KeyP"),
        (RunButtons.RESET, "KeyR"),
        (RunButtons.STOP, ""),
    ]
    assert clicks.clicks == {}


def test_the_buttons_go_when_the_run_fails():
    def fail():
        raise ValueError("it fell")

    meshcat = Meshcat()
    names = []
    simulator, _ = make(
        {0.05: lambda: names.extend(meshcat.GetButtonNames()), 0.15: fail}
    )
    with pytest.raises(ValueError, match="it fell"):
        run(simulator, 1.0, meshcat=meshcat)
    assert names == [RunButtons.PAUSE, RunButtons.RESET, RunButtons.STOP]
    assert meshcat.GetButtonNames() == []
    # And they can come back.
    simulator, _ = make()
    run(simulator, 1.0, meshcat=meshcat)


def test_intervals_end_at_multiples_of_a_millisecond():
    simulator, _ = make()
    times = run(simulator, 7.05)
    assert times == [*(100 * i * 0.001 for i in range(1, 71)), 7.05]
    assert simulator.get_context().get_time() == 7.05


def test_the_function_that_advances_may_be_given():
    simulator, _ = make()
    ends = []

    def advance_to(time):
        ends.append(time)
        simulator.AdvanceTo(time)

    assert run(simulator, 0.35, advance_to=advance_to) == ends
    assert len(ends) == 4


def test_run_continues_while_a_function_returns_true():
    simulator, _ = make()
    answers = iter([True, True, False])
    times = run(simulator, 0.25, keep_running=lambda: next(answers))
    assert times == pytest.approx([0.1, 0.2, 0.25, 0.3, 0.4])


def test_stop_button_ends_a_run():
    clicks = Clicks()
    clicks.at[3] = lambda: clicks.click(RunButtons.STOP)
    simulator, _ = make()
    times = run(simulator, 1.0, meshcat=clicks)
    assert times == pytest.approx([0.1, 0.2, 0.3])
    assert clicks.clicks == {}
