"""Which channels a picture shows, and what they are called."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from fmp_drake.errors import RunError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive

type Demonstrations = Demonstration | Sequence[Demonstration]


@dataclass(frozen=True)
class Channels:
    """Names and units of the channels of a skill or of demonstrations.

    Every method raises a RunError where a picture asks for channels that do not exist.

    Attributes
    ----------
    names, units : tuple of str
    """

    names: tuple[str, ...]
    units: tuple[str, ...]

    @classmethod
    def of_skill(cls, skill: FourierMovementPrimitive) -> Self:
        """Return the channels of a fitted skill."""
        skill.check_fitted()
        return cls(skill.channels_, skill.units_)

    @classmethod
    def of_demonstrations(cls, demonstrations: Sequence[Demonstration]) -> Self:
        """Return the channels that all the demonstrations have."""
        if not demonstrations:
            raise RunError("there is no demonstration; give at least one.")
        out = cls(demonstrations[0].channels, demonstrations[0].units)
        out.check(demonstrations)
        return out

    def check(self, demonstrations: Sequence[Demonstration]) -> None:
        """Raise where a demonstration has other channels."""
        for number, demonstration in enumerate(demonstrations):
            if demonstration.channels != self.names:
                raise RunError(
                    f"demonstration {number} has the channels "
                    f"{', '.join(demonstration.channels)}; the others and the skill "
                    f"in this picture have {', '.join(self.names)}. Select the same "
                    "ones (Demonstration.select)."
                )

    def indices(self, names: Sequence[str] | None) -> list[int]:
        """Return the indices of the named channels, all where None."""
        chosen = self.names if names is None else tuple(names)
        if not chosen:
            raise RunError("no channel is named; name at least one, or give None.")
        for name in chosen:
            if name not in self.names:
                raise RunError(
                    f"there is no channel {name!r}; the channels are "
                    f"{', '.join(self.names)}."
                )
        return [self.names.index(name) for name in chosen]

    def plane(self, names: Sequence[str] | None) -> tuple[int, int]:
        """Return the indices of the upward and the leftward channel."""
        if names is None and len(self.names) < 2:
            raise RunError(
                f"there is only the channel {self.names[0]}; a picture in the plane "
                "needs two. Draw it over time."
            )
        chosen = self.indices(self.names[:2] if names is None else names)
        if len(chosen) != 2 or chosen[0] == chosen[1]:
            raise RunError(
                f"the plane is {tuple(names or ())}; name two different channels."
            )
        return chosen[0], chosen[1]

    def label(self, index: int) -> str:
        """Return a channel's name with its unit."""
        return f"{self.names[index]} ({self.units[index]})"


def as_list(demonstrations: Demonstrations) -> list[Demonstration]:
    """Return one or several demonstrations as a list."""
    if isinstance(demonstrations, Demonstration):
        return [demonstrations]
    return list(demonstrations)
