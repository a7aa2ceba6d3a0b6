"""Simulates the station in a process of its own; prints its memory as JSON.

Arguments: the scenario and the minutes. MB resident after every minute.
"""

import json
import sys

from learn_large import resident
from station_replay import make_simulator, make_station

from fmp_drake.station.scenario import LoadScenario


def main():
    scenario = LoadScenario(sys.argv[1])
    simulator = make_simulator(make_station(scenario), scenario)
    memory = []
    for minute in range(int(sys.argv[2])):
        simulator.AdvanceTo(60.0 * (minute + 1))
        memory.append(resident("VmRSS"))
    sys.stdout.write(json.dumps(memory))


if __name__ == "__main__":
    main()
