"""Settings as records of numbers, because compiled functions take no dataclasses."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def values_of[C](settings: C) -> C:
    """Return a NumPy record with the fields of a dataclass of numbers.

    It is a copy. Numbers become floats, lists arrays, dataclasses and named tuples
    records, so that compiled functions see the same types every time.

    Examples
    --------
    >>> from fmp_drake.systems.impedance.supervision import WatchdogConfig
    >>> float(values_of(WatchdogConfig(max_age=1)).max_age)
    1.0
    """
    record: Any = np.array([_contents(settings)], _dtype(settings))
    return record.view(np.recarray)[0]


def _parts(value: Any) -> dict[str, Any] | None:
    """Return the named parts of a value that has some."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return value._asdict() if hasattr(value, "_asdict") else None


def _contents(value: Any) -> Any:
    parts = _parts(value)
    return value if parts is None else tuple(map(_contents, parts.values()))


def _dtype(value: Any) -> np.dtype[Any]:
    parts = _parts(value)
    if parts is not None:
        return np.dtype([(name, _dtype(part)) for name, part in parts.items()])
    kind = bool if isinstance(value, bool) else float
    return np.dtype((kind, np.shape(value)))
