"""Draw the idea in one picture: ``python examples/site/idea.py examples/idea.png``."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from fmp_drake.plots import draw_rollout_in_plane, draw_samples_in_plane
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Player
from fmp_drake.station import models_dir

EQUATIONS = (
    r"$y = \Phi w$",
    r"$p(w) = \sum_m \pi_m \, \mathcal{N}(w;\, \mu_m, \Sigma_m)$",
    r"$\hat w = \mu_m + \Sigma_m \Phi_K^\top (\Phi_K \Sigma_m \Phi_K^\top"
    + r" + \lambda I)^{-1} (y_K - \Phi_K \mu_m)$",
)


def draw_idea(path: Path) -> None:
    """Draw a recording with its windows, samples of the skill, and a return to it."""
    recording = Demonstration.load(models_dir() / "demonstrations" / "eight.npz")
    skill = FourierMovementPrimitive().fit(recording)
    low, high = skill.extent_
    start = np.append(((low + high) / 2)[:2], low[2])
    start[0] = high[0] + 0.12

    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(12, 4), layout="constrained", width_ratios=(1, 1, 1.15)
    )
    is_drawn = recording.time < 16
    for channel, color in ((1, "tab:blue"), (0, "tab:cyan")):
        left.plot(
            recording.time[is_drawn],
            recording.values[is_drawn, channel],
            color=color,
            label=recording.channels[channel],
        )
    span = skill.n_steps / skill.rate
    for begin in (0.8, 4.1, 8.6):
        left.axvspan(begin, begin + span, color="tab:orange", alpha=0.18, linewidth=0)
    left.set(xlabel="time (s)", ylabel="recording (m)", xlim=(0, 16))
    left.margins(y=0.2)
    left.legend(loc="upper right", ncols=2, frameon=False)
    draw_samples_in_plane(skill, n=12, demonstrations=recording, ax=middle)
    draw_rollout_in_plane(Player(skill), start, demonstrations=recording, ax=right)
    middle.set(xlim=right.get_xlim(), ylim=right.get_ylim())
    titles = (
        "windows that begin anywhere",
        "samples of the skill",
        "the window that continues from there",
    )
    for axes, equation, title in zip(
        (left, middle, right), EQUATIONS, titles, strict=True
    ):
        axes.set_title(f"{equation}\n{title}", loc="left", fontsize=12)
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    draw_idea(Path(sys.argv[1]))
