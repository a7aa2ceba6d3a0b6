"""Rehearsal: a simulated run that decides where the prediction of a check is doubtful."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from pydrake.common.yaml import yaml_dump_typed

from fmp_drake.errors import FmpError
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.runs.judging import Fault, RunResult, failure, faults
from fmp_drake.runs.station_run import MakeRun
from fmp_drake.station import CheckFeasibility, Scenario
from fmp_drake.station.reach.feasibility import Feasibility

REHEARSAL = 30.0
"""Simulated time of a rehearsal, s."""
# Times at which it ends if its faults are so severe that the rest cannot mend them, s: a fault
# of the first 10 s is at least a third as severe in 30 s.
_ENDS = (10.0, 20.0, REHEARSAL)
# Largest predicted tracking error that is rehearsed, in tolerances. Of 16 runs with 1.25 or
# more one passed, with 1.25.
_MOST_ERROR = 1.3
# A check that passes is rehearsed above this fraction of the tolerance and of the allowed
# height after a push, or above this rms error of the normal force, N: seven of 672 accepted
# trials, of which three failed. So is one with a stronger push along the board, N, for what it
# does to the path is not predicted.
_CLOSE, _CLOSE_FORCE_ERROR, _STRONG_PUSH = 0.9, 0.5, 40.0
# Least number of windows of the skill in a rehearsal.
_LEAST_WINDOWS = 2


def rehearse(scenario: Scenario, skill: FourierMovementPrimitive) -> list[Fault]:
    """Simulate a skill on a scenario's board for `REHEARSAL`, and return its faults.

    It plays other samples than a run with the scenario's seed, and ends early where it goes
    so badly that the rest cannot mend it.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted.

    Returns
    -------
    list of Fault
        The most severe first.
    """
    text: str = yaml_dump_typed(scenario)  # type: ignore[no-untyped-call]
    result, found = RunResult(scenario=text), list[Fault]()
    try:
        run = MakeRun(scenario, skill, seed=scenario.skill.seed + 1)
        run.simulator.set_target_realtime_rate(0)
        for time in _ENDS:
            run.advance_to(time)
            result.metrics = run.metrics()
            found = faults(result, time)
            if found and found[0].severity > _ENDS[-1] / time:
                break
    except (FmpError, RuntimeError) as error:
        result.error = failure(error)
        found = faults(result)
    return found


def CheckWithRehearsal(
    scenario: Scenario,
    skill: FourierMovementPrimitive,
    *,
    suggest: bool = True,
    say: Callable[[str], object] | None = None,
) -> Feasibility:
    """Check a skill on a board, and rehearse it where the prediction is doubtful.

    Close to its bounds `CheckFeasibility` cannot tell whether friction, pushes, joints that are
    braked, or poses that are nearly singular or out of reach, disturb a run too much. A
    rehearsal of at most `REHEARSAL` decides then, if that is long enough for two windows of the
    skill and for a cycle of a board on its rail.

    Parameters
    ----------
    scenario : Scenario
    skill : FourierMovementPrimitive
        Fitted, with channels that `MakeStation` can play.
    suggest : bool
        Whether to look for a change with which the check passes.
    say : callable, optional
        Called with a text before a rehearsal.

    Raises
    ------
    StationError
        If a value of the scenario is not allowed, or a channel of the skill has no role.

    Examples
    --------
    >>> from fmp_drake.skills import scenario_skill
    >>> from fmp_drake.station import LoadScenario
    >>> scenario = LoadScenario("table_top")
    >>> CheckWithRehearsal(scenario, scenario_skill(scenario)[0]).is_feasible
    True
    """
    predicted = CheckFeasibility(scenario, skill, suggest=False)
    is_feasible, verdict = predicted.is_feasible, predicted.verdict
    if _is_close(predicted, scenario) and _is_long_enough(scenario, skill):
        if say is not None:
            say(
                f"close to the bounds of the check; a rehearsal of {REHEARSAL:g} s decides"
            )
        found = rehearse(scenario, skill)
        is_feasible, verdict = not found, _decided(predicted, found)
    if suggest and not (predicted.is_feasible or is_feasible):
        checked = CheckFeasibility(scenario, skill)
        remedy = checked.verdict.removeprefix(predicted.verdict)
        return replace(checked, verdict=verdict + remedy)
    return replace(predicted, is_feasible=is_feasible, verdict=verdict)


def _is_close(predicted: Feasibility, scenario: Scenario) -> bool:
    """Return whether a prediction is so close to its bounds that only a run decides."""
    values = predicted.values
    error = values["tracking_error"] / scenario.tolerance
    if predicted.is_feasible:
        lift = values.get("push_deviation", 0.0) / scenario.tolerance
        pushes = (p.force for p in scenario.disturbances if p.start < REHEARSAL)
        return (
            error > _CLOSE
            or lift > _CLOSE * predicted.bounds.lift
            or any(math.hypot(*force[:2]) > _STRONG_PUSH for force in pushes)
            or values.get("force_error", 0.0) > _CLOSE_FORCE_ERROR
            or values.get("unsteady_fraction", 0.0) > 0
        )
    return predicted.is_doubtful and error <= _MOST_ERROR


def _is_long_enough(scenario: Scenario, skill: FourierMovementPrimitive) -> bool:
    """Return whether a rehearsal visits most of what a run does."""
    rail = scenario.board.motion
    windows = REHEARSAL * scenario.skill.tempo * skill.rate / skill.n_steps
    has_cycle = rail.amplitude == 0 or REHEARSAL * rail.frequency >= 1
    return windows >= _LEAST_WINDOWS and has_cycle


def _decided(predicted: Feasibility, found: Sequence[Fault]) -> str:
    """Return the verdict of a prediction and a rehearsal with the given faults."""
    if found and predicted.is_feasible:
        return (
            f"The arm cannot follow this skill, as a rehearsal shows: {found[0].text}. "
            "A slower tempo or another place of the board may help."
        )
    if found:
        return f"{predicted.verdict} A rehearsal agrees: {found[0].text}."
    if predicted.is_feasible:
        return f"{predicted.verdict} A rehearsal of {REHEARSAL:g} s agrees."
    return (
        f"The arm can follow this skill: a rehearsal of {REHEARSAL:g} s stays within all "
        "bounds, but close to them. What was predicted: "
        f"{predicted.verdict.partition(': ')[2]}"
    )
