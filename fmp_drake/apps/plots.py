"""Pictures of skills and runs, written to files."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fmp_drake.errors import FmpError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Player

if TYPE_CHECKING:
    from fmp_drake.apps.wiping_run import WipingRun

_DEMONSTRATED = {"color": "0.7", "linewidth": 0.5}
_PLAYED = {"color": "tab:orange", "linewidth": 1.0}


def plot_skill(
    skill: FourierMovementPrimitive, demonstrations: Sequence[Demonstration], path: Path
) -> None:
    """Draw demonstrations, samples, and a rollout from outside, in the plane."""
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    axes = figure.subplots(1, 3)
    low, high = skill.extent_
    rollout = Player(skill).rollout(high + 0.5 * (high - low), 30.0)[:, 0]
    for ax, title in zip(
        axes, ("demonstrated", "sampled", "played from outside"), strict=True
    ):
        ax.set_title(title)
        for demonstration in demonstrations:
            _plane(ax, demonstration.values, **_DEMONSTRATED)
        _label(ax, skill)
    for sample in skill.sample(20, with_noise=False):
        _plane(axes[1], sample, color="tab:blue", linewidth=0.8)
    _plane(axes[2], rollout, **_PLAYED)
    _plane(axes[2], rollout[:1], color="tab:red", marker="o")
    _save(figure, path)


def plot_run(run: "WipingRun", path: Path) -> None:
    """Draw path, ink left, force on the board and tracking error of a run."""
    figure = Figure(figsize=(12, 8), layout="constrained")
    (a, b), (c, d) = figure.subplots(2, 2)
    measured = run.log("measured_position")
    a.set_title("path of the eraser")
    for demonstrated in run.demonstrated:
        _plane(a, demonstrated, **_DEMONSTRATED)
    _plane(a, measured[::20], **_PLAYED)
    _label(a, run.skill)

    b.set_title("ink left")
    nx, ny = run.grid.size
    image = b.imshow(
        run.ink().T,
        origin="lower",
        extent=(-ny / 2, ny / 2, -nx / 2, nx / 2),
        cmap="Blues",
        vmin=0,
        vmax=1,
    )
    outline = run.demonstrated_area().T.astype(float)
    b.contour(
        np.linspace(-ny / 2, ny / 2, outline.shape[1]),
        np.linspace(-nx / 2, nx / 2, outline.shape[0]),
        outline,
        levels=[0.5],
        colors="tab:orange",
        linewidths=1,
    )
    figure.colorbar(image, ax=b)
    _label(b, run.skill)

    c.set_title("force on the board")
    c.plot(run.log_times("normal_force"), run.log("normal_force")[:, 0], linewidth=0.8)
    c.set_xlabel("time (s)")
    c.set_ylabel("normal force (N)")

    d.set_title("tracking error")
    error = 1e3 * (run.log("measured_position") - run.log("desired_position"))
    times = run.log_times("measured_position")
    for i, name in enumerate("xyz"):
        d.plot(times[::10], error[::10, i], linewidth=0.8, label=name)
    d.set_xlabel("time (s)")
    d.set_ylabel("measured - desired (mm)")
    d.legend()
    _save(figure, path)


def _plane(ax: Any, points: np.ndarray, **style: Any) -> None:
    """Draw a path as the robot's user sees it: y to the left and right, x up."""
    ax.plot(points[:, 1], points[:, 0], **style)


def _label(ax: Any, skill: FourierMovementPrimitive) -> None:
    ax.set_aspect("equal")
    x, y = skill.channels_[:2]
    ux, uy = skill.units_[:2]
    ax.set_xlabel(f"{y} ({uy})")
    ax.set_ylabel(f"{x} ({ux})")


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    try:
        figure.savefig(path, dpi=120)
    except ValueError as error:
        raise FmpError(f"cannot write {path}: {error}.") from None
