"""Controllers that bring Fourier weights to their target: Algorithm 2."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.primitives.data.numeric import GREATEST, is_number
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian


@dataclass(frozen=True, eq=False, kw_only=True)
class Drift:
    """How a deviation of weights from their target dies away under one component.

    In the modes (the columns of an orthonormal basis) every coordinate has its own
    rate; what is outside their span has a common one.

    Attributes
    ----------
    modes : ndarray, shape (n, r), or None
        None: every weight is a mode of its own.
    rates : ndarray, shape (r,)
        Per second.
    rest_rate : float
        Per second, outside the span of the modes.
    euler_tick : float
        Seconds of one Euler step, where the decay is that of Euler's method with linear
        motion in between; 0 for the exact exponential.
    """

    modes: NDArray[np.float64] | None
    rates: NDArray[np.float64]
    rest_rate: float = 0.0
    euler_tick: float = 0.0

    def split(
        self, deviation: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return coordinates (..., r) in the modes, and the rest (..., n) if any."""
        if self.modes is None:
            return deviation, None
        inside = deviation @ self.modes
        return inside, deviation - inside @ self.modes.T

    def decay(self, seconds: ArrayLike) -> NDArray[np.float64]:
        """Return what is left of each mode and two derivatives, (3, ..., r)."""
        if self.euler_tick == 0 and isinstance(seconds, float):
            return self._powers * np.exp(self._powers[1] * seconds)
        return _decay(self.rates, seconds, self.euler_tick)

    @cached_property
    def _powers(self) -> NDArray[np.float64]:
        return np.stack([np.ones_like(self.rates), -self.rates, self.rates**2])

    def rest_decay(self, seconds: ArrayLike) -> NDArray[np.float64]:
        """Return what is left of the rest and two derivatives, (3, ...)."""
        return _decay(np.array([self.rest_rate]), seconds, self.euler_tick)[..., 0]

    def after(
        self,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        seconds: float,
    ) -> NDArray[np.float64]:
        """Return the weights after some seconds, (..., n)."""
        deviation = weights - target
        decay = self.decay(seconds)[0]
        if self.modes is None:
            return target + decay * deviation
        if self.euler_tick == 0:
            rest = math.exp(-self.rest_rate * seconds)
        else:
            rest = float(self.rest_decay(seconds)[0])
        inside = deviation @ self.modes
        inside *= decay - rest
        left: NDArray[np.float64] = inside @ self.modes.T
        left += rest * deviation
        left += target
        return left

    def advance(
        self,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        seconds: float,
    ) -> NDArray[np.float64]:
        """Return the weights after some seconds and two derivatives, (3, ..., n)."""
        inside, rest = self.split(weights - target)
        decay = self.decay(seconds).reshape(3, *[1] * (inside.ndim - 1), -1)
        left = inside * decay
        if self.modes is not None:
            left = left @ self.modes.T
        if rest is not None:
            left += np.multiply.outer(self.rest_decay(seconds), rest)
        left[0] += target
        return left


def _decay(
    rates: NDArray[np.float64], seconds: ArrayLike, euler_tick: float
) -> NDArray[np.float64]:
    t = np.asarray(seconds, dtype=float)[..., None]
    if euler_tick > 0:
        whole = np.floor(t / euler_tick * (1 + 1e-12))
        held = (1 - euler_tick * rates) ** whole
        slope = -rates * held
        return np.stack(
            [held + slope * (t - whole * euler_tick), slope, np.zeros_like(slope)]
        )
    left = np.exp(-rates * t)
    return np.stack([left, -rates * left, rates**2 * left])


class Tracker(Protocol):
    """A rule that moves weights towards a target."""

    def drift(self, component: LowRankGaussian, *, n_steps: int, tick: float) -> Drift:
        """Prepare the rule for one component.

        Parameters
        ----------
        component : LowRankGaussian
        n_steps : int
            Length T of a window in samples.
        tick : float
            Seconds between two samples.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class LqrTracker:
    """Optimal return: the paper's future work, in closed form.

    Minimises the integral of (w - mu)' Sigma^-1 (w - mu) + rho |dw/dt|^2 over
    all time. In the eigenbasis of Sigma every coordinate decays with its own time
    constant sqrt(rho * eigenvalue): quickly where the demonstrations agree, slowly
    where they vary.

    Attributes
    ----------
    time_constant : float
        Seconds, of the direction in which the component varies most. It sets rho =
        time_constant^2 / (largest eigenvalue).
    shortest : float
        Seconds; no direction returns faster. The isotropic rest would otherwise
        return within milliseconds: a jump for the robot.
    """

    time_constant: float = 2.0
    shortest: float = 0.3

    def __post_init__(self) -> None:
        """Check the parameters."""
        for name in ("time_constant", "shortest"):
            _check_positive(name, getattr(self, name))

    def drift(
        self,
        component: LowRankGaussian,
        *,
        n_steps: int,  # noqa: ARG002 - part of the protocol
        tick: float,  # noqa: ARG002
    ) -> Drift:
        """Prepare the closed form for one component; see `Tracker.drift`."""
        eigenvalues = component.variances + component.noise
        largest = np.max(eigenvalues, initial=component.noise)
        scale = self.time_constant / np.sqrt(largest)
        return Drift(
            modes=component.basis,
            rates=1 / np.maximum(scale * np.sqrt(eigenvalues), self.shortest),
            rest_rate=1 / max(scale * np.sqrt(component.noise), self.shortest),
        )


@dataclass(frozen=True, kw_only=True)
class ProportionalTracker:
    """The proportional controller (17), one Euler step per tick.

    diag(Sigma^-1) is that of the paper's 2T weights per channel, so a gain of the
    paper means the same here. In between two ticks the weights move linearly.

    Attributes
    ----------
    beta : float
        The gain of (17), positive.
    """

    beta: float

    def __post_init__(self) -> None:
        """Check the gain."""
        _check_positive("beta", self.beta)

    def drift(self, component: LowRankGaussian, *, n_steps: int, tick: float) -> Drift:
        """Prepare (17) for one component; see `Tracker.drift`.

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
                f"this skill up to {largest:.6g}. The exponential tracker is stable "
                "for every beta."
            )
        return Drift(modes=None, rates=self.beta * precision, euler_tick=tick)


@dataclass(frozen=True, kw_only=True)
class ExponentialTracker:
    """The exact solution of dw/dt = beta diag(Sigma^-1) (mu - w).

    (17) is its Euler step. Stable for every gain, and exact at every time.

    Attributes
    ----------
    beta : float
        The gain of (17), positive.
    """

    beta: float

    def __post_init__(self) -> None:
        """Check the gain."""
        _check_positive("beta", self.beta)

    def drift(
        self,
        component: LowRankGaussian,
        *,
        n_steps: int,
        tick: float,  # noqa: ARG002 - part of the protocol
    ) -> Drift:
        """Prepare the solution for one component; see `Tracker.drift`."""
        precision = paper_precision_diagonal(component, n_steps=n_steps)
        return Drift(modes=None, rates=self.beta * precision)


def paper_precision_diagonal(
    component: LowRankGaussian, *, n_steps: int
) -> NDArray[np.float64]:
    """Return diag(Sigma^-1) of the paper's weights, as seen by ours, shape (n,).

    The paper's 2T weights of a channel are sqrt(T) G w with G isometric, and its
    regulariser also fills the T dimensions that describe no real signal. With an
    isotropic variance `noise` here and T * noise there, the paper's diagonal is
    ((Sigma^-1)_ii + 1 / noise) / (2 T) for a weight that has a conjugate copy
    and (Sigma^-1)_ii / T for the mean and the Nyquist weight.
    """
    ours = component.precision_diagonal().reshape(-1, n_steps)
    out = (ours + 1 / component.noise) / (2 * n_steps)
    single = [0, n_steps - 1] if n_steps % 2 == 0 else [0]
    out[:, single] = ours[:, single] / n_steps
    return out.ravel()


def _check_positive(name: str, value: float) -> None:
    if not (is_number(value) and value > 1 / GREATEST):
        raise SkillError(f"{name} is {value}; it must be positive.")
