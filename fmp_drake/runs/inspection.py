"""What is in a recording, and what can be made of it, in words."""

from collections.abc import Iterator
from itertools import groupby

import numpy as np
from scipy.ndimage import uniform_filter1d

from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.data.scaling import channel_scales
from fmp_drake.primitives.data.windows import as_windows
from fmp_drake.primitives.model.phase.period import fundamental_period
from fmp_drake.runs.skills import lay_on_board
from fmp_drake.station.scenario import Scenario

_MOST_NAMES = 12


def describe_recording(demonstration: Demonstration) -> list[str]:
    """Return four lines: channels, rate and gaps, cycles and drift, what can be learned.

    Examples
    --------
    >>> time = np.arange(0, 30, 0.02)
    >>> circles = 0.1 * np.column_stack([np.cos(3 * time), np.sin(3 * time)])
    >>> for line in describe_recording(Demonstration(time=time, values=circles)):
    ...     print(line)
    channels: x, y (m)
    rate: 50 Hz, 1500 samples in 30 s; intervals from 20 to 20 ms
    cycles: 14.3 of 2.10 s; their middle drifts by up to 1 % of the width
    learning: possible, from 720 windows of 6 s; not for the board: ...
    """
    steps = 1e3 * np.diff(demonstration.time)
    rate = (
        f"{1e3 / np.median(steps):.4g} Hz, {len(demonstration.time)} samples in "
        f"{demonstration.duration:.3g} s; intervals from {steps.min():.3g} to "
        f"{steps.max():.3g} ms"
    )
    return [
        f"channels: {'; '.join(_channels(demonstration))}",
        f"rate: {rate}",
        f"cycles: {_cycles(demonstration)}",
        f"learning: {_learning(demonstration)}",
    ]


def _channels(demonstration: Demonstration) -> Iterator[str]:
    """Yield the names of the channels that have one unit."""
    named = zip(demonstration.units, demonstration.channels, strict=True)
    for unit, group in groupby(named, key=lambda pair: pair[0]):
        names = [name for _, name in group]
        more = f" and {len(names) - _MOST_NAMES} more" * (len(names) > _MOST_NAMES)
        yield f"{', '.join(names[:_MOST_NAMES])}{more} ({unit})"


def _cycles(demonstration: Demonstration) -> str:
    """Return how many cycles there are, and how far their middle wanders."""
    rate = FourierMovementPrimitive().rate
    try:
        even = demonstration.resample(rate)
        values = even.values / channel_scales("units", even.values, even.units)
        period = fundamental_period([values])
    except DemonstrationError as error:
        return f"none found: {error}"
    middle = uniform_filter1d(values, max(1, round(period)), axis=0)
    margin = min(int(period / 2), len(middle) // 2 - 1)
    middle = middle[margin : len(middle) - margin]
    drift = float(np.max(np.ptp(middle, axis=0)) / np.max(np.ptp(values, axis=0)))
    return (
        f"{len(values) / period:.1f} of {period / rate:.2f} s; their middle drifts by up "
        f"to {100 * drift:.0f} % of the width"
    )


def _learning(demonstration: Demonstration) -> str:
    """Return whether windows can be learned, and whether the board can be wiped."""
    skill = FourierMovementPrimitive()
    try:
        windows = as_windows(
            [demonstration],
            n_steps=skill.n_steps,
            stride=skill.window_stride,
            rate=skill.rate,
        )
    except DemonstrationError as error:
        return f"not possible: {error}"
    seconds = skill.n_steps / skill.rate
    possible = f"possible, from {len(windows.values)} windows of {seconds:g} s"
    try:
        _, remarks = lay_on_board(demonstration, scenario=Scenario())
    except DemonstrationError as error:
        return f"{possible}; not for the board: {error}"
    return "; ".join([possible, *remarks] if remarks else [possible, "on the board"])
