"""Cooking pot without contact geometry."""

from math import cos, pi, sin

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, SpatialInertia, UnitInertia

from fmp_drake.station.models.model_files import (
    AddModel,
    Box,
    Cylinder,
    Inertial,
    Visual,
)

_RADIUS, _HEIGHT, _WALL = 0.125, 0.115, 0.003  # Of its inside, m.
_SIDES = 36
_STEEL = (0.72, 0.73, 0.75)
_SOUP = (0.78, 0.38, 0.14)
_DARK = (0.16, 0.17, 0.19)


def AddPot(plant: MultibodyPlant) -> ModelInstanceIndex:
    """Add the model `pot`: body `pot`, with its origin in the middle of the bottom.

    z points up. It is there to be seen, and touches nothing.

    Parameters
    ----------
    plant : MultibodyPlant
        Not finalized, without a model of that name.

    Returns
    -------
    ModelInstanceIndex
    """
    inertia = SpatialInertia(
        1.5, np.zeros(3), UnitInertia.SolidCylinder(_RADIUS, _HEIGHT, np.eye(3)[2])
    )
    outer = _RADIUS + _WALL
    width = 2 * outer * np.tan(pi / _SIDES) * 1.02
    wall, grip = Box(_WALL, width, _HEIGHT), Box(0.03, 0.07, 0.012)
    soup = 0.42 * _HEIGHT
    parts = [
        Inertial(inertia),
        Visual("bottom", Cylinder(outer, _WALL), at=(0, 0, -_WALL / 2), colour=_STEEL),
        Visual(
            "foot",
            Cylinder(0.9 * outer, 0.004),
            at=(0, 0, -_WALL - 0.002),
            colour=_DARK,
        ),
        Visual("soup", Cylinder(_RADIUS, soup), at=(0, 0, soup / 2), colour=_SOUP),
    ]
    for i in range(_SIDES):
        angle = 2 * pi * i / _SIDES
        middle = _RADIUS + _WALL / 2
        at = (middle * cos(angle), middle * sin(angle), _HEIGHT / 2)
        parts.append(Visual(f"wall_{i}", wall, at=at, colour=_STEEL, yaw=angle))
    for i, side in enumerate((1, -1)):
        at = (0.0, side * (outer + 0.012), 0.8 * _HEIGHT)
        parts.append(Visual(f"grip_{i}", grip, at=at, colour=_DARK, yaw=pi / 2))
    return AddModel(plant, model="pot", link="pot", parts="".join(parts), frames="")
