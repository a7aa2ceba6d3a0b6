"""Region around the demonstrated paths."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from fmp_drake.errors import SkillError
from fmp_drake.numeric import Array, as_floats, check_number
from fmp_drake.primitives.data.windows import extent_of

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive

# Points per margin along the paths; errors of distances near the margin are below 0.2 %.
_DENSITY = 8
# Bounds of the number of points along the diagonal of the paths.
_LEAST, _MOST = 200, 2000
# Additional distance that is allowed where the mean is outside, relative to the margin.
_SLACK = 0.25
# Fraction of the margin that is used: between two ticks a movement may be farther out.
_FILLED = 0.96
# Automatic margin, and that of a channel without metres, relative to the half width.
_AUTOMATIC = 0.2
# Smallest bound of channels without metres, and deviations that need none (rad, N ...).
_LEAST_RANGE, _LEAST_DEVIATION = 1e-3, 1e-12
# Fractions of a deviation from a component's mean.
_FRACTIONS = np.arange(8, 0, -1) / 8
# Largest factor on the distance of a sample from the mean, or, with a phase model, from
# the cycle. Chosen on the bundled wiping: with 3, an eraser that follows exactly also
# cleans polishing and the 8 sooner than with 1.5 or 2; 4 and 6 are no better.
_WIDENING = {"mixture": 1.5, "phase": 3.0}
# Standard deviation of the filter that removes the noise of single samples from a distance
# that is enlarged, in samples.
_SLOW = 2.0


class DemonstratedRegion:
    """All points within a margin of a demonstrated path.

    Distances are of the channels with the unit m. The region is in the frame of the skill
    and isotropic: a movement that was demonstrated on a surface may also leave the
    surface by the margin. Each of the other channels, such as a force, may leave its
    demonstrated range by a fifth of half its width.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    margin : float
        m.

    Attributes
    ----------
    margin : float

    Raises
    ------
    SkillError
        If the skill does not contain its demonstrated paths, as in a file of an earlier
        version, or has no channel with the unit m.

    Examples
    --------
    >>> from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
    >>> time = np.arange(400) / 20
    >>> line = np.column_stack([0.1 * np.sin(2 * time), 0 * time])
    >>> skill = FourierMovementPrimitive(n_components=2).fit(
    ...     Demonstration(time=time, values=line)
    ... )
    >>> region = DemonstratedRegion(skill, 0.02)
    >>> region.distance([[0.0, 0.01], [0.13, 0.0]]).round(3)
    array([0.01, 0.03])
    """

    def __init__(self, skill: "FourierMovementPrimitive", margin: float) -> None:
        hint = "or 'automatic', or None for no bound"
        check_number(margin, "margin", above=0, unit="m", hint=hint)
        self._channels = [i for i, unit in enumerate(skill.units_) if unit == "m"]
        if not (skill.paths_ and self._channels):
            raise SkillError(
                f"margin is {margin} m, but the skill has no demonstrated paths in m (its "
                f"units are {', '.join(skill.units_)}); learn it again, or play it "
                "without a margin."
            )
        self.margin = float(margin)
        self._other_channels = [i for i, unit in enumerate(skill.units_) if unit != "m"]
        # Not `extent_`, which grows with each rotation of a skill.
        low, high = extent_of(skill.paths_)[:, self._other_channels]
        self._middle = (low + high) / 2
        self._most = np.maximum((1 + _AUTOMATIC) * (high - low) / 2, _LEAST_RANGE)
        paths = [path[:, self._channels] for path in skill.paths_]
        size = float(np.linalg.norm(np.ptp(np.concatenate(paths), axis=0)))
        size = max(size, 1e-9)
        spacing = float(np.clip(margin / _DENSITY, size / _MOST, size / _LEAST))
        self._tree = KDTree(
            np.concatenate([densified(path, spacing) for path in paths])
        )

    def distance(self, values: ArrayLike) -> Array:
        """Return the distance of values (..., D) to the nearest path, shape (...), m."""
        points = as_floats(values, "the values")[..., self._channels]
        return self._tree.query(points)[0]

    def largest_ratio(self, values: Array) -> float:
        """Return how far values (N, D) leave the region: 2 at twice the margin, at least 1."""
        ratios = np.abs(values[:, self._other_channels] - self._middle) / self._most
        distance = np.max(self.distance(values)) / self.margin
        return float(np.max(ratios, initial=max(distance, 1.0)))

    def largest_fractions(self, steady: Array, deviations: Array) -> Array:
        """Return the largest fractions of deviations that keep a movement in the region.

        Where the movement without its deviation is outside, as after a push, it may be
        farther out by a quarter of the margin. Inside, 4 % of the margin remain unused.
        Therefore a fraction of 0 is always admissible.

        Parameters
        ----------
        steady : ndarray, shape (N, D) or (S, N, D)
            The movement without deviations; common, or one for each deviation.
        deviations : ndarray, shape (S, N, D)

        Returns
        -------
        ndarray, shape (S,)
            The largest ones of 0, 1/8, 1/4 ... 1.
        """
        limit = self.distance(steady)
        inner_limit = np.maximum(limit, _FILLED * self.margin)
        limit = np.where(limit > self.margin, limit + _SLACK * self.margin, inner_limit)
        fractions = np.zeros(len(deviations))
        remaining = np.arange(len(deviations))
        steady = np.broadcast_to(steady, deviations.shape)
        limit = np.broadcast_to(limit, deviations.shape[:2])
        for fraction in _FRACTIONS:
            distance = self.distance(
                steady[remaining] + fraction * deviations[remaining]
            )
            fits = np.all(distance <= limit[remaining], axis=1)
            fractions[remaining[fits]] = fraction
            remaining = remaining[~fits]
        return fractions

    def largest_channel_fractions(self, steady: Array, deviations: Array) -> Array:
        """Return the largest parts of the deviations of each channel, shape (S, D).

        They are the `largest_fractions`, and of channels without metres at most what keeps
        them in their range.
        """
        fractions = self.largest_fractions(steady, deviations)[:, None]
        parts = np.repeat(fractions, deviations.shape[2], axis=1)
        among = (..., self._other_channels)
        change, before = deviations[among], steady[among]
        room = self._most - (before - self._middle) * np.sign(change)
        room = np.maximum(room, 0.0) / np.maximum(np.abs(change), _LEAST_DEVIATION)
        parts[among] = np.minimum(fractions, room.min(axis=1))
        return parts


def automatic_margin(skill: "FourierMovementPrimitive") -> float | None:
    """Return a fifth of the half width of a movement, m; None without paths in m."""
    widths = np.ptp(skill.extent_, axis=0) / 2
    width = float(np.linalg.norm(widths[np.array(skill.units_) == "m"]))
    return _AUTOMATIC * width if skill.paths_ and width > 0 else None


def drawn_out(
    skill: "FourierMovementPrimitive",
    deviation: Array,
    steady: Array,
    values: Array,
    *,
    channels: Sequence[int],
) -> Array:
    """Return deviations from a component's mean that are enlarged in some channels.

    Where those from the cycle of a phase model would accelerate more than the movement,
    only their slow part is enlarged, not the noise of the recordings.

    Parameters
    ----------
    skill : FourierMovementPrimitive
    deviation : ndarray, shape (S, D*T)
        Weights.
    steady : ndarray, shape (N, D) or (S, N, D)
        The movement without deviations.
    values : ndarray, shape (S, N, D)
        The deviations at the same times.
    channels : sequence of int
    """
    factors = np.ones(skill.n_channels_)
    factors[list(channels)] = _WIDENING[skill.model_]
    out: Array = deviation * np.repeat(factors, skill.n_steps)
    movement, largest = (
        np.sum(np.diff(x[..., list(channels)], n=2, axis=-2) ** 2, axis=(-2, -1))
        for x in (steady, values * factors)
    )
    rough = largest > movement
    if skill.phase_model_ is not None and rough.any():
        windows = skill.basis.synthesize(deviation[rough])
        slow = gaussian_filter1d(windows, _SLOW, axis=1, mode="nearest")
        out[rough] = skill.basis.analyze(windows + (factors - 1) * slow)
    return out


def densified(path: Array, spacing: float) -> Array:
    """Insert points into a path (N, D) so that neighbours are at most `spacing` apart."""
    change = np.diff(path, axis=0)
    pieces = np.maximum(np.ceil(np.linalg.norm(change, axis=1) / spacing), 1)
    ends = np.concatenate([[0], np.cumsum(pieces)])
    positions = np.interp(np.arange(ends[-1] + 1), ends, np.arange(len(path)))
    segment = np.minimum(positions.astype(np.intp), max(len(path) - 2, 0))
    t = (positions - segment)[:, None]
    following = np.minimum(segment + 1, len(path) - 1)
    return path[segment] * (1 - t) + path[following] * t
