"""Which sample of a component a playback tracks."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmp_drake.blas import one_blas_thread
from fmp_drake.primitives.playback.outlook import look_ahead, look_ahead_at_once
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.segment import decayed_offset

if TYPE_CHECKING:
    from fmp_drake.primitives.playback.player import Player

type Worth = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# How much farther from the mean than it is a sample is drawn out at most; of a phase model
# only what it adds to the cycle. Chosen on the bundled wiping. Polishing and the 8, too,
# are cleaned sooner with 3 than with 1.5 or 2 by an eraser that follows exactly; 4 and 6
# are alike.
_WIDENED = 1.5
_WIDENED_RESIDUAL = 3.0
# Samples that are looked at until the movement after one stays in the region.
_TRIES = 8


def track_component(player: "Player", state: PlaybackState) -> PlaybackState:
    """Track a sample of a state's component, or what is expected, without a jump."""
    if state.sample:
        return track_sample(player, state)
    return _tracking(
        player, state, player.skill.expected(state.component, _past(player, state))
    )


@one_blas_thread()
def track_sample(
    player: "Player",
    state: PlaybackState,
    *,
    count: int = 1,
    worth: Worth | None = None,
) -> PlaybackState:
    """Track a sample of a state's component, without a jump of the motion.

    Where the player has a region, samples are brought so close to the mean that up to the
    next re-mapping they lead out of it at no tick, or hardly farther than the mean does. Of
    these the first is tracked after which the next mean stays inside, too; the speed at the
    end of a window may otherwise carry the movement out before the next one has effect.
    Where there is a worth, too, samples are drawn out to 1.5 times their difference from
    the mean, or 3 times that from the cycle of a phase model, as far as the region allows:
    what is worth most often lies at its rim.

    Parameters
    ----------
    player : Player
    state : PlaybackState
        The samples follow from its seed and its number of re-mappings.
    count : int
        How many samples are drawn.
    worth : callable, optional
        Returns the worth (S,) of S samples from the values (S, N, D) at the ticks that they
        lead to, up to the next re-mapping: the order in which they are looked at.

    Examples
    --------
    >>> from fmp_drake.primitives import FourierMovementPrimitive, Player
    >>> windows = np.random.default_rng(0).standard_normal((40, 24, 2))
    >>> skill = FourierMovementPrimitive(n_steps=24, rate=10, overlap=4).fit(windows)
    >>> player = Player(skill)
    >>> high = track_sample(
    ...     player,
    ...     player.start([0.0, 0.0]),
    ...     count=16,
    ...     worth=lambda values: values[..., 1].mean(axis=1),
    ... )
    >>> high.target.shape
    (48,)
    """
    skill, region = player.skill, player.region
    rng = np.random.default_rng([state.seed, state.remaps])
    if region is not None:
        count = max(count, _TRIES)
    past = _past(player, state)
    centre, deviation = skill.draw(state.component, rng, count, past=past)
    if region is None and worth is None:
        return _tracking(player, state, centre[0] + deviation[0])
    if region is not None and worth is not None:
        deviation *= _WIDENED if skill.phase_model_ is None else _WIDENED_RESIDUAL
    if skill.phase_model_ is not None:
        # At last what is expected, of which it was made sure before that it stays inside.
        expected = skill.expected(state.component, past)
        centre = np.concatenate([centre, expected[None]])
        deviation = np.concatenate([deviation, np.zeros_like(expected)[None]])
    steady, values = _led_to(player, state, centre, deviation)
    # Up to the next re-mapping.
    ticks = skill.overlap - 1 + player.ticks_between_remaps - state.step
    steady, values = steady[..., :ticks, :], values[:, :ticks]
    if region is not None:
        fractions = region.largest_fractions(steady, values)
        deviation *= fractions[:, None]
        values *= fractions[:, None, None]
    values += steady
    targets = centre + deviation
    order = np.arange(count)
    if worth is not None:
        order = np.argsort(-worth(values[:count]), kind="stable")
    if region is None:
        return _tracking(player, state, targets[order[0]])
    best, least = state, math.inf
    for i in [*order[:_TRIES], *range(count, len(targets))]:
        tracking = _tracking(player, state, targets[i])
        led_to = _next_mean(player, tracking, values[i])
        if skill.phase_model_ is not None:
            led_to = np.concatenate([values[i], led_to])
        outside = max(float(np.max(region.distance(led_to))), region.margin)
        if outside < least:
            best, least = tracking, outside
        if outside <= region.margin:
            break
    return best


def _past(player: "Player", state: PlaybackState) -> NDArray[np.float64]:
    """Return the first samples (K, D) of the window that a state plays."""
    return player.skill.synthesize(state.weights)[: player.skill.overlap]


def _tracking(
    player: "Player", state: PlaybackState, target: NDArray[np.float64]
) -> PlaybackState:
    """Return the state that tracks weights; those of a phase model are played at once.

    On the way from one weights to others that differ in phase both would be averaged,
    and what is played would leave the cycle.
    """
    at_once = player.skill.phase_model_ is not None
    return player.retarget(state, target, at_once=at_once)


def _led_to(
    player: "Player",
    state: PlaybackState,
    centre: NDArray[np.float64],
    deviation: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the values at the coming ticks that S targets lead to, as two parts.

    Returns
    -------
    steady : ndarray, shape (N, D) or (S, N, D)
        Of the centres (S, D*T).
    values : ndarray, shape (S, N, D)
        What their deviations (S, D*T) add.
    """
    skill = player.skill
    if skill.phase_model_ is None:
        gaussian = skill.components_[state.component]
        state = player.retarget(state, gaussian.mean)
        outlook = look_ahead(skill, player.relaxations[state.component], state)
        added = np.tensordot(deviation @ gaussian.basis, outlook.response, (1, 2))
        return outlook.steady, added
    kept, rows = look_ahead_at_once(skill, state, player.motion(state)[:2])

    def seen(weights: NDArray[np.float64]) -> NDArray[np.float64]:
        windows = weights.reshape(len(weights), skill.n_channels_, skill.n_steps)
        return np.swapaxes(windows @ rows.T, 1, 2) * skill.scales_

    return kept + seen(centre), seen(deviation)


def _next_mean(
    player: "Player", state: PlaybackState, values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the values (N, D) that the next window leads to if its mean is tracked.

    Parameters
    ----------
    player : Player
    state : PlaybackState
    values : ndarray, shape (N, D)
        At the ticks up to the end of the window.
    """
    skill, relaxation = player.skill, player.relaxations[state.component]
    seconds = len(values) * player.tick_seconds
    wait = (seconds - state.time_since_tick) / (state.tempo or 1.0)
    end = replace(
        state,
        weights=relaxation.after(state.weights, state.target, seconds),
        step=state.step + len(values),
        history=np.concatenate([state.history, values])[-skill.overlap :],
        offset=decayed_offset(state.offset, state.blend_time, wait)[:2],
        time_since_tick=0.0,
        sample=False,
    )
    after = player.remap(end)
    ahead = look_ahead(skill, player.relaxations[after.component], after)
    return ahead.steady[: player.ticks_between_remaps]
