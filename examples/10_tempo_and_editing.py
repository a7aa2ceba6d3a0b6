"""
Edit tempo, place, size and rhythm
==================================

A learned skill can be edited without learning it again: every edit maps the Gaussians of
its windows and the cycle of its phase model.
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
# Spectrum
# --------
# The spectrum of the windows shows the frequencies of the movement in each channel.

for channel in ("x", "y"):
    (strongest, *_) = skill_spectrum(skill).peaks(channel)
    print(
        f"{channel}: {strongest.frequency:.2f} Hz, "
        f"{100 * strongest.fraction:.0f} % of the variance"
    )

# %%
# Tempo
# -----
# `scale_tempo` changes the skill. During playback the tempo is changed by
# `PlaybackState.tempo`, the port `tempo` of `FourierPrimitiveSystem`, and the page's slider.

fast_skill = scale_tempo(skill, 1.5)
start = recording.values[0]
speed, fast_speed = (
    np.linalg.norm(Player(s).rollout(start, 20.0)[:, 1], axis=1).mean()
    for s in (skill, fast_skill)
)
print(f"mean speed {speed:.3f} and {fast_speed:.3f} m/s")

# %%
# Place and size
# --------------
# Half the size, rotated by 30 degrees in the plane, and 5 cm further away.

moved_skill = transform_space(
    skill,
    rotation=Rotation.from_euler("z", 30, degrees=True),
    scale=0.5,
    translation=[0.05, 0.0, 0.0],
)

# %%
# Rhythm
# ------
# The harmonics of the loops of the 8 are amplified in x: the figure becomes larger in x, with
# the same timing.

x = skill_spectrum(skill).peaks("x")[0].harmonic
large_skill = modulate_skill(
    skill, harmonics=[x - 1, x, x + 1], gain=1.6, channels=["x"]
)

figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
for ax, edited_skill, title in zip(
    axes,
    (skill, moved_skill, large_skill),
    ("learned", "moved", "modulated"),
    strict=True,
):
    draw_samples_in_plane(edited_skill, n=6, demonstrations=recording, ax=ax)
    ax.set_title(title, loc="left")
plt.show()
assert 1.3 < fast_speed / speed < 1.7
