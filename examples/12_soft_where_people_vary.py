"""
Stiff where people agree, soft where they vary
==============================================

The covariance of the demonstrations shows where precision matters. Connected to the controller's
port `covariance`, it makes the arm stiff only there. An energy tank prevents the varying stiffness
from adding energy to the motion.
"""

# sphinx_gallery_thumbnail_path = '../../models/scenarios/gentle.png'

import matplotlib.pyplot as plt
import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.station import LoadScenario, MakeWipingStation, models_dir

recording = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
skill = FourierMovementPrimitive().fit(recording)

# %%
# The variation of people in one window of a component is large along the strokes, and smaller
# across them.

component = 0
deviations = 1e3 * np.array(
    [
        np.sqrt(np.linalg.eigvalsh(skill.covariance(component, step))[1:])
        for step in range(skill.n_steps)
    ]
)
time = np.arange(skill.n_steps) / skill.rate
figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
ax.plot(time, deviations, label=["smaller axis", "larger axis"])
ax.set(xlabel="time in the window (s)", ylabel="standard deviation (mm)")
ax.legend()
plt.show()

# %%
# The scenario `gentle` is the table top with one additional line:
# ``covariance_stiffness: {enabled: true}``. Its parameters are the least and the greatest
# stiffness, and the deviation at which the stiffness is half way between them.

scenario = LoadScenario("gentle")
print(scenario.impedance.covariance_stiffness)

# %%
# Push both arms sideways with 10 N for a second, and compare their deviations. The disturbances of
# a scenario are part of its diagram.


def tracking_error(name: str) -> np.ndarray:
    """Return the distance of a pushed arm from its path, m, at 100 Hz for 6 s."""
    scenario = LoadScenario(name)
    scenario.disturbances = LoadScenario("pushed").disturbances[:1]
    push = scenario.disturbances[0]
    push.start, push.duration, push.force = 3.0, 1.0, [0.0, 10.0, 0.0]
    builder = DiagramBuilder()
    station = builder.AddSystem(MakeWipingStation(scenario, skill))
    log = LogVectorOutput(station.GetOutputPort("tracking_error"), builder, 0.01)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(6.0)
    return np.linalg.norm(log.FindLog(simulator.get_context()).data()[3:5], axis=0)


figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for name in ("table_top", "gentle"):
    error = 1e3 * tracking_error(name)
    ax.plot(0.01 * np.arange(len(error)), error, label=name)
    print(f"{name}: {error[300:400].max():.0f} mm off its path during the push")
ax.axvspan(3, 4, color="0.9")
ax.set(xlabel="time (s)", ylabel="distance from the path (mm)")
ax.legend()
plt.show()
