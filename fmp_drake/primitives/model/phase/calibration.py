"""Calibration of predictions by cross-validation within the recordings."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fmp_drake.numeric import Array, Indices, Mask
from fmp_drake.primitives.model.phase.components import PhaseGrid, grid_gaussians
from fmp_drake.primitives.model.phase.random_processes import Residual
from fmp_drake.primitives.model.phase.tracking import PhaseTrack
from fmp_drake.primitives.model.prediction import Conditioning, Replay, Replayed

# Horizons of the predictions that are evaluated, samples, and the greatest one of the blend.
_HORIZONS = np.array([1, 2, 3, 5, 7, 10, 14, 20, 28, 40])
_BLEND_HORIZON = 20
# Number of cycles from which a blend with replay gains nothing and fewer parts suffice,
# and that number of parts.
MANY_CYCLES, _PARTS_OF_MANY = 15.0, 5
# Left-out parts for each cycle, and bounds of their number.
_PARTS_PER_CYCLE, _PARTS = 3.0, (4, 10)
# Left-out parts for a mixture, which is learned again without each of them.
_PLAYED_PARTS = 4
# Greatest number of recordings of which parts are left out.
_MOST_LEFT_OUT = 16
# Predictions in all parts.
_PREDICTIONS = 300
# Shortest segment of the remaining recordings that is used, samples.
_LEAST_SEGMENT = 12
# Greatest distance of a known phase to a sample of the remaining recordings, rad.
_PHASE_REACH = 0.35
# Prior weight of the phase model, its weight in parts, and the greatest weight of a
# part.
_WEIGHT, _WEIGHT_PARTS, _MOST_WEIGHT = 0.4, 6.0, 1.2
# Priors of errors, and their weights in parts. They were fitted to bundled and real
# recordings and rounded. If they are fitted without one recording, its 95 % tube contains 92,
# 91 and 87 % of it after 0.25, 0.5 and 1 s. First the standard deviation of an error,
# relative to that of the change of the movement in the same time.
_PRIOR_ERROR, _ERROR_PARTS = 0.4, 2.0
# Shortfall of the covariances of few cycles: by a factor (1 + _SHORTFALL /
# cycles^1.5)^2.
_SHORTFALL, _SHORTFALL_PARTS = 4.5, 6.0
# Cycles after which the model's covariances count as much as the errors do.
_MODEL_CYCLES = 5.0
# Fraction of the errors that is replaced by the spread of similar futures, and least
# relative variance of a channel.
_LOCAL_FRACTION, _LEAST_RELATIVE = 0.4, 0.003
# The model's variances of few cycles are uncertain: 1 + _VARIANCE_UNCERTAINTY / cycles. All
# grow with the horizon relative to the middle one, by a power that falls from _GROWTH with
# the number of cycles.
_VARIANCE_UNCERTAINTY, _GROWTH, _GROWTH_CYCLES, _MIDDLE_HORIZON = 1.5, 0.5, 3.0, 10.0
# The least weight of the left-out parts of n cycles is n^2 / _CYCLES_OF_MANY.
_CYCLES_OF_MANY = 8.0
# Degrees of freedom: constant, and factor of the square of the number of cycles.
_DEGREES, _DEGREES_OF_CYCLES = 4.0, 0.05
# Variance that an unfamiliar past adds: fraction of its squared distance beyond a part
# of the variance of the recordings.
_NOVELTY_FRACTION, _NOVELTY_THRESHOLD = 0.75, 0.04
# Greatest weight of the background in the density, and the number of cycles that halves
# it.
_BACKGROUND, _BACKGROUND_CYCLES = 0.2, 6.0
# In squared scaled units.
_NOISE = 1e-8
# Number of cycles that is assumed for each part where none are known, and its minimum.
_CYCLES_PER_PART, _LEAST_CYCLES = 0.5, 1.5
# Fields of a calibration that are covariances.
_COVARIANCES = ("error_covariances", "change_covariances", "playback_covariances")


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Corrections of predictions that cross-validation has shown to be necessary.

    Attributes
    ----------
    horizons : ndarray, shape (A,)
        Samples ahead of the last observed one; increasing.
    factors : ndarray, shape (A,)
        Factors of the model's covariances at the horizons; the components of a phase model
        contain them.
    error_covariances : ndarray, shape (A, D, D)
        Covariances that are added, in scaled units; the components contain them, too.
    change_covariances : ndarray, shape (A, D, D)
        Covariances of the change of a recording within each horizon, divided by their
        trace. They shape the covariance that is added for an unfamiliar past.
    model_weight : float
        Weight of the model in the mean; the remainder is the weight of replay.
    local_factor : float
        Factor of the covariance of the samples that followed similar pasts.
    degrees_of_freedom : float
        Of the t distributions.
    background_weight : float
        Weight of the background in the density of windows.
    playback_covariances : ndarray, shape (A, D, D), optional
        Covariances of the errors of windows that are played, beside those of the
        components. Where None, they are `error_covariances` for a mixture, and 0 for a
        phase model.
    """

    horizons: Array
    factors: Array
    error_covariances: Array
    change_covariances: Array
    model_weight: float = 1.0
    local_factor: float = 0.0
    degrees_of_freedom: float = 100.0
    background_weight: float = 0.0
    playback_covariances: Array | None = None

    def at(self, horizon: int) -> "Calibration":
        """Return the calibration of the next samples, up to a horizon."""
        steps = np.arange(1, horizon + 1, dtype=float)
        interpolated: dict[str, Any] = {
            name: _interpolated(steps, self.horizons, values)
            for name in ("factors", *_COVARIANCES)
            if (values := getattr(self, name)) is not None
        }
        return replace(self, horizons=steps, **interpolated)

    def playback_covariance(self, horizon: float) -> Array:
        """Return the interpolated `playback_covariances` (D, D); 0 for observed samples."""
        played, errors = self.playback_covariances, self.error_covariances
        covariances = errors if played is None else played
        growth = float(np.clip(horizon / self.horizons[0], 0, 1))
        return growth * _interpolated(np.asarray(horizon), self.horizons, covariances)

    def transformed(self, matrix: Array) -> "Calibration":
        """Return the calibration of A y for a matrix (D, D)."""
        transformed: dict[str, Any] = {
            name: matrix @ values @ matrix.T
            for name in _COVARIANCES
            if (values := getattr(self, name)) is not None
        }
        return replace(self, **transformed)

    def combined(
        self, mean: Array, covariances: Array, replayed: Replayed, variance: float
    ) -> tuple[Array, Array]:
        """Blend a model's prediction (H, D) and covariances (H, D, D) with replay.

        Parameters
        ----------
        mean, covariances : ndarray
            The covariances are calibrated.
        replayed : Replayed
        variance : float
            Sum of the variances of the recordings.
        """
        weight = self.model_weight
        change = mean - replayed.values
        disagreement = weight * (1 - weight) * change[:, :, None] * change[:, None]
        novelty = _NOVELTY_FRACTION * max(
            replayed.distance - _NOVELTY_THRESHOLD * variance, 0.0
        )
        isotropic = np.eye(mean.shape[1]) / mean.shape[1]
        out = covariances + self.factors[:, None, None] * disagreement
        out = (
            out
            + self.local_factor * replayed.spread
            + novelty / 2 * (self.change_covariances + isotropic)
        )
        return mean - (1 - weight) * change, out


class _Errors(NamedTuple):
    """Predictions of left-out samples; NaN where a part has ended.

    Attributes
    ----------
    truth, model, replay : ndarray, shape (N, A, D)
    covariances : ndarray, shape (N, A, D, D)
    part : ndarray of int, shape (N,)
        Number of the part that was left out.
    """

    truth: Array
    model: Array
    replay: Array
    covariances: Array
    part: Indices

    @property
    def parts(self) -> int:
        """Number of parts with predictions."""
        return len(np.unique(self.part))


def calibrate(
    track: PhaseTrack, grid: PhaseGrid, *, n_steps: int, reference_step: int
) -> Calibration:
    """Calibrate the predictions of a phase model.

    Each part of the recordings in turn is left out and predicted by a model of the
    others. Few parts are weak evidence, so the estimates are shrunk towards priors from
    many recordings of few cycles.

    Parameters
    ----------
    track : PhaseTrack
    grid : PhaseGrid
        Phases of the components.
    n_steps : int
        T, samples in a window.
    reference_step : int
        K, samples of a window that are observed when its end is predicted.
    """
    horizons = _HORIZONS[_HORIZONS <= n_steps - reference_step]
    cycles = track.cycles
    has_few_cycles = cycles < MANY_CYCLES
    errors = _cross_validation(track, grid, horizons, reference_step)
    weight = 1.0
    if has_few_cycles:
        weight = _WEIGHT
        if errors is not None:
            is_blended = horizons <= _BLEND_HORIZON
            change = (errors.model - errors.replay)[:, is_blended]
            true_change = (errors.truth - errors.replay)[:, is_blended]
            projections = np.sum(true_change * change, axis=2)
            squares = np.sum(change**2, axis=2)[np.isfinite(projections)]
            ratio = np.nansum(projections) / max(float(squares.sum()), 1e-300)
            weight = errors.parts * float(np.clip(ratio, 0, _MOST_WEIGHT))
            weight += _WEIGHT_PARTS * _WEIGHT
            weight = min(1.0, weight / (errors.parts + _WEIGHT_PARTS))
    return _calibration(
        errors, _changes(track.recordings, horizons), horizons, weight, cycles
    )


def calibrate_replay(
    recordings: Sequence[Array], seen: int, horizon: int
) -> Calibration | None:
    """Calibrate predictions by replay alone; None where the recordings are too short.

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    seen : int
        K, samples of a past.
    horizon : int
        Greatest number of samples to predict.
    """
    horizons = _HORIZONS[_HORIZONS <= horizon]
    total = sum(map(len, recordings))
    size = seen + _BLEND_HORIZON + 4
    count = int(np.clip(total // size, 2, _PARTS[1]))
    steps = np.concatenate([np.arange(seen), seen + horizons - 1])
    truth: list[Array] = []
    replayed: list[Array] = []
    part: list[int] = []
    for rest, left_out in _left_out(recordings, count, least=2):
        replay = Replay(rest, seen, int(horizons[-1]))
        if not replay.is_possible or len(left_out) <= seen:
            continue
        number = part[-1] + 1 if part else 0
        for window in _windows(left_out, steps, max(1, _PREDICTIONS // count))[0]:
            truth.append(window[seen:])
            replayed.append(replay.predict(window[:seen]).values[horizons - 1])
            part.append(number)
    if not Replay(recordings, seen, horizon).is_possible:
        return None
    errors = None
    if part:
        values = np.stack(replayed)
        errors = _Errors(np.stack(truth), values, values, np.empty(0), np.array(part))
    cycles = _CYCLES_PER_PART * (0 if errors is None else errors.parts)
    changes = _changes(recordings, horizons)
    return _calibration(errors, changes, horizons, 0.0, max(_LEAST_CYCLES, cycles))


def calibrate_playback(
    calibration: Calibration,
    recordings: Sequence[Array],
    learn: Callable[[list[Array]], Callable[[Array], Array] | None],
    *,
    seen: int,
) -> Calibration:
    """Return a calibration with the errors of the windows that a mixture plays.

    Parameters
    ----------
    calibration : Calibration
    recordings : sequence of ndarray, shape (n, D)
    learn : callable
        Learns a mixture of recordings; returns its continuation (H, D) of a past (K, D)
        as a function, or None where they are too short.
    seen : int
        K, samples of a past.
    """
    horizons = calibration.horizons.astype(int)
    steps = np.concatenate([np.arange(seen), seen + horizons - 1])
    deviations: list[Array] = []
    part: list[int] = []
    splits = _left_out(recordings, _PLAYED_PARTS, least=1)
    for number, (rest, left_out) in enumerate(splits):
        play = learn(rest) if len(left_out) > seen else None
        if play is None:
            continue
        for window in _windows(left_out, steps, _PREDICTIONS // _PLAYED_PARTS)[0]:
            values = play(window[:seen])
            is_reached = (horizons <= len(values))[:, None]
            values = values[np.minimum(horizons, len(values)) - 1]
            deviations.append(np.where(is_reached, window[seen:] - values, np.nan))
            part.append(number)
    if not part:
        return calibration
    squares = _squares(np.stack(deviations))
    covariances, count = _part_means(squares, np.array(part))
    last = int(np.flatnonzero(count)[-1])
    # Few parts underestimate the errors: to first order by two over their number.
    covariances = (covariances.T * (1 + 2 / np.maximum(count, 1))).T
    # Farther ahead than the parts reach, the errors increase by as much as those of replay.
    # These begin near 0, so their ratio would be the growth of much greater errors.
    replayed = np.trace(calibration.error_covariances, axis1=1, axis2=2)[last:]
    played = float(np.trace(covariances[last])) or np.inf
    growth = 1 + np.maximum(replayed - replayed[0], 0) / played
    covariances[last:] = np.multiply.outer(growth, covariances[last])
    covariances = _less_dependent(covariances, float(count.max()))
    return replace(calibration, playback_covariances=covariances)


def _squares(errors: Array) -> Array:
    """Return the outer products (..., D, D) of errors (..., D) with themselves."""
    return errors[..., :, None] * errors[..., None, :]


def _part_means(values: Array, part: Indices) -> tuple[Array, Array]:
    """Return the mean over parts, (A, ...), of each part's mean of values (N, A, ...).

    Also return the number of parts (A,) with values that are not NaN.
    """
    is_known = np.isfinite(values.reshape(*values.shape[:2], -1)[..., 0])
    means, counts = np.zeros(values.shape[1:]), np.zeros(values.shape[1])
    for number in np.unique(part):
        is_in_part = part == number
        known = is_known[is_in_part].sum(axis=0)
        total = np.nansum(values[is_in_part], axis=0)
        means += (total.T / np.maximum(known, 1)).T
        counts += known > 0
    return (means.T / np.maximum(counts, 1)).T, counts


def _left_out(
    recordings: Sequence[Array], count: int, *, least: int
) -> Iterator[tuple[list[Array], Array]]:
    """Yield the rest of recordings, and the left-out one of about `count` parts.

    Each recording has at least `least` parts. Of many recordings only some are left out.
    """
    total = sum(map(len, recordings))
    last = len(recordings) - 1
    chosen = np.linspace(0, last, min(_MOST_LEFT_OUT, last + 1)).astype(int)
    for i in chosen:
        y = recordings[i]
        parts = max(least, round(count * len(y) / total))
        for a, b in pairwise(np.linspace(0, len(y), parts + 1).astype(int)):
            others = [x for j, x in enumerate(recordings) if j != i]
            yield [*others, y[:a], y[b:]], y[a:b]


def _less_dependent(covariances: Array, parts: float) -> Array:
    """Return covariances (A, D, D) whose channels depend less on each other.

    Few parts do not show the correlations between the errors of many channels.
    """
    d = covariances.shape[1]
    variance = np.trace(covariances, axis1=1, axis2=2) / d
    even = variance[:, None, None] * np.eye(d)
    independent = d / (d + max(1.0, parts))
    less = covariances - independent * covariances * (1 - np.eye(d))
    return less + _LEAST_RELATIVE * even


def _calibration(
    errors: _Errors | None,
    changes: Array,
    horizons: Indices,
    weight: float,
    cycles: float,
) -> Calibration:
    """Return the calibration by left-out parts, shrunk towards priors.

    Covariances are a sum: those of the model, scaled, and those of the errors. With
    fewer cycles the errors have a greater weight, and their uncertainty adds more.

    Parameters
    ----------
    errors : _Errors or None
        None where nothing can be left out.
    changes : ndarray, shape (A, D, D)
        Of the recordings within each horizon.
    horizons : ndarray, shape (A,)
    weight : float
        Of the model in the mean; 0 for replay alone.
    cycles : float
    """
    a, d = changes.shape[:2]
    covariances, count = np.zeros((a, d, d)), np.zeros(a)
    blended = np.zeros((a, d, d))
    logs, scale_counts = np.zeros(a), np.zeros(a)
    if errors is not None:
        disagreement = errors.model - errors.replay
        deviations = errors.truth - errors.replay - weight * disagreement
        covariances, count = _part_means(_squares(deviations), errors.part)
        blended, _ = _part_means(_squares((1 - weight) * disagreement), errors.part)
        if weight > 0:
            model = errors.covariances + weight * (1 - weight) * _squares(disagreement)
            solved = np.linalg.solve(model, deviations[..., None])[..., 0]
            squares = np.sum(deviations * solved, axis=2) / d
            squares, scale_counts = _part_means(squares, errors.part)
            logs = np.log(np.maximum(squares, 1e-12)) * (scale_counts > 0)
    # With many cycles only few parts are left out, but they are long.
    count_of_many = cycles**2 / _CYCLES_OF_MANY
    count = np.where(count > 0, np.maximum(count, count_of_many), 0.0)
    scale_counts = np.where(
        scale_counts > 0, np.maximum(scale_counts, count_of_many), 0.0
    )
    change_variances = np.trace(changes, axis1=1, axis2=2)
    prior = _ERROR_PARTS * _PRIOR_ERROR**2 * changes.T
    covariances = ((count * covariances.T + prior) / (count + _ERROR_PARTS)).T
    blended = (count * blended.T / (count + _ERROR_PARTS)).T
    if count.any():
        # Farther ahead than the parts reach, the errors grow as the changes do.
        last = int(np.flatnonzero(count)[-1])
        later = change_variances[last:] / change_variances[last]
        for values in (covariances, blended):
            values[last:] = np.multiply.outer(later, values[last])
    covariances = _less_dependent(covariances, float(count.max()))
    growth = (horizons / _MIDDLE_HORIZON) ** (
        _GROWTH * _GROWTH_CYCLES / (_GROWTH_CYCLES + cycles)
    )
    prior_log = np.log(variance_factor(cycles))
    logs = (scale_counts * logs + _SHORTFALL_PARTS * prior_log) / (
        scale_counts + _SHORTFALL_PARTS
    )
    padded = np.pad(logs, 1, mode="edge")
    factors = np.exp((padded[:-2] + padded[1:-1] + padded[2:]) / 3)
    error_fraction = 1 / (1 + (cycles / _MODEL_CYCLES) ** 2) if weight > 0 else 1.0
    # A model of many cycles replays none of them.
    local_fraction = _LOCAL_FRACTION if weight < 1 else 0.0
    scale = growth * error_fraction * (1 - local_fraction)
    played = None
    if 0 < weight < 1:
        # A window that is played follows the model alone, without similar samples.
        local = growth * error_fraction * local_fraction
        played = (local * covariances.T + growth * blended.T).T
    background = _BACKGROUND * _BACKGROUND_CYCLES / (_BACKGROUND_CYCLES + cycles)
    return Calibration(
        horizons=horizons.astype(float),
        factors=growth
        * (1 - error_fraction)
        * (1 + _VARIANCE_UNCERTAINTY / cycles)
        * factors
        if weight > 0
        else np.ones(a),
        error_covariances=scale[:, None, None] * covariances,
        change_covariances=changes / change_variances[:, None, None],
        model_weight=weight,
        local_factor=error_fraction * local_fraction,
        degrees_of_freedom=_DEGREES + _DEGREES_OF_CYCLES * cycles**2,
        background_weight=background,
        playback_covariances=played,
    )


def _interpolated(new_steps: Array, steps: Array, values: Array) -> Array:
    """Interpolate values (A, ...) at increasing steps (A,) at other steps (...)."""
    columns = values.reshape(len(steps), -1).T
    out = np.stack([np.interp(new_steps, steps, column) for column in columns], axis=-1)
    return out.reshape(*new_steps.shape, *values.shape[1:])


def variance_factor(cycles: float) -> float:
    """Return the factor by which sample variances are too small for a number of cycles."""
    return float((1 + _SHORTFALL / cycles**1.5) ** 2)


def _changes(recordings: Sequence[Array], horizons: Indices) -> Array:
    """Return second moments (A, D, D) of the change within each horizon."""
    out: list[Array] = []
    for h in horizons.tolist():
        change = [y[h:] - y[:-h] for y in recordings if len(y) > h]
        if change:
            x = np.concatenate(change)
            out.append(x.T @ x / len(x) + _NOISE * np.eye(x.shape[1]))
        else:
            out.append(out[-1])
    return np.array(out)


def _cross_validation(
    track: PhaseTrack, grid: PhaseGrid, horizons: Indices, reference_step: int
) -> _Errors | None:
    """Predict the parts of recordings that are left out; None where nothing can be."""
    k = reference_step
    d = track.cycle.coefficients.shape[1]
    has_few_cycles = track.cycles < MANY_CYCLES
    longest = int(horizons[-1])
    least = k + min(_BLEND_HORIZON, longest) + 4
    splits = [
        split
        for split in _splits(track, least)
        if sum(map(len, split[0].recordings)) > 2 * least
    ]
    results: list[tuple[Array, Array, Array, Array]] = []
    part: list[int] = []
    steps = np.concatenate([np.arange(k), k + horizons - 1])
    for number, (rest, left_out) in enumerate(splits):
        windows = [
            _windows(y, steps, max(1, _PREDICTIONS // len(splits) // len(left_out)))
            for y, _ in left_out
        ]
        trials = np.concatenate([values for values, _ in windows])
        is_known = _known(rest, [phase for _, phase in left_out], windows, steps)
        trials = trials[is_known]
        if not len(trials):
            continue
        residual = Residual.fit(rest.phases, rest.residuals())
        gaussians = grid_gaussians(rest, residual, grid, steps - k)
        means, covariances = gaussians(slice(None))
        conditioning = Conditioning(
            np.ones(len(means)),
            means.reshape(len(means), -1),
            covariances + _NOISE * np.eye(covariances.shape[1]),
            noise=np.full(k * d, _NOISE),
            channels=d,
        )
        replay = Replay(rest.recordings, k, longest) if has_few_cycles else None
        for window in trials:
            mean, covariance = conditioning.predict(window[:k])
            replay_mean = mean
            if replay is not None and replay.is_possible:
                replay_mean = replay.predict(window[:k]).values[horizons - 1]
            part.append(number)
            results.append((window[k:], mean, replay_mean, covariance))
    if not results:
        return None
    truth, model, replays, covariances = map(np.stack, zip(*results, strict=True))
    return _Errors(truth, model, replays, covariances, np.array(part))


def _windows(values: Array, steps: Indices, places: int) -> tuple[Array, Indices]:
    """Return samples (N, n, D) at steps after some starts (N,), and the starts.

    Samples after the end are NaN. Each window has at least the samples up to the first gap
    in the steps, and the next one.
    """
    least = int(np.argmax(np.diff(steps, append=steps[-1] + 2) > 1)) + 1
    last = max(len(values) - 1 - int(steps[min(least, len(steps) - 1)]), 0)
    first = np.unique(np.linspace(0, last, min(places, last + 1)).astype(int))
    i = first[:, None] + steps
    out = np.where(
        (i < len(values))[..., None], values[np.minimum(i, len(values) - 1)], np.nan
    )
    return out, first


def _known(
    rest: PhaseTrack,
    phases: list[Array],
    windows: list[tuple[Array, Indices]],
    steps: Indices,
) -> Mask:
    """Return a mask of the windows that pass only phases that the rest contains."""
    count = 48

    def bins(phase: Array) -> Indices:
        turns = np.mod(phase, 2 * np.pi) / (2 * np.pi)
        return np.floor(turns * count).astype(int) % count

    reach = round(_PHASE_REACH / (2 * np.pi) * count)
    is_covered = np.zeros(count, dtype=bool)
    for shift in range(-reach, reach + 1):
        is_covered[(bins(np.concatenate(rest.phases)) + shift) % count] = True
    out = []
    for phase, (_, first) in zip(phases, windows, strict=True):
        indices = np.minimum(first[:, None] + steps, len(phase) - 1)
        out.append(is_covered[bins(phase[indices])].all(axis=1))
    return np.concatenate(out)


def _splits(
    track: PhaseTrack, least: int
) -> Iterator[tuple[PhaseTrack, list[tuple[Array, Array]]]]:
    """Yield tracks without one part of the recordings, and its values and phases."""
    ends = np.cumsum([len(y) for y in track.recordings])
    if track.cycles < MANY_CYCLES:
        nominal = int(np.clip(round(_PARTS_PER_CYCLE * track.cycles), *_PARTS))
        parts = max(2, min(nominal, int(ends[-1]) // least))
    else:
        parts = _PARTS_OF_MANY
    for a, b in pairwise(np.linspace(0, ends[-1], parts + 1).astype(int)):
        rest_parts: list[tuple[Array, Array, Array]] = []
        left_out: list[tuple[Array, Array]] = []
        for y, phase, shift, end in zip(
            track.recordings, track.phases, track.shifts, ends, strict=True
        ):
            low, high = np.clip(np.array([a, b]) - (end - len(y)), 0, len(y))
            if high - low >= least - _BLEND_HORIZON // 2:
                left_out.append((y[low:high], phase[low:high]))
            rest_parts += [
                (y[part], phase[part], shift[part])
                for part in (slice(0, low), slice(high, None))
                if len(y[part]) >= _LEAST_SEGMENT
            ]
        if left_out and rest_parts:
            values, phases, shifts = map(list, zip(*rest_parts, strict=True))
            rest = replace(track, recordings=values, phases=phases, shifts=shifts)
            yield rest.with_smooth_cycle(), left_out
