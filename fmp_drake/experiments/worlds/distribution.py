"""Distributions of one value of a scenario."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, log
from typing import Any

import numpy as np

from fmp_drake.errors import ExperimentError
from fmp_drake.numeric import is_number, is_whole

KINDS = {
    "uniform": "[least, most]",
    "log_uniform": "[least, most], both positive",
    "normal": "[mean, standard deviation, least, most]",
    "choice": "[one, another, ...], equally likely",
}
"""The distributions by their names, with what each expects."""


@dataclass(frozen=True)
class Distribution:
    """What a value is drawn from.

    Parameters
    ----------
    kind : str
        One of `KINDS`. Uniform between whole numbers draws whole numbers.
    values : tuple
        As `KINDS` says.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> 0.3 < Distribution("uniform", (0.3, 0.8)).draw(rng) < 0.8
    True
    """

    kind: str
    values: tuple[Any, ...]

    @classmethod
    def read(cls, given: Mapping[str, Any], name: str) -> "Distribution":
        """Read a distribution such as ``{uniform: [0, 1]}``.

        Raises
        ------
        ExperimentError
            That says what is allowed.
        """
        ((kind, values),) = given.items()
        numbers = isinstance(values, list) and all(map(is_number, values))
        fits = {
            "uniform": numbers and len(values) == 2 and values[0] <= values[1],
            "log_uniform": numbers and len(values) == 2 and 0 < values[0] <= values[1],
            "normal": numbers
            and len(values) == 4
            and values[1] > 0
            and values[2] <= values[0] <= values[3],
            "choice": isinstance(values, list) and len(values) > 0,
        }[kind]
        if not fits:
            raise ExperimentError(
                f"{name} is {{{kind}: {values}}}; expected {kind}: {KINDS[kind]}."
            )
        return cls(kind, tuple(values))

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw a value."""
        if self.kind == "choice":
            return self.values[rng.integers(len(self.values))]
        if self.kind == "log_uniform":
            least, most = map(log, self.values)
            return exp(rng.uniform(least, most))
        if self.kind == "uniform":
            least, most = self.values
            if is_whole(least) and is_whole(most):
                return int(rng.integers(least, most, endpoint=True))
            return float(rng.uniform(least, most))
        mean, deviation, least, most = self.values
        while not least <= (value := float(rng.normal(mean, deviation))) <= most:
            pass
        return value

    def extremes(self) -> tuple[Any, ...]:
        """Return the values that are the least and the greatest, or all choices."""
        return self.values[2:] if self.kind == "normal" else self.values
