"""Times a station and its bare plant in turns, in a process of their own.

Arguments: the scenario, the seconds to begin with and the number of slices. Prints the
seconds of every slice, station and bare plant, and how far the replay went off, as
JSON. What other benchmarks leave in memory slows Python more than the plant.
"""

import json
import sys

from station_replay import make_bare, make_simulator, make_station, record, take_turns

from fmp_drake.station.scenario import LoadScenario


def main():
    name, warm_up, slices = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
    scenario = LoadScenario(name)
    torques = record(scenario, warm_up + slices)
    bare = make_simulator(make_bare(scenario, *torques), scenario)
    station = make_simulator(make_station(scenario), scenario)
    seconds, off = take_turns(
        (station, bare), warm_up=warm_up, slices=slices, follow=name == "cenic"
    )
    sys.stdout.write(json.dumps({"seconds": seconds.tolist(), "off": off}))


if __name__ == "__main__":
    main()
