"""Where in its cycle a playback is."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fmp_drake.errors import SkillError
from fmp_drake.primitives.playback.playback_state import PlaybackState

if TYPE_CHECKING:
    from fmp_drake.primitives.playback.player import Player

# Phases that are looked at, up to so far from where the component says it is, rad.
_LOOKED_AT = 41
_FARTHEST = 1.5
_STEPS = 4


def phase_of(player: "Player", state: PlaybackState) -> float:
    """Return the phase of the desired motion at a state, rad, from 0 to 2 pi.

    It is where the cycle of the phase model has the most similar position and velocity,
    near the phase of the component that is tracked. Where the motion is continuous, so is
    the phase, modulo 2 pi, unless it is still far from the cycle.

    Raises
    ------
    SkillError
        Where the skill has no phase model.
    """
    model = player.skill.phase_model_
    if model is None:
        raise SkillError("the skill is a mixture, which knows no phase.")
    tempo, pace = model.tempo.mean, player.skill.rate
    # In units of the cycle, per radian.
    motion = player.motion(replace(state, tempo=1.0, tempo_rate=0.0))[:2]
    seen = (motion / player.skill.scales_ / [[1.0], [tempo * pace]]).ravel()
    step = state.step + state.time_since_tick * pace - model.pinned
    near = model.anchors[state.component] + tempo * step
    phases = near + np.linspace(-_FARTHEST, _FARTHEST, _LOOKED_AT)
    shown = np.concatenate(
        [model.cycle.values(phases), model.cycle.values(phases, 1)], axis=1
    )
    phase = phases[np.argmin(np.sum((shown - seen) ** 2, axis=1))]
    for _ in range(_STEPS):
        shown, along, bent = (model.cycle.values(phase, k) for k in range(3))
        slope = np.concatenate([along, bent])
        error = seen - np.concatenate([shown, along])
        phase += np.clip(slope @ error / max(slope @ slope, 1e-300), -0.2, 0.2)
    return float(np.mod(phase, 2 * np.pi))
