"""One discrete movement, and the points that it has to pass."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.primitives.playback.motion import Motion


@dataclass(frozen=True, kw_only=True, eq=False)
class ViaPoint:
    """A place that a discrete movement passes at a given phase.

    Attributes
    ----------
    phase : float
        When, as a fraction of the duration, between 0 and 1.
    values : array_like, shape (C,)
        Of the C channels, in their units.
    channels : sequence of str or int, optional
        Names or indices of the channels; all D where None.

    Examples
    --------
    >>> half_way_up = ViaPoint(phase=0.5, values=[0.3], channels=["z"])

    `DiscreteMovementPrimitive.plan` takes it.
    """

    phase: float
    values: ArrayLike
    channels: Sequence[str | int] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class DiscreteMovement:
    """One movement from a start to a goal, as a cosine series in time.

    The value at time t is sum_k coefficients_k cos(pi k t / duration): the Fourier
    series of the mirrored movement, in which all sines vanish. So the velocity is
    0 at the start and, up to rounding, at the end, whatever the coefficients.

    Attributes
    ----------
    coefficients : ndarray, shape (T, D)
        In the units of the channels.
    duration : float
        Seconds.
    component : int
        The component of the mixture that the movement is made of.
    """

    coefficients: NDArray[np.float64]
    duration: float
    component: int

    def __post_init__(self) -> None:
        """Make the array read-only."""
        self.coefficients.setflags(write=False)

    def motion(self, seconds: ArrayLike) -> Motion:
        """Return the desired motion at any time.

        Parameters
        ----------
        seconds : array_like, shape (...)
            Since the start. Before it the movement stands at the start, after
            `duration` at the end.

        Returns
        -------
        Motion, shape (..., 3, D)
            Position, velocity (per second) and acceleration (per second^2) of each
            channel. Position and velocity are continuous everywhere; the acceleration
            is not 0 at the start and the end, and is 0 outside.
        """
        t = np.asarray(seconds, dtype=float)
        omega = np.pi * np.arange(len(self.coefficients)) / self.duration
        angle = np.clip(t, 0.0, self.duration)[..., None] * omega
        within = ((t >= 0) & (t <= self.duration))[..., None]
        moving = np.where(within, omega, 0.0)
        cosine, sine = np.cos(angle), np.sin(angle)
        rows = np.stack([cosine, -moving * sine, -(moving**2) * cosine], axis=-2)
        return Motion(rows @ self.coefficients)
