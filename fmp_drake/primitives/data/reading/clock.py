"""Times of the samples of a recording, in seconds and in order."""

import numpy as np

from fmp_drake.errors import DemonstrationError
from fmp_drake.numeric import Array, Indices
from fmp_drake.primitives.data.reading.table import TIMES, ReadingOptions, count_text

# Times of day of a recording, s: since 1970, from 2001 on, and ticks of 100 ns since the
# year 1 or 1601.
_EPOCHS = {
    **dict.fromkeys(("s", "ms", "us", "ns"), (1e9, 4e9)),
    "100 ns": (1.2e10, 7e10),
}
# Plausible sample intervals of a recorded movement, and longest one of a time of day, s.
_INTERVALS, _LONGEST_INTERVAL = (4e-4, 0.5), 60.0
# Greatest fraction of samples whose time repeats with other values, and with any.
_MOST_REPEATED, _MOST_EQUAL = 0.1, 0.5
# Steps backwards in time, in sample intervals, up to which samples are put in order.
_LARGEST_STEP_BACK = 3.0


def ordered_times(
    stamp: tuple[Array, str] | None,
    rows: Indices,
    values: Array,
    options: ReadingOptions,
    remarks: list[str],
) -> tuple[Array, Indices]:
    """Return increasing times, s, and the indices of their rows."""
    count = len(rows)
    if stamp is None:
        return np.arange(count) / (options.sample_rate or 1.0), np.arange(count)
    time, unit = _seconds(stamp[0][rows], stamp[1])
    if unit != "s":
        remarks.append(f"the time is in {unit}")
    order, steps = np.arange(count), np.diff(time)
    forward = steps[steps > 0]
    interval = float(np.median(forward)) if len(forward) else 0.0
    step_back = -float(np.min(steps, initial=0.0))
    if step_back > _LARGEST_STEP_BACK * interval:
        row = int(np.argmax(steps < 0))
        raise DemonstrationError(
            f"time does not increase after sample {row} ({time[row]:g} s, then "
            f"{time[row + 1]:g} s). Cut the file there, or, if the samples are at equal "
            f"intervals, give their rate: --sample-rate {_rate(interval)}"
        )
    if step_back > 0:
        remarks.append("samples sorted by time")
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
    is_new = np.concatenate([[True], np.diff(time) != 0])
    has_other_values = np.concatenate(
        [[False], np.any(np.diff(values, axis=0) != 0, axis=1)]
    )
    repeated = int(np.count_nonzero(~is_new))
    is_coarse = np.count_nonzero(~is_new & has_other_values) > _MOST_REPEATED * count
    if is_coarse or repeated > _MOST_EQUAL * count:
        raise DemonstrationError(
            f"the time stays the same in {repeated} of {count} samples: it is too coarse. "
            "Give the sample rate instead: --sample-rate "
            f"{_rate((time[-1] - time[0]) / count)}"
        )
    if repeated:
        samples = count_text(repeated, "sample")
        remarks.append(f"{samples} with the time of the one before left out")
    return time[is_new], order[is_new]


def _rate(interval: float) -> str:
    """Return the sample rate of an interval in s, for a command."""
    return f"{1 / interval:.6g}" if interval > 0 else "100"


def _seconds(time: Array, stated_unit: str) -> tuple[Array, str]:
    """Return times in seconds and their unit in the file; times since 1970 start at 0.

    Parameters
    ----------
    time : ndarray, shape (N,)
    stated_unit : str
        "" to infer it from the numbers.

    Raises
    ------
    DemonstrationError
        Where the unit is unknown or cannot be inferred.
    """
    if stated_unit and stated_unit not in TIMES:
        raise DemonstrationError(
            f"the time is in {stated_unit!r}; expected s, ms, us or ns."
        )
    steps = np.abs(np.diff(time))
    steps = steps[steps > 0]
    unit = stated_unit
    if not unit and len(steps):
        step, start = float(np.median(steps)), abs(float(time[0]))
        since_epoch = [
            name
            for name, (least, most) in _EPOCHS.items()
            if least <= start * TIMES[name] <= most
            and step * TIMES[name] <= _LONGEST_INTERVAL
        ]
        if since_epoch:
            unit = since_epoch[0]
        elif step < 1:
            unit = "s"
        elif np.all(np.diff(time) == 1):
            raise DemonstrationError(
                "the time column counts 1, 2, 3 ...: samples or milliseconds. Give the sample "
                "rate (--sample-rate), or the unit (--columns 'time=t [ms]')."
            )
        else:
            low, high = _INTERVALS
            units = (u for u in ("ms", "us", "ns") if low <= step * TIMES[u] <= high)
            unit = next(units, "s")
    start = time[0] if abs(time[0]) * TIMES[unit or "s"] > 1e8 else 0.0
    return (time - start) * TIMES[unit or "s"], unit or "s"
