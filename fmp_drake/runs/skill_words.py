"""What a skill was learned from, and what playing it will look like, in words."""

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives import FourierMovementPrimitive, PhaseModel, Player

# Below this the phase model's assumptions count for more than the windows it saw.
_ENOUGH_CYCLES = 12
# Windows that do not overlap, of which a mixture needs about so many: on the bundled
# movements the density of what it has not seen collapses below.
_ENOUGH_WINDOWS = 7
# Of a drift beside the extent, of a tempo beside its mean: worth a word.
_DRIFT = 0.1
_TEMPO = 0.15
_SECONDS = 8.0


def model_in_words(skill: FourierMovementPrimitive) -> str:
    """Return which model a skill has, and why."""
    return f"model: {skill.model_}, because {skill.model_reason_}".replace(
        "phase, because", "phase,"
    )


def skill_in_words(skill: FourierMovementPrimitive) -> list[str]:
    """Return sentences: the model, what was found in the demonstrations, how it plays.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 20, 0.05)
    >>> circles = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time)])
    >>> windows = np.stack([circles[i : i + 120] for i in range(0, 280, 2)])
    >>> words = skill_in_words(FourierMovementPrimitive().fit(windows))
    >>> print(words[-1])
    played, it covers x -0.10 to 0.10 m, y -0.10 to 0.10 m, once in 3.1 s, at up to 0.20 m/s
    """
    phase = skill.phase_model_
    found = _about_windows(skill) if phase is None else _about_cycles(skill, phase)
    return [model_in_words(skill), *found, _about_playing(skill)]


def _about_windows(skill: FourierMovementPrimitive) -> list[str]:
    seconds = sum(len(path) for path in skill.paths_) / skill.rate
    window = skill.n_steps / skill.rate
    if not skill.paths_ or seconds >= _ENOUGH_WINDOWS * window:
        return []
    each = skill.n_windows_ / len(skill.components_)
    return [
        (
            f"{seconds:.0f} s are short for a mixture with windows of {window:g} s: "
            f"{seconds / window:.1f} of them do not overlap, and a component has "
            f"{each:.1f} that do. What it has not seen will leave its span; record "
            f"{_ENOUGH_WINDOWS * window:.0f} s or four equal cycles"
        )
    ]


def _about_cycles(skill: FourierMovementPrimitive, phase: PhaseModel) -> list[str]:
    tempos, sizes = skill.tempos_, skill.amplitudes_
    said = [
        f"{phase.cycles} whole cycles of {skill.period_:.2f} s, tempo "
        f"{_percent(tempos)}, size {_percent(sizes)} of the mean; "
        + (
            "more would hardly help"
            if phase.cycles >= _ENOUGH_CYCLES
            else f"{_ENOUGH_CYCLES} or more would help"
        )
    ]
    if phase.approach or phase.paused:
        said.append(
            f"left out: {phase.approach / skill.rate:.1f} s of ways to the movement or "
            f"away from it, {phase.paused / skill.rate:.1f} s of pauses"
        )
    drift = phase.history.drift * skill.scales_
    extent = np.ptp(skill.extent_, axis=0)
    if np.any(np.abs(drift) > _DRIFT * extent):
        moved = ", ".join(
            f"{name} by {by:+.3f} {unit}"
            for name, by, unit in zip(skill.channels_, drift, skill.units_, strict=True)
            if abs(by) > 0.1 * float(np.max(np.abs(drift)))
        )
        said.append(
            f"the centre drifted, {moved}: it is played about the middle, and samples "
            "are wider than one cycle"
        )
    if np.ptp(tempos) > 2 * _TEMPO:
        said.append(
            "the tempo varies so much that means get smaller than the movement; play "
            "samples (sample=True)"
        )
    return said


def _about_playing(skill: FourierMovementPrimitive) -> str:
    """Return extent, period and greatest speed of the means, played from the middle."""
    player = Player(skill)
    start = skill.paths_[0][-1] if skill.paths_ else skill.extent_.mean(axis=0)
    motion = player.rollout(start, 2 * _SECONDS)[round(_SECONDS * skill.rate) :]
    covers = ", ".join(
        f"{name} {low:.2f} to {high:.2f} {unit}"
        for name, unit, low, high in zip(
            skill.channels_,
            skill.units_,
            motion[:, 0].min(axis=0),
            motion[:, 0].max(axis=0),
            strict=True,
        )
    )
    said = f"played, it covers {covers}"
    if skill.phase_model_ is not None:
        said += f", once in {skill.period_:.1f} s"
    metres = [unit == "m" for unit in skill.units_]
    if any(metres):
        speed = float(np.linalg.norm(motion[:, 1, metres], axis=-1).max())
        said += f", at up to {speed:.2f} m/s"
    return said


def _percent(values: NDArray[np.float64]) -> str:
    return f"{100 * values.min():.0f} to {100 * values.max():.0f} %"
