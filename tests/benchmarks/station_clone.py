"""Clone the Context of a station, and of its plant and scene graph alone.

Argument: the scenario. Prints milliseconds and MB resident of a clone, each for the
station and the scene, as JSON; in a process of its own, whose memory nobody else uses.
"""

import json
import sys
from time import perf_counter

import numpy as np
from learn_large import resident
from station_replay import make_scene, make_simulator, make_station

from fmp_drake.station.scenario import LoadScenario

CLONES = 40


def cost(context, kept):
    """Return the median milliseconds and the mean MB of a clone.

    All are kept: one in memory that others gave back would seem to take none.
    """
    times = []
    kept.append(context.Clone())
    before = resident("VmRSS")
    for _ in range(CLONES):
        begin = perf_counter()
        kept.append(context.Clone())
        times.append(1e3 * (perf_counter() - begin))
    return float(np.median(times)), (resident("VmRSS") - before) / CLONES


def main():
    scenario = LoadScenario(sys.argv[1])
    found, kept = [], []
    for diagram in (make_station(scenario), make_scene(scenario)):
        simulator = make_simulator(diagram, scenario)
        simulator.AdvanceTo(0.0137)
        context = simulator.get_context()
        for i in range(diagram.num_output_ports()):
            diagram.get_output_port(i).Eval(context)
        found.append(cost(context, kept))
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
