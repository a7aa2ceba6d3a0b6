"""Folder of the package's models, and SDF text of models with variable sizes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, SpatialInertia

from fmp_drake.errors import StationError

Colour = tuple[float, float, float]


def models_dir() -> Path:
    """Find the folder of models, in an installed wheel or in a checkout.

    Returns
    -------
    Path
        The folder with ``package.xml``.

    Raises
    ------
    StationError
        If it is missing in both.
    """
    package = Path(__file__).resolve().parents[2]
    candidates = (package / "models", package.parent / "models")
    for folder in candidates:
        if (folder / "package.xml").is_file():
            return folder
    folders = " nor ".join(str(folder) for folder in candidates)
    raise StationError(
        f"no models: package.xml is neither in {folders}. "
        "Install fmp_drake again, or run it from a complete checkout."
    )


def AddFmpDrakePackage(parser: Parser) -> None:
    """Add the package of ``package://fmp_drake/...`` to a parser.

    A parser with this package is not changed.

    Parameters
    ----------
    parser : Parser
        Parser of the models.
    """
    packages = parser.package_map()
    if not packages.Contains("fmp_drake"):
        packages.AddPackageXml(str(models_dir() / "package.xml"))


def Numbers(values: Sequence[float] | NDArray[np.float64]) -> str:
    """Return numbers with six digits, separated by spaces."""
    return " ".join(f"{value:.6g}" for value in values)


def Box(*size: float) -> str:
    """Return a box of size x, y, z, m."""
    return f"<box><size>{Numbers(size)}</size></box>"


def Cylinder(radius: float, length: float) -> str:
    """Return a cylinder along z, m."""
    return (
        f"<cylinder><radius>{radius:.6g}</radius>"
        f"<length>{length:.6g}</length></cylinder>"
    )


def Ellipsoid(*radii: float) -> str:
    """Return an ellipsoid with radii along x, y, z, m."""
    return f"<ellipsoid><radii>{Numbers(radii)}</radii></ellipsoid>"


def Visual(name: str, shape: str, *, at: Sequence[float], colour: Colour) -> str:
    """Return a shape at a position in its link, m, with an sRGB colour.

    It is there twice: for the page, which takes colours as sRGB, and for the renderer, which
    takes them as linear beside the arm's glTF meshes. Both then look the same.
    """
    pose = [*at, 0, 0, 0]
    return _Role(name, "perception", shape, pose, colour) + _Role(
        f"{name}_rendered", "illustration", shape, pose, linear_colour(colour)
    )


def _Role(
    name: str, without: str, shape: str, pose: Sequence[float], colour: Sequence[float]
) -> str:
    return (
        f'<visual name="{name}"><pose>{Numbers(pose)}</pose>'
        f"<geometry>{shape}</geometry>"
        f"<material><diffuse>{Numbers([*colour, 1])}</diffuse></material>"
        f'<drake:{without}_properties enabled="false"/></visual>\n'
    )


def linear_colour(colour: Sequence[float]) -> Colour:
    """Undo sRGB's transfer curve (IEC 61966-2-1)."""
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour
    )
    return red, green, blue


def Collision(
    name: str,
    shape: str,
    *,
    at: Sequence[float],
    friction: float,
    modulus: float | None = None,
    dissipation: float = 0,
) -> str:
    """Return contact geometry with a modulus, Pa, and a dissipation, s/m.

    It is compliant hydroelastic geometry, or has point contact without a modulus.
    """
    hydroelastic = (
        f"""<drake:compliant_hydroelastic/>
    <drake:hydroelastic_modulus>{modulus:.10g}</drake:hydroelastic_modulus>
    <drake:hunt_crossley_dissipation>{dissipation}</drake:hunt_crossley_dissipation>"""
        if modulus is not None
        else ""
    )
    return f"""<collision name="{name}"><pose>{Numbers([*at, 0, 0, 0])}</pose>
  <geometry>{shape}</geometry>
  <drake:proximity_properties>
    {hydroelastic}
    <drake:mu_dynamic>{friction:.10g}</drake:mu_dynamic>
    <drake:mu_static>{friction:.10g}</drake:mu_static>
  </drake:proximity_properties>
</collision>
"""


def Inertial(inertia: SpatialInertia) -> str:
    """Return the inertia of a symmetric body, given about the link's origin."""
    central = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
    moments = (
        f"<i{axis}>{value:.6g}</i{axis}>"
        for axis, value in zip(("xx", "yy", "zz"), central.get_moments(), strict=True)
    )
    products = "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz>"
    return (
        f"<inertial><pose>{Numbers([*inertia.get_com(), 0, 0, 0])}</pose>"
        f"<mass>{inertia.get_mass():.6g}</mass>"
        f"<inertia>{''.join(moments)}{products}</inertia></inertial>\n"
    )


def AddModel(
    plant: MultibodyPlant, *, model: str, link: str, parts: str, frames: str
) -> ModelInstanceIndex:
    """Add a model of one link with inertia, visuals and collisions."""
    text = f"""<?xml version="1.0"?>
<sdf version="1.9" xmlns:drake="http://drake.mit.edu">
<model name="{model}">
<link name="{link}">
{parts}</link>
{frames}
</model>
</sdf>
"""
    (instance,) = Parser(plant).AddModelsFromString(text, "sdf")
    return instance
