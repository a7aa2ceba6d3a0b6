"""Measure whether a played skill returns to the demonstrated movement, and stays there.

Two measures. The tube of a component at a time of its window is the ellipsoid that holds
99 % of its values there: squared Mahalanobis distance, with the covariance (18), up to the
99 % quantile of the chi-square distribution. It is the model's own: a model that is too sure
has a narrow tube, and whatever it plays is inside. So also how near what is played is
to the demonstrations, by how near these are to themselves at other times. Only the public
interface is used.
"""

from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
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

    def inside(self, values, components, steps):
        """Tell which values (n, D), of components and steps (n,), are in the tube."""
        means, precisions = self._tables
        steps = np.asarray(steps) - (self.skill.overlap - 1)
        delta = values - means[components, steps]
        squares = np.einsum("ld,lde,le->l", delta, precisions[components, steps], delta)
        return squares <= self.threshold


def demonstrated_inside(skill, demonstration):
    """Return how much of a demonstration is in the tubes of what it is mapped on.

    K samples are mapped, as where a skill is played, and the rest of their window counts.
    """
    values = demonstration.resample(skill.rate).values
    steps = np.arange(skill.overlap - 1, skill.n_steps)
    plan, tube = skill.mapping_plan(np.arange(skill.overlap)), tube_of(skill)
    inside = []
    for first in range(0, len(values) - skill.n_steps, 7):
        window = values[first : first + skill.n_steps]
        component = plan.map(window[: skill.overlap].ravel()).component
        components = np.full(len(steps), component)
        inside.append(tube.inside(window[steps], components, steps))
    return float(np.mean(inside))


class Nearness:
    """Distance of values to a demonstration.

    Attributes
    ----------
    usual : float
        The distance, m, that 99 % of its own samples are nearer than to the nearest one at
        least a period away in time.
    """

    def __init__(self, demonstration, rate, period):
        values = demonstration.resample(rate).values
        self._tree = KDTree(values)
        times = np.arange(len(values))
        apart = np.abs(times[::5, None] - times) >= period * rate
        squares = ((values[::5, None] - values) ** 2).sum(axis=2)
        nearest = np.sqrt(np.where(apart, squares, np.inf).min(axis=1))
        self.usual = float(np.quantile(nearest, 0.99))

    def usually(self, values):
        """Return which of values (..., D) are as near as the demonstration mostly is."""
        return self._tree.query(values)[0] <= self.usual


@cache
def tube_of(skill):
    """Return the tubes of a skill, whose tables take a second, once for all tests."""
    return Tube(skill)


class Return(NamedTuple):
    """Results of playback from many starts.

    `at` and `after` are the shares of starts inside at two periods, and at every tick
    from then on; `ever_after` is the share of all ticks from then on; `near` is the share
    of these that are as near to the demonstration as it is to itself; `slow` is the
    share of starts whose peak speed stays below twice the demonstrated one.
    """

    at: float
    after: float
    ever_after: float
    near: float
    slow: float
    greatest_speed: float
    seconds: float


def played(player, start, ticks, **options):
    """Yield the states of a playback at the start and at so many ticks."""
    state = player.start(start, **options)
    yield state
    for _ in range(ticks):
        state = player.advance(state, player.tick_seconds)
        yield state


def measure_return(skill, demonstration, *, starts, seconds, period, **options):
    """Play a skill from many starts and measure how it returns, see `Return`.

    Parameters
    ----------
    skill : FourierMovementPrimitive
    demonstration : Demonstration
    starts : ndarray, shape (S, D)
    seconds : float
        How long is played.
    period : float
        Of the movement, s.
    **options
        Of the player.
    """
    tube, player = tube_of(skill), Player(skill, **options)
    peak = peak_speed(demonstration, skill.rate)
    nearness = Nearness(demonstration, skill.rate, period)
    ticks = round(seconds * skill.rate)
    inside, near, greatest = [], [], []
    for i, start in enumerate(starts):
        states = list(played(player, start, ticks, seed=player.seed + i))
        motions = np.array([player.motion(state) for state in states])
        components, steps = np.array([(s.component, s.step) for s in states]).T
        inside.append(tube.inside(motions[:, 0], components, steps))
        near.append(nearness.usually(motions[:, 0]))
        greatest.append(np.linalg.norm(motions[:, 1], axis=1).max())
    inside, near, speeds = np.array(inside), np.array(near), np.array(greatest)
    first = round(2 * period * skill.rate)
    return Return(
        at=float(inside[:, first].mean()),
        after=float(inside[:, first:].all(axis=1).mean()),
        ever_after=float(inside[:, first:].mean()),
        near=float(near[:, first:].mean()),
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
        later = player.advance(state, player.tick_seconds)
        if later.remaps > state.remaps:
            # The end of a window, seen from a little before it.
            before = player.motion(player.advance(state, player.tick_seconds - 1e-6))
            after = player.motion(player.advance(state, player.tick_seconds + 1e-6))
            middle = (before[:2] + after[:2]) / 2
            steady = middle - before[:2] - 1e-6 * before[1:]
            jumps.append(np.linalg.norm(2 * steady, axis=1))
            offsets.append(np.linalg.norm(later.offset, axis=1))
        state = later
    return np.max(jumps, axis=0), np.max(offsets, axis=0)
