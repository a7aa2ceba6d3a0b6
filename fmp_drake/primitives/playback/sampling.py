"""Which sample of a component a playback tracks."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.playback.outlook import look_ahead
from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.segment import decayed_offset

if TYPE_CHECKING:
    from fmp_drake.primitives.playback.player import Player

type Worth = Callable[[NDArray[np.float64]], NDArray[np.float64]]

# How much farther from the mean than it is a sample is drawn out at most.
_WIDENED = 1.5
# Samples that are looked at until the movement after one stays in the region.
_TRIES = 8


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
    the mean as far as the region allows: what is worth most often lies at its rim.

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
    gaussian, region = player.skill.components_[state.component], player.region
    rng = np.random.default_rng([state.seed, state.remaps])
    if region is not None:
        count = max(count, _TRIES)
    targets = player.skill.draw(state.component, rng, count)
    if region is None and worth is None:
        return player.retarget(state, targets[0])
    state = player.retarget(state, gaussian.mean)
    outlook = look_ahead(player.skill, player.relaxations[state.component], state)
    targets -= gaussian.mean
    if region is not None and worth is not None:
        targets *= _WIDENED
    values = np.tensordot(targets @ gaussian.basis, outlook.response, (1, 2))
    if region is not None:
        fractions = region.largest_fractions(outlook.steady, values)
        targets *= fractions[:, None]
        values *= fractions[:, None, None]
    values += outlook.steady
    order = np.arange(count)
    if worth is not None:
        order = np.argsort(-worth(values), kind="stable")
    if region is None:
        return player.retarget(state, gaussian.mean + targets[order[0]])
    best, least = state, math.inf
    for i in order[:_TRIES]:
        tracking = player.retarget(state, gaussian.mean + targets[i])
        after = _next_mean(player, tracking, values[i])
        outside = max(float(np.max(region.distance(after))), region.margin)
        if outside < least:
            best, least = tracking, outside
        if outside <= region.margin:
            break
    return best


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
        step=skill.n_steps - 1,
        history=np.concatenate([state.history, values])[-skill.overlap :],
        offset=decayed_offset(state.offset, state.blend_time, wait)[:2],
        time_since_tick=0.0,
        sample=False,
    )
    after = player.remap(end)
    return look_ahead(skill, player.relaxations[after.component], after).steady
