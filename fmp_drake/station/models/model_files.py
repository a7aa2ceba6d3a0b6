"""Folder of the package's models, and models of one link with variable sizes."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from xml.dom.expatbuilder import parse
from xml.dom.minidom import Element
from xml.parsers.expat import ExpatError

import numpy as np
import pydrake.common
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    GeometryInstance,
    MakePhongIllustrationProperties,
    PerceptionProperties,
    ProximityProperties,
    Rgba,
    Shape,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
)

from fmp_drake.errors import StationError

Colour = tuple[float, float, float]

# Files that have been parsed, with their times of modification.
_PARSED = set[tuple[Path, int]]()


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


def named_joints(file: str | Path, element: str) -> dict[str, Element]:
    """Return the first element of a kind, such as `limit`, of each joint that has one.

    Parameters
    ----------
    file : str or Path
        URDF or SDF.
    element : str

    Returns
    -------
    dict of str to Element
        By the names of the joints; empty where the file is not strict XML, which Drake reads.
    """
    try:  # As for Drake, prefixes need no declaration.
        document = parse(str(file), namespaces=False)
    except (ExpatError, ValueError):
        return {}
    joints = document.getElementsByTagName("joint")
    return {
        joint.getAttribute("name"): found
        for joint in joints
        for found in joint.getElementsByTagName(element)[:1]
    }


def check_limit_order(file: str | Path) -> None:
    """Check the limits of the joints in a URDF file.

    Raises
    ------
    StationError
        With the first joint whose limits are reversed or whose greatest speed is negative.
    """
    for name, limit in named_joints(file, "limit").items():
        keys = ("lower", "upper", "velocity")
        lower, upper, speed = (float(limit.getAttribute(k) or "nan") for k in keys)
        if lower > upper or speed < 0:
            raise StationError(
                f"{name} has the limits lower {lower:g}, upper {upper:g} and velocity "
                f"{speed:g}; lower must be less than upper, and velocity above 0."
            )


@contextmanager
def warned_once(file: str | Path) -> Iterator[None]:
    """Suppress Drake's warnings about a model file from its second parsing on.

    A command parses the file of a robot ten times. A file that has changed is a new one.
    """
    path = Path(file).resolve()
    key = path, path.stat().st_mtime_ns if path.is_file() else 0
    # It applies to Python's logging and to Drake's own, but its name is private.
    set_level = getattr(pydrake.common, "_set_log_level", None)
    level = set_level("err") if set_level and key in _PARSED else None
    try:
        yield
        _PARSED.add(key)
    finally:
        if set_level and level is not None:
            set_level(level)


def linear_colour(colour: Sequence[float]) -> Colour:
    """Undo sRGB's transfer curve (IEC 61966-2-1)."""
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour
    )
    return red, green, blue


class Visual(NamedTuple):
    """A shape at a position in its link, m, with an sRGB colour.

    It is registered twice: for the page, which takes colours as sRGB, and for the
    renderer, which takes them as linear beside the arm's glTF meshes. Both then look
    the same.
    """

    name: str
    shape: Shape
    at: Sequence[float]
    colour: Colour

    def AddTo(self, plant: MultibodyPlant, body: RigidBody) -> None:
        """Register the shape with its two colours."""
        X = RigidTransform(np.array(self.at, dtype=float))
        shown = GeometryInstance(X, self.shape, self.name)
        shown.set_illustration_properties(
            MakePhongIllustrationProperties(np.array([*self.colour, 1.0]))
        )
        rendered = GeometryInstance(X, self.shape, f"{self.name}_rendered")
        material = PerceptionProperties()
        material.AddProperty("phong", "diffuse", Rgba(*linear_colour(self.colour)))
        rendered.set_perception_properties(material)
        plant.RegisterVisualGeometry(body, shown)
        plant.RegisterVisualGeometry(body, rendered)


class Collision(NamedTuple):
    """Contact geometry with a modulus, Pa, and a dissipation, s/m.

    It is compliant hydroelastic geometry; with an infinite modulus it is rigid, and without
    a modulus it has point contact.
    """

    name: str
    shape: Shape
    at: Sequence[float]
    friction: float
    modulus: float | None = None
    dissipation: float = 0.0

    def AddTo(self, plant: MultibodyPlant, body: RigidBody) -> None:
        """Register the geometry."""
        contact, dissipation = ProximityProperties(), None
        if self.modulus is not None and math.isinf(self.modulus):
            AddRigidHydroelasticProperties(contact)
        elif self.modulus is not None:
            # The resolution hint is required, but neither box nor hull uses it.
            AddCompliantHydroelasticProperties(1.0, self.modulus, contact)
            dissipation = self.dissipation
        friction = CoulombFriction(self.friction, self.friction)
        AddContactMaterial(
            dissipation=dissipation, friction=friction, properties=contact
        )
        X = RigidTransform(np.array(self.at, dtype=float))
        plant.RegisterCollisionGeometry(body, X, self.shape, self.name, contact)


def check_free_name(plant: MultibodyPlant, model: str) -> None:
    """Raise a StationError where a plant already has a model of this name."""
    if plant.HasModelInstanceNamed(model):
        raise name_is_taken(model)


def name_is_taken(model: str) -> StationError:
    """Return the error for a second model of a name in a plant."""
    return StationError(
        f"the plant already has a model named {model}, and each needs a name of its own "
        "(a station has an eraser and a whiteboard); choose another name for yours, such "
        "as that of <robot> in a URDF, or another tool, or give AddRobot "
        "a model_name_prefix."
    )


def AddModel(
    plant: MultibodyPlant,
    *,
    model: str,
    link: str,
    inertia: SpatialInertia,
    parts: Iterable[Visual | Collision],
    frames: Mapping[str, float],
) -> ModelInstanceIndex:
    """Add a model of one link.

    Parameters
    ----------
    plant : MultibodyPlant
        Geometry is added if it is registered with a SceneGraph.
    model, link : str
        Names of model and link.
    inertia : SpatialInertia
        Of a symmetric body about the link's origin; used with six digits.
    parts : iterable of Visual or Collision
    frames : mapping of str to float
        Names of frames, and their z in the link, m.
    """
    check_free_name(plant, model)
    instance = plant.AddModelInstance(model)
    body: Any = plant.AddRigidBody(link, instance, _six_digits(inertia))
    for name, height in frames.items():
        X = RigidTransform(np.array([0.0, 0.0, height]))
        plant.AddFrame(FixedOffsetFrame(name, body.body_frame(), X, instance))
    if plant.geometry_source_is_registered():
        for part in parts:
            part.AddTo(plant, body)
    return instance


def _six_digits(inertia: SpatialInertia) -> SpatialInertia:
    """Round mass, centre of mass and central moments, as numbers in a model's file."""
    central = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
    exact = [inertia.get_mass(), *inertia.get_com(), *central.get_moments()]
    mass, x, y, z, *moments = (float(f"{value:.6g}") for value in exact)
    return SpatialInertia.MakeFromCentralInertia(
        mass, np.array([x, y, z]), RotationalInertia(*moments)
    )


def check_model_file(model: Path) -> None:
    """Check that there is a URDF or SDF file of a robot.

    Raises
    ------
    StationError
    """
    if model.suffix.lower() == ".xacro":
        raise StationError(
            f"{model.name} has macros; write the URDF that `xacro {model.name} > {model.stem}` "
            "makes of it, and name it as the model."
        )
    if model.suffix.lower() == ".xml":
        raise StationError(
            f"{model.name} is read as MJCF (MuJoCo), in which joints have no velocity "
            "limits; give a URDF (.urdf) or SDF (.sdf) file with these limits."
        )
    if not model.is_file():
        raise StationError(
            f"there is no model {model}; give the path of a URDF or SDF file, "
            "relative to the robot's YAML file."
        )
