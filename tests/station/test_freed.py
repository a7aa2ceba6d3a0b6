"""Facts about the memory of a station without references.

Not always so one with a page or behind LCM: Drake ties parts of it to Meshcat or the bus.
"""

import gc
import weakref

import pytest
from pydrake.systems.analysis import Simulator

from fmp_drake.station import (
    LoadScenario,
    MakeStation,
    MakeWipingStation,
    SimulatedHand,
)
from fmp_drake.systems import HandMotion


def wiping(skill, name="table_top"):
    scenario = LoadScenario(name)
    scenario.skill.candidates = 4
    scenario.press.by_torque = name == "pushed"
    return MakeWipingStation(scenario, skill)


def taught_by(hand):
    return MakeStation(LoadScenario("table_top"), hand)


STATIONS = {
    "wiping": wiping,
    "pushed": lambda skill: wiping(skill, "pushed"),
    "late sensors": lambda skill: wiping(skill, "late_sensors"),
    "moving board": lambda skill: wiping(skill, "moving_board"),
    "simulated hand": lambda _: taught_by(
        SimulatedHand(HandMotion.make("eight", duration=5.0, seed=0))
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STATIONS)
def test_a_station_is_freed_with_its_systems(restless_skill, name):
    station = STATIONS[name](restless_skill)
    Simulator(station).AdvanceTo(0.01)
    systems = {s.get_name(): weakref.ref(s) for s in station.GetSystems()}
    assert len(systems) > 3
    del station
    gc.collect()
    assert [name for name, system in systems.items() if system() is not None] == []
