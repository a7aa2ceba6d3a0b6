"""Checks of what an ink board is made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from fmp_drake.errors import StationError
from fmp_drake.systems.ink.grid import InkGrid


def check_ink_options(*, wear_constant: float, worn: float, period: float) -> None:
    """Refuse numbers that are out of range."""
    for name, value in (("wear_constant", wear_constant), ("period", period)):
        if not (np.isfinite(value) and value > 0.0):
            raise StationError(f"InkBoard {name} is {value}: give a positive number.")
    if not 0.0 <= worn <= 1.0:
        raise StationError(
            f"InkBoard worn is {worn}: give the share of the felt that does not rub, "
            "from 0 to 1."
        )


def checked_ink(initial_ink: ArrayLike | None, grid: InkGrid) -> NDArray[np.float64]:
    """Return a read-only copy of the ink at the start, shape (ny, nx).

    None means ink all over.
    """
    ink = grid.full() if initial_ink is None else np.array(initial_ink, dtype=float)
    if ink.shape != grid.shape:
        raise StationError(
            f"InkBoard initial_ink has shape {ink.shape}, but the grid has "
            f"{grid.shape} (ny, nx) cells."
        )
    if not bool(np.all((ink >= 0.0) & (ink <= 1.0))):
        raise StationError(
            f"InkBoard initial_ink goes from {ink.min()} to {ink.max()}: give "
            "fractions from 0 to 1."
        )
    ink.setflags(write=False)
    return ink


def check_touchable(plant: MultibodyPlant, eraser: RigidBody, board: RigidBody) -> None:
    """Refuse bodies that can never touch."""
    for body in (eraser, board):
        if not plant.GetCollisionGeometriesForBody(body):
            raise StationError(
                f"The body '{body.name()}' has no collision geometry, so the "
                "eraser and the board can never touch: add hydroelastic "
                "collision geometries to both, and register the plant with a "
                "SceneGraph first."
            )
