"""Measure the time of a station, also with a page, and of its bare plant in turns.

Arguments: the scenario, the seconds to begin with and the number of slices. Prints the
seconds of every slice (station, bare plant, station with a page and no browser), and
how far the replay went off, as JSON. In a process of its own: what other benchmarks
leave in memory slows Python more than the plant.
"""

import json
import sys

from pydrake.geometry import Meshcat
from station_replay import make_bare, make_simulator, make_station, record, take_turns

from fmp_drake.station.scenario import LoadScenario
from fmp_drake.systems.page.page_panel import PagePanel


def main():
    name, warm_up, slices = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
    scenario = LoadScenario(name)
    torques = record(scenario, warm_up + slices)
    bare = make_simulator(make_bare(scenario, *torques), scenario)
    station = make_simulator(make_station(scenario), scenario)
    page = make_simulator(make_station(scenario, PagePanel(Meshcat())), scenario)
    seconds, off = take_turns(
        (station, bare, page), warm_up=warm_up, slices=slices, follow=name == "cenic"
    )
    sys.stdout.write(json.dumps({"seconds": seconds.tolist(), "off": off}))


if __name__ == "__main__":
    main()
