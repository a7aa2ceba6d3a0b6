"""The ink on the board, added to a scene."""

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.ink.drawing import draw_picture, draw_words, upright_turns
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink_board import InkBoard


def AddInk(builder: DiagramBuilder, scene: BoardScene, scenario: Scenario) -> InkBoard:
    """Add the ink that the eraser rubs off: system ink_board.

    What is written or drawn is upright for the scenario's camera.

    Raises
    ------
    StationError
        Where a picture cannot be read, or nothing would be on the board.
    """
    x, y = scenario.board.size
    grid = InkGrid(size=(x, y), cell=scenario.ink.cell)
    ink = InkBoard(
        plant=scene.plant,
        eraser=scene.tip,
        surface=scene.surface,
        grid=grid,
        initial_ink=_drawing(grid, scene, scenario),
        worn=scenario.eraser.worn,
        period=scenario.ink.period,
    )
    builder.AddSystem(ink)
    for name in ("contact_results", "body_poses", "body_spatial_velocities"):
        builder.Connect(scene.plant.GetOutputPort(name), ink.GetInputPort(name))
    return ink


def _drawing(
    grid: InkGrid, scene: BoardScene, scenario: Scenario
) -> NDArray[np.float64] | None:
    """Return the ink at the start, None for a board that is full of it."""
    ink = scenario.ink
    if not (ink.words or ink.picture):
        return None
    turns = upright_turns(grid, X_WB=scene.X_WB, eye=scenario.camera.eye)
    if ink.words:
        return draw_words(grid, ink.words, height=ink.size, quarter_turns=turns)
    return draw_picture(grid, ink.picture, size=ink.size, quarter_turns=turns)
