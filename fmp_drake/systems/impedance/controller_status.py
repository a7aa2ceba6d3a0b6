"""Status of the impedance controller: flags, and their texts for people."""

from enum import IntFlag
from typing import Literal, NamedTuple, Self

from numpy.typing import ArrayLike

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import as_floats


class StatusFlag(IntFlag):
    """Flags of the last update of the controller; any combination of them.

    The target was not followed:

    - `PROTECTIVE_STOP`: the arm is held, damped, at its position when a fault occurred.
    - `RECOVER`: the arm moves back to its target.
    - `NOT_FINITE`: an input was NaN, infinite or above 1e12.
    - `JUMP`: the target jumped.
    - `STALE`: the target is too old, or stands still although it has a velocity.
    - `IMPLAUSIBLE`: the target is too fast, accelerates too much, does not move with
      its velocity, or has a time in the future.
    - `NO_STATE`: the arm's state was not finite; the torque goes to zero.
    - `NOT_FOUND`: the surface is below the search range, or there is none.
    - `EXCESS_FORCE`: the normal force is far above the desired one.
    - `FORCE_OSCILLATION`: the normal force oscillates.
    - `SPEED_EXCEEDED`: a joint is faster than its limit.

    The torque was limited:

    - `ERROR_CLIPPED`: the error is greater than the stiffness responds to.
    - `NEAR_SINGULAR`: the inertia was bounded.
    - `TORQUE_LIMITED`, `RATE_LIMITED`: by the joints' effort or the torque's rate.
    - `JOINT_WALL`: a joint is near its limit, and pushed back.
    - `SPEED_LIMITED`: a joint is braked.
    - `OVERSPEED`: a joint could not have been braked in time with the desired torque,
      which was replaced, or exceeds its speed limit.

    The force and the stiffness:

    - `FORCE_CONTROL`: the normal force is controlled in closed loop.
    - `CONTACT_LOST`: a normal force is desired, but there is no contact.
    - `FORCE_LIMITED`: the surface is at the end of the search range.
    - `STIFFNESS_REFUSED`: the stiffness or covariance at the port was not symmetric
      positive (semi)definite, or the stiffness was too large.
    - `TANK_EMPTY`: the energy tank held the stiffness back.

    Not from the controller: a `SurfaceMonitor` adds them to the status of a station.

    - `BELOW_SURFACE`: something hard is below the board's surface.
    - `ARM_TOUCHES`: a link of the arm touches the board.

    Examples
    --------
    >>> flags = StatusFlag(576)
    >>> StatusFlag.RATE_LIMITED in flags, StatusFlag.PROTECTIVE_STOP in flags
    (True, False)
    """

    PROTECTIVE_STOP = 1
    RECOVER = 2
    NOT_FINITE = 4
    JUMP = 8
    STALE = 16
    NO_STATE = 32
    ERROR_CLIPPED = 64
    NEAR_SINGULAR = 128
    TORQUE_LIMITED = 256
    RATE_LIMITED = 512
    JOINT_WALL = 1024
    SPEED_LIMITED = 2048
    FORCE_CONTROL = 4096
    CONTACT_LOST = 8192
    FORCE_LIMITED = 16384
    STIFFNESS_REFUSED = 32768
    TANK_EMPTY = 65536
    NOT_FOUND = 131072
    IMPLAUSIBLE = 262144
    OVERSPEED = 524288
    BELOW_SURFACE = 1048576
    ARM_TOUCHES = 2097152
    EXCESS_FORCE = 4194304
    FORCE_OSCILLATION = 8388608
    SPEED_EXCEEDED = 16777216


class ImpedanceStatus(NamedTuple):
    """The vector at the controller's port `status`, by name.

    Attributes
    ----------
    flags : StatusFlag
        Actions and conditions of the last update.
    target_fraction : float
        1 where the target is followed, 0 in a protective stop, between them in
        recovery.
    torque_scale, rate_scale : float
        Factors in (0, 1] by which the torque and its change were shortened.
    surface_height : float
        Height of the surface that was found above the assumed one, m.
    tank_energy : float
        Energy that the stiffness may still take from the tank, J.

    Examples
    --------
    >>> status = ImpedanceStatus.from_vector([512.0, 1.0, 1.0, 0.8, 0.0, 0.5])
    >>> status.flags.name, status.rate_scale
    ('RATE_LIMITED', 0.8)
    """

    flags: StatusFlag
    target_fraction: float
    torque_scale: float
    rate_scale: float
    surface_height: float
    tank_energy: float

    @classmethod
    def from_vector(cls, vector: ArrayLike) -> Self:
        """Read the port's vector.

        Parameters
        ----------
        vector : array_like, shape (6,)
            The fields in their order.

        Raises
        ------
        SystemsError
            If the vector has another size, or its flags are not a whole number.
        """
        size = len(cls._fields)
        values = as_floats(vector, "the status", (size,), error=SystemsError)
        flags, *rest = values.tolist()
        if flags < 0 or not flags.is_integer():
            raise SystemsError(
                f"the flags of the status are {flags}; they must be a whole number, at "
                "least 0."
            )
        return cls(StatusFlag(int(flags)), *rest)


class Condition(NamedTuple):
    """Words for a flag of the status.

    Attributes
    ----------
    level : str
        ``busy`` where the arm continues without help, or ``bad``.
    mode, detail : str
        Text on a page: one or two words, and the reason; the mode is empty where it is
        not shown.
    event : str
        Text in the list of a run's problems; empty where it is not listed.
    advice : str
        What a person can do about the event.
    """

    level: Literal["busy", "bad"]
    mode: str
    detail: str
    event: str = ""
    advice: str = ""


CONDITIONS = {
    StatusFlag.PROTECTIVE_STOP: Condition(
        "bad",
        "protective stop",
        "",
        "protective stop",
        "The arm returns by itself. If it stops again, lower the tempo, or check the pose "
        "of the board.",
    ),
    StatusFlag.RECOVER: Condition("busy", "going back", "after a protective stop: "),
    StatusFlag.BELOW_SURFACE: Condition(
        "bad",
        "below the board",
        "something hard is below the surface",
        "a hard part below the board",
        "Lower the normal force.",
    ),
    StatusFlag.ARM_TOUCHES: Condition(
        "bad",
        "arm on the board",
        "a link of the arm touches the board",
        "the arm touches the board",
        "Move the board away from the arm's base.",
    ),
    StatusFlag.OVERSPEED: Condition(
        "busy",
        "braking",
        "a joint is near its speed limit",
        "a joint near its speed limit",
        "Lower the tempo, or the stiffness.",
    ),
    StatusFlag.CONTACT_LOST: Condition(
        "busy",
        "searching for the board",
        "there is no contact where there should be",
        "contact lost",
        "The arm searches for the board by itself.",
    ),
    StatusFlag.JOINT_WALL: Condition("busy", "", "", "a joint at its limit"),
}
"""Conditions of a wiping arm that are shown or reported to a person, worst first.

The reasons of a protective stop, `STOP_REASONS`, follow its detail."""

STATUS_SIZE = len(ImpedanceStatus._fields)

STOP_REASONS = {
    StatusFlag.JUMP: "the target jumped away",
    StatusFlag.STALE: "the target was too old",
    StatusFlag.NOT_FINITE: "an input was not finite",
    StatusFlag.NO_STATE: "the arm's state was not known",
    StatusFlag.NOT_FOUND: "no board was found within the search range",
    StatusFlag.IMPLAUSIBLE: "the target moved in an implausible way",
    StatusFlag.EXCESS_FORCE: "the normal force was far above the desired one",
    StatusFlag.FORCE_OSCILLATION: "the normal force oscillated",
    StatusFlag.SPEED_EXCEEDED: "a joint was faster than its limit",
}
"""Reasons of a protective stop, by the flag of the fault that began it."""
