"""
Learn a rhythmic skill from one recording
=========================================

The only input is one long recording of a person who draws the figure 8. It is not aligned or
cut into periods, and the period is not given. The script learns the skill, plots it, saves it,
and plays it from a start that was never demonstrated.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, Rgba

from fmp_drake.plots import draw_rollout_in_plane, draw_samples_in_plane, plot_skill
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    load_skill,
    save_skill,
)
from fmp_drake.station import SetStage, models_dir
from fmp_drake.systems import AddPathToRecording, InlinePage, draw_demonstrations

# Or your own: "my_motion.csv" with the columns time,x,y,z.
recording = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
print(f"{recording.duration:.0f} s of {', '.join(recording.channels)}")

# %%
# Learn
# -----
# Windows of 120 samples at 20 Hz: 6 seconds, long enough for a period. They overlap, and
# each may begin anywhere. The skill is a mixture of Gaussians over their Fourier weights.

skill = FourierMovementPrimitive(n_steps=120, n_components=10).fit(recording)
ranks = [component.rank for component in skill.components_]
print(f"{skill.n_windows_} windows, components of rank {min(ranks)} to {max(ranks)}")

# %%
# Save and load
# -------------
# A skill is one file, without pickle.

out = Path("out")
out.mkdir(exist_ok=True)
save_skill(skill, out / "skill.npz")
skill = load_skill(out / "skill.npz")

# %%
# Play
# ----
# For 30 s, from a start 15 cm beside the demonstrated movement. Every 5.5 s the last half
# second is mapped onto a new window, so the movement never ends.

low, high = skill.extent_
start = (low + high) / 2
start[0] = high[0] + 0.15
player = Player(skill)
motion = player.rollout(start, duration=30.0)
steps = np.linalg.norm(np.diff(recording.values, axis=0), axis=1)
print(
    f"peak speed {np.max(np.linalg.norm(motion.velocity, axis=1)):.2f} m/s, "
    f"demonstrated {np.max(steps / np.diff(recording.time)):.2f} m/s"
)

# %%
# Plot
# ----
# Every picture can be drawn into your own axes; `plot_skill` writes a whole page.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained")
draw_samples_in_plane(skill, n=10, demonstrations=recording, ax=left)
draw_rollout_in_plane(player, start, demonstrations=recording, ax=right)
plot_skill(skill, recording, out / "skill_page.png")
plt.show()

# %%
# View in 3D
# ----------
# Meshcat needs no robot. A notebook shows the page here.

meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
SetStage(meshcat, eye=[-0.3, 0.0, 0.35], target=[0.0, 0.0, 0.0])
draw_demonstrations(meshcat, "demonstrated", [recording.values])
time = np.arange(len(motion.position)) * player.tick_seconds
path, color = motion.position, Rgba(1.0, 0.5, 0.0)
AddPathToRecording(meshcat, "played", times=time, points=path, color=color)
meshcat.PublishRecording()
InlinePage(meshcat.StaticHtml())
