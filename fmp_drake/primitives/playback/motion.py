"""Position, velocity and acceleration, by name."""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


class Motion(np.ndarray[tuple[Any, ...], np.dtype[np.float64]]):
    """A movement or one instant of it: an array (..., 3, D) whose rows have names.

    Parts of it, and what is computed from it, are plain arrays.

    Parameters
    ----------
    values : ndarray, shape (..., 3, D)
        Value, velocity (per second) and acceleration (per second^2) of each channel.

    Examples
    --------
    >>> motion = Motion(np.arange(12.0).reshape(2, 3, 2))
    >>> motion.position
    array([[0., 1.],
           [6., 7.]])
    >>> motion.acceleration[-1]
    array([10., 11.])
    """

    def __new__(cls, values: NDArray[np.float64]) -> Self:
        """Give names to an array, which is not copied."""
        return values.view(cls)

    @property
    def position(self) -> NDArray[np.float64]:
        """The value of each channel, shape (..., D)."""
        return self[..., 0, :]

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Per second, shape (..., D)."""
        return self[..., 1, :]

    @property
    def acceleration(self) -> NDArray[np.float64]:
        """Per second^2, shape (..., D)."""
        return self[..., 2, :]

    def __getitem__(self, key: Any) -> Any:
        """Return a part as a plain array."""
        return self.view(np.ndarray)[key]

    def __iter__(self) -> Any:
        """Iterate over the parts along the first axis, plain arrays."""
        return iter(self.view(np.ndarray))

    def __array_wrap__(self, array: Any, *_: Any) -> Any:
        """Return what is computed from a motion as a plain array."""
        return array[()]
