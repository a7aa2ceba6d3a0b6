"""The parts of a scenario, as dataclasses that mirror the YAML files.

Values are checked by `check`, because loading YAML does not construct anew.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from fmp_drake.errors import StationError

DISTURBANCES = ("push", "hold")


@dataclass(kw_only=True)
class BoardMotion:
    """A board that slides to and fro on a rail.

    Attributes
    ----------
    axis : list of 3 floats
        Direction of the rail in B.
    amplitude : float
        m; 0 for a board that stands still.
    frequency : float
        Hz.
    """

    axis: list[float] = field(default_factory=lambda: [0.0, 1.0, 0.0])
    amplitude: float = 0.0
    frequency: float = 0.1

    def check(self) -> None:
        """Check every value."""
        if np.linalg.norm(finite("board.motion.axis", self.axis, 3)) == 0:
            raise StationError("board.motion.axis is 0; expected a direction.")
        number("board.motion.amplitude", self.amplitude, at_least=0)
        number("board.motion.frequency", self.frequency, above=0)


@dataclass(kw_only=True)
class BoardError:
    """How far the board is from where the controller takes it to be.

    Attributes
    ----------
    translation : list of 3 floats
        Of the real board in the frame of the assumed one, m.
    rpy : list of 3 floats
        Roll, pitch, yaw of it, rad.
    """

    translation: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])


@dataclass(kw_only=True)
class BoardConfig:
    """The whiteboard.

    Attributes
    ----------
    translation : list of 3 floats
        p_WB, the centre of the surface in the frame of the robot's base, m.
    rpy : list of 3 floats
        Roll, pitch, yaw of R_WB, rad; z of B is the normal out of the surface.
    size : list of 2 floats
        Along x and y of B, m.
    friction : float
        Coefficient of friction of its surface.
    legs : bool
        Whether it is drawn with the legs of a table.
    error : BoardError
    motion : BoardMotion
    """

    translation: list[float] = field(default_factory=lambda: [0.55, 0.0, 0.10])
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    size: list[float] = field(default_factory=lambda: [0.50, 0.70])
    friction: float = 0.5
    legs: bool = True
    error: BoardError = field(default_factory=BoardError)
    motion: BoardMotion = field(default_factory=BoardMotion)

    def check(self) -> None:
        """Check every value."""
        self.pose()
        if min(finite("board.size", self.size, 2)) < 0.1:
            raise StationError(f"board.size is {self.size}; it must be 0.1 m or more.")
        number("board.friction", self.friction, at_least=0)
        self.motion.check()

    def assumed_pose(self) -> RigidTransform:
        """Return X_WB as the controller takes it to be, at the middle of the rail."""
        return _pose("board", self.translation, self.rpy)

    def pose(self) -> RigidTransform:
        """Return X_WB, at the middle of the rail."""
        error = _pose("board.error", self.error.translation, self.error.rpy)
        return self.assumed_pose() @ error

    def axis(self) -> list[float]:
        """Return the direction of the rail in B, a unit vector."""
        axis = np.array(self.motion.axis)
        return list(axis / np.linalg.norm(axis))


@dataclass(kw_only=True)
class EraserConfig:
    """The eraser in the robot's hand.

    Attributes
    ----------
    footprint : list of 2 floats
        Edges of its felt along x and y of E, m.
    modulus : float
        Stiffness of the felt: pressure for a depth of half its thickness, Pa.
    friction : float
        Coefficient of friction of its felt.
    worn : float
        Share of the felt's face that does not rub any more, from 0 to 1.
    """

    footprint: list[float] = field(default_factory=lambda: [0.12, 0.05])
    modulus: float = 1.25e4
    friction: float = 0.5
    worn: float = 0.0

    def check(self) -> None:
        """Check every value."""
        if min(finite("eraser.footprint", self.footprint, 2)) <= 0:
            raise StationError(
                f"eraser.footprint is {self.footprint}; it must be positive."
            )
        number("eraser.modulus", self.modulus, above=0)
        number("eraser.friction", self.friction, at_least=0)
        number("eraser.worn", self.worn, at_least=0, at_most=1)


@dataclass(kw_only=True)
class PressConfig:
    """How the eraser is pressed on the board.

    Attributes
    ----------
    force : float
        Along the board's normal, N; not negative.
    engage_height : float
        Height of the eraser and its target over the board below which the force comes
        in smoothly, m.
    """

    force: float = 10.0
    engage_height: float = 0.01

    def check(self) -> None:
        """Check every value."""
        number("press.force", self.force, at_least=0)
        number("press.engage_height", self.engage_height, above=0)


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
        What is written on the board, instead of ink all over.
    picture : str
        File of a picture that is drawn on the board, relative to the scenario's.
    size : float or None
        Height of the capital letters, or width of the picture, m; None for as large as fits.
    """

    cell: float = 0.005
    period: float = 0.05
    words: str = ""
    picture: str = ""
    size: float | None = None

    def check(self) -> None:
        """Check every value."""
        number("ink.cell", self.cell, above=0)
        number("ink.period", self.period, above=0)
        if self.size is not None:
            number("ink.size", self.size, above=0)
        if self.words and self.picture:
            raise StationError("ink has words and a picture; give one of them.")


@dataclass(kw_only=True)
class SkillConfig:
    """What the robot does.

    Attributes
    ----------
    demonstration : str
        Bundled (eight, polishing, wiping) or a file, relative to the scenario's, to
        learn from.
    file : str
        A learned skill to play instead.
    window, components
        Of the learning: seconds and Gaussians.
    sample : bool
        Whether to track samples of the components or their means.
    candidates : int
        How many samples are drawn at each re-mapping; the one that passes over the most
        ink is tracked. 1 for any sample, as in the paper.
    seed : int
        Of the samples.
    tempo : float
        1 is as demonstrated.
    push_threshold : float or None
        Distance from the path, m, from which on the movement waits for a pushed
        robot; None for the periodic mode only.
    push_dwell : float
        Seconds until the motion of a pushed robot is mapped.
    """

    demonstration: str = "wiping"
    file: str = ""
    window: float = 6.0
    components: int = 80
    sample: bool = True
    candidates: int = 32
    seed: int = 0
    tempo: float = 1.0
    push_threshold: float | None = None
    push_dwell: float = 0.2

    def check(self) -> None:
        """Check every value."""
        number("skill.tempo", self.tempo, at_least=0, at_most=4)
        number("skill.seed", self.seed, at_least=0)
        number("skill.candidates", self.candidates, at_least=1)
        number("skill.push_dwell", self.push_dwell, above=0)
        if self.push_threshold is not None:
            number("skill.push_threshold", self.push_threshold, above=0)


@dataclass(kw_only=True)
class Disturbance:
    """A person who disturbs the arm at its eraser, at given times.

    Attributes
    ----------
    kind : str
        `push`: a constant force. `hold`: a grip that pulls to a point like a spring.
    start, duration : float
        s.
    every : float
        Again after so many seconds; 0 for once.
    force : list of 3 floats
        Of a push, in B, N.
    position : list of 3 floats
        p_B of a hold, m.
    stiffness : float
        Of a hold, N/m; it is critically damped for a mass of 5 kg.
    max_force : float
        Greatest force of a hold, N.
    """

    kind: str = "push"
    start: float = 0.0
    duration: float = 1.0
    every: float = 0.0
    force: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    stiffness: float = 1000.0
    max_force: float = 60.0

    def check(self) -> None:
        """Check every value."""
        if self.kind not in DISTURBANCES:
            raise StationError(
                f"a disturbance's kind is {self.kind}; choose one of: "
                f"{', '.join(DISTURBANCES)}."
            )
        number("a disturbance's start", self.start, at_least=0)
        number("a disturbance's duration", self.duration, above=0)
        number("a disturbance's every", self.every, at_least=0)
        if 0 < self.every < self.duration:
            raise StationError(
                f"a disturbance of {self.duration} s comes every {self.every} s; it "
                "must end before it begins again."
            )
        finite("a disturbance's force", self.force, 3)
        finite("a disturbance's position", self.position, 3)
        number("a disturbance's stiffness", self.stiffness, above=0)
        number("a disturbance's max_force", self.max_force, above=0)


@dataclass(kw_only=True)
class SensorConfig:
    """How the controller measures the arm's joints.

    Attributes
    ----------
    rate : float
        Measurements per second; 0 for a direct look at the simulated state.
    delay : float
        Age of what arrives, s.
    position_noise, velocity_noise : float
        Standard deviations, rad and rad/s.
    seed : int
        Of the noise.
    """

    rate: float = 0.0
    delay: float = 0.0
    position_noise: float = 0.0
    velocity_noise: float = 0.0
    seed: int = 0

    def check(self) -> None:
        """Check every value."""
        number("sensors.rate", self.rate, at_least=0, at_most=1000)
        for name in ("delay", "position_noise", "velocity_noise", "seed"):
            number(f"sensors.{name}", getattr(self, name), at_least=0)
            if self.rate == 0 and name != "seed" and getattr(self, name) > 0:
                raise StationError(
                    f"sensors.{name} needs a sensors.rate, 1000 Hz for example."
                )


@dataclass(kw_only=True)
class CameraConfig:
    """From where the page and films look, in the frame of the robot's base, m."""

    eye: list[float] = field(default_factory=lambda: [1.50, -0.98, 0.86])
    target: list[float] = field(default_factory=lambda: [0.37, 0.0, 0.20])

    def check(self) -> None:
        """Check every value."""
        eye = finite("camera.eye", self.eye, 3)
        if eye == finite("camera.target", self.target, 3):
            raise StationError("camera.eye and camera.target are the same point.")


@dataclass(kw_only=True)
class ShowConfig:
    """What the page shows beside arm, eraser and board; each can be switched off."""

    ink: bool = True
    demonstrations: bool = True
    trail: bool = True
    plan: bool = True
    tube: bool = True
    component: bool = True
    force: bool = True
    controls: bool = True
    mouse: bool = True


def finite(name: str, values: Sequence[float], size: int) -> list[float]:
    """Return values if they are so many finite numbers."""
    if len(values) != size or not np.all(np.isfinite(values)):
        raise StationError(f"{name} is {values}; expected {size} finite numbers.")
    return list(values)


def number(
    name: str,
    value: float,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> None:
    """Refuse a value that is not finite or out of range."""
    bounds = {
        "above": (above, lambda bound: value > bound),
        "at least": (at_least, lambda bound: value >= bound),
        "at most": (at_most, lambda bound: value <= bound),
    }
    given = {word: bound for word, (bound, _) in bounds.items() if bound is not None}
    if math.isfinite(value) and all(bounds[word][1](b) for word, b in given.items()):
        return
    allowed = " and ".join(f"{word} {bound:g}" for word, bound in given.items())
    raise StationError(f"{name} is {value}; it must be {allowed}.")


def _pose(name: str, translation: list[float], rpy: list[float]) -> RigidTransform:
    angles = RollPitchYaw(np.array(finite(f"{name}.rpy", rpy, 3)))
    return RigidTransform(
        angles, np.array(finite(f"{name}.translation", translation, 3))
    )
