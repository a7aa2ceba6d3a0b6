"""
Many worlds
===========

Ten scenarios that somebody has tuned prove little. Draw them at random, over any field of a
scenario, and look at which went wrong. `fmp-drake worlds` does this from the command line
for thousands, on all cores or on a cluster, goes on where it was stopped, and writes a report.
"""

import matplotlib.pyplot as plt

from fmp_drake.experiments.worlds import WorldSpec
from fmp_drake.runs import WipingRun, scenario_skill
from fmp_drake.station import CheckFeasibility, ParseScenario

# %%
# Distributions
# -------------
# A specification names scenarios to begin with, and what is drawn of which field.

spec = WorldSpec(
    """
description: A table that is shoved about, and somebody who wants it more or less firmly.
base: table_top
offsets:
  board:
    translation: [{uniform: [-0.05, 0.35]}, 0.0, {uniform: [-0.02, 0.10]}]
fields:
  press.force: {uniform: [5.0, 15.0]}
"""
)

# %%
# A world depends on the specification, a seed and its number, and on nothing else: world 3
# is the same one tomorrow, on another machine, and without worlds 0 to 2.

worlds = [spec.draw(seed=1, number=number) for number in range(5)]
assert spec.draw(seed=1, number=3) == worlds[3]

# %%
# Checked in advance, and run
# ---------------------------
# Where the check says that the arm cannot follow, nothing is run.

figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for number, world in enumerate(worlds):
    scenario = ParseScenario(world.scenario)
    skill, demonstrations, _ = scenario_skill(scenario)
    check = CheckFeasibility(scenario, skill)
    x, force = scenario.board.translation[0], scenario.press.force
    print(f"world {number}, board {x:.2f} m away, {force:.1f} N: {check.verdict}")
    if check.is_feasible:
        run = WipingRun(scenario, skill, demonstrations=demonstrations)
        run.advance_to(3.0)
        print(f"    cleaned {100 * run.metrics()['cleaned_fraction']:.0f} % in 3 s")
    ax.plot(x, force, "go" if check.is_feasible else "rx", markersize=10)
ax.set(xlabel="distance of the board (m)", ylabel="wanted force (N)")
ax.set_title("green: run; red: refused in advance")
plt.show()
