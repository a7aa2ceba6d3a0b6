"""Facts about the four laws of the diagram, for the whole station.

Observing changes nothing; the state is the state; one datum has one owner; the law of
the arm is computed at every control period.
"""

import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, LeafSystem

from fmp_drake.film import FilmReel
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    load_skill,
    save_skill,
)
from fmp_drake.runs import MakeRun, load_context, save_context
from fmp_drake.runs.log import SIGNALS
from fmp_drake.station import (
    LoadScenario,
    MakeStation,
    MakeWipingStation,
    models_dir,
)
from fmp_drake.systems.page.page_panel import PagePanel

pytestmark = pytest.mark.slow

PARTS = ("plant", "fourier_primitive", "controller", "ink_board")
# No multiples of anything.
ODD_INSTANTS = 0.3 + np.cumsum(np.random.default_rng(1).uniform(0.01, 0.09, 20))


@pytest.fixture(scope="module")
def panel():
    return PagePanel(Meshcat())


@pytest.fixture(scope="module")
def skills(restless_skill):
    """A skill for each scenario, re-mapped every 0.75 s."""
    shown = Demonstration.load(models_dir() / "demonstrations" / "stirring.npz")
    stirring = FourierMovementPrimitive(n_steps=20, overlap=5, n_components=4)
    on_board = dict.fromkeys(("table_top", "pushed"), restless_skill)
    return {**on_board, "stir": stirring.fit(shown)}


def scenario_at(tempo, name="table_top"):
    """Return a scenario at a tempo; in `pushed` a person pushes soon."""
    scenario = LoadScenario(name)
    scenario.skill.tempo = tempo
    scenario.skill.candidates = 4
    if name == "pushed":
        scenario.skill.push_threshold = 0.02
        scenario.disturbances = [
            replace(each, start=0.3, duration=0.6, every=0.0)
            for each in scenario.disturbances[:1]
        ]
    return scenario


def state_of(station, context):
    """Return the discrete state of the parts that decide, name by name."""
    results = {}
    for name in PARTS:
        if not station.HasSubsystemNamed(name):
            continue  # There is no ink in free space.
        system = station.GetSubsystemByName(name)
        values = system.GetMyContextFromRoot(context).get_discrete_state()
        for i in range(values.num_groups()):
            results[f"{name}[{i}]"] = values.value(i).copy()
    return results


def assert_same(one, two):
    assert one.keys() == two.keys()
    for name, value in one.items():
        assert_array_equal(value, two[name], err_msg=name)


def look_at_everything(station, context):
    """Evaluate all output ports of all systems."""
    for system in [station, *station.GetSystems()]:
        own = system.GetMyContextFromRoot(context)
        for i in range(system.num_output_ports()):
            if system.get_name() not in ("scene_graph", "plant"):
                system.get_output_port(i).Eval(own)


# 1. Observing changes nothing ---------------------------------------------------------


@pytest.mark.parametrize(
    ("tempo", "name"),
    [
        *((tempo, "table_top") for tempo in (0.5, 0.9, 1.0, 1.37)),
        *((1.0, name) for name in ("pushed", "stir")),
    ],
)
def test_page_recording_log_and_film_change_nothing(skills, panel, tempo, name):
    scenario, skill = scenario_at(tempo, name), skills[name]
    end = max(0.95 / tempo, 1.2)  # Past a re-mapping, and the push.
    alone = Simulator(MakeStation(scenario, skill))
    alone.AdvanceTo(end)
    expected = state_of(alone.get_system(), alone.get_context())

    watched = MakeRun(
        scenario,
        skill,
        meshcat=panel.meshcat,
        panel=panel,
        recording=True,
        keep=SIGNALS,
    )
    reel = FilmReel(watched.station, fps=20.0, speed=1.0)
    watched.simulator.set_monitor(reel.observe)
    for instant in ODD_INSTANTS[:5]:
        watched.advance_to(instant)
        look_at_everything(watched.station, watched.simulator.get_context())
    watched.advance_to(end)
    assert_same(state_of(watched.station, watched.simulator.get_context()), expected)


# 2. The state is the state ------------------------------------------------------------


@pytest.mark.parametrize("name", ["table_top", "pushed", "stir"])
def test_station_continues_identically_from_a_clone(skills, name):
    station = MakeStation(scenario_at(0.9, name), skills[name])
    simulator = Simulator(station)
    context = simulator.get_context()
    clones, expected = [], []
    for instant in ODD_INSTANTS:
        simulator.AdvanceTo(instant)
        look_at_everything(station, context)
        expected.append(state_of(station, context))
        clones.append(context.Clone())
    for i in range(len(clones) - 1):
        follower = Simulator(station, clones[i])
        follower.AdvanceTo(ODD_INSTANTS[i + 1])
        assert_same(state_of(station, follower.get_context()), expected[i + 1])


def continue_run(folder, until):
    """Go on with a saved station, in a process of its own; save what it comes to."""
    skill = load_skill(folder / "skill.npz")
    station = MakeWipingStation(scenario_at(0.9), skill)
    simulator = Simulator(station)
    load_context(simulator.get_mutable_context(), folder / "context.npz")
    simulator.AdvanceTo(until)
    np.savez(folder / "state.npz", **state_of(station, simulator.get_context()))
    save_context(simulator.get_context(), folder / "end.npz")


def test_station_continues_identically_in_another_process(restless_skill, tmp_path):
    save_skill(restless_skill, tmp_path / "skill.npz")
    station = MakeWipingStation(scenario_at(0.9), restless_skill)
    simulator = Simulator(station)
    simulator.AdvanceTo(0.9137)
    save_context(simulator.get_context(), tmp_path / "context.npz")
    simulator.AdvanceTo(1.3)
    process = multiprocessing.get_context("spawn").Process(
        target=continue_run, args=(tmp_path, 1.3)
    )
    process.start()
    process.join()
    expected = state_of(station, simulator.get_context())
    with np.load(tmp_path / "state.npz") as results:
        assert_same(dict(results), expected)
    end = station.CreateDefaultContext()
    load_context(end, tmp_path / "end.npz")
    assert end.get_time() == 1.3
    assert_same(state_of(station, end), expected)


@pytest.mark.parametrize("t0", [0.0137, 100.001])
def test_simulation_starts_at_any_time(restless_skill, t0):
    station = MakeWipingStation(scenario_at(1.0), restless_skill)
    simulator = Simulator(station)
    simulator.get_mutable_context().SetTime(t0)
    simulator.AdvanceTo(t0 + 1.0)
    context = simulator.get_context()
    desired = station.GetOutputPort("desired_position").Eval(context)
    measured = station.GetOutputPort("measured_position").Eval(context)
    assert np.linalg.norm(desired - measured) < 0.02
    assert station.GetOutputPort("status").Eval(context)[1] == 1.0


def is_plain(value):
    """Tell whether a value is made of arrays, numbers and text, or is a Context."""
    if isinstance(value, np.ndarray):
        return value.dtype != object
    if isinstance(value, tuple | list):
        return all(map(is_plain, value))
    plain = bool | int | float | str | np.number | Context
    return value is None or isinstance(value, plain)


def test_caches_hold_arrays_and_plain_values(restless_skill, panel, monkeypatch):
    declared = []
    declare = LeafSystem.DeclareCacheEntry

    def recording(system, *arguments, **keywords):
        entry = declare(system, *arguments, **keywords)
        declared.append((system, entry))
        return entry

    monkeypatch.setattr(LeafSystem, "DeclareCacheEntry", recording)
    station = MakeWipingStation(
        scenario_at(0.9, "pushed"), restless_skill, meshcat=panel.meshcat
    )
    simulator = Simulator(station)
    simulator.AdvanceTo(0.4)
    assert declared
    for system, entry in declared:
        value = entry.Eval(system.GetMyContextFromRoot(simulator.get_context()))
        assert is_plain(value), (system.get_name(), entry.description())
