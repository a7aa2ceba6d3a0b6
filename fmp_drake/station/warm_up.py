"""Compiling in advance."""

from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator

from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.wiping_station import MakeWipingStation
from fmp_drake.systems.ink.mesh import corner_shades, ink_mesh
from fmp_drake.systems.viewer.swept_mesh import rod_mesh


def WarmUp() -> None:
    """Compile what a station of the Panda and its page compile when they first need it.

    That takes half a minute, once for a computer. Later it is read from the cache, in about a
    second, and nothing waits for it in the middle of a run.

    Examples
    --------
    >>> WarmUp()
    """
    t = np.arange(200) / 10
    circles = 0.1 * np.column_stack([np.cos(3 * t), np.sin(3 * t), 0 * t])
    for model in ("phase", "mixture"):
        skill = FourierMovementPrimitive(
            model=model, rate=10.0, n_steps=24, overlap=4, n_components=2
        ).fit(circles)
        station = MakeWipingStation(Scenario(), skill)
        Simulator(station).AdvanceTo(0.15)
    # What a page draws.
    rod_mesh(circles, 0.01)
    board: Any = station.GetSubsystemByName("ink_board")
    ink_mesh(board.grid, corner_shades(board.initial_ink))
