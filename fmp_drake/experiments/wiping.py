"""Section V-D: wiping for any duration, Fig. 10, and by the simulated Panda."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.experiments.metrics import draw_paths, millimetres
from fmp_drake.experiments.report import Finding, Profile
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive, Player
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.station.scenario import Scenario

_LENGTH = 400  # samples: 20 s
_START = (0.05, 0.20, 0.05)


def wiping(demonstration: Demonstration, profile: Profile) -> list[Finding]:
    """Play wiping for 400 samples, tracking mean and samples, also with the robot."""
    skill = FourierMovementPrimitive().fit(demonstration)
    paths, cells = {}, {}
    for sample, title in ((False, "tracking the mean"), (True, "tracking a sample")):
        path = Player(skill, sample=sample).rollout(_START, 60.0)[:, 0]
        paths[title] = path[: _LENGTH + 1]
        cells[sample] = _visited_cells(path)
    findings = [
        Finding(
            name="fig10",
            title="Fig. 10: generated trajectories of length 400 (20 s)",
            shows=f"In 60 s the tool visits {cells[False]} cells of 5 mm tracking the "
            f"means (left), {cells[True]} tracking samples (right).",
            claim="Movements of any length; sampling gives them much more variability.",
            agrees=cells[True] > 2 * cells[False],
            figure=draw_paths(demonstration, paths),
        )
    ]
    runs, errors = {}, {}
    for sample, title in ((False, "mean, measured"), (True, "sample, measured")):
        run = WipingRun(
            Scenario(),
            skill,
            demonstrations=[demonstration],
            start=_START,
            sample=sample,
            keep=["measured_position"],
        )
        run.advance_to(profile.robot_seconds)
        runs[title] = run.log("measured_position")[::4]
        errors[sample] = run.metrics()["tracking_rms_m"] or 0.0
    findings.append(
        Finding(
            name="fig10_robot",
            title="Fig. 10, executed by the simulated Panda",
            shows=f"{profile.robot_seconds:g} s on the whiteboard, followed to "
            f"{millimetres(errors[False])} (mean) and {millimetres(errors[True])} "
            "(sample) rms.",
            claim="An impedance controller with fixed orientation executes them.",
            agrees=max(errors.values()) < 0.01,
            figure=draw_paths(demonstration, runs),
        )
    )
    return findings


def _visited_cells(path: NDArray[np.float64]) -> int:
    """Return the number of 5 mm cells in the plane that a path (ticks, D) visits."""
    ticks = np.arange(len(path))
    fine = np.linspace(0, len(path) - 1, 20 * len(path))
    points = np.stack([np.interp(fine, ticks, path[:, i]) for i in (0, 1)], axis=1)
    return len(np.unique(np.floor(points / 0.005).astype(int), axis=0))
