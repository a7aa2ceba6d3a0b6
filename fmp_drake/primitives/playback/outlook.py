"""Where a playback leads until its next re-mapping, whichever target it tracks."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.relaxation import Relaxation
from fmp_drake.primitives.playback.segment import decayed_offset

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


class Outlook(NamedTuple):
    """The values at the coming ticks, up to the last one of the window.

    They are an affine function of the target.

    Attributes
    ----------
    steady : ndarray, shape (N, D)
        With the target as it is.
    response : ndarray, shape (N, D, r)
        What each of the component's directions, added to the target, adds to them.
    seconds : float
        Until the last of the ticks.
    """

    steady: NDArray[np.float64]
    response: NDArray[np.float64]
    seconds: float


def look_ahead_at_once(
    skill: "FourierMovementPrimitive",
    state: PlaybackState,
    motion: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Prepare the outlook from a state whose weights are replaced at once.

    The offset takes up the difference, so that the motion, (2, D), stays as it is.

    Returns
    -------
    steady : ndarray, shape (N, D)
        What the motion adds to the values at the coming ticks.
    rows : ndarray, shape (N, T)
        What multiplies the new weights of a channel.
    """
    now, step = state.time_since_tick, np.arange(state.step + 1, skill.n_steps)
    tempo = state.tempo if state.tempo > 0 else 1.0
    seconds = ((step - state.step) / skill.rate - now) / tempo
    fading = np.array(
        [decayed_offset(np.eye(2), state.blend_time, t)[0] for t in seconds]
    )
    here = min(state.step + now * skill.rate, skill.n_steps - 1)
    seen = skill.basis.local_rows(here)[:2] * [[1.0], [skill.rate * tempo]]
    return fading @ motion, skill.basis.rows(step) - fading @ seen


def look_ahead(
    skill: "FourierMovementPrimitive", relaxation: Relaxation, state: PlaybackState
) -> Outlook:
    """Prepare the outlook from a state, at its tempo (1 where it stands still).

    It is what `Player.retarget` and `Player.advance` would make of each target.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    relaxation : Relaxation
        Of the component that is tracked.
    state : PlaybackState
        Before the last sample of its window.
    """
    d, n = skill.n_channels_, skill.n_steps
    directions = skill.components_[state.component].basis
    deviations = np.column_stack([state.weights - state.target, directions])
    whole = np.column_stack([state.target, directions]).reshape(d, n, -1)
    inside, residual = relaxation.split(deviations.T)
    modes = np.eye(d * n) if relaxation.modes is None else relaxation.modes

    def seen(
        rows: NDArray[np.float64],
        left: tuple[NDArray[np.float64], NDArray[np.float64]],
    ) -> NDArray[np.float64]:
        """Return what k rows of the basis see of the deviations, shape (D, k, 1 + r)."""
        modal, complement = left
        out = ((rows @ modes.reshape(d, n, -1)) * modal) @ inside.T
        out += complement * (rows @ residual.T.reshape(d, n, -1))
        return out

    now, step = state.time_since_tick, np.arange(state.step + 1, n)
    since_tick = (step - state.step) / skill.rate
    tempo = state.tempo if state.tempo > 0 else 1.0
    seconds = (since_tick - now) / tempo
    rows = skill.basis.rows(step)
    out, decaying = rows @ whole, seen(rows, relaxation.left(since_tick))
    out[..., 0] += decaying[..., 0]
    out[..., 1:] -= decaying[..., 1:]
    # What another target would change now, in value and velocity, the offset takes up.
    rows = skill.basis.local_rows(min(state.step + now * skill.rate, n - 1))[:2]
    rows[1] *= skill.rate
    change = rows @ whole - seen(rows, relaxation.left(now))
    change[:, 1] += seen(rows[:1], relaxation.loss(now))[:, 0]
    change[:, 1] *= tempo
    fading = [decayed_offset(np.eye(2), state.blend_time, t)[0] for t in seconds]
    out[..., 1:] -= np.array(fading) @ change[..., 1:]
    out = np.swapaxes(out * skill.scales_[:, None, None], 0, 1)
    out[..., 0] += np.array(fading) @ state.offset
    return Outlook(out[..., 0], out[..., 1:], float(seconds[-1]))
