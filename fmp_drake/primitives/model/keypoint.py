"""Keypoints: values that a movement has to pass, with a tolerance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import as_floats, check_number, finite_array
from fmp_drake.primitives.data.channels import channel_indices


@dataclass(frozen=True, kw_only=True, eq=False)
class Keypoint:
    """Values of some channels that a movement has to pass at one step of a window.

    Attributes
    ----------
    step : float
        Time in samples from the start of the window, 0 to T - 1.
    values : array_like, shape (C,)
        Values of the C channels, in their units, per second^derivative.
    channels : sequence of str or int, optional
        Names or indices of the channels; all D where None.
    derivative : int
        0 for values, 1 for velocities, 2 for accelerations.
    tolerance : float or array_like, shape (C,), optional
        lambda of (13), in squared units of the values; the skill's where None.

    Examples
    --------
    Through x = 0.1 m at step 40, upwards at 0.2 m/s in the middle of the window:

    >>> at = Keypoint(step=40, values=[0.1], channels=["x"])
    >>> fast = Keypoint(step=60, values=[0.2], channels=["z"], derivative=1)

    `FourierMovementPrimitive.map_keypoints` takes them.
    """

    step: float
    values: ArrayLike
    channels: Sequence[str | int] | None = None
    derivative: int = 0
    tolerance: ArrayLike | None = None


def stack_keypoints(
    keypoints: Sequence[Keypoint],
    *,
    names: Sequence[str],
    tolerance: NDArray[np.float64],
    rows_of: Callable[..., NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return several keypoints as one linear observation of the weights.

    Parameters
    ----------
    keypoints : sequence of Keypoint
    names : sequence of str
        Of the D channels.
    tolerance : ndarray, shape (D,)
        lambda of (13) for keypoints that have none.
    rows_of : callable
        Returns the rows Phi^D (20) of a step, some channels and a derivative.

    Returns
    -------
    rows : ndarray, shape (m, D*T)
    values, tolerances : ndarray, shape (m,)

    Raises
    ------
    SkillError
        If a keypoint does not fit the skill, or there is none.
    """
    if not isinstance(keypoints, Sequence) or not all(
        isinstance(point, Keypoint) for point in keypoints
    ):
        raise SkillError(f"{keypoints!r} is not a list of Keypoint; give one.")
    if not keypoints:
        raise SkillError("there is no keypoint; give at least one.")
    rows, values, tolerances = [], [], []
    for point in keypoints:
        check_number(point.step, "the step of a keypoint")
        name = f"of the keypoint at step {point.step:g}"
        index = channel_indices(point.channels, names)
        shape = (len(index),)
        rows.append(rows_of(point.step, channels=index, derivative=point.derivative))
        values.append(finite_array(point.values, f"the values {name}", shape))
        allowed = tolerance[index] if point.tolerance is None else point.tolerance
        squares = as_floats(allowed, f"the tolerance {name}")
        if squares.ndim == 0:
            squares = np.full(shape, squares)
        tolerances.append(as_floats(squares, f"the tolerance {name}", shape))
    return np.concatenate(rows), np.concatenate(values), np.concatenate(tolerances)
