"""Contact of a tool with a surface, in recordings with or without forces."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Mask, runs
from fmp_drake.primitives import Demonstration, Rhythm, find_rhythm
from fmp_drake.primitives.data.channels import (
    FORCE_CHANNEL,
    FORCE_COMPONENTS,
    POSITION_CHANNELS,
    ROTATION_CHANNELS,
    listed,
)
from fmp_drake.primitives.data.orientation import rotations_of
from fmp_drake.primitives.data.reading.table import FORCES
from fmp_drake.primitives.data.windows import DEFAULT_RATE, cut_demonstrations
from fmp_drake.skills.surface_fit import fit_surface

# Force above which the tool touches, relative to its 95 % quantile; height without a force, m.
_PRESSED, _TOUCH = 0.3, 0.01
_LEAST_FORCE = 1.0  # N; with a smaller quantile nothing was touched.
# An offset of the force: distance from the movement at which the tool is in the air, m, greatest
# spread relative to its mean, and least mean relative to the force of the movement. It is a
# weight if the least forces, a fraction of all, are smaller by a factor without it.
_FAR, _STEADY, _WEIGHT, _FEWEST, _LESS = 0.03, 0.3, 0.1, 0.2, 0.8
# The same from lifts, which are shorter: least magnitude relative to the force of the movement;
# time over which the force in the air is steady, s, and fraction of such samples.
_LIFT_WEIGHT, _STEADY_TIME, _QUIET = 0.15, 0.25, 0.1
_LEAST_SAMPLES = 4  # In the air.
# Lifts without a force: greatest fraction of the squared steps along the tool's axis, least
# length of its mean, initial quantile of the heights, and fraction of low samples from which
# there are no lifts. Height of a lift, m, and relative to the extent of the movement; greatest
# median height of the low samples, relative to it. Residual of a surface with lifts, relative
# to that without. Displacements that are as bad as a slope of 1, m, and as a curvature of 2/m,
# m; greatest slope.
_ALONG, _COMMON, _LOWEST, _NO_LIFTS, _ROUNDS = 0.4, 0.7, 0.1, 0.9, 50
_LOW, _LOW_OF_SIZE, _EXACT_LOW, _BETTER = 0.005, 0.015, 0.6, 1.6
_SLOPE, _BEND, _MOST_SLOPE = 0.04, 0.0005, 0.4
# Residual of a surface relative to another one that is as exact, and one that is exact, m.
_AS_EXACT, _EXACT = 1.2, 3e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Contact:
    """Contact of the tool in a recording of N samples.

    Attributes
    ----------
    touching, in_bout : ndarray of bool, shape (N,)
        Samples in contact, and those in bouts of the movement.
    force : ndarray, shape (N, 1) or (N, 3), or None
        N; None where it was not recorded.
    offset : float
        Magnitude of the force in the air that was subtracted, N.
    rhythm : Rhythm or None
        Of the positions; None where nothing repeats.
    """

    touching: Mask
    in_bout: Mask
    force: Array | None
    offset: float = 0.0
    rhythm: Rhythm | None = None


def find_contact(demonstration: Demonstration, **options: float | None) -> Contact:
    """Find where the tool touches, by the bouts of the movement, and by force or orientation.

    The options are those of `find_rhythm`.
    """
    path = demonstration.select(POSITION_CHANNELS)
    in_bout, rhythm = _find_bouts(path, **options)
    channels = set(demonstration.channels)
    forces = (FORCE_COMPONENTS, (FORCE_CHANNEL,))
    names = next((f for f in forces if set(f) <= channels), None)
    rotations = recorded_rotations(demonstration)
    if names is None:
        touching = in_bout.copy()
        if rotations is not None:
            touching[in_bout] = _not_lifted(path.values, in_bout, rotations)
        return Contact(touching=touching, in_bout=in_bout, force=None, rhythm=rhythm)
    units = set(demonstration.select(names).units) - {"N", "1"}
    if units:
        raise DemonstrationError(
            f"the unit of {listed(names)} is {' or '.join(sorted(units))}; it must be one of "
            f"{', '.join(FORCES)} in the header or in --columns, such as "
            f"{names[0]}=NAME [N]."
        )
    force = demonstration.select(names).values
    force, offset = _without_offset(path, in_bout, force, rotations)
    magnitude = np.linalg.norm(force, axis=1)
    pressed = float(np.percentile(magnitude, 95))
    if pressed < _LEAST_FORCE:
        raise DemonstrationError(
            f"the force is at most {pressed:.2g} N, so the tool touches nothing; check its "
            "column and unit (--columns)."
        )
    touching = in_bout & (magnitude > _PRESSED * pressed)
    return Contact(
        touching=touching,
        in_bout=in_bout,
        force=force,
        offset=offset,
        rhythm=rhythm,
    )


def samples_in_bouts(path: Demonstration, **options: float | None) -> Mask:
    """Return which samples of a path are in bouts of its movement.

    The options are those of `find_rhythm`. Without a rhythm all samples between the times
    are.
    """
    return _find_bouts(path, **options)[0]


def _find_bouts(
    path: Demonstration,
    *,
    start_time: float | None = None,
    end_time: float | None = None,
    period: float | None = None,
) -> tuple[Mask, Rhythm | None]:
    """Return `samples_in_bouts`, and the rhythm of the path, if it has any."""
    (part,) = cut_demonstrations([path], start_time, end_time, DEFAULT_RATE)
    try:
        rhythm = find_rhythm(
            path, start_time=start_time, end_time=end_time, period=period
        )
    except DemonstrationError:
        return np.isin(path.time, part.time), None
    in_bout = np.zeros(len(path.time), dtype=bool)
    time = path.time - path.time[0]
    for bout in rhythm.bouts:
        in_bout |= (time >= bout.start) & (time <= bout.end)
    return in_bout, rhythm


def recorded_rotations(demonstration: Demonstration) -> Rotation | None:
    """Return the orientations R_DT of a demonstration, if it has any."""
    reference = demonstration.rotation_reference
    if reference is None:
        return None
    return rotations_of(demonstration.select(ROTATION_CHANNELS).values, reference)


def touching_samples(contact: Contact, heights: Array) -> Mask:
    """Return where the tool touches, by its force and its heights (N,) over the surface, m.

    A force that was low-pass filtered rises while the tool is still high. Where it is weak
    but the tool is not lifted, the tool touches.
    """
    is_low = heights <= _TOUCH
    if contact.force is None:
        return contact.in_bout & is_low
    touching = np.zeros_like(is_low)
    for a, b in runs(contact.touching):
        low = a + np.flatnonzero(is_low[a:b])
        if len(low):
            touching[low[0] : low[-1] + 1] = True
    for a, b in runs(contact.in_bout & ~touching):
        touching[a:b] = np.all(is_low[a:b])
    return touching


def _not_lifted(points: Array, in_bout: Mask, rotations: Rotation) -> Mask:
    """Return which of the samples in bouts are not above the others, along the tool's axis.

    A loop of contact and lift has a plane of its own. Without a force only the orientation
    distinguishes it from the surface: a tool is held about normal to it, with z along its
    axis. The heights are those above a quadric, which bounds the samples from below and
    hardly tilts. All samples are returned where the tool moves along its axis, or those
    below are not on a surface that fits better than that of all.
    """
    axes = rotations.apply([0.0, 0.0, 1.0])
    mean = axes[in_bout].mean(axis=0)
    steps = np.diff(points[in_bout], axis=0)
    along = np.sum(steps * axes[in_bout][1:], axis=1)
    every = np.ones(len(steps) + 1, dtype=bool)
    is_normal = np.sum(along**2) < _ALONG * np.sum(steps**2)
    if not is_normal or np.linalg.norm(mean) < _COMMON:
        return every
    up = Rotation.align_vectors([[0.0, 0.0, 1.0]], [-mean])[0]
    x, y, z = up.apply(points - points[in_bout].mean(axis=0)).T
    if len(z) > len(every) and np.median(z[~in_bout]) < z[in_bout].min() - _TOUCH:
        z = -z  # Approach and retreat are above the surface.
    x, y, z = x[in_bout], y[in_bout], z[in_bout]
    terms = np.column_stack([every, x, y, x * x, x * y, y * y])
    penalty = len(z) * np.diag([0.0, _SLOPE, _SLOPE, _BEND, _BEND, _BEND]) ** 2
    low = max(_LOW, _LOW_OF_SIZE * float(np.ptp([x, y], axis=1).max()))
    heights = z - np.quantile(z, _LOWEST)
    for _ in range(_ROUNDS):
        weighted = terms.T / (1 + np.maximum(heights / low, 0.0) ** 2)
        quadric = np.linalg.lstsq(weighted @ terms + penalty, weighted @ z)[0]
        heights = z - terms @ quadric
    is_low = heights <= low
    is_exact = np.median(np.abs(heights[is_low])) < _EXACT_LOW * low
    is_level = np.linalg.norm(quadric[1:3]) < _MOST_SLOPE
    if not (is_exact and is_level and is_low.mean() < _NO_LIFTS):
        return every
    contact = in_bout.copy()
    contact[in_bout] = is_low
    without_lifts = _BETTER * _residual(points, contact) + _EXACT
    return is_low if _residual(points, in_bout) > without_lifts else every


def _residual(points: Array, touching: Mask) -> float:
    """Return the residual of the surface that fits the contact; infinite without one."""
    try:
        return fit_surface([points], [touching]).residual
    except DemonstrationError:
        return np.inf


def _without_offset(
    path: Demonstration, in_bout: Mask, force: Array, rotations: Rotation | None
) -> tuple[Array, float]:
    """Subtract the force in the air from a force (N, 1 or 3); return its magnitude, too.

    The offset of a sensor is constant as it was recorded, but the weight of a tool is
    constant in D. That one is subtracted which leaves less while the force is least.
    """
    air = _force_in_air(path, in_bout, force)
    without = force - air
    if rotations is not None and force.shape[1] == 3:
        in_D = rotations.apply(force)
        weight = _force_in_air(path, in_bout, in_D)
        if _least(in_D - weight, in_bout) < _LESS * _least(without, in_bout):
            air, without = weight, rotations.apply(in_D - weight, inverse=True)
    return without, float(np.linalg.norm(air))


def _least(force: Array, in_bout: Mask) -> float:
    """Return the mean of the least magnitudes of a force in bouts."""
    magnitudes = np.sort(np.linalg.norm(force[in_bout], axis=1))
    return float(np.mean(magnitudes[: 1 + int(_FEWEST * len(magnitudes))]))


def _force_in_air(path: Demonstration, in_bout: Mask, force: Array) -> Array:
    """Return the force far from the movement, or while the tool is lifted, or 0."""
    offset = _offset(path, in_bout, force)
    return offset if offset.any() else _offset_of_lifts(path, in_bout, force)


def _offset(path: Demonstration, in_bout: Mask, force: Array) -> Array:
    """Return the force (1 or 3) in the air far from the movement; 0 where it varies.

    The weight of a tool that is not compensated, or a sensor's offset, looks like contact.
    Its variation is that of averages: a tool that vibrates does so in the air, too.
    """
    points = path.values
    is_far = KDTree(points[in_bout]).query(points)[0] > _FAR
    in_air = force[is_far & ~in_bout]
    pressed = float(np.percentile(np.linalg.norm(force[in_bout], axis=1), 95))
    if len(in_air) < _LEAST_SAMPLES or pressed < _LEAST_FORCE:
        return np.zeros(force.shape[1])
    mean = in_air.mean(axis=0)
    averages = uniform_filter1d(in_air, _steady_count(path), axis=0)
    size, spread = np.linalg.norm(mean), np.linalg.norm(averages.std(axis=0))
    is_constant = spread < _STEADY * size and size > _WEIGHT * pressed
    return mean if is_constant else np.zeros(force.shape[1])


def _steady_count(path: Demonstration) -> int:
    """Return the number of samples in the time over which a force in the air is steady."""
    return max(3, round(_STEADY_TIME / float(np.median(np.diff(path.time)))))


def _offset_of_lifts(path: Demonstration, in_bout: Mask, force: Array) -> Array:
    """Return the force (1 or 3) while the tool is lifted from the surface, or 0.

    The candidate is the force where it is steadiest. It is an offset if, without it, the
    samples in contact fit a surface about as well as those of the recorded force do, and
    the tool is lifted from that surface in most of the other samples.
    """
    count = _steady_count(path)
    none = np.zeros(force.shape[1])
    if len(force) <= count:
        return none
    windows = np.lib.stride_tricks.sliding_window_view(force, count, axis=0)
    spread = np.sum(np.var(windows, axis=-1), axis=-1)
    is_quiet = spread <= np.quantile(spread, _QUIET)
    steady = np.median(np.mean(windows, axis=-1)[is_quiet], axis=0)
    remaining = np.linalg.norm(force - steady, axis=1)
    pressed = float(np.percentile(remaining[in_bout], 95))
    if np.linalg.norm(steady) < _LIFT_WEIGHT * pressed or pressed < _LEAST_FORCE:
        return none
    touching = in_bout & (remaining > _PRESSED * pressed)
    size = np.linalg.norm(force, axis=1)
    as_recorded = in_bout & (size > _PRESSED * np.percentile(size, 95))
    try:
        fit = fit_surface([path.values], [touching])
    except DemonstrationError:
        return none
    with suppress(DemonstrationError):
        residual = fit_surface([path.values], [as_recorded]).residual
        if fit.residual > _AS_EXACT * residual + _EXACT:
            return none  # The steady force is that of the contact.
    is_free = in_bout & ~touching
    lifted = is_free & (fit.coordinates(path.values)[:, 2] > _FAR)
    if np.sum(lifted) < max(_LEAST_SAMPLES, np.sum(is_free) / 2):
        return none
    in_air = force[lifted]
    mean, deviation = in_air.mean(axis=0), np.linalg.norm(in_air.std(axis=0))
    return mean if deviation < _STEADY * pressed else none
