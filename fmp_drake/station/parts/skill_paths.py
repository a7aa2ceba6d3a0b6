"""The paths that a skill may take over the board, as many as a check needs."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import StationError
from fmp_drake.primitives import FourierMovementPrimitive, Player

Array = NDArray[np.float64]

# Of so many times the windows the longest are taken, as a run takes what wipes most.
_DRAWN = 16


def CheckPositions(skill: FourierMovementPrimitive) -> None:
    """Refuse a skill that is not fitted, or not of the 3 coordinates of a position."""
    skill.check_fitted()
    if skill.n_channels_ != 3:
        raise StationError(
            f"the skill has {skill.n_channels_} channels; the station needs the 3 "
            "coordinates of a position."
        )


def skill_paths(
    skill: FourierMovementPrimitive,
    *,
    start: ArrayLike,
    tempo: float,
    sample: bool,
    seed: int,
    beginnings: int,
    windows: int,
    every: int,
) -> Array:
    """Play beginnings from a start, and draw windows from the whole mixture.

    Half of the windows are any samples, half the longest of many: a run prefers samples
    that wipe much, which are long and fast.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted, of 3 position channels.
    start : array_like, shape (3,)
        p_BE, m.
    tempo : float
        1 is as demonstrated.
    sample, seed
        Of the beginnings, as for `Player`; the windows are always samples.
    beginnings, windows : int
        How many.
    every : int
        Samples of a window from one to the next that is returned.

    Returns
    -------
    array, shape (beginnings + windows, T, 3)
        Positions in B, m, ``every / (tempo * skill.rate)`` seconds apart; beginnings
        first.
    """
    begun = np.empty((beginnings, skill.n_steps, 3))
    player = Player(skill, sample=sample, seed=seed)
    for i in range(beginnings):
        state = player.start(start, tempo=tempo, seed=seed + i)
        for k in range(skill.n_steps):
            begun[i, k] = player.motion(state)[0]
            state = player.advance(state, player.tick_seconds / tempo)
    drawn = skill.sample(_DRAWN * windows, seed=seed, with_noise=False)
    lengths = np.sum(np.linalg.norm(np.diff(drawn, axis=1), axis=2), axis=1)
    longest = np.argsort(lengths[windows // 2 :])[windows // 2 - windows :]
    chosen = [*range(windows // 2), *(windows // 2 + longest)]
    return np.concatenate([begun, drawn[chosen]])[:, ::every]
