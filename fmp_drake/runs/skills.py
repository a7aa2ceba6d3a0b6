"""What the commands read: demonstrations and skills, laid onto the board."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import cast

import numpy as np
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError, RunError
from fmp_drake.numeric import check_number
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    ReadingOptions,
    load_skill,
    read_demonstrations,
)
from fmp_drake.primitives.data.placement import Placement, check_width, fit_placement
from fmp_drake.primitives.model.parameters import ModelChoice
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.parts.joint_recording import EraserPath, PandaJoints
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.skill_config import SkillConfig

# What is left of the board around the eraser, m.
_MARGIN = 0.02
# What is laid onto the board touches it so often at least, at this part of its size.
_LEAST_TOUCHING, _LEAST_SCALE = 0.2, 0.3
_BOARD = ["x", "y", "z"]


def bundled_demonstrations() -> list[str]:
    """Return the names of the demonstrations that come with the package."""
    return sorted(path.stem for path in (models_dir() / "demonstrations").glob("*.npz"))


def default_demonstration(task: str = "wiping") -> Path:
    """Return a demonstration that comes with the package, or a file of the user's."""
    if Path(task).suffix or Path(task).is_dir():
        return Path(task)
    if task not in bundled_demonstrations():
        raise DemonstrationError(
            f"there is no demonstration {task}; give a file or one of: "
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
    model: ModelChoice | None = None,
    reading: ReadingOptions | None = None,
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
        reading=reading,
    )
    skill = learn_skill(
        demonstrations,
        window=plays.window if window is None else window,
        components=plays.components if components is None else components,
        model=model or cast(ModelChoice, plays.model),
    )
    return skill, demonstrations, remarks


def shared_skill(
    scenario: Scenario,
) -> tuple[FourierMovementPrimitive, list[Demonstration]]:
    """Return the skill of a scenario and its demonstrations, learned once a process."""
    plays = scenario.skill
    return _learned(
        plays.demonstration,
        plays.file,
        plays.window,
        plays.components,
        plays.model,
        tuple(scenario.board.size),
        tuple(scenario.eraser.footprint),
    )


@cache
def _learned(
    demonstration: str,
    file: str,
    window: float,
    components: int | None,
    model: str,
    board: tuple[float, ...],
    footprint: tuple[float, ...],
) -> tuple[FourierMovementPrimitive, list[Demonstration]]:
    """Learn from what a skill depends on, and nothing else."""
    scenario = Scenario()
    scenario.skill.demonstration, scenario.skill.file = demonstration, file
    scenario.skill.window, scenario.skill.components = window, components
    scenario.skill.model = model
    scenario.board.size, scenario.eraser.footprint = list(board), list(footprint)
    skill, demonstrations, _ = scenario_skill(scenario)
    return skill, demonstrations


def load_on_board(
    paths: Sequence[Path],
    *,
    scenario: Scenario,
    transform: Sequence[float] | None,
    stretch: float,
    reading: ReadingOptions | None = None,
    needs_board: bool = True,
) -> tuple[list[Demonstration], list[str]]:
    """Load demonstrations in the frame of the board, and say what was done.

    Without `needs_board` those that have neither positions nor a Panda's joints stay as
    they are.
    """
    demonstrations, remarks = [], []
    for path in paths:
        found, said = load_as_recorded([path], stretch=stretch, reading=reading)
        remarks += said
        for demonstration in found:
            try:
                demonstration, said = lay_on_board(
                    demonstration,
                    scenario=scenario,
                    transform=transform,
                    needs_board=needs_board,
                )
            except DemonstrationError as error:
                raise DemonstrationError(f"{path}: {error}") from None
            demonstrations.append(demonstration)
            remarks += [f"{path.name}: {remark}" for remark in said]
    return demonstrations, remarks


def load_as_recorded(
    paths: Sequence[Path], *, stretch: float, reading: ReadingOptions | None = None
) -> tuple[list[Demonstration], list[str]]:
    """Load demonstrations with all their channels, and say what was recognised."""
    check_number(stretch, "stretch", above=0, error=DemonstrationError)
    demonstrations, remarks = read_demonstrations(paths, reading)
    if stretch != 1.0:
        demonstrations = [replace(d, time=d.time * stretch) for d in demonstrations]
    return demonstrations, remarks


def lay_on_board(
    demonstration: Demonstration,
    *,
    scenario: Scenario,
    transform: Sequence[float] | None = None,
    needs_board: bool = True,
) -> tuple[Demonstration, list[str]]:
    """Return x, y and z of a demonstration in the frame of the board, and remarks.

    Raises
    ------
    DemonstrationError
        Where there is no position, or none that makes sense on the board.
    """
    remarks = []
    names = demonstration.channels
    if not set(_BOARD) <= set(names):
        listed = ", ".join(names)
        if PandaJoints(demonstration):
            demonstration = EraserPath(demonstration, eraser=scenario.eraser)
            remarks.append(f"the eraser's path by a Panda's kinematics, from {listed}")
        elif needs_board:
            raise DemonstrationError(
                f"the channels are {listed}; the board needs x, y and z. Say which "
                "columns they are (--columns x=NAME,y=NAME,z=NAME)."
            )
        else:
            return demonstration, ["as recorded: without x, y and z there is no board"]
    elif len(names) > 3:
        others = ", ".join(name for name in names if name not in _BOARD)
        demonstration = demonstration.select(_BOARD)
        remarks.append(f"{others} left out: the board needs x, y and z")
    check_width(demonstration)
    if transform is not None:
        placement = Placement(
            rotation=Rotation.from_euler("xyz", transform[3:]).as_matrix(),
            translation=np.array(transform[:3]),
        )
        return placement.apply(demonstration), remarks
    if demonstration.frame == "board":
        return demonstration, remarks
    usable = np.array(scenario.board.size) - scenario.eraser.footprint - _MARGIN
    placement = fit_placement(demonstration, usable=usable)
    touching = f"{100 * placement.touching:.0f} % of the time"
    at_size = f"{100 * placement.scale:.0f} % of its size"
    instead = "Give its pose (--transform), or learn it as it is (learn --as-recorded)."
    if placement.touching < _LEAST_TOUCHING:
        raise DemonstrationError(
            f"laid onto the board it would touch it {touching}; at least "
            f"{100 * _LEAST_TOUCHING:.0f} % make sense. {instead}"
        )
    if placement.scale < _LEAST_SCALE:
        raise DemonstrationError(
            f"it would fit onto the board at {at_size}; at least "
            f"{100 * _LEAST_SCALE:.0f} % make sense. {instead}"
        )
    remarks.append(
        f"laid onto the middle of the board by its plane, at {at_size}; it touches the "
        f"board {touching}"
    )
    return placement.apply(demonstration), remarks


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
        n_components=default.n_components if components is None else components,
        overlap=min(10, n_steps // 4),
    ).fit(list(demonstrations), progress=progress)
