"""Whether the arm can follow a skill on a board, before anything moves."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.common.yaml import yaml_dump_typed

from fmp_drake.blas import one_blas_thread
from fmp_drake.errors import StationError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.station.parts.board_reach import BoardReach, FollowingBounds
from fmp_drake.station.parts.held_arm import HeldMotion
from fmp_drake.station.parts.skill_paths import CheckPositions, skill_paths
from fmp_drake.station.scenario import ParseScenario, Scenario

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
type Values = dict[str, np.floating | float]

# Samples of all windows together, windows at the least and most; every other is used.
_SAMPLES, _WINDOWS, _EVERY = 6000, (8, 48), 2
# Windows that are played from the start, each with a seed of its own.
_BEGINNINGS = 3
# A slower tempo is checked as this one: the joints' way is the same, and slow enough.
_SLOWEST = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class Feasibility:
    """Whether an arm can follow a skill on a board, and why not.

    Attributes
    ----------
    is_feasible : bool
    verdict : str
        One line: the numbers that decide, and what would help.
    values : dict
        ``reachable_fraction`` of the samples, ``largest_distance`` (m) that is left to
        one, ``smallest_joint_margin`` to a limit (rad), ``wall_fraction`` of the samples
        with a joint at its wall, ``smallest_manipulability`` (sqrt det J Jᵀ, m³),
        ``smallest_clearance`` of the arm's links from the board (m),
        ``largest_speed_ratio`` to the joints' limits, ``largest_torque_ratio``, ``drag``
        by friction (m), and what would still do: ``largest_tempo``, ``largest_press`` (N). The
        ratios are those that but `FollowingBounds.exceptions` of the samples keep.
    start : array, shape (3,)
        p_BE, m.
    paths : array, shape (B, T, 3)
        The samples of the skill, p_BE, m.
    followed : array, shape (B, T)
        Whether each can be followed.
    posture : array, shape (n,)
        Of the controller, rad.
    scenario : str
        As it was when it was checked, YAML.
    bounds : FollowingBounds

    Examples
    --------
    >>> list(Feasibility.__dataclass_fields__)[:3]
    ['is_feasible', 'verdict', 'values']
    """

    is_feasible: bool
    verdict: str
    values: dict[str, float]
    start: Array
    paths: Array
    followed: NDArray[np.bool_]
    posture: Array
    scenario: str
    bounds: FollowingBounds

    @cached_property
    def cells(self) -> tuple[Array, Array, Array]:
        """How far the joints are from their walls over the board; found when asked for.

        x (nx,) and y (ny,) of its cells in B, m, and the margin (nx, ny) with the eraser
        there, rad; NaN where it is out of reach.
        """
        with one_blas_thread():
            reach = BoardReach(ParseScenario(self.scenario), self.bounds)
            return reach.cells(self.posture)


@one_blas_thread()
def CheckFeasibility(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    *,
    bounds: FollowingBounds | None = None,
) -> Feasibility:
    """Tell whether the arm can follow a skill on a scenario's board.

    Kinematics of the arm as the controller would hold it (`HeldArm`), along windows
    that are drawn from the skill and windows that are played from the start: where the
    board is assumed to be, and where it is, and on its way along its rail.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels in the frame of the board, m.
    bounds : FollowingBounds, optional

    Raises
    ------
    StationError
        Where the scenario has values that do not fit, or the skill no 3 channels.

    Examples
    --------
    >>> from fmp_drake.primitives import Demonstration
    >>> from fmp_drake.station import LoadScenario, models_dir
    >>> wiping = Demonstration.load(models_dir() / "demonstrations" / "wiping.npz")
    >>> skill = FourierMovementPrimitive().fit(wiping)
    >>> scenario = LoadScenario("table_top")
    >>> CheckFeasibility(scenario, skill).is_feasible
    True
    >>> scenario.board.translation = [0.85, 0.0, 0.1]
    >>> CheckFeasibility(scenario, skill).is_feasible
    False
    """
    scenario.check()
    CheckPositions(skill)
    return _Check(scenario, skill, bounds or FollowingBounds()).result()


class _Check:
    """One check: the paths, what the arm makes of them, and how that is judged."""

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        bounds: FollowingBounds,
    ) -> None:
        self._scenario, self._bounds = scenario, bounds
        self._reach = BoardReach(scenario, bounds)
        plays, board = scenario.skill, scenario.board
        self._tempo = max(plays.tempo, _SLOWEST)
        self._step = _EVERY / (self._tempo * skill.rate)
        self._shown = skill_paths(
            skill,
            start=scenario.start,
            tempo=self._tempo,
            sample=plays.sample,
            seed=plays.seed,
            beginnings=_BEGINNINGS,
            windows=int(np.clip(_SAMPLES // skill.n_steps, *_WINDOWS)),
            every=_EVERY,
        )
        # Each path meets the board elsewhere on its rail; the first one at its end.
        count, length = self._shown.shape[:2]
        omega, rail = 2 * math.pi * board.motion.frequency, self._reach.rail
        phase = np.linspace(-0.5, 1.5, count, endpoint=False)[:, None] * math.pi
        phase = (phase + omega * self._step * np.arange(length))[..., None]
        self._moved = np.sin(phase) * rail
        self._paths = self._shown + self._moved
        self._faults: list[str] = []
        self._advice: list[str] = []

    def result(self) -> Feasibility:
        """Follow the paths, judge, and look for what helps."""
        scenario, reach, board = self._scenario, self._reach, self._scenario.board
        X_WB = [board.assumed_pose()]
        if any([*board.error.translation, *board.error.rpy]):
            X_WB.append(board.pose())
        try:
            posture = reach.start_posture()
        except StationError:
            self._faults.append("the start is out of reach")
            posture = reach.near_postures(X_WB[:1])[0]
        postures = np.tile(posture, (len(X_WB), 1))
        motion = reach.follow(X_WB, self._paths, step=self._step, postures=postures)
        near = reach.clearance(X_WB, motion, self._moved)
        reached, missed = self._judge_reach(motion, *near)
        values = reached | self._judge_speed(motion) | self._judge_force(motion)
        ratios = [
            f"{100 * values[name]:.0f} %"
            for name in ("largest_speed_ratio", "largest_torque_ratio")
        ]
        verdict = (
            "The arm can follow this skill: it stays "
            f"{values['smallest_joint_margin']:.2f} rad from its joints' limits and "
            f"needs up to {ratios[0]} of their speed and {ratios[1]} of their torque."
        )
        if self._faults:
            verdict = f"The arm cannot follow this skill: {'; '.join(self._faults)}."
        if self._advice:
            verdict += f" What would help: {', '.join(self._advice)}."
        return Feasibility(
            is_feasible=not self._faults,
            verdict=verdict,
            values={name: float(value) for name, value in values.items()},
            start=np.array(scenario.start),
            paths=self._shown,
            followed=~np.any(missed.reshape(-1, *self._shown.shape[:2]), axis=0),
            posture=posture,
            scenario=yaml_dump_typed(scenario),  # type: ignore[no-untyped-call]
            bounds=self._bounds,
        )

    def _often(self, missed: Flags) -> bool:
        return float(np.mean(missed)) > self._bounds.exceptions

    def _judge_reach(
        self, motion: HeldMotion, clearance: Array, link: str
    ) -> tuple[Values, Flags]:
        """Return the values, and the samples where the arm cannot or must not be."""
        out, at_wall, room = self._reach.missed(motion)
        near = clearance < self._bounds.clearance
        distance = np.linalg.norm(motion.error[..., 3:], axis=-1)
        if self._often(out):
            self._faults.append(
                f"{100 * np.mean(out):.1f} % of the way is out of reach, by up to "
                f"{1e3 * np.max(distance):.0f} mm"
            )
        if self._often(at_wall):
            self._faults.append(
                f"{100 * np.mean(at_wall):.1f} % of the way is at a joint's wall, and "
                f"joint {_joint(-room)} comes to {max(np.min(room), 0.0):.2f} rad of its "
                "limit"
            )
        if self._often(near):
            self._faults.append(
                f"on {100 * np.mean(near):.1f} % of the way {link} touches the board, or "
                f"comes nearer than {1e3 * self._bounds.clearance:.0f} mm"
            )
        if self._faults:
            self._advice.append(
                self._reach.shortest_move(self._paths, self._moved, self._step)
            )
        return {
            "reachable_fraction": 1 - np.mean(out),
            "largest_distance": np.max(distance),
            "smallest_joint_margin": np.min(room),
            "wall_fraction": np.mean(at_wall),
            "smallest_clearance": np.min(clearance),
            "smallest_manipulability": np.min(motion.manipulability),
        }, out | at_wall | near

    def _judge_speed(self, motion: HeldMotion) -> Values:
        speed = np.abs(motion.v) / self._reach.limits.speed
        fastest = np.max(speed, axis=-1)
        # Faster than the controller brakes, it would be beside its path, or too fast.
        allowed = self._scenario.impedance.walls.speed_fraction
        usual = np.quantile(fastest, 1 - self._bounds.exceptions)
        tempo = self._tempo * allowed / usual
        # Out of reach, and at a wall, the joints' speed says nothing.
        if usual > allowed and not self._faults:
            self._faults.append(
                f"joint {_joint(speed)} needs {100 * usual:.0f} % of its greatest speed, "
                f"and is braked from {100 * allowed:.0f} % on"
            )
            slower = max(math.floor(20 * tempo) / 20, 0.05)
            self._advice.append(f"slow down to tempo {slower:.2f}")
        return {
            "largest_speed_ratio": usual,
            "largest_tempo": tempo,
        }

    def _judge_force(self, motion: HeldMotion) -> Values:
        bounds, force = self._bounds, self._scenario.press.force
        effort, drag = self._reach.limits.upper_effort, self._drag()
        torque, press = motion.torque / effort, motion.press_torque / effort
        ratio = np.quantile(
            np.max(np.abs(torque + force * press), axis=-1), 1 - bounds.exceptions
        )
        room = bounds.torque_fraction - np.sign(press) * torque
        most = np.min(room / np.maximum(np.abs(press), 1e-9), axis=-1)
        most = np.quantile(np.maximum(most, 0.0), bounds.exceptions)
        limit = min(float(most), bounds.drag / max(drag, 1e-9))
        if ratio > bounds.torque_fraction and not self._faults:
            self._faults.append(f"a joint needs {100 * ratio:.0f} % of its torque")
        if drag * force > bounds.drag:
            self._faults.append(
                f"at a press of {force:g} N friction holds the eraser "
                f"{1e3 * drag * force:.0f} mm behind its path"
            )
        if force > limit > 0:
            self._advice.append(f"press with at most {math.floor(limit)} N")
        return {
            "largest_torque_ratio": ratio,
            "drag": drag * force,
            "largest_press": limit,
        }

    def _drag(self) -> float:
        """Return how far friction holds the eraser back, per newton of press, m/N."""
        config = self._scenario.impedance
        stiffness = min(config.translational_stiffness[:2])
        soft = config.covariance_stiffness
        if soft.enabled:  # Somewhere between the two.
            stiffness = math.sqrt(soft.min_stiffness * soft.max_stiffness)
        return self._scenario.contact_friction() / stiffness


def _joint(values: Array) -> int:
    """Return the number, from 1, of the joint with the largest value."""
    return int(np.unravel_index(np.argmax(values), values.shape)[-1]) + 1
