"""What the commands read: demonstrations and skills, laid onto the board."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError, RunError
from fmp_drake.numeric import check_number
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    load_skill,
)
from fmp_drake.primitives.data.placement import Placement, fit_placement
from fmp_drake.primitives.model.parameters import ModelChoice
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scenario_parts import SkillConfig

# What is left of the board around the eraser, m.
_MARGIN = 0.02


def bundled_demonstrations() -> list[str]:
    """Return the names of the demonstrations that come with the package."""
    return sorted(path.stem for path in (models_dir() / "demonstrations").glob("*.npz"))


def default_demonstration(task: str = "wiping") -> Path:
    """Return a demonstration that comes with the package, or a file of the user's."""
    if task.endswith((".npz", ".csv")):
        return Path(task)
    if task not in bundled_demonstrations():
        raise DemonstrationError(
            f"there is no demonstration {task}; give a .npz or .csv file or one of: "
            f"{', '.join(bundled_demonstrations())}."
        )
    return models_dir() / "demonstrations" / f"{task}.npz"


def scenario_skill(
    scenario: Scenario,
    *,
    demos: Sequence[Path] = (),
    skill_file: Path | None = None,
    transform: Sequence[float] | None = None,
    stretch: float = 1.0,
    window: float | None = None,
    components: int | None = None,
) -> tuple[FourierMovementPrimitive, list[Demonstration], list[str]]:
    """Load or learn what a scenario, or the command line, says.

    Returns
    -------
    skill : FourierMovementPrimitive
    demonstrations : list of Demonstration
        What it was learned from; empty for a skill from a file.
    remarks : list of str
    """
    if skill_file is not None and demos:
        raise RunError("give either --demo or --skill, not both.")
    plays = scenario.skill
    if skill_file is None and plays.file and not demos:
        skill_file = Path(plays.file)
    if skill_file is not None:
        skill, remarks = load_skill(skill_file), [f"loaded {skill_file}"]
        if not skill.paths_:
            remarks.append(
                f"{skill_file.name} does not say where it was demonstrated: what is "
                "played may lead anywhere. Learn it again to bound it."
            )
        return skill, [], remarks
    demonstrations, remarks = load_on_board(
        demos or [default_demonstration(plays.demonstration)],
        scenario=scenario,
        transform=transform,
        stretch=stretch,
    )
    skill = learn_skill(
        demonstrations,
        window=plays.window if window is None else window,
        components=plays.components if components is None else components,
    )
    return skill, demonstrations, remarks


def load_on_board(
    paths: Sequence[Path],
    *,
    scenario: Scenario,
    transform: Sequence[float] | None,
    stretch: float,
) -> tuple[list[Demonstration], list[str]]:
    """Load demonstrations in the frame of the board, and say what was done."""
    check_number(stretch, "stretch", above=0, error=DemonstrationError)
    usable = np.array(scenario.board.size) - scenario.eraser.footprint - _MARGIN
    demonstrations, remarks = [], []
    for path in paths:
        demonstration = Demonstration.load(path)
        if demonstration.n_channels != 3:
            raise DemonstrationError(
                f"{path} has {demonstration.n_channels} channels "
                f"({', '.join(demonstration.channels)}); the board needs x, y and z."
            )
        if stretch != 1.0:
            demonstration = replace(demonstration, time=demonstration.time * stretch)
        if transform is not None:
            placement = Placement(
                rotation=Rotation.from_euler("xyz", transform[3:]).as_matrix(),
                translation=np.array(transform[:3]),
            )
            demonstration = placement.apply(demonstration)
        elif demonstration.frame != "board":
            placement = fit_placement(demonstration, usable=usable)
            demonstration = placement.apply(demonstration)
            remarks.append(
                f"{path.name}: laid onto the middle of the board by its plane, at "
                f"{100 * placement.scale:.0f} % of its size; it touches the board "
                f"{100 * placement.touching:.0f} % of the time"
            )
        demonstrations.append(demonstration)
    return demonstrations, remarks


def learn_skill(
    demonstrations: Sequence[Demonstration],
    *,
    window: float | None = None,
    components: int | None = None,
    model: ModelChoice | None = None,
    progress: Callable[[str], None] | None = None,
) -> FourierMovementPrimitive:
    """Learn a skill with the options of the command line, None for the defaults."""
    defaults = SkillConfig()
    window = defaults.window if window is None else window
    components = defaults.components if components is None else components
    default = FourierMovementPrimitive()
    rate = default.rate
    check_number(window, "window", above=0, unit="s", error=DemonstrationError)
    n_steps = max(8, round(window * rate))
    longest = max(d.duration for d in demonstrations)
    if longest < n_steps / rate:
        raise DemonstrationError(
            f"the longest demonstration lasts {longest:.3g} s, a window {window:g} s; at "
            "least two windows must fit. Record for longer, choose shorter windows "
            "(--window) that still hold a whole period, or slow the demonstration "
            "down (--stretch)."
        )
    return FourierMovementPrimitive(
        model=default.model if model is None else model,
        n_steps=n_steps,
        n_components=components,
        overlap=min(10, n_steps // 4),
    ).fit(list(demonstrations), progress=progress)
