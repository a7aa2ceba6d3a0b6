"""Controllers that bring Fourier weights to their target: Algorithm 2."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillError
from fmp_drake.primitives.low_rank_gaussian import LowRankGaussian


class Drift(Protocol):
    """The motion of weights towards a target under one component."""

    def advance(
        self,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        seconds: float,
    ) -> NDArray[np.float64]:
        """Return the weights after some seconds and two derivatives, (3, n)."""
        ...


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


@dataclass(frozen=True, eq=False)
class _ModalDrift:
    """Each coordinate in an orthonormal basis decays at its own rate."""

    basis: NDArray[np.float64]
    rates: NDArray[np.float64]
    rest_rate: float

    def advance(
        self,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        seconds: float,
    ) -> NDArray[np.float64]:
        delta = weights - target
        inside = delta @ self.basis
        rest = np.exp(-self.rest_rate * seconds)
        # The rest is delta minus its part inside the basis: fold both into one.
        decay = np.exp(-self.rates * seconds)
        coordinates = np.empty((3, len(inside)))
        coordinates[0] = inside * (decay - rest)
        coordinates[1] = inside * (-self.rates * decay + self.rest_rate * rest)
        coordinates[2] = inside * (self.rates**2 * decay - self.rest_rate**2 * rest)
        out: NDArray[np.float64] = coordinates @ self.basis.T
        out[0] += target + rest * delta
        out[1] -= self.rest_rate * rest * delta
        out[2] += self.rest_rate**2 * rest * delta
        return out


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
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise SkillError(f"{name} is {value} s; it must be positive.")

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
        return _ModalDrift(
            basis=component.basis,
            rates=1 / np.maximum(scale * np.sqrt(eigenvalues), self.shortest),
            rest_rate=1 / max(scale * np.sqrt(component.noise), self.shortest),
        )


@dataclass(frozen=True, eq=False)
class _EulerDrift:
    """Every weight moves by a fixed share of its distance per second."""

    rates: NDArray[np.float64]

    def advance(
        self,
        weights: NDArray[np.float64],
        target: NDArray[np.float64],
        seconds: float,
    ) -> NDArray[np.float64]:
        velocity = self.rates * (target - weights)
        return np.stack(
            [weights + seconds * velocity, velocity, np.zeros_like(velocity)]
        )


@dataclass(frozen=True, kw_only=True)
class ProportionalTracker:
    """The proportional controller (17), one Euler step per tick.

    diag(Sigma^-1) is that of the paper's 2T weights per channel, so a gain of the
    paper means the same here. In between two ticks the weights move linearly.

    Attributes
    ----------
    beta : float
        The gain of (17).
    """

    beta: float

    def drift(self, component: LowRankGaussian, *, n_steps: int, tick: float) -> Drift:
        """Prepare (17) for one component; see `Tracker.drift`.

        Raises
        ------
        SkillError
            Where dt beta max diag(Sigma^-1) > 2: (17) would diverge.
        """
        precision = paper_precision_diagonal(component, n_steps=n_steps)
        largest = 2 / (tick * float(np.max(precision)))
        if not 0 < self.beta <= largest:
            raise SkillError(
                f"beta is {self.beta}; the proportional tracker (17) is stable for "
                f"this skill from 0 to {largest:.6g}."
            )
        return _EulerDrift(rates=self.beta * precision)


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
