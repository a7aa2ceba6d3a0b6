"""Learn a rhythmic skill from one demonstration, look at it, and play it.

    python examples/01_learn_a_skill.py                 # the bundled figure of eight
    python examples/01_learn_a_skill.py my_motion.csv   # your own: time,x,y,z

No Drake is needed here: the skill layer is NumPy, SciPy and scikit-learn.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fmp_drake.plots import draw_samples_in_plane, draw_way_back, plot_skill
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    load_skill,
    save_skill,
)

BUNDLED = Path(__file__).parent.parent / "models" / "demonstrations" / "eight.npz"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("demonstration", nargs="?", type=Path, default=BUNDLED)
    parser.add_argument("--out", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    # One long recording. It is not aligned, not segmented, and nobody has to say what
    # its period is.
    demonstration = Demonstration.load(arguments.demonstration)
    print(
        f"{demonstration.duration:.0f} s of {', '.join(demonstration.channels)} "
        f"from {arguments.demonstration.name}"
    )

    # Windows of 120 samples at 20 Hz: 6 seconds, long enough for a period.
    skill = FourierMovementPrimitive(n_steps=120, n_components=10)
    skill.fit(demonstration)
    print(
        f"{skill.n_windows_} windows, {len(skill.components_)} components of rank "
        f"{', '.join(str(c.rank) for c in skill.components_)}"
    )

    # A skill is one file.
    file = arguments.out / "skill.npz"
    save_skill(skill, file)
    skill = load_skill(file)

    # Play it for 30 s from a start that nobody has shown: 15 cm to the side. Every
    # 5.5 s the last half second is mapped onto a new window, so there is no end.
    low, high = skill.extent_
    start = (low + high) / 2
    start[0] = high[0] + 0.15
    player = Player(skill)
    velocity = player.rollout(start, duration=30.0)[:, 1]
    print(
        f"peak speed {np.max(np.linalg.norm(velocity, axis=1)):.2f} m/s, "
        f"demonstrated {peak_speed(demonstration):.2f} m/s"
    )

    # Every picture can go into axes of your own; `plot_skill` writes a whole page.
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_samples_in_plane(skill, n=10, demonstrations=demonstration, ax=left)
    draw_way_back(player, start, demonstrations=demonstration, ax=right)
    picture = arguments.out / "01_learn_a_skill.png"
    figure.savefig(picture, dpi=120)
    page = arguments.out / "01_skill_page.png"
    plot_skill(skill, demonstration, page)
    print(f"wrote {file}, {picture} and {page}")


def peak_speed(demonstration: Demonstration) -> float:
    """Return the greatest speed between two samples, m/s."""
    steps = np.linalg.norm(np.diff(demonstration.values, axis=0), axis=1)
    return float(np.max(steps / np.diff(demonstration.time)))


if __name__ == "__main__":
    main()
