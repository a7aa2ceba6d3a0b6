"""Settings as records of numbers, because compiled functions take no dataclasses."""

from dataclasses import astuple, fields, is_dataclass
from typing import Any

import numpy as np


def values_of[C](config: C) -> C:
    """Return a NumPy record with the fields of a dataclass of numbers.

    It is a copy. Numbers become floats, lists arrays and dataclasses records, so that
    compiled functions see the same types every time.

    Examples
    --------
    >>> from fmp_drake.systems.impedance.supervision import WatchdogConfig
    >>> float(values_of(WatchdogConfig(max_age=1)).max_age)
    1.0
    """
    instance: Any = config
    record: Any = np.array([astuple(instance)], _dtype(instance)).view(np.recarray)[0]
    return record


def _dtype(config: Any) -> np.dtype[Any]:
    kinds: list[Any] = []
    for field in fields(config):
        value = getattr(config, field.name)
        if is_dataclass(value):
            kinds.append((field.name, _dtype(value)))
        elif isinstance(value, list):
            kinds.append((field.name, float, (len(value),)))
        else:
            kinds.append((field.name, bool if isinstance(value, bool) else float))
    return np.dtype(kinds)
