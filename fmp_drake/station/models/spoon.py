"""A wooden spoon on the flange, for stirring in free space."""

from math import pi

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, SpatialInertia, UnitInertia

from fmp_drake.station.models.model_files import (
    AddModel,
    Cylinder,
    Ellipsoid,
    Inertial,
    Visual,
)

_PLATE = (0.0315, 0.008)  # Radius and height of the flange plate, m.
_STICK = (0.007, 0.205)  # Radius and length, m.
_BOWL = (0.026, 0.019, 0.034)  # Radii, m.
_TIP = 0.250  # From the flange, m.
_ALUMINIUM, _WOOD = 2700.0, 700.0  # kg/m^3
_METAL = (0.55, 0.57, 0.59)
_BEECH = (0.80, 0.62, 0.42)
_UP = np.array([0.0, 0.0, 1.0])


def AddSpoon(plant: MultibodyPlant) -> ModelInstanceIndex:
    """Add the model `spoon`: body `spoon` with the frames `mount` and `tip` (E).

    The body's frame is `mount`, on the robot's flange, z pointing away from the robot. E
    has the same axes and its origin at the end of the spoon, 0.250 m from the flange. The
    mass is that of an aluminium plate (2700 kg/m^3), a stick and an ellipsoid of wood
    (700 kg/m^3): 0.12 kg. It touches nothing: there is nothing to touch in free space.

    Parameters
    ----------
    plant : MultibodyPlant
        Not finalized, without a model of that name.

    Returns
    -------
    ModelInstanceIndex
    """
    radius, length = _STICK
    stick, bowl = _PLATE[1] + length / 2, _TIP - _BOWL[2]
    volume = 4 / 3 * pi * float(np.prod(_BOWL))
    solids = (
        (_ALUMINIUM * pi * _PLATE[0] ** 2 * _PLATE[1], _PLATE[1] / 2, _Round(*_PLATE)),
        (_WOOD * pi * radius**2 * length, stick, _Round(radius, length)),
        (_WOOD * volume, bowl, UnitInertia.SolidEllipsoid(*_BOWL)),
    )
    inertia = SpatialInertia.Zero()
    for mass, height, unit in solids:
        inertia += SpatialInertia(mass, np.zeros(3), unit).Shift(-height * _UP)
    parts = [
        Inertial(inertia),
        Visual("plate", Cylinder(*_PLATE), at=(0, 0, _PLATE[1] / 2), colour=_METAL),
        Visual("stick", Cylinder(radius, length), at=(0, 0, stick), colour=_BEECH),
        Visual("bowl", Ellipsoid(*_BOWL), at=(0, 0, bowl), colour=_BEECH),
    ]
    return AddModel(
        plant,
        model="spoon",
        link="spoon",
        parts="".join(parts),
        frames=f"""<frame name="mount" attached_to="spoon"/>
<frame name="tip" attached_to="spoon"><pose>0 0 {_TIP} 0 0 0</pose></frame>""",
    )


def _Round(radius: float, length: float) -> UnitInertia:
    return UnitInertia.SolidCylinder(radius, length, unit_vector=_UP)
