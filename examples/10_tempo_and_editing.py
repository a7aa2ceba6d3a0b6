"""
Faster, larger, elsewhere, with another rhythm
==============================================

A learned skill can be edited exactly, without learning it again. Every edit is a linear map
of the windows, and so it maps the Gaussians of the mixture.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.plots import draw_samples_in_plane
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    modulate_skill,
    scale_tempo,
    skill_spectrum,
    transform_space,
)
from fmp_drake.station import models_dir

recording = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
skill = FourierMovementPrimitive().fit(recording)

# %%
# What is in it
# -------------
# The spectrum of the windows tells the movement's frequencies, channel by channel.

for channel in ("x", "y"):
    (strongest, *_) = skill_spectrum(skill).peaks(channel)
    print(
        f"{channel}: {strongest.frequency:.2f} Hz, "
        f"{100 * strongest.fraction:.0f} % of the variance"
    )

# %%
# Tempo
# -----
# Faster for good, or while it is played: `PlaybackState.tempo`, the port `tempo` of
# `FourierPrimitiveSystem`, and the slider of the page do the latter.

quick = scale_tempo(skill, 1.5)
start = recording.values[0]
usual_speed, quick_speed = (
    np.linalg.norm(Player(each).rollout(start, 20.0)[:, 1], axis=1).mean()
    for each in (skill, quick)
)
print(f"mean speed {usual_speed:.3f} and {quick_speed:.3f} m/s")

# %%
# Place and size
# --------------
# Half as large, turned by 30 degrees in the plane, and 5 cm further away.

moved = transform_space(
    skill,
    rotation=Rotation.from_euler("z", 30, degrees=True),
    scale=0.5,
    translation=[0.05, 0.0, 0.0],
)

# %%
# Rhythm
# ------
# The harmonics that make the loops of the 8, twice as strong in x: a fatter figure with the
# same timing.

x = skill_spectrum(skill).peaks("x")[0].harmonic
fat = modulate_skill(skill, harmonics=[x - 1, x, x + 1], gain=1.6, channels=["x"])

figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
for ax, each, title in zip(
    axes, (skill, moved, fat), ("learned", "moved", "modulated"), strict=True
):
    draw_samples_in_plane(each, n=6, demonstrations=recording, ax=ax)
    ax.set_title(title)
plt.show()
assert 1.3 < quick_speed / usual_speed < 1.7
