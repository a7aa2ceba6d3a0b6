"""Wipe a board in a separate process; print its memory as JSON.

Arguments: the scenario and the minutes, and `log` to keep all signals. MB resident after
every minute.
"""

import json
import sys

from learn_large import resident

from fmp_drake.runs import WipingRun
from fmp_drake.runs.log import SIGNALS
from fmp_drake.skills import scenario_skill
from fmp_drake.station.scenario import LoadScenario


def main():
    scenario = LoadScenario(sys.argv[1])
    skill, demonstrations, _ = scenario_skill(scenario)
    keep = SIGNALS if "log" in sys.argv else ()
    run = WipingRun(scenario, skill, demonstrations=demonstrations, keep=keep)
    memory = []
    for minute in range(int(sys.argv[2])):
        run.advance_to(60.0 * (minute + 1))
        memory.append(resident("VmRSS"))
    sys.stdout.write(json.dumps(memory))


if __name__ == "__main__":
    main()
