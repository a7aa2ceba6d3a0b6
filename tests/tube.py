"""Measures whether a played skill returns to where it was demonstrated, and stays.

The tube of a component at a time of its window is the ellipsoid that holds 99 % of
its values there: squared Mahalanobis distance, with the covariance (18), up to the
99 % quantile of the chi-square distribution. Only the public interface is used.
"""

from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from fmp_drake.primitives import Demonstration, Player

DEMONSTRATIONS = Path(__file__).resolve().parents[1] / "models" / "demonstrations"


def bundled(task):
    """Return a bundled demonstration: 3 minutes at 20 Hz."""
    return Demonstration.load(DEMONSTRATIONS / f"{task}.npz")


def peak_speed(demonstration, rate):
    """Return the greatest demonstrated speed, in m/s."""
    values = demonstration.resample(rate).values
    return float(np.linalg.norm(np.diff(values, axis=0), axis=1).max() * rate)


def starts_in_box(skill, count, *, times=2.0, seed=0):
    """Return random starts in a box some times as wide as was demonstrated."""
    low, high = skill.extent_
    rng = np.random.default_rng(seed)
    box = rng.uniform(-1, 1, (count, len(low)))
    return (low + high) / 2 + times * (high - low) / 2 * box


class Tube:
    """The tubes of all components of a skill, from sample K - 1 to T - 1."""

    def __init__(self, skill):
        self.skill = skill
        self.threshold = chi2.ppf(0.99, skill.n_channels_)

    @cached_property
    def _tables(self):
        skill = self.skill
        steps = range(skill.overlap - 1, skill.n_steps)
        means = [
            skill.synthesize(c.mean)[skill.overlap - 1 :] for c in skill.components_
        ]
        precisions = [
            [np.linalg.inv(skill.covariance(j, step)) for step in steps]
            for j in range(len(skill.components_))
        ]
        return np.array(means), np.array(precisions)

    def inside(self, values, components):
        """Tell which values (S, ticks, D) of a window are in the tube, (S, ticks)."""
        means, precisions = self._tables
        ticks = values.shape[1]
        delta = values - means[components, :ticks]
        squares = np.einsum(
            "sld,slde,sle->sl", delta, precisions[components, :ticks], delta
        )
        return squares <= self.threshold


class Return(NamedTuple):
    """What playing from many starts showed.

    `at` and `after` are the shares of starts inside at two periods, and at every tick
    from then on; `ever_after` is the share of all ticks from then on; `slow` is the
    share of starts whose peak speed stays below twice the demonstrated one.
    """

    at: float
    after: float
    ever_after: float
    slow: float
    greatest_speed: float
    seconds: float


def windows_with_components(player, starts):
    """Yield windows (S, T - K, 3, D) of a stream and the components (S,) they track.

    A re-mapping maps the last K values, the first of the next window among them.
    """
    skill = player.skill
    plan = skill.mapping_plan(np.arange(skill.overlap))
    components = np.array([player.start(start).component for start in starts])
    before = None
    for window in player.stream(starts):
        if before is not None:
            last = [before[:, 1 - skill.overlap :, 0], window[:, :1, 0]]
            last = np.concatenate(last, axis=1)
            components = plan.map_many(last.reshape(len(starts), -1))[1]
        yield window, components
        before = window


def measure_return(skill, *, starts, seconds, period, peak, **options):
    """Play a skill from many starts and measure how it returns, see `Return`.

    Parameters
    ----------
    skill : FourierMovementPrimitive
    starts : ndarray, shape (S, D)
    seconds : float
        Whole windows are played, at least as long as this.
    period : float
        Of the movement, s.
    peak : float
        Greatest demonstrated speed, m/s.
    **options
        Of the player.
    """
    tube = Tube(skill)
    inside, ticks = [], 0
    speeds = np.zeros(len(starts))
    for window, components in windows_with_components(Player(skill, **options), starts):
        inside.append(tube.inside(window[:, :, 0], components))
        speeds = np.maximum(speeds, np.linalg.norm(window[:, :, 1], axis=2).max(axis=1))
        ticks += window.shape[1]
        if ticks >= seconds * skill.rate:
            break
    inside = np.concatenate(inside, axis=1)
    first = round(2 * period * skill.rate)
    return Return(
        at=float(inside[:, first].mean()),
        after=float(inside[:, first:].all(axis=1).mean()),
        ever_after=float(inside[:, first:].mean()),
        slow=float((speeds < 2 * peak).mean()),
        greatest_speed=float(speeds.max() / peak),
        seconds=ticks / skill.rate,
    )


def remapping_jumps(skill, start, seconds, **options):
    """Return what happens at the re-mappings: the greatest jumps, and what is hidden.

    Returns
    -------
    jumps : ndarray, shape (2,)
        Of position (m) and velocity (m/s), between the motion at the end of a window
        and that at the start of the next.
    offsets : ndarray, shape (2,)
        How far the mapped windows themselves were off, which the offset takes up.
    """
    player = Player(skill, **options)
    state = player.start(start)
    jumps, offsets = [], []
    for _ in range(int(seconds * skill.rate)):
        state = player.tick(state)
        if state.step == skill.n_steps - 1:
            before = player.motion(state)
            state = player.remap(state)
            jumps.append(np.linalg.norm(player.motion(state) - before, axis=1)[:2])
            offsets.append(np.linalg.norm(state.offset, axis=1))
    return np.max(jumps, axis=0), np.max(offsets, axis=0)
