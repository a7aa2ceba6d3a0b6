"""Speed of the station compared with its bare plant, and the time of its systems.

No limit is asserted: the figures depend on the machine. Station and bare plant run in
turns, so that a busy machine slows both.
"""

import json
import subprocess
import sys
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from benchmarks.station_replay import (
    TICK,
    make_bare,
    make_simulator,
    make_station,
    record,
    take_turns,
    timed_callbacks,
)
from pydrake.geometry import HydroelasticContactRepresentation

from fmp_drake.station.scenario import LoadScenario

WARM_UP = 1.0
SLICES = 12
MINUTES = 4
# (scenario, greatest difference of the replay's state, rad and rad/s)
ROWS = {"table_top": 0.0, "cenic": 0.001}


def run_script(name, *arguments):
    """Run a script beside this file in a process of its own; return what it prints."""
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name(name), *map(str, arguments)],
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", list(ROWS))
def test_the_station_beside_its_bare_plant(benchmark, figures, name):
    run = benchmark.pedantic(
        run_script, args=("station_speed.py", name, WARM_UP, SLICES), rounds=1
    )
    seconds, off = np.array(run["seconds"]), run["off"]
    assert seconds.shape == (SLICES, 3)
    assert off <= ROWS[name]
    whole, alone, page = 1 / np.median(seconds, axis=0)
    figures.section = f"The whiteboard station: {SLICES} s of {name}, contact on"
    figures.add("bare plant, fed the recorded torques", alone, "x real time")
    figures.add("whole station", whole, "x real time", above=3 if alone >= 4 else None)
    figures.add(
        "station / bare plant (speed)",
        np.median(seconds[:, 1] / seconds[:, 0]),
        above=0.68,
    )
    figures.add("whole station with a page, no browser", page, "x real time")
    figures.add(
        "station with a page / bare plant (speed)",
        np.median(seconds[:, 1] / seconds[:, 2]),
        above=0.58,
    )
    figures.add("replayed state, largest difference", off, "rad, rad/s")


def geometry_seconds(simulator):
    """Return the median seconds of one look for all contact surfaces."""
    diagram = simulator.get_system()
    plant = diagram.GetSubsystemByName("plant")
    port = plant.get_geometry_query_input_port()
    query = port.Eval(plant.GetMyContextFromRoot(simulator.get_context()))
    times = []
    for _ in range(200):
        begin = perf_counter()
        query.ComputeContactSurfacesWithFallback(
            HydroelasticContactRepresentation.kPolygon
        )
        times.append(perf_counter() - begin)
    return np.median(times)


def test_time_of_each_system(benchmark, figures):
    scenario = LoadScenario("table_top")
    end = WARM_UP + SLICES
    bare = make_simulator(make_bare(scenario, *record(scenario, end)), scenario)
    with timed_callbacks() as times:
        station = make_simulator(make_station(scenario), scenario)
    station.AdvanceTo(WARM_UP)
    times.seconds.clear()
    seconds, _ = benchmark.pedantic(
        take_turns,
        args=((station, bare),),
        kwargs={"warm_up": WARM_UP, "slices": SLICES},
        rounds=1,
    )
    ticks = SLICES / TICK
    whole, alone = 1e6 * seconds.sum(axis=0) / ticks
    python = {name: 1e6 * s / ticks for name, s in times.seconds.items()}
    assert {"controller", "fourier_primitive", "ink_board"} <= set(python)
    figures.section = "Where a millisecond of table_top goes, while callbacks are timed"
    figures.add("plant and scene graph (the bare plant), C++", alone, "us")
    figures.add(
        "of it, one look for contact surfaces", 1e6 * geometry_seconds(bare), "us"
    )
    for name, took in sorted(python.items(), key=lambda item: -item[1]):
        figures.add(f"{name}, Python", took, "us")
    rest = whole - alone - sum(python.values())
    figures.add("the rest: events, C++", rest, "us")
    figures.add("whole station", whole, "us")


def test_clone_of_a_context(benchmark, figures):
    station, scene = benchmark.pedantic(
        run_script, args=("station_clone.py", "table_top"), rounds=1
    )
    figures.section = "A clone of a Context of table_top, all ports evaluated"
    for i, (unit, limit) in enumerate((("ms", 1.0), ("MB", 1.0))):
        figures.add("plant and scene graph alone", scene[i], unit)
        figures.add("station, more than that", station[i] - scene[i], unit, below=limit)


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kept", ["nothing", "log"])
def test_memory_over_minutes(benchmark, figures, kept):
    memory = benchmark.pedantic(
        run_script, args=("station_memory.py", "table_top", MINUTES, kept), rounds=1
    )
    assert len(memory) == MINUTES
    figures.section = f"Memory of a run over {MINUTES} minutes, kept: {kept}"
    figures.add("after a minute", memory[0], "MB")
    figures.add("growth after that", memory[-1] - memory[0], "MB", below=5)
