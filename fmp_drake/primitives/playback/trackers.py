"""Controllers that move Fourier weights to their target: Algorithm 2."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fmp_drake.errors import SkillError
from fmp_drake.numeric import Array, check_number
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian


@dataclass(frozen=True, eq=False, kw_only=True)
class Relaxation:
    """Decay of the weights' deviation from their target under one component.

    Along each mode (a column of an orthonormal basis) the deviation decays exponentially
    with its own rate, in the orthogonal complement of the modes with a common rate.

    Attributes
    ----------
    modes : ndarray, shape (n, r), or None
        None where every weight is a separate mode: r = n.
    rates : ndarray, shape (r,)
        Per second.
    complement_rate : float
        Per second, in the orthogonal complement.
    euler_tick : float
        Duration of one step of Euler's method, s, with linear motion in between; 0 for
        exponential decay.
    """

    modes: Array | None
    rates: Array
    complement_rate: float = 0.0
    euler_tick: float = 0.0

    def rates_by_channel(self, channels: int) -> Array:
        """Return the rates of decay in each of D channels, shape (D, m).

        They are those of all modes and of their orthogonal complement, or those of the
        channel's weights where every weight is a separate mode.
        """
        if self.modes is None:
            return self.rates.reshape(channels, -1)
        return np.tile([*self.rates, self.complement_rate], (channels, 1))

    def split(self, deviation: Array) -> tuple[Array, Array]:
        """Split deviations (..., n) into coordinates (..., r) and residuals (..., n)."""
        if self.modes is None:
            return deviation, np.zeros_like(deviation)
        coordinates = deviation @ self.modes
        return coordinates, deviation - coordinates @ self.modes.T

    def decay(self, seconds: float | Array) -> tuple[Array, Array]:
        """Return the remaining fraction of the modes (..., r) and the complement (..., 1).

        Parameters
        ----------
        seconds : float or ndarray, shape (...)
            Time since the fraction was 1.
        """
        t = np.asarray(seconds)[..., None]
        complement = np.exp(-self.complement_rate * t)
        if self.euler_tick <= 0:
            return np.exp(-self.rates * t), complement
        ticks, time_since_tick = np.divmod(t, self.euler_tick)
        per_tick = 1 - self.rates * self.euler_tick
        return per_tick**ticks * (1 - self.rates * time_since_tick), complement

    def decay_rate(self, seconds: float) -> tuple[Array, Array]:
        """Return the negative derivative of `decay`, per second.

        With Euler's method it is that of the first tick.
        """
        modes, complement = self.decay(0.0 if self.euler_tick > 0 else seconds)
        return self.rates * modes, self.complement_rate * complement

    def after(
        self,
        weights: Array,
        target: Array,
        seconds: float,
    ) -> Array:
        """Return the weights, shape (n,), some seconds later.

        Parameters
        ----------
        weights, target : ndarray, shape (n,)
        seconds : float
        """
        deviation = weights - target
        if not deviation.any():
            return target
        decay, complement = self.decay(seconds)
        if self.modes is None:
            return target + decay * deviation
        coordinates, residual = self.split(deviation)
        out = self.modes @ (decay * coordinates)
        out += complement * residual
        out += target
        return out


class Tracker(Protocol):
    """Controller that moves weights towards a target.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import LqrTracker, Tracker
    >>> tracker: Tracker = LqrTracker(time_constant=1.5)
    """

    def relaxation(
        self, component: LowRankGaussian, *, n_steps: int, tick: float
    ) -> Relaxation:
        """Prepare the decay towards one component.

        Parameters
        ----------
        component : LowRankGaussian
        n_steps : int
            Length T of a window in samples.
        tick : float
            Sample interval, s.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class LqrTracker:
    """Linear-quadratic regulator in closed form, which the paper leaves to future work.

    Minimises the integral of ``(w - mu)' Sigma^-1 (w - mu) + rho |dw/dt|^2`` over
    all time. In the eigenbasis of Sigma every coordinate decays with its own time
    constant sqrt(rho * eigenvalue): quickly where the demonstrations agree, slowly
    where they vary.

    Attributes
    ----------
    time_constant : float
        Time constant of the direction in which the component varies most, s. It sets
        rho = time_constant^2 / (largest eigenvalue).
    shortest : float
        Least time constant, s. The orthogonal complement would otherwise decay within
        milliseconds: a jump for the robot.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import LqrTracker
    >>> from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
    >>> component = LowRankGaussian(
    ...     mean=np.zeros(8),
    ...     basis=np.eye(8)[:, :1],
    ...     variances=np.array([1.0]),
    ...     noise=0.01,
    ... )
    >>> tracker = LqrTracker(time_constant=1.0)
    >>> relaxation = tracker.relaxation(component, n_steps=8, tick=0.1)
    >>> print(relaxation.after(np.ones(8), component.mean, 1.0).round(2)[:2])
    [0.37 0.04]
    """

    time_constant: float = 2.0
    shortest: float = 0.3

    def __post_init__(self) -> None:
        """Check the parameters."""
        for name in ("time_constant", "shortest"):
            check_number(getattr(self, name), name, above=0)

    def relaxation(
        self,
        component: LowRankGaussian,
        *,
        n_steps: int,  # noqa: ARG002 - part of the protocol
        tick: float,  # noqa: ARG002
    ) -> Relaxation:
        """Prepare the closed form for one component; see `Tracker.relaxation`."""
        eigenvalues = component.variances + component.noise
        largest = np.max(eigenvalues, initial=component.noise)
        scale = self.time_constant / np.sqrt(largest)
        return Relaxation(
            modes=component.basis,
            rates=1 / np.maximum(scale * np.sqrt(eigenvalues), self.shortest),
            complement_rate=1 / max(scale * np.sqrt(component.noise), self.shortest),
        )


@dataclass(frozen=True, kw_only=True)
class ExponentialTracker:
    """Exact solution of dw/dt = beta diag(Sigma^-1) (mu - w).

    (17) is its Euler step. The weights converge for every gain and are exact at every time.
    Time constants below a few sample intervals give velocities, and with them excursions,
    that no robot can follow: choose a small gain, or `LqrTracker`, which bounds them.

    Attributes
    ----------
    beta : float
        The gain of (17), positive.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import ExponentialTracker
    >>> from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
    >>> component = LowRankGaussian(
    ...     mean=np.zeros(8),
    ...     basis=np.eye(8)[:, :1],
    ...     variances=np.array([1.0]),
    ...     noise=0.01,
    ... )
    >>> tracker = ExponentialTracker(beta=0.1)
    >>> relaxation = tracker.relaxation(component, n_steps=8, tick=0.1)
    >>> print(relaxation.after(np.ones(8), component.mean, 0.5).round(2)[:2])
    [0.99 0.54]
    """

    beta: float

    def __post_init__(self) -> None:
        """Check the gain."""
        check_number(self.beta, "beta", above=0)

    def relaxation(
        self,
        component: LowRankGaussian,
        *,
        n_steps: int,
        tick: float,  # noqa: ARG002 - part of the protocol
    ) -> Relaxation:
        """Prepare the solution for one component; see `Tracker.relaxation`."""
        precision = paper_precision_diagonal(component, n_steps=n_steps)
        return Relaxation(modes=None, rates=self.beta * precision)


@dataclass(frozen=True, kw_only=True)
class ProportionalTracker(ExponentialTracker):
    """Proportional controller (17): one Euler step per tick.

    diag(Sigma^-1) is that of the paper's 2T weights per channel, so gains equal those of
    the paper. Between two ticks the weights move linearly.

    Attributes
    ----------
    beta : float
        The gain of (17), positive.

    Examples
    --------
    >>> import numpy as np
    >>> from fmp_drake.primitives import ProportionalTracker
    >>> from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
    >>> component = LowRankGaussian(
    ...     mean=np.zeros(8),
    ...     basis=np.eye(8)[:, :1],
    ...     variances=np.array([1.0]),
    ...     noise=0.01,
    ... )
    >>> tracker = ProportionalTracker(beta=0.1)
    >>> relaxation = tracker.relaxation(component, n_steps=8, tick=0.1)
    >>> print(relaxation.after(np.ones(8), component.mean, 0.1).round(2)[:2])
    [1.   0.88]
    """

    def relaxation(
        self, component: LowRankGaussian, *, n_steps: int, tick: float
    ) -> Relaxation:
        """Prepare (17) for one component; see `Tracker.relaxation`.

        Raises
        ------
        SkillError
            Where dt beta max diag(Sigma^-1) > 2: (17) would diverge.
        """
        precision = paper_precision_diagonal(component, n_steps=n_steps)
        largest = 2 / (tick * float(np.max(precision)))
        if self.beta > largest:
            raise SkillError(
                f"beta is {self.beta}; the proportional tracker (17) is stable for "
                f"this skill up to {largest:.6g}. Choose a smaller beta, or LqrTracker()."
            )
        return Relaxation(modes=None, rates=self.beta * precision, euler_tick=tick)


def paper_precision_diagonal(component: LowRankGaussian, *, n_steps: int) -> Array:
    """Return diag(Sigma^-1) of the paper's weights for ours, shape (n,).

    The paper's 2T weights of a channel are sqrt(T) G w with G isometric, and its
    regulariser also fills the T dimensions that describe no real signal. The isotropic
    variance is `noise` here and T * noise there. Then the paper's diagonal is
    ((Sigma^-1)_ii + 1 / noise) / (2 T) for a weight that has a conjugate copy.
    For the mean and the Nyquist weight it is (Sigma^-1)_ii / T.
    """
    precision = component.precision_diagonal().reshape(-1, n_steps)
    out = (precision + 1 / component.noise) / (2 * n_steps)
    single = [0, n_steps - 1] if n_steps % 2 == 0 else [0]
    out[:, single] = precision[:, single] / n_steps
    return out.ravel()
