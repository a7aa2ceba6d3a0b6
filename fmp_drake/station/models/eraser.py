"""Eraser of any size with its stem, and the compression and force limit of its felt."""

from math import pi

import numpy as np
from pydrake.geometry import Box, Cylinder, Ellipsoid
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    ModelInstanceIndex,
    ScopedName,
    SpatialInertia,
    UnitInertia,
)

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array
from fmp_drake.settings import check_settings
from fmp_drake.station.models.model_files import AddModel, Collision, Visual
from fmp_drake.station.scenario_parts import EraserConfig

_THICKNESS = 0.030  # Of the felt, m.
FELT_DEPTH = 0.012
"""Depth of the felt in front of its core, m."""

_INSET = 0.005  # Distance of the core from the felt's edges, m.
_CORE_MODULUS = 1e7  # Pressure in the middle of core and handle, Pa.
_RIM = 0.006  # Width of the handle less that of the felt, m.
_METAL = (0.55, 0.57, 0.59)
_BLUE = (0.10, 0.32, 0.62)
_FELT = (0.20, 0.21, 0.23)

_UP = np.array([0.0, 0.0, 1.0])


def AddEraser(
    plant: MultibodyPlant, config: EraserConfig, model_name_prefix: str = ""
) -> ModelInstanceIndex:
    """Add the model `eraser`: body `eraser` with frames `mount` and `eraser_tip` (E).

    The frame of the body is `mount`, on the robot's flange, with z away from the robot.
    E has the same axes and its origin at the centre of the felt's unloaded face, 0.100 m
    from the flange. The mass is that of four uniform solids: flange plate and stem
    (aluminium, 2700 kg/m^3), handle (700 kg/m^3), felt (200 kg/m^3).

    The felt's pressure is modulus * depth / 0.015 m (half the thickness), and smaller at
    the edges: 10 N compress a felt of 0.12 m x 0.05 m and 1.25e4 Pa by 2.13 mm. Its
    dissipation prevents a bounce after landing at 0.05 m/s.

    Behind 12 mm of felt there is a hard core, 5 mm within the felt's edges. It represents
    compressed fibres in contact, whose pressure increases with the cube of the density
    [1]_. The pressure of the felt alone decreases beyond half of the thickness, and 45 N
    push it through a board. Core and handle have the modulus of the board: 100 N on the
    whole face compress them by 0.03 mm. In a flat impact at 1.7 m/s with 10 kg, and a felt
    of 3e3 Pa, the core penetrates the board by 2.1 mm.

    The same law yields plausible moduli. Wool, of 1310 kg/m^3 and about 3 GPa, has the
    pressure k E phi^3 (2^3 - 1) when it is compressed by half, with k about 0.01 and phi
    the volume fraction of the fibres: 2.5e3 Pa for a fleece of 30 kg/m^3, 1.2e4 Pa for
    50 kg/m^3, 2e5 Pa for a felt of 130 kg/m^3. The stiffness of a felt also increases with
    its load [2]_, which is neglected.

    Parameters
    ----------
    plant : MultibodyPlant
        Not finalized, without a model of that name.
    config : EraserConfig
    model_name_prefix : str
        Scope of the model's name: `left::eraser`.

    Returns
    -------
    ModelInstanceIndex

    Raises
    ------
    StationError
        If a value of the config is not allowed.

    References
    ----------
    .. [1] C. M. van Wyk, "Note on the compressibility of wool", J. Textile Institute
       37(12), 1946.
    .. [2] F. G. Tyzzer, H. C. Hardy, "The properties of felt in the reduction of noise
       and vibration", J. Acoustical Society of America 19(5), 1947.
    """
    check_settings(config, StationError, "eraser.")
    x, y = config.footprint
    parts: list[Visual | Collision] = [
        Visual("plate", Cylinder(0.0315, 0.008), at=(0, 0, 0.004), colour=_METAL),
        Visual("stem", Cylinder(0.012, 0.042), at=(0, 0, 0.029), colour=_METAL),
        *_Handle(x + _RIM, y + _RIM),
        Visual("felt", Box(x, y, 0.030), at=(0, 0, 0.085), colour=_FELT),
        *_Contacts(config),
    ]
    return AddModel(
        plant,
        model=ScopedName.Join(model_name_prefix, "eraser").to_string(),
        link="eraser",
        inertia=_Inertia(x, y),
        parts=parts,
        frames={"mount": 0.0, "eraser_tip": 0.100},
    )


def FeltForceLimit(config: EraserConfig, *, sagitta: float = 0.0) -> float:
    """Return the normal force that squeezes a felt to its core, N.

    It is the felt's pressure at the depth of the core on the whole footprint,
    ``modulus * (0.012 m / 0.015 m) * x * y``: 60 N for the default eraser. The simulated
    felt, whose pressure is smaller at the edges, bears 42 N of it. With a larger force the
    hard edges of the core would wipe, not the felt. A curved surface reduces the depth.

    Parameters
    ----------
    config : EraserConfig
    sagitta : float
        Depth of the surface's curvature below the felt, see `Surface.sagitta`, m.

    Examples
    --------
    >>> round(FeltForceLimit(EraserConfig(footprint=[0.1, 0.05], modulus=1e4)), 6)
    40.0
    """
    x, y = config.footprint
    depth = max(FELT_DEPTH - sagitta, 0.0)
    return config.modulus * depth / (_THICKNESS / 2) * x * y


def FeltCompression(config: EraserConfig, force: Array) -> Array:
    """Return the compression of a flat felt, m, under normal forces, N; of equal shape.

    A box of height h has the pressure ``2 modulus / h`` times the distance d from its
    nearest face: ``(x y d - (x + y) d² + 4/3 d³) 2 modulus / h`` in all. From the depth
    of the core on, it remains constant.

    Examples
    --------
    >>> (1e3 * FeltCompression(EraserConfig(), np.array([10.0, 30.0]))).round(2)
    array([2.13, 7.5 ])
    """
    x, y = config.footprint
    d = np.linspace(0, min(FELT_DEPTH, x / 2, y / 2), 100)
    volumes = x * y * d - (x + y) * d**2 + 4 / 3 * d**3
    forces = volumes * config.modulus / (_THICKNESS / 2)
    return np.asarray(np.interp(force, forces, d), dtype=float)


def _Contacts(config: EraserConfig) -> list[Collision]:
    """Return the contact geometry: the felt, and the hard parts behind it."""
    x, y = config.footprint
    core = Box(x - 2 * _INSET, y - 2 * _INSET, _THICKNESS - FELT_DEPTH)
    handle = Box(x + _RIM, y + _RIM, 0.020)
    felt: dict[str, float] = {"modulus": config.modulus, "dissipation": 20}
    hard: dict[str, float] = {"modulus": _CORE_MODULUS, "dissipation": 5}
    mu = config.friction
    return [
        Collision("felt", Box(x, y, _THICKNESS), at=(0, 0, 0.085), friction=mu, **felt),
        Collision("core", core, at=(0, 0, 0.085 - FELT_DEPTH / 2), friction=mu, **hard),
        Collision("handle", handle, at=(0, 0, 0.060), friction=mu, **hard),
        Collision("stem", Cylinder(0.012, 0.042), at=(0, 0, 0.029), friction=mu),
        Collision("plate", Cylinder(0.0315, 0.008), at=(0, 0, 0.004), friction=mu),
    ]


def _Inertia(x: float, y: float) -> SpatialInertia:
    """Return the sum of the solids, about the flange."""
    handle, cylinder = (x + _RIM, y + _RIM, 0.020), UnitInertia.SolidCylinder
    solids = [
        (2700 * pi * 0.0315**2 * 0.008, 0.004, cylinder(0.0315, 0.008, _UP)),
        (2700 * pi * 0.012**2 * 0.042, 0.029, cylinder(0.012, 0.042, _UP)),
        (700 * float(np.prod(handle)), 0.060, UnitInertia.SolidBox(*handle)),
        (200 * x * y * 0.030, 0.085, UnitInertia.SolidBox(x, y, 0.030)),
    ]
    total = SpatialInertia.Zero()
    for mass, height, unit in solids:
        total += SpatialInertia(mass, np.zeros(3), unit).Shift(-height * _UP)
    return total


def _Handle(x: float, y: float) -> list[Visual]:
    """Return the visuals of a rounded handle, z from 0.047 to 0.070."""
    r = 0.24 * min(x, y)
    parts = [
        Visual("handle", Box(x - 2 * r, y, 0.013), at=(0, 0, 0.0635), colour=_BLUE),
        Visual("handle_x", Box(x, y - 2 * r, 0.013), at=(0, 0, 0.0635), colour=_BLUE),
        Visual(
            "handle_top",
            Ellipsoid(0.47 * x, 0.46 * y, 0.013),
            at=(0, 0, 0.057),
            colour=_BLUE,
        ),
    ]
    corners = [(sx * (x / 2 - r), sy * (y / 2 - r)) for sx in (1, -1) for sy in (1, -1)]
    for i, corner in enumerate(corners, start=1):
        at = (*corner, 0.0635)
        parts.append(Visual(f"handle_{i}", Cylinder(r, 0.013), at=at, colour=_BLUE))
    return parts
