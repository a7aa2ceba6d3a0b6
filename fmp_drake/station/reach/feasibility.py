"""Feasibility of a skill on a board, before anything moves."""

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.common.yaml import yaml_dump_typed

from fmp_drake.errors import StationError
from fmp_drake.numeric import Array, Mask, one_blas_thread, rms
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.station.reach.board_reach import (
    LONGEST_MOVE,
    BoardReach,
    FollowingBounds,
)
from fmp_drake.station.reach.deviation_prediction import predict_lifts
from fmp_drake.station.reach.tracking_prediction import PredictedMotion, lengths
from fmp_drake.station.scenario import ParseScenario, Scenario, check_scenario
from fmp_drake.station.scenario_parts import FORCE_TOLERANCE
from fmp_drake.station.skill_motion import (
    SampledForces,
    SampledRotations,
    SampleSkillPaths,
    SkillRoles,
)

type Values = dict[str, np.floating | float]

# Ticks of a skill between two samples of its paths.
_STRIDE = 2
# Smallest checked tempo; at lower ones the joint motions are the same, and slow enough.
_MIN_TEMPO = 0.25
# Remedies: number of moves of the board, and factors of tempo and normal force with respect
# to the values that the check has found possible.
_MOVES, _FACTORS = 4, (1.0, 0.9, 0.75)


@dataclass(frozen=True, kw_only=True, eq=False)
class Feasibility:
    """Feasibility of a skill on a board, with the reasons against it.

    Attributes
    ----------
    is_feasible : bool
    is_doubtful : bool
        Whether only predictions of the motion, which may be wrong, speak against it: see
        `fmp_drake.runs.CheckWithRehearsal`.
    verdict : str
        One line: the decisive numbers and, where it was requested, the smallest change
        with which the check passes.
    values : dict
        ``reachable_fraction`` of the samples; ``largest_distance`` (m) and
        ``largest_angle`` (rad) between desired and predicted poses;
        ``smallest_joint_margin`` to a limit (rad); ``wall_fraction`` of the samples with a
        joint at its limit spring; ``smallest_manipulability`` (sqrt det J Jᵀ, m³);
        ``smallest_clearance`` of the arm's links from the board (m);
        ``largest_speed_ratio`` and ``largest_torque_ratio`` to the joints' limits;
        ``deviation`` (rms, m) of the eraser where joints are damped, braked or at their
        limits, or the arm is nearly singular; ``friction_lag`` of the eraser (rms, m); the
        predicted ``tracking_error`` (rms, m); ``force_error`` (rms, N), and
        ``unsteady_fraction`` of the samples at which such joints and poses out of reach
        change the normal force by more than 5 N; ``push_deviation``, the height to which
        scripted pushes lift the eraser off the board (m); the ``largest_tempo`` at which
        no joint is braked, and the ``largest_press`` (N) that friction and the joints'
        torques allow.
        Ratios exclude `FollowingBounds.exceptions` of the samples. In free space there are
        no clearance, friction and normal force; the angle needs rotation channels.
    start : array, shape (3,)
        p_BE, or (u, v, h) over a curved board, m.
    paths : array, shape (B, T, 3)
        The samples of the skill, likewise, m.
    followed : array, shape (B, T)
        Whether each can be followed.
    posture : array, shape (n,)
        Of the controller, rad.
    scenario : str
        Checked scenario, YAML.
    bounds : FollowingBounds
    suggestion : dict
        Values of ``tempo``, ``press_force`` (N) and ``start`` (m), and ``move_board``, a
        displacement of the board in the world (m), with which the check passes; empty where
        none was found.

    Examples
    --------
    >>> list(Feasibility.__dataclass_fields__)[:3]
    ['is_feasible', 'is_doubtful', 'verdict']
    """

    is_feasible: bool
    is_doubtful: bool
    verdict: str
    values: dict[str, float]
    start: Array
    paths: Array
    followed: Mask
    posture: Array
    scenario: str
    bounds: FollowingBounds
    suggestion: dict[str, Any] = field(default_factory=dict)

    @property
    def suggested_tempo(self) -> float | None:
        """Slower tempo at which the check passes, if nothing else has to change."""
        return self.suggestion["tempo"] if [*self.suggestion] == ["tempo"] else None

    @cached_property
    def cells(self) -> tuple[Array, Array, Array]:
        """Joint-limit margins over the whole board; computed at the first access.

        x (nx,) and y (ny,) of its cells in B, m, and the margin (nx, ny) of an eraser at
        each cell, rad; NaN out of reach.
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
    suggest: bool = True,
) -> Feasibility:
    """Check whether the arm can follow a skill on a scenario's board.

    `TrackingPredictor` predicts the arm's motion along windows that are drawn from the
    skill and windows that are played from the start. They are checked for the assumed and
    the actual pose of the board, and along its rail.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted, with channels that `MakeStation` can play.
    bounds : FollowingBounds, optional
    suggest : bool
        Whether to look for a change with which the check passes; it takes several times as
        long as the check.

    Raises
    ------
    StationError
        If a value of the scenario is not allowed, or a channel of the skill has no role.

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
    check_scenario(scenario, "CheckFeasibility(scenario, skill)")
    bounds = bounds or FollowingBounds()
    check = _Check(scenario, skill, bounds)
    feasibility = check.result()
    if feasibility.is_feasible or not suggest:
        return feasibility
    remedy, suggestion = check.remedy()
    verdict = f"{feasibility.verdict} What would help: {remedy}."
    return replace(feasibility, verdict=verdict, suggestion=suggestion)


class _Check:
    """Check of a skill: its paths, the predicted motion of the arm, and the verdict."""

    def __init__(
        self,
        scenario: Scenario,
        skill: FourierMovementPrimitive,
        bounds: FollowingBounds,
        values: Array | None = None,
    ) -> None:
        self._scenario, self._skill, self._bounds = scenario, skill, bounds
        self._most_error = bounds.tracking_error * scenario.tolerance
        self._reach = BoardReach(scenario, bounds)
        board, roles = scenario.board, SkillRoles(skill)
        self._tempo = max(scenario.skill.tempo, _MIN_TEMPO)
        self._step = _STRIDE / (self._tempo * skill.rate)
        if values is None:
            values = SampleSkillPaths(
                scenario, skill, roles, tempo=self._tempo, stride=_STRIDE
            )
        self._values = values
        self._paths = values[..., list(roles.position)]
        self._R_TE = SampledRotations(roles, values)
        self._X_WB = [board.assumed_pose()]
        if any([*board.error.translation, *board.error.rpy]):
            self._X_WB.append(board.pose())
        boards = len(self._X_WB)
        # Normal force, N: of all samples, or at each one.
        self._force = SampledForces(scenario, skill, roles, values)
        if np.ndim(self._force):
            self._force = np.tile(self._force, (boards, 1))
        lags = self._reach.friction_lag(self._paths, boards, self._force)
        self._friction_lag = rms(lags)
        count, length = self._paths.shape[:2]
        self._displacement = self._reach.displacements(count, length, self._step)
        # What is wrong, and those predictions of it that may be wrong themselves.
        self._faults: list[str] = []
        self._doubtful: list[str] = []
        # Remedies: a move of the board, a setting in words, a slower tempo, a smaller or greater
        # normal force (N).
        self._is_far = self._is_disturbed = False
        self._setting = ""
        self._slower: float | None = None
        self._softer: float | None = None
        self._firmer: float | None = None
        self._changed_pace: dict[str, Any] = {}

    def result(self) -> Feasibility:
        """Predict the motion along the paths, and return the verdict."""
        scenario, reach, X_WB = self._scenario, self._reach, self._X_WB
        try:
            posture = reach.start_posture()
        except StationError:
            self._faults.append("the start is out of reach")
            posture = reach.near_postures(X_WB[:1], [0.0, 0.0, scenario.start[2]])[0]
        motion = reach.follow(
            X_WB,
            self._paths,
            moved=self._displacement,
            step=self._step,
            postures=np.tile(posture, (len(X_WB), 1)),
            R_TE=self._R_TE,
        )
        deviation, error, hindrance = reach.deviation(
            motion,
            self._paths,
            force=float(np.max(self._force)),
            q_posture=posture,
            step=self._step,
        )
        lag, turn = map(rms, lengths(deviation, has_rotation=self._R_TE is not None))
        values, missed = self._judge_reach(motion, lag)
        values |= self._judge_speed(motion)
        values |= self._judge_force(motion, reach.start_force(posture))
        tempo = float(values["largest_tempo"])
        values |= self._judge_deviation(lag, turn, error, tempo, hindrance)
        values |= self._judge_pushes(motion)
        if not self._faults:
            self._faults, self._setting = reach.oscillation(motion, self._step)
        speed, torque = values["largest_speed_ratio"], values["largest_torque_ratio"]
        braked = ", at which joints are braked," if speed > 1 else ""
        margin = values["smallest_joint_margin"]
        stays = f"stays {margin:.2f} rad from its joint limits and "
        verdict = (
            f"The arm can follow this skill: it {stays if margin < np.inf else ''}needs up "
            f"to {100 * speed:.0f} % of the speed limits{braked} and {100 * torque:.0f} % of "
            "the torque limits."
        )
        if scenario.has_board and not np.any(reach.pressed(self._paths, 1)):
            lowest = 1e3 * np.min(self._paths[..., 2])
            verdict += f" It never comes nearer to the board than {lowest:.0f} mm."
        if self._faults:
            verdict = f"The arm cannot follow this skill: {'; '.join(self._faults)}."
        return Feasibility(
            is_feasible=not self._faults,
            is_doubtful=0 < len(self._faults) == len(self._doubtful),
            verdict=verdict,
            values={name: float(value) for name, value in values.items()},
            start=np.array(scenario.start),
            paths=self._paths,
            followed=~np.any(missed.reshape(-1, *self._paths.shape[:2]), axis=0),
            posture=posture,
            scenario=yaml_dump_typed(scenario),  # type: ignore[no-untyped-call]
            bounds=self._bounds,
        )

    def remedy(self) -> tuple[str, dict[str, Any]]:
        """Return the smallest change with which the check passes: text and values.

        Each change is checked as a separate scenario.
        """
        if self._setting:
            return self._setting, {}
        if words := self._pace_remedy():
            return words, self._changed_pace
        may_move = self._is_far or self._is_disturbed
        for words, values in self._changes() if may_move else ():
            check = self._changed_by(values)
            if check.result().is_feasible:
                return words, values
            if pace := check._pace_remedy():
                return f"{words}, and {pace}", values | check._changed_pace
        what = "board" if self._scenario.has_board else "motion"
        return (
            "none of the tested changes (a slower tempo, a smaller normal force, a start "
            f"in the middle, moves of the {what} by up to {100 * LONGEST_MOVE:.0f} cm); "
            f"turn the {what}, or make the movement smaller"
        ), {}

    def _changes(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield changes of the start and the board, the smallest one first."""
        scenario, start = self._scenario, [0.0, 0.0, self._scenario.start[2]]
        if not scenario.has_board:
            start = (np.median(self._paths, axis=(0, 1)).round(3) + 0.0).tolist()
        words = "start at {:g} {:g} {:g}".format(*start)
        if start != scenario.start:
            yield words, {"start": start}
        base = self._reach.p_WBase
        move = base - scenario.board.translation
        if not scenario.has_board and np.any(move):
            # Where it was recorded, if in axes of the world from the robot's base.
            words = "board.translation: [{:g}, {:g}, {:g}], and ".format(*base) + words
            yield words, {"start": start, "move_board": (move + 0.0).tolist()}
        moves = self._reach.moves_into_reach(
            self._paths, self._displacement, self._step, self._R_TE
        )
        for words, move in moves[:_MOVES]:
            # Without a negative zero.
            yield words, {"move_board": (move + 0.0).tolist()}

    def _changed_by(self, values: dict[str, Any]) -> "_Check":
        """Return the check with the values of a suggestion; the same samples if it plays them."""
        changed, samples = deepcopy(self._scenario), self._values
        changed.start = values.get("start", changed.start)
        moved = np.add(changed.board.translation, values.get("move_board", 0.0))
        changed.board.translation = moved.tolist()
        changed.press.force = values.get("press_force", changed.press.force)
        changed.skill.tempo = values.get("tempo", changed.skill.tempo)
        is_same = {"start", "tempo"}.isdisjoint(values)
        return _Check(changed, self._skill, self._bounds, samples if is_same else None)

    def _pace_remedy(self) -> str:
        """Return a text about tempo and normal force with which the check passes."""
        if self._is_far or not (self._slower or self._softer or self._firmer):
            return ""
        for factor in _FACTORS:
            words, pace = [], dict[str, Any]()
            if self._slower is not None:
                pace["tempo"] = max(math.floor(20 * factor * self._slower) / 20, 0.05)
                words.append(f"slow down to tempo {pace['tempo']:.2f}")
            if self._softer is not None:
                pace["press_force"] = float(math.floor(factor * self._softer))
                words.append(f"press with at most {pace['press_force']:.0f} N")
            elif self._firmer is not None:
                pace["press_force"] = float(math.ceil(self._firmer / factor))
                words.append(f"press with at least {pace['press_force']:.0f} N")
            check = self._changed_by(pace)
            # The felt may not bear the normal force.
            if check._scenario.inconsistency():
                continue
            is_enough = check.result().is_feasible
            # Joints that are too fast are only seen with a force that they can bear.
            if not is_enough and self._slower is None and check._slower is not None:
                words.append(check._pace_remedy())
                pace |= check._changed_pace
                is_enough = [*check._changed_pace] == ["tempo"]
            if is_enough:
                self._changed_pace = pace
                return " and ".join(words)
        return ""

    def _doubt(self, fault: str) -> None:
        self._faults.append(fault)
        self._doubtful.append(fault)

    def _is_frequent(self, missed: Mask) -> bool:
        return float(np.mean(missed)) > self._bounds.exceptions

    def _judge_reach(self, motion: PredictedMotion, lag: float) -> tuple[Values, Mask]:
        """Return the values, and the samples that are out of reach or too near the board.

        For poses that are briefly out of reach, the predicted errors decide. That of the
        position is the root sum of squares of distance and `off_path`.
        """
        has_rotation, bounds = self._R_TE is not None, self._bounds
        far, tilted, at_spring, margin = self._reach.missed(
            motion, has_rotation=has_rotation
        )
        is_missed = far | tilted
        distance, tilt = lengths(motion.error, has_rotation=has_rotation)
        error = math.hypot(rms(distance), self._reach.off_path(lag, self._friction_lag))
        is_far = self._is_frequent(far) and (
            error > self._most_error or self._is_frequent(distance > bounds.farthest)
        )
        tilt_rms = rms(tilt)
        is_tilted = self._is_frequent(tilted) and (
            tilt_rms > bounds.tilt_error or self._is_frequent(tilt > bounds.steepest)
        )
        text, is_off = "", is_missed
        if is_far or is_tilted:
            text = (
                f"{100 * np.mean(is_missed):.1f} % of the path is out of reach, by up to "
                f"{1e3 * np.max(distance):.0f} mm"
            )
            if has_rotation or is_tilted:
                text += f" and {np.rad2deg(np.max(tilt)):.0f} degrees"
        elif has_rotation and tilt_rms > bounds.orientation_error:
            text = f"the tool is off its orientation by {np.rad2deg(tilt_rms):.1f} degrees rms"
            is_off = tilt > bounds.orientation_error
        if text and np.any(is_off & at_spring):
            text += f", where joint {_joint(-margin)} is at a joint-limit spring"
        if text:
            self._doubt(text)
        clearance, faults, touching = self._reach.contacts(
            self._X_WB, motion, self._displacement
        )
        self._faults += faults
        self._is_far = bool(self._faults)
        faults, missing = self._reach.missing_board(self._paths)
        self._faults += faults
        self._setting = touching or missing
        values: Values = {}
        if has_rotation:
            values["largest_angle"] = np.max(tilt)
        if self._scenario.has_board:
            values["smallest_clearance"] = np.min(clearance)
        return {
            **values,
            "reachable_fraction": 1 - np.mean(is_missed),
            "largest_distance": np.max(distance),
            "tracking_error": error,
            "smallest_joint_margin": np.min(margin),
            "wall_fraction": np.mean(at_spring),
            "smallest_manipulability": np.min(motion.manipulability),
        }, is_missed | (clearance < bounds.clearance)

    def _judge_speed(self, motion: PredictedMotion) -> Values:
        """Return the values of the joints' speed."""
        speed, bounds = np.abs(motion.v) / self._reach.limits.speed, self._bounds
        fastest = np.max(speed, axis=-1)
        allowed = self._scenario.impedance.walls.speed_fraction
        ratio = np.quantile(fastest, 1 - bounds.exceptions)
        tempo, above = self._tempo * allowed / ratio, float(np.mean(fastest > 1))
        # Out of reach, or at a joint-limit spring, the joints' speed is meaningless.
        if above > bounds.brief and not self._faults:
            self._doubt(
                f"joint {_joint(speed)} needs {100 * ratio:.0f} % of its greatest speed, and "
                f"more than 100 % on {100 * above:.1f} % of the path"
            )
            self._slower = tempo
        return {"largest_speed_ratio": ratio, "largest_tempo": tempo}

    def _judge_force(self, motion: PredictedMotion, start_force: float) -> Values:
        bounds, force = self._bounds, float(np.max(self._force))
        joints = self._reach.limits
        effort = np.minimum(joints.upper_effort, -joints.lower_effort)
        friction_lag, tolerance = self._friction_lag, self._scenario.tolerance
        torque, per_newton = motion.torque / effort, motion.force_torque / effort
        load = np.abs(torque + np.asarray(self._force)[..., None] * per_newton)
        ratio = np.quantile(np.max(load, axis=-1), 1 - bounds.exceptions)
        reserve = bounds.torque_fraction - np.sign(per_newton) * torque
        limits = np.min(reserve / np.maximum(np.abs(per_newton), 1e-9), axis=-1)
        limit = float(np.quantile(np.maximum(limits, 0.0), bounds.exceptions))
        if friction_lag > 0:
            limit = min(limit, force * tolerance / friction_lag)
        limit = min(limit, start_force)
        if ratio > bounds.torque_fraction and not self._faults:
            self._faults.append(
                f"joint {_joint(load)} needs {100 * ratio:.0f} % of its greatest torque"
            )
        elif self._scenario.press.force > start_force and not self._faults:
            self._faults.append(f"it can press with {start_force:.1f} N at the start")
        if not self._scenario.has_board:
            return {"largest_torque_ratio": ratio}
        if friction_lag > tolerance:
            self._doubt(
                f"at a normal force of {force:.3g} N friction holds the eraser "
                f"{1e3 * friction_lag:.1f} mm rms behind its path"
            )
        if force > limit > 1:
            self._softer = limit
        return {
            "largest_torque_ratio": ratio,
            "friction_lag": friction_lag,
            "largest_press": limit,
        }

    def _judge_deviation(
        self, lag: float, turn: float, error: Array, tempo: float, hindrance: str
    ) -> Values:
        """Return the rms deviation of the tool and the errors (B, T) of its normal force."""
        has_board, bounds = self._scenario.has_board, self._bounds
        values: Values = {"deviation": lag}
        if has_board:
            # Contact is lost where the force would be negative.
            least = -min(FORCE_TOLERANCE, float(np.max(self._force)))
            unsteady = float(np.mean((error > FORCE_TOLERANCE) | (error < least)))
            values |= {"force_error": rms(error), "unsteady_fraction": unsteady}
        if self._faults:
            return values
        # Friction does not make runs worse than predicted, nor does damping.
        distance = max(
            math.hypot(lag, bounds.tracking_error * self._friction_lag),
            bounds.tracking_error * self._reach.off_path(lag, self._friction_lag),
        )
        text, allowed = "", bounds.constant_force_error
        if np.ndim(self._force):
            allowed = bounds.force_error
        if self._R_TE is not None and turn > bounds.orientation_error:
            text = (
                f"the tool is off its orientation by {np.rad2deg(turn):.1f} degrees rms"
            )
        elif distance > self._most_error or turn > bounds.tilt:
            text = (
                "the tool is off its path by "
                f"{1e3 * self._reach.off_path(lag, self._friction_lag):.1f} mm "
                f"and {np.rad2deg(turn):.1f} degrees rms"
            )
        elif has_board and unsteady > bounds.unsteady:
            text = (
                f"on {100 * unsteady:.1f} % of the path the normal force is off by more than "
                f"{FORCE_TOLERANCE:g} N"
            )
        elif has_board and values["force_error"] > allowed:
            text = f"the normal force is off by {values['force_error']:.1f} N rms"
        if text:
            self._doubt(f"{hindrance}, and {text}" if hindrance else text)
            if np.any(self._reach.damping):  # Its force is proportional to the tempo.
                worst = float(np.quantile(np.abs(error), 1 - bounds.unsteady))
                left = max(self._scenario.tolerance - self._friction_lag, 1e-9)
                excess = max(worst / FORCE_TOLERANCE, distance / self._most_error)
                excess = max(excess, lag / left, 1e-9)
                tempo = min(tempo, self._tempo / excess)
            self._slower, self._is_disturbed = min(tempo, self._tempo), True
        return values

    def _judge_pushes(self, motion: PredictedMotion) -> Values:
        """Return how far scripted pushes lift the eraser off the board."""
        scenario, force = self._scenario, float(np.max(self._force))
        if not scenario.has_board:
            return {}
        allowed = self._bounds.lift * scenario.tolerance
        found = predict_lifts(scenario, motion, force=force, allowed=allowed)
        if found.lift > allowed:
            self._firmer = found.withstanding
            self._faults.append(
                f"a push of {found.push:.0f} N lifts the eraser by {100 * found.lift:.0f} cm "
                f"off the board; a normal force of {math.ceil(self._firmer)} N withstands it"
            )
        return {"push_deviation": found.lift}


def _joint(values: Array) -> int:
    """Return the number, from 1, of the joint with the largest value."""
    return int(np.unravel_index(np.argmax(values), values.shape)[-1]) + 1
