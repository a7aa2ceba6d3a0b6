"""The region that demonstrations have shown."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from fmp_drake.errors import SkillError
from fmp_drake.numeric import as_floats, check_number

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive

# Points per margin along the paths: distances near the margin are exact to 0.2 %.
_DENSITY = 8
# No sparser and no denser than so many along the diagonal of the paths.
_LEAST, _MOST = 200, 2000
# Of the margin: how much farther out than its mean a movement may be outside.
_SLACK = 0.25
# Of the margin: up to where a movement is drawn out. Between two ticks it may bulge.
_FILLED = 0.96
# Of a deviation from a component's mean, from the whole to an eighth.
_FRACTIONS = np.arange(8, 0, -1) / 8


class DemonstratedRegion:
    """All that is at most a margin away from a path that was demonstrated.

    Of a skill with other channels than positions only those with the unit m count; the
    others are free. The region is in the frame of the skill and the same in all
    directions: what was shown on a surface may be left along its normal, too, by the
    margin.

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
        Where the skill does not hold its demonstrated paths, as from a file of an earlier
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
        check_number(margin, "margin", above=0, unit="m")
        self._channels = [i for i, unit in enumerate(skill.units_) if unit == "m"]
        if not (skill.paths_ and self._channels):
            raise SkillError(
                f"margin is {margin} m, but the skill has no demonstrated paths in m (its "
                f"units are {', '.join(skill.units_)}); learn it again, or play it without."
            )
        self.margin = float(margin)
        paths = [path[:, self._channels] for path in skill.paths_]
        size = float(np.linalg.norm(np.ptp(np.concatenate(paths), axis=0)))
        size = max(size, 1e-9)
        spacing = float(np.clip(margin / _DENSITY, size / _MOST, size / _LEAST))
        self._tree = KDTree(
            np.concatenate([densified(path, spacing) for path in paths])
        )

    def distance(self, values: ArrayLike) -> NDArray[np.float64]:
        """Return how far values (..., D) are from the nearest path, shape (...), m."""
        points = as_floats(values, "the values")[..., self._channels]
        distance: NDArray[np.float64] = self._tree.query(points)[0]
        return distance

    def largest_fractions(
        self, steady: NDArray[np.float64], deviations: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return which fractions of deviations keep a movement in the region.

        A movement may be outside where it would be without its deviation, such as on
        the way back after a push, at most a quarter of the margin farther. Inside it
        keeps 4 % of the margin free. So a fraction of 0 is always good.

        Parameters
        ----------
        steady : ndarray, shape (N, D) or (S, N, D)
            The movement without deviations; one for all, or one each.
        deviations : ndarray, shape (S, N, D)

        Returns
        -------
        ndarray, shape (S,)
            The largest ones of 0, 1/8, 1/4 ... 1.
        """
        limit = self.distance(steady)
        within = np.maximum(limit, _FILLED * self.margin)
        limit = np.where(limit > self.margin, limit + _SLACK * self.margin, within)
        out = np.zeros(len(deviations))
        left = np.arange(len(deviations))
        steady = np.broadcast_to(steady, deviations.shape)
        limit = np.broadcast_to(limit, deviations.shape[:2])
        for fraction in _FRACTIONS:
            distance = self.distance(steady[left] + fraction * deviations[left])
            fits = np.all(distance <= limit[left], axis=1)
            out[left[fits]] = fraction
            left = left[~fits]
        return out


def densified(path: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Put points on a path (N, D) so that none is farther than spacing from the next."""
    change = np.diff(path, axis=0)
    pieces = np.maximum(np.ceil(np.linalg.norm(change, axis=1) / spacing), 1)
    ends = np.concatenate([[0], np.cumsum(pieces)])
    at = np.interp(np.arange(ends[-1] + 1), ends, np.arange(len(path)))
    segment = np.minimum(at.astype(np.intp), max(len(path) - 2, 0))
    t = (at - segment)[:, None]
    after = np.minimum(segment + 1, len(path) - 1)
    return path[segment] * (1 - t) + path[after] * t
