"""
Randomised scenarios
====================

A few tuned scenarios prove little. Randomise any field of a scenario, and look at the failed ones.
`fmp-drake worlds` runs thousands from the command line, on all cores or on a cluster. It continues
where it was stopped, and writes a report.
"""

# sphinx_gallery_thumbnail_path = '../../models/scenarios/wipe_dome.png'

import matplotlib.pyplot as plt

from fmp_drake.experiments.trials import TrialSpec
from fmp_drake.runs import WipingRun
from fmp_drake.skills import scenario_skill
from fmp_drake.station import CheckFeasibility, ParseScenario

# %%
# Distributions
# -------------
# A specification names a base scenario, and the distributions of its fields.

spec = TrialSpec(
    """
description: A table at various places, wiped with various forces.
base: table_top
offsets:
  board:
    translation: [{uniform: [-0.05, 0.35]}, 0.0, {uniform: [-0.02, 0.10]}]
fields:
  press.force: {uniform: [5.0, 15.0]}
"""
)

# %%
# A trial depends only on the specification, a seed and its number: trial 3 is the same on any
# day, on any machine, and without trials 0 to 2.

trials = [spec.draw(seed=1, number=number) for number in range(5)]
assert spec.draw(seed=1, number=3) == trials[3]

# %%
# Check and run
# -------------
# Infeasible trials are not run.

figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for number, trial in enumerate(trials):
    scenario = ParseScenario(trial.scenario)
    skill, demonstrations, _ = scenario_skill(scenario)
    feasibility = CheckFeasibility(scenario, skill)
    x, force = scenario.board.translation[0], scenario.press.force
    print(f"trial {number}, board {x:.2f} m away, {force:.1f} N: {feasibility.verdict}")
    if feasibility.is_feasible:
        run = WipingRun(scenario, skill, demonstrations=demonstrations)
        run.advance_to(3.0)
        print(f"    cleaned {100 * run.metrics()['cleaned_fraction']:.0f} % in 3 s")
    ax.plot(x, force, "go" if feasibility.is_feasible else "rx", markersize=10)
ax.set(xlabel="distance of the board (m)", ylabel="desired force (N)")
ax.set_title("green: feasible; red: infeasible")
plt.show()
