"""Parts of a scenario, as dataclasses that mirror the YAML files.

`Scenario.check` checks their values, because loading YAML does not call constructors.
"""

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, get_args

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.math import RigidTransform, RollPitchYaw

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array, shown
from fmp_drake.primitives.model.movement_primitive import ModelChoice
from fmp_drake.settings import bounded, check_yaml
from fmp_drake.systems.operational_space_impedance_controller import ENGAGE_HEIGHT
from fmp_drake.systems.scripted_disturbances import Disturbance
from fmp_drake.systems.surface.surface import Surface

FORCE_TOLERANCE = 5.0
"""Tolerance of the normal force around its desired value, N."""

# Curvatures along x and y of B for a radius of 1 m. A cylinder is straight along its `axis`.
_SHAPES = {
    "plane": (0.0, 0.0),
    "cylinder": (1.0, 1.0),
    "dome": (1.0, 1.0),
    "bowl": (-1.0, -1.0),
    "none": (0.0, 0.0),
}


@contextmanager
def in_one_line(what: str, hint: str = "") -> Iterator[None]:
    """Convert an error of the block to a `StationError` with a message of one line.

    Parameters
    ----------
    what : str
        Text before the first line of the error.
    hint : str
        Text after an error that is not a `StationError`, which says itself what to do.
    """
    try:
        yield
    except (
        RuntimeError,
        TypeError,
        ValueError,
        KeyError,
        OSError,
        AssertionError,  # Drake's loader, for a number in place of a mapping.
        SystemExit,  # Drake's failed assertions.
        yaml.YAMLError,
    ) as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        is_own = isinstance(error, StationError)
        text = f"{reason.rstrip('.')}.{hint}" if hint and not is_own else reason
        raise StationError(f"{what}: {text}") from None


def load_yaml(schema: type, text: str) -> Any:
    """Load a dataclass from checked YAML text, over its defaults."""
    return yaml_load_typed(  # type: ignore[no-untyped-call]
        schema=schema, data=text, defaults=schema()
    )


_ANGLE: dict[str, Any] = {"least": -6.3, "most": 6.3, "hint": "in rad, not degrees"}


@dataclass(kw_only=True)
class BoardMotion:
    """Oscillation of a board on a rail, from rest at one end when a simulation begins.

    Attributes
    ----------
    axis : list of 3 floats
        Direction of the rail in B.
    amplitude : float
        m; 0 for a board that stands still.
    frequency : float
        Hz, at most 3: the check samples paths, and the board's motion, at 10 Hz.

    Examples
    --------
    >>> motion = BoardMotion(axis=[1.0, 1.0, 0.0], amplitude=0.05)
    >>> BoardConfig(motion=motion).rail_axis()
    array([0.70710678, 0.70710678, 0.        ])
    """

    axis: list[float] = bounded([0.0, 1.0, 0.0])
    amplitude: float = bounded(0.0, least=0)
    frequency: float = bounded(0.1, above=0, most=3)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if not np.any(self.axis):
            return "board.motion.axis is 0; expected a direction."
        return ""


@dataclass(kw_only=True)
class PoseConfig:
    """A pose.

    Attributes
    ----------
    translation : list of 3 floats
        m.
    rpy : list of 3 floats
        Roll, pitch, yaw, rad.

    Examples
    --------
    >>> PoseConfig(translation=[0.0, 0.0, 0.1]).transform().translation()
    array([0. , 0. , 0.1])
    """

    translation: list[float] = bounded([0.0, 0.0, 0.0])
    rpy: list[float] = bounded([0.0, 0.0, 0.0], **_ANGLE)

    def transform(self) -> RigidTransform:
        """Return the pose."""
        return RigidTransform(
            RollPitchYaw(np.array(self.rpy)), np.array(self.translation)
        )


@dataclass(kw_only=True)
class BoardConfig:
    """The whiteboard, or another surface to wipe.

    Attributes
    ----------
    shape : str
        `plane`, `cylinder`, `dome`, `bowl`, or `none` for free space without a board.
    radius : float
        Of a cylinder, dome or bowl, m.
    axis : str
        Of a cylinder: `x` or `y` of B.
    translation : list of 3 floats
        p_WB, the centre of the surface in the world, m.
    rpy : list of 3 floats
        Roll, pitch, yaw of R_WB, rad; z of B is the normal out of the surface.
    size : list of 2 floats
        Along x and y of B, m; on a curved board along the surface.
    friction : float
        Coefficient of friction of its surface.
    legs : bool
        Whether it is drawn with the legs of a table.
    error : PoseConfig
        Pose of the real board in the frame of the assumed one.
    motion : BoardMotion

    Examples
    --------
    >>> board = BoardConfig(translation=[0.5, 0.1, 0.2], rpy=[0.0, -0.3, 0.0])
    >>> board.pose().translation()
    array([0.5, 0.1, 0.2])
    >>> BoardConfig(shape="cylinder", radius=0.25, axis="x").curvature()
    Surface(kx=0.0, ky=4.0)
    """

    shape: str = "plane"
    radius: float = bounded(0.30, above=0)
    axis: str = "x"
    translation: list[float] = bounded([0.55, 0.0, 0.10])
    rpy: list[float] = bounded([0.0, 0.0, 0.0], **_ANGLE)
    size: list[float] = bounded([0.50, 0.70], least=0.1, most=10)
    friction: float = bounded(0.5, least=0)
    legs: bool = True
    error: PoseConfig = field(default_factory=PoseConfig)
    motion: BoardMotion = field(default_factory=BoardMotion)

    def assumed_pose(self) -> RigidTransform:
        """Return the controller's assumption of X_WB, at the middle of the rail."""
        return PoseConfig(translation=self.translation, rpy=self.rpy).transform()

    def pose(self) -> RigidTransform:
        """Return X_WB, at the middle of the rail."""
        return self.assumed_pose() @ self.error.transform()

    def rail_axis(self) -> Array:
        """Return the direction of the rail in B, a unit vector."""
        axis = np.array(self.motion.axis)
        return axis / np.linalg.norm(axis)

    def start_displacement(self) -> RigidTransform:
        """Return the pose of the board at the start from the middle of the rail."""
        return RigidTransform(-self.motion.amplitude * self.rail_axis())

    def curvature(self) -> Surface:
        """Return the curvatures of the surface along x and y of B, 1/m."""
        kx, ky = _SHAPES[self.shape]
        if self.shape == "cylinder":
            kx, ky = (0.0, ky) if self.axis == "x" else (kx, 0.0)
        return Surface(kx=kx / self.radius, ky=ky / self.radius)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.shape not in _SHAPES:
            return f"board.shape is {self.shape}; choose one of: {', '.join(_SHAPES)}."
        if self.axis not in ("x", "y"):
            return f"board.axis is {self.axis}; expected x or y."
        if self.shape == "none" and self.motion.amplitude > 0:
            return "board.shape is none: set board.motion.amplitude to 0."
        if self.curvature().is_plane:
            return ""
        if self.shape == "cylinder":
            width = self.size[1 if self.axis == "x" else 0]
            limit, description = 2 * np.pi * self.radius, "its circumference"
        else:
            width = math.hypot(*self.size)
            limit, description = np.pi * self.radius, "a hemisphere across its corners"
        if width > 1.000001 * limit:
            return (
                f"board.size is {self.size} m, {width:.3f} m around a {self.shape} of "
                f"{self.radius:g} m; expected {limit:.3f} m or less, {description}."
            )
        return ""


@dataclass(kw_only=True)
class EraserConfig:
    """The eraser at the robot's flange.

    Attributes
    ----------
    footprint : list of 2 floats
        Edges of its felt along x and y of E, m.
    modulus : float
        Stiffness of the felt: pressure for a depth of half its thickness, Pa.
    friction : float
        Coefficient of friction of its felt.
    worn : float
        Fraction of the felt's face that no longer removes ink, from 0 to 1.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> Scenario(eraser=EraserConfig(friction=0.3)).contact_friction()
    0.375
    """

    footprint: list[float] = bounded([0.12, 0.05], above=0.01, most=1)
    modulus: float = bounded(1.25e4, above=0)
    friction: float = bounded(0.5, least=0)
    worn: float = bounded(0.0, least=0, most=1)


@dataclass(kw_only=True)
class NormalForceConfig:
    """Normal force of the eraser on the board.

    Attributes
    ----------
    force : float
        Along the board's normal, N; not negative.
    engage_height : float
        Height of the target below which the force increases smoothly, m: over the board, or
        over the greatest height of a recording that is never lifted.
    by_torque : bool
        Whether `impedance.force_control` uses the normal force from the arm's external
        torque, as behind LCM, instead of that of the simulated contact.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> Scenario(press=NormalForceConfig(force=8.0)).press.force
    8.0
    """

    force: float = bounded(10.0, least=0)
    engage_height: float = bounded(ENGAGE_HEIGHT, above=0)
    by_torque: bool = False


@dataclass(kw_only=True)
class InkConfig:
    """The ink on the board.

    Attributes
    ----------
    cell : float
        Edge of a cell, m.
    period : float
        Seconds between updates.
    words : str
        Text on the board, instead of ink all over.
    picture : str
        File of a picture on the board, relative to the scenario's.
    size : float or None
        Height of the capital letters, or width of the picture, m; None for the largest
        that fits.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> scenario = Scenario(ink=InkConfig(words="hello", size=0.1))
    >>> scenario.check()
    """

    cell: float = bounded(0.005, above=0, most=0.05)
    period: float = bounded(0.05, least=0.001, most=0.25)
    words: str = ""
    picture: str = ""
    size: float | None = bounded(None, above=0)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.words and self.picture:
            return "ink has words and a picture; give one of them."
        return ""


@dataclass(kw_only=True)
class SensorConfig:
    """Sensors of the arm's joints.

    Attributes
    ----------
    rate : float
        Measurements per second; 0 for the simulated state itself.
    delay : float
        Age of a measurement when it arrives, s.
    position_noise, velocity_noise : float
        Standard deviations, rad and rad/s.
    seed : int
        Of the noise.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> scenario = Scenario(sensors=SensorConfig(delay=0.002))
    >>> scenario.check()
    Traceback (most recent call last):
    fmp_drake.errors.StationError: sensors.delay needs a sensors.rate, 1000 Hz for example.
    """

    rate: float = bounded(0.0, least=0, most=1000)
    delay: float = bounded(0.0, least=0, most=1)
    position_noise: float = bounded(0.0, least=0)
    velocity_noise: float = bounded(0.0, least=0)
    seed: int = bounded(0, least=0)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        for name in ("delay", "position_noise", "velocity_noise"):
            if self.rate == 0 and getattr(self, name) > 0:
                return f"sensors.{name} needs a sensors.rate, 1000 Hz for example."
        return ""


@dataclass(kw_only=True)
class CameraConfig:
    """Camera of the page and of films, in the world, m.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> scenario = Scenario(camera=CameraConfig(eye=[0.0, -1.5, 1.2]))
    >>> scenario.camera.target
    [0.37, 0.0, 0.2]
    """

    eye: list[float] = bounded([1.50, -0.98, 0.86])
    target: list[float] = bounded([0.37, 0.0, 0.20])

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.eye == self.target:
            return "camera.eye and camera.target are the same point."
        return ""


@dataclass(kw_only=True)
class ShowConfig:
    """Optional items on the page beside arm, eraser and board.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> scenario = Scenario(show=ShowConfig(tube=False, mouse=False))
    >>> scenario.show.plan
    True
    """

    ink: bool = True
    demonstrations: bool = True
    trail: bool = True
    plan: bool = True
    tube: bool = True
    component: bool = True
    force: bool = True
    controls: bool = True
    mouse: bool = True


@dataclass(kw_only=True)
class SkillConfig:
    """Playback of the skill.

    Attributes
    ----------
    demonstration : str
        Recording to learn from: a bundled one (eight, polishing, pulsing, stirring,
        wiping) or a file, relative to the scenario's.
    file : str
        A learned skill to play instead.
    window : float
        Length of the windows to learn from, s.
    n_components : int or None
        Number of Gaussians; None for as many as the recordings allow.
    model : str
        automatic, phase or mixture, as for `FourierMovementPrimitive`.
    sample : bool
        Whether to track samples of the components or their means.
    candidates : int
        Number of samples at the start and at each re-mapping; the one that passes over
        the most ink of the demonstrated area is tracked. 1 for any sample, as in the paper.
    margin : float or None
        Largest distance of samples from the demonstrated paths, m; None for 20 mm, or, of a
        phase model, for the distance of the mean movement where cycles differ by more, at
        most a fifth of half the width of the movement.
    seed : int
        Of the samples.
    tempo : float
        1 is as demonstrated.
    push_threshold : float or None
        Distance from the path, m, above which the movement waits for a pushed
        robot; None for the periodic mode only.
    push_dwell : float
        Duration of a push until the motion of the robot is mapped, s.

    Examples
    --------
    >>> from fmp_drake.station import Scenario
    >>> scenario = Scenario(skill=SkillConfig(demonstration="eight", tempo=0.8))
    >>> scenario.check()
    """

    demonstration: str = "wiping"
    file: str = ""
    window: float = bounded(6.0, above=0)
    n_components: int | None = bounded(None, least=1)
    model: str = "automatic"
    sample: bool = True
    candidates: int = bounded(48, least=1, most=1000)
    margin: float | None = bounded(None, above=0)
    seed: int = bounded(0, least=0)
    tempo: float = bounded(1.0, least=0, most=4)
    push_threshold: float | None = bounded(None, above=0)
    push_dwell: float = bounded(0.2, above=0)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        if self.model not in (models := get_args(ModelChoice)):
            return f"skill.model is {self.model}; choose one of: {', '.join(models)}."
        return ""


def load_settings(schema: type, text: str | bytes) -> Any:
    """Check YAML text and load it as a dataclass, over its defaults.

    Parameters
    ----------
    schema : type
        The dataclass.
    text : str or bytes

    Raises
    ------
    StationError
        With a key that the dataclass does not have, or a value of another type.
    """
    check_yaml(text, "it", StationError)
    _check_types(yaml.load(text, Loader=yaml.CSafeLoader), schema())
    return load_yaml(schema, text.decode() if isinstance(text, bytes) else text)


def _check_types(value: Any, default: Any, name: str = "") -> None:
    """Raise an error for a value whose type is not that of its default value."""
    fields = field_names(default)
    if fields:
        path, allowed = name or "it", ", ".join(fields)
        if not isinstance(value, Mapping):
            raise StationError(
                f"{path} is {shown(value)} ({type(value).__name__}); expected a mapping "
                f"with any of: {allowed}."
            )
        for key, item in value.items():
            if key not in fields:
                suggestions = get_close_matches(str(key), fields, 1)
                hint = (
                    f"did you mean {suggestions[0]}? All" if suggestions else "allowed"
                )
                raise StationError(
                    f"{path} has no key {shown(key)}; {hint} are: {allowed}."
                )
            _check_types(item, getattr(default, key), f"{name}.{key}".lstrip("."))
    elif default == [] and isinstance(value, list):
        for i, item in enumerate(value):
            _check_types(item, _ITEMS.get(name, 0.0), f"{name}[{i}]")
    elif not _fits(value, default):
        expected = f"a list like {default}" if isinstance(default, list) else "a number"
        expected = _EXPECTED.get(type(default), expected)
        raise StationError(f"{name} is {shown(value)}; expected {expected}.")


# Items of lists that are empty by default; other lists contain numbers.
_ITEMS: dict[str, Any] = {"disturbances": Disturbance(), "contact_free": [""]}
_ITEMS |= dict.fromkeys(("joint_names", "joint_prefixes"), "")
_EXPECTED = {bool: "true or false", str: "text", type(None): "a number or null"}


def _fits(value: Any, default: Any) -> bool:
    if isinstance(default, list):
        return isinstance(value, list) and all(
            _fits(item, default[0] if default else 0.0) for item in value
        )
    if isinstance(default, bool | str):
        return isinstance(value, type(default))
    if value is None:
        return default is None
    if isinstance(value, str):  # YAML 1.1 reads 1e-3, without a point, as text.
        return re.fullmatch(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+", value) is not None
    return isinstance(value, int | float) and not isinstance(value, bool)


def field_names(value: Any) -> list[str]:
    """Return the names of a dataclass's fields, or of one of Drake's own configs."""
    if dataclasses.is_dataclass(value):
        return [field.name for field in dataclasses.fields(value)]
    return [field.name for field in getattr(type(value), "__fields__", ())]
