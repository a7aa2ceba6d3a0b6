"""Sliding windows over demonstrations."""

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Indices, as_floats, check_number, finite_array
from fmp_drake.primitives.data.channels import ROTATION_CHANNELS, channel_indices
from fmp_drake.primitives.data.demonstration import (
    Demonstration,
    change_reference,
    with_reference,
)


class UnstatedRate(float):
    """Default sample rate (Hz) of a skill; arrays without times need a stated one."""


# Sample rate of skills and of their training data, Hz.
DEFAULT_RATE = 20.0
UNSTATED_RATE = UnstatedRate(DEFAULT_RATE)

_WHAT = "the windows (or give a Demonstration, or a list of them)"
# Most channels of an array that is transposed by mistake.
_MOST_CHANNELS = 16
# Most values in a window; a mixture of windows of 8400 takes a minute to learn.
_MOST_VALUES = 10_000
# Rate above which rhythms of longer windows are found slowly, or not, Hz and samples.
_HIGH_RATE, _MOST_SAMPLES = 250.0, 1500


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Windows that a skill is learned from, and their sources.

    Attributes
    ----------
    values : ndarray, shape (N, T, D)
    example : Demonstration or None
        First demonstration, with the channels, units and frame of all; None where the
        windows were given as an array.
    part : ndarray, shape (N,), or None
        Index of the part, in `resampled`, of each window.
    resampled : list of ndarray, shape (n, D), or None
        Parts of the demonstrations without gaps, at one rate; None where the windows were
        given as an array.
    sources : ndarray, shape (P,), or None
        Index of the demonstration of each of the parts in `resampled`.
    starts : ndarray, shape (P,), or None
        Start of each of these parts, s from the first sample of its demonstration.
    excluded : frozenset of int
        Indices of the parts of demonstrations that have no weight.
    """

    values: Array
    example: Demonstration | None
    part: Indices | None = None
    resampled: list[Array] | None = None
    sources: Indices | None = None
    starts: Array | None = None
    excluded: frozenset[int] = frozenset()

    def recordings(self) -> list[Array]:
        """Return the recordings that the windows were cut from, arrays (n, D).

        Windows that were given as an array are joined where they overlap exactly.
        """
        if self.resampled is None or self.part is None:
            return joined_recordings(self.values)
        return [y for i, y in enumerate(self.resampled) if i not in self.excluded]

    def origins(self) -> list[tuple[int, float]]:
        """Return the index of the demonstration of each recording, and its start there, s.

        Empty where the windows were given as an array.
        """
        if self.sources is None or self.starts is None:
            return []
        origins = zip(self.sources.tolist(), self.starts.tolist(), strict=True)
        return [o for i, o in enumerate(origins) if i not in self.excluded]

    def paths(self, stride: int) -> tuple[Array, ...]:
        """Return the demonstrated paths, each (samples, D), without repetitions.

        Empty where the windows were given as an array, as their overlap is unknown.
        """
        if self.part is None:
            return ()
        is_apart = (np.diff(self.part) != 0) | (stride > self.values.shape[1])
        return tuple(
            np.concatenate([part[:-1, :stride].reshape(-1, part.shape[2]), part[-1]])
            for part in np.split(self.values, np.flatnonzero(is_apart) + 1)
        )


def extent_of(values: Sequence[Array]) -> Array:
    """Return the minima and maxima of recordings (n, D), shape (2, D)."""
    return np.stack(
        [
            np.min([y.min(axis=0) for y in values], axis=0),
            np.max([y.max(axis=0) for y in values], axis=0),
        ]
    )


def sliding_windows(values: Array, *, n_steps: int, stride: int) -> Array:
    """Cut samples (N, D) into windows `stride` samples apart: (n, T, D).

    Section V-A of the paper, with T = 120 and a stride of 10. A recording shorter
    than one window gives none.
    """
    for name, value in (("n_steps", n_steps), ("stride", stride)):
        check_number(value, name, least=1, whole=True, error=DemonstrationError)
    values = as_floats(values, "the samples", error=DemonstrationError)
    if values.ndim != 2:
        raise DemonstrationError(
            f"the samples have shape {values.shape}; expected (N, D)."
        )
    if len(values) < n_steps:
        return np.empty((0, n_steps, values.shape[1]))
    view = np.lib.stride_tricks.sliding_window_view(values, n_steps, axis=0)
    return np.ascontiguousarray(np.swapaxes(view[::stride], 1, 2))


def windows_of_all(
    recordings: Sequence[Array], *, n_steps: int, stride: int = 1
) -> Array:
    """Cut recordings (n, D) into windows, (N, T, D); see `sliding_windows`."""
    return np.concatenate(
        [sliding_windows(y, n_steps=n_steps, stride=stride) for y in recordings]
    )


def _alike(demonstrations: Sequence[Demonstration]) -> list[Demonstration]:
    """Return demonstrations with the rotation reference of the first.

    Raise where they differ in channels or units, or one of them has no such reference.
    """
    first = demonstrations[0]
    alike = [with_reference(d, first) for d in demonstrations]
    for number, demonstration in enumerate(alike, 1):
        expected = first.channels, first.units, first.rotation_reference
        _check_same(demonstration, f"demonstration {number}", expected, "first")
    return alike


def as_learned(demonstration: Demonstration, skill: Any) -> Demonstration:
    """Return a demonstration with the channels and the rotation reference of a skill.

    Raises
    ------
    DemonstrationError
        Where it has other channels or units.
    """
    if set(demonstration.channels) == set(skill.channels_):
        demonstration = demonstration.select(skill.channels_)
    if skill.rotation_reference_ is not None:
        index = channel_indices(ROTATION_CHANNELS, skill.channels_)
        near = skill.extent_[:, index].mean(axis=0)
        demonstration = change_reference(
            demonstration, skill.rotation_reference_, near=near
        )
    expected = skill.channels_, skill.units_, skill.rotation_reference_
    _check_same(demonstration, "the demonstration", expected, "skill")
    return demonstration


def _check_same(
    demonstration: Demonstration, name: str, expected: tuple[Any, ...], owner: str
) -> None:
    """Raise an error where channels, units or the rotation reference are not as expected."""
    whats = ("channels", "units", "rotation_reference")
    for what, wanted in zip(whats, expected, strict=True):
        actual = getattr(demonstration, what)
        if actual != wanted:
            actual, wanted = (
                ", ".join(map(str, values or ["none"])) for values in (actual, wanted)
            )
            raise DemonstrationError(
                f"{name} has the {what.replace('_', ' ')} {actual}; the {owner} has "
                f"{wanted}. They must be the same."
            )


def demonstration_list(recordings: Any, call: str) -> list[Demonstration]:
    """Return one or several demonstrations as a list; refuse anything else.

    Parameters
    ----------
    recordings : Demonstration or sequence of Demonstration
    call : str
        Call of the user, for the error.
    """
    if isinstance(recordings, Demonstration):
        return [recordings]
    is_sequence = isinstance(recordings, Sequence)
    if not is_sequence or not all(isinstance(r, Demonstration) for r in recordings):
        raise DemonstrationError(
            f"{call} needs a Demonstration, or a list of them; it is "
            f"{reprlib.repr(recordings)}. An array becomes one by "
            "Demonstration(time=time, values=array), a file by Demonstration.load(path)."
        )
    return list(recordings)


def _recordings(X: Any, *, rate: float) -> Sequence[Demonstration] | None:
    """Return X as demonstrations, or None where it holds windows."""
    is_sequence = isinstance(X, Sequence) and not isinstance(X, str)
    is_mixed = is_sequence and (not X or any(isinstance(x, Demonstration) for x in X))
    is_other = X is None or isinstance(X, str | Path | Mapping) or hasattr(X, "columns")
    if isinstance(X, Demonstration) or is_mixed or is_other:
        return demonstration_list(X, "fit")
    if is_sequence:
        arrays = [x for x in X if isinstance(x, np.ndarray) and x.ndim in (1, 2)]
        if len(arrays) == len(X):
            return [_sampled(x, rate) for x in arrays]
    array = as_floats(X, _WHAT, error=DemonstrationError)
    return [_sampled(array, rate)] if array.ndim in (1, 2) else None


def _sampled(values: Array, rate: float) -> Demonstration:
    if isinstance(rate, UnstatedRate):
        raise DemonstrationError(
            f"the array of shape {values.shape} has no times. Give them, "
            "Demonstration(time=time, values=array), which is learned at "
            f"{DEFAULT_RATE:g} Hz, or its sample rate in Hz, at which it is learned and "
            "played, FourierMovementPrimitive(rate=50)."
        )
    count, channels = len(values), values.size // max(1, len(values))
    if count <= _MOST_CHANNELS and 4 * count < channels:
        raise DemonstrationError(
            f"the array of shape {values.shape} would be {count} samples of {channels} "
            f"channels; give its transpose (array.T), of shape ({channels}, {count})."
        )
    return Demonstration(time=np.arange(len(values)) / rate, values=values)


def cut_demonstrations(
    X: Any, start_time: float | None, end_time: float | None, rate: float
) -> Any:
    """Return the part of every recording between two times, s from its first sample.

    Raises
    ------
    DemonstrationError
        If windows were given as an array, or a recording has no two samples there.
    """
    if start_time is None and end_time is None:
        return X
    for name, value in (("start_time", start_time), ("end_time", end_time)):
        if value is not None and value != np.inf:
            check_number(value, name, unit="s", error=DemonstrationError)
    recordings = _recordings(X, rate=rate)
    if recordings is None:
        raise DemonstrationError(
            "windows have no start_time and end_time; give demonstrations instead."
        )
    first = 0.0 if start_time is None else float(start_time)
    last = np.inf if end_time is None else float(end_time)
    out = []
    for number, recording in enumerate(recordings, 1):
        time = recording.time - recording.time[0]
        is_inside = (time >= first - 1e-9) & (time <= last + 1e-9)
        if np.count_nonzero(is_inside) < 2:
            until = "" if end_time is None else f" to {last:g} s"
            raise DemonstrationError(
                f"demonstration {number} lasts {time[-1]:.3g} s; it has no two samples "
                f"from {first:g} s{until}."
            )
        out.append(recording.rows(is_inside))
    return out


def as_windows(
    X: Any, *, n_steps: int, stride: int, rate: float, at_least: int = 2
) -> Windows:
    """Return the windows of recordings, or those in an array (N, T, D).

    A recording is a demonstration, or an array (N, D) or (N,) sampled at the rate. Each
    is split at its gaps and resampled to the rate; no window crosses a gap.

    Raises
    ------
    DemonstrationError
        Where they have different channels, or give fewer than `at_least` windows.
    """
    recordings = _recordings(X, rate=rate)
    if recordings is not None:
        X = recordings
        if not X:
            raise DemonstrationError("there is no demonstration; give at least one.")
        X = _alike(X)
        split = [d.split_at_gaps(rate) or [d] for d in X]
        sources = np.repeat(np.arange(len(X)), [len(parts) for parts in split])
        recordings = [part for parts in split for part in parts]
        first = np.array([X[i].time[0] for i in sources])
        resampled = [part.resample(rate).values for part in recordings]
        cut = [sliding_windows(y, n_steps=n_steps, stride=stride) for y in resampled]
        counts = [len(windows) for windows in cut]
        if sum(counts) < at_least:
            longest = max(part.duration for part in recordings)
            least = (n_steps - 1 + stride * (at_least - 1)) / rate
            # Four fifths of what fits, in tenths of a second.
            fitting = np.floor(8 * (longest - stride * at_least / rate)) / 10
            advice = f", of {fitting:g} s for example" if fitting * rate >= 8 else ""
            raise DemonstrationError(
                f"the demonstrations give {sum(counts) or 'no'} "
                f"window{'s' * (sum(counts) != 1)} of {n_steps / rate:g} s "
                f"(the longest lasts {longest:.3g} s); at least {at_least} are needed. "
                f"Record at least {least:.3g} s, or choose shorter windows{advice}."
            )
        return Windows(
            values=cut[0] if len(cut) == 1 else np.concatenate(cut),
            example=X[0],
            part=np.repeat(np.arange(len(cut)), counts),
            resampled=resampled,
            sources=sources,
            starts=np.array([part.time[0] for part in recordings]) - first,
        )
    shape = ("windows", n_steps, "channels")
    values = finite_array(X, _WHAT, shape, error=DemonstrationError)
    if len(values) < at_least:
        raise DemonstrationError(
            f"there are {len(values)} windows; at least {at_least} are needed."
        )
    return Windows(values=values, example=None)


def check_window_size(recordings: Sequence[Array], n_steps: int, rate: float) -> None:
    """Refuse windows that take many minutes to learn, such as those of 1 kHz."""
    n_steps = min(n_steps, max(map(len, recordings)))
    channels = recordings[0].shape[1]
    has_high_rate = rate > _HIGH_RATE and n_steps > _MOST_SAMPLES
    if n_steps * channels > _MOST_VALUES or has_high_rate:
        raise DemonstrationError(
            f"a window of {n_steps / rate:.3g} s at {rate:g} Hz has {n_steps} samples of "
            f"{channels} channels, which take minutes to learn; choose a lower "
            "rate or shorter windows. Without a rate, FourierMovementPrimitive() learns at "
            f"{DEFAULT_RATE:g} Hz, also from an array with times: "
            f"Demonstration(time=np.arange(len(array)) / {rate:g}, values=array)."
        )


def weighted_windows(
    windows: Windows, weights: ArrayLike | None
) -> tuple[Windows, Array | None]:
    """Return the windows of positive weight and their weights, on average 1.

    Parameters
    ----------
    windows : Windows
    weights : array_like, optional
        Weights of the demonstrations, or of the windows of an array; none negative.
    """
    if weights is None:
        return windows, None
    sources, part = windows.sources, windows.part
    count = len(windows.values) if sources is None else int(sources[-1]) + 1
    weights = finite_array(weights, "the weights", (count,), error=DemonstrationError)
    if np.any(weights < 0):
        raise DemonstrationError(f"the weights are {weights}; none may be negative.")
    per_window = weights if sources is None else weights[sources[part]]
    is_used = per_window > 0
    if sources is not None:
        excluded = frozenset(np.flatnonzero(weights[sources] == 0).tolist())
        windows = replace(windows, excluded=excluded)
    if not np.any(weights) or (len(is_used) and np.count_nonzero(is_used) < 2):
        raise DemonstrationError(
            f"the weights leave {np.count_nonzero(is_used)} windows; at least 2 must have "
            "a positive weight."
        )
    if not np.all(is_used):
        windows = replace(
            windows,
            values=windows.values[is_used],
            part=None if part is None else part[is_used],
        )
    positive = per_window[is_used] if len(is_used) else weights[weights > 0]
    return windows, positive / positive.mean()


def joined_recordings(windows: Array) -> list[Array]:
    """Join windows (N, T, D) that overlap exactly to recordings (n, D), in order.

    Models that need the whole signal (its period, its phase) recover it from the windows
    that all models get. A window that does not continue the one before, sample
    for sample, starts another recording.
    """
    out: list[list[Array]] = []
    guess = 0
    for i, window in enumerate(windows):
        shift = _shift(windows[i - 1], window, guess) if i else 0
        if shift:
            out[-1].append(window[-shift:])
            guess = shift
        else:
            out.append([window])
    return [np.concatenate(parts) for parts in out]


def _shift(before: Array, after: Array, guess: int) -> int:
    """Return the shift between two windows in samples, 0 where they do not overlap."""
    last = len(before) - 2  # At least two samples must agree.
    shifts = np.flatnonzero(np.all(before == after[0], axis=1)).tolist()
    for s in sorted((s for s in shifts if 1 <= s <= last), key=lambda s: s != guess):
        if np.array_equal(before[s:], after[:-s]):
            return s
    return 0
