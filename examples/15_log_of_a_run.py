"""
The log of a run
================

`fmp-drake wipe --log run.npz` writes every signal of a run, with its unit and meaning, to one file
that NumPy can read. The same from Python:
"""

# sphinx_gallery_thumbnail_path = '../../models/scenarios/pushed.png'

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.runs import RunLog, WipingRun
from fmp_drake.skills import scenario_skill
from fmp_drake.station import LoadScenario

# %%
# A run stores the signals in `keep` in temporary files, so that its memory does not grow with
# its duration. A person pushes the arm from 8 to 9 s. Events are faults, such as lost contact:
# here there are none.

scenario = LoadScenario("pushed")
skill, demonstrations, _ = scenario_skill(scenario)
run = WipingRun(
    scenario,
    skill,
    demonstrations=demonstrations,
    keep=["normal_force", "tracking_error", "cleaned_fraction", "torque"],
)
run.advance_to(10.0)
metrics = run.metrics()
print(f"cleaned {100 * metrics['cleaned_fraction']:.0f} % in 10 s")
print(f"events: {[event.text for event in run.events()]}")

# %%
# Write and read the log
# ----------------------

folder = Path(tempfile.mkdtemp())
run.save_log(folder / "run.npz", metrics)
log = RunLog.load(folder / "run.npz")
for name, signal in sorted(log.signals.items()):
    print(f"{name:18} {signal.values.shape!s:12} {signal.unit:6} {signal.meaning}")

figure, axes = plt.subplots(3, 1, figsize=(8, 6), layout="constrained", sharex=True)
for ax, (name, label) in zip(
    axes,
    (
        ("normal_force", "normal force (N)"),
        ("tracking_error", "tracking error (mm)"),
        ("torque", "torque (Nm)"),
    ),
    strict=True,
):
    signal = log.signals[name]
    values = signal.values
    if name == "tracking_error":
        values = 1e3 * np.linalg.norm(values[:, 3:], axis=1)
    ax.plot(signal.times, values, linewidth=0.8)
    ax.set_ylabel(label)
axes[-1].set_xlabel("time (s)")
plt.show()
