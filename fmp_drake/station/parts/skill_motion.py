"""The primitive that moves a robot, wired to it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder, System
from pydrake.systems.primitives import Demultiplexer

from fmp_drake.primitives import FourierMovementPrimitive, Tracker
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.skill_config import SkillConfig
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.ink.coverage_choice import CoverageChoice
from fmp_drake.systems.ink.grid import InkGrid

DESIRED = ("desired_position", "desired_velocity", "desired_acceleration")
"""Inputs of a robot, and outputs of `AddSkillMotion`'s second system, in its order."""


def ChoiceByInk(
    scenario: Scenario, skill: FourierMovementPrimitive, grid: InkGrid
) -> tuple[CoverageChoice | None, NDArray[np.bool_] | None]:
    """Return how samples are chosen by the ink, if they are, and what is to be cleaned.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted; the area is what its demonstrations passed over, None where it knows none.
    grid : InkGrid
        Of the ink.
    """
    x, y = scenario.eraser.footprint
    area = grid.swept_by(skill.paths_, (x, y)) if skill.paths_ else None
    candidates = scenario.skill.candidates
    if candidates == 1:
        return None, area
    choice = CoverageChoice(
        grid=grid, footprint=(x, y), candidates=candidates, area=area
    )
    return choice, area


def AddSkillMotion(
    builder: DiagramBuilder,
    skill: FourierMovementPrimitive,
    plays: SkillConfig,
    robot: System,
    *,
    tracker: Tracker | None = None,
    sample: bool | None = None,
    seed: int | None = None,
    choice: CoverageChoice | None = None,
) -> tuple[FourierPrimitiveSystem, Any]:
    """Add systems fourier_primitive and desired_motion, and let a robot follow them.

    Parameters
    ----------
    builder : DiagramBuilder
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels.
    plays : SkillConfig
        How it is played.
    robot : System
        With the output measured_position and the inputs `DESIRED`.
    tracker, choice
        As for `FourierPrimitiveSystem`.
    sample, seed : optional
        Instead of those of `plays`.

    Returns
    -------
    FourierPrimitiveSystem, Demultiplexer
    """
    primitive = FourierPrimitiveSystem(
        skill,
        tracker=tracker,
        sample=plays.sample if sample is None else sample,
        seed=plays.seed if seed is None else seed,
        push_threshold=plays.push_threshold,
        push_dwell=plays.push_dwell,
        choice=choice,
        margin=plays.margin if skill.paths_ else None,
        soft_start=True,
    )
    builder.AddSystem(primitive)
    measured = robot.GetOutputPort("measured_position")
    builder.Connect(measured, primitive.GetInputPort("measured_position"))
    # One evaluation of the motion for all of its parts.
    desired = builder.AddNamedSystem("desired_motion", Demultiplexer([3, 3, 3]))
    builder.Connect(primitive.GetOutputPort("motion"), desired.get_input_port())
    for order, name in enumerate(DESIRED):
        builder.Connect(desired.get_output_port(order), robot.GetInputPort(name))
    return primitive, desired
