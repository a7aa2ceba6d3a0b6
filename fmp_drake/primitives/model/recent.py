"""What was made a moment ago, for those who ask for the same again."""

from collections.abc import Callable, Hashable


class Recent[T]:
    """The values that were asked for last, by what they are made of.

    Parameters
    ----------
    count : int
        How many are kept.

    Examples
    --------
    >>> squares = Recent[int](2)
    >>> squares.get(3, lambda: 9), squares.get(3, lambda: 1 / 0)
    (9, 9)
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._values: dict[Hashable, T] = {}

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the value of a key, and make it where it is not kept."""
        # The last in a dictionary is what was put there last.
        value = self._values.pop(key) if key in self._values else make()
        self._values[key] = value
        if len(self._values) > self._count:
            del self._values[next(iter(self._values))]
        return value
