"""Units that recordings come in, and what they are of ours."""

import re

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError

# A factor to seconds, metres or radians for each.
TIMES = {
    **dict.fromkeys(("s", "sec", "secs", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "usec", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanoseconds"), 1e-9),
}
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
_ANGLES = {"rad": 1.0, "deg": np.pi / 180, "°": np.pi / 180}
_SUFFIXES = "|".join(sorted({*TIMES, *LENGTHS, *_ANGLES}, key=len, reverse=True))
# Since 1970, in what unit? Above the limit it is.
_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (0.0, "s"))
# A hand is recorded this often, s between samples.
_STEPS = (4e-4, 0.5)


def named_unit(header: str) -> tuple[str, str]:
    """Split a header into name and unit: `x [mm]`, `Time (s)`; "" where unstated."""
    found = re.fullmatch(r"(.*?)[\s_]*[\[(](.*?)[\])]\s*", header)
    name, unit = found.groups() if found else (header, "")
    return name.strip(), unit.strip()


def suffixed_unit(name: str) -> tuple[str, str]:
    """Split a name that ends with its unit: `time_ms`; "" where it does not."""
    found = re.fullmatch(rf"(.+?)_({_SUFFIXES})", name)
    return (found[1], found[2]) if found else (name, "")


def in_our_units(unit: str) -> tuple[float, str]:
    """Return the factor from a unit to one of ours, and that one's name."""
    for factors, ours in ((LENGTHS, "m"), (_ANGLES, "rad")):
        if unit in factors:
            return factors[unit], ours
    return 1.0, unit


def seconds(time: NDArray[np.float64], stated: str) -> tuple[NDArray[np.float64], str]:
    """Return times in seconds, from 0 where they count since 1970, and the unit.

    Parameters
    ----------
    time : ndarray, shape (N,)
    stated : str
        The unit; "" to tell it from the numbers.

    Raises
    ------
    DemonstrationError
        Where the unit means nothing, or cannot be told.
    """
    if stated and stated not in TIMES:
        raise DemonstrationError(
            f"the time is in {stated!r}; s, ms, us and ns are understood."
        )
    steps = np.abs(np.diff(time))
    steps = steps[steps > 0]
    unit = stated
    if not unit and len(steps):
        step, start = float(np.median(steps)), abs(float(time[0]))
        if start > 1e8:
            unit = next(name for limit, name in _EPOCHS if start > limit)
        elif step < 1:
            unit = "s"
        elif np.all(np.diff(time) == 1):
            raise DemonstrationError(
                "the time counts 1, 2, 3 ...: samples, or milliseconds? Give the sample "
                "rate (--sample-rate), or the unit (--columns 'time=t [ms]')."
            )
        else:
            fits = (u for u in ("ms", "us", "ns") if _fits(step * TIMES[u]))
            unit = next(fits, "s")
    since = time[0] if abs(time[0]) * TIMES[unit or "s"] > 1e8 else 0.0
    return (time - since) * TIMES[unit or "s"], unit or "s"


def _fits(step: float) -> bool:
    return _STEPS[0] <= step <= _STEPS[1]
