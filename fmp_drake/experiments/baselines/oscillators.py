"""Adaptive frequency oscillators that find the frequency of a signal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import DemonstrationError

# Gains, relative to an oscillator's own frequency, and Euler steps per sample.
_PHASE_GAIN, _FREQUENCY_GAIN, _AMPLITUDE_GAIN, _SUBSTEPS = 0.3, 0.03, 0.2, 2
# The signals are repeated until an oscillator has seen this many samples.
_LEAST_SAMPLES = 4000
# A component with less of the total power than this does not count.
_LEAST_SHARE = 0.08
# Frequencies this close to integer multiples belong to one fundamental.
_HARMONIC = 0.06
_MOST_MULTIPLE = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Entrainment:
    """What the oscillators have locked to.

    Attributes
    ----------
    frequency : float
        Fundamental, rad per sample.
    phases : tuple of ndarray, shape (n,)
        Of the fundamental at every sample of each recording, rad, not wrapped.
    """

    frequency: float
    phases: tuple[NDArray[np.float64], ...]


def entrain(
    recordings: Sequence[NDArray[np.float64]],
    *,
    slowest: float,
    fastest: float = 12.0,
    n_oscillators: int = 5,
) -> Entrainment:
    """Let a pool of oscillators find the fundamental frequency of raw signals.

    Every channel y, in its own standard deviations, drives oscillators that all see
    what the others leave (Righetti et al. 2006, in the feedback loop of Gams et al.
    2009)::

        e = y - sum_i a_i cos(phi_i)
        dphi_i / dt = omega_i (1 - 0.3 e sin(phi_i))
        domega_i / dt = -0.03 omega_i^2 e sin(phi_i)
        da_i / dt = 0.2 omega_i e cos(phi_i)

    The gains are relative to omega_i here, so that no time scale is set by hand. The
    strong components of all channels are then taken as multiples, 1 to 4 or
    fractions thereof, of one fundamental (the "logical operation" of Gams et al.).

    Parameters
    ----------
    recordings : sequence of ndarray, shape (n, D)
    slowest, fastest : float
        Periods of the first and last oscillator at the start, samples.
    n_oscillators : int
        For each channel.

    References
    ----------
    L. Righetti, J. Buchli, A. J. Ijspeert, "Dynamic Hebbian learning in adaptive
    frequency oscillators", Physica D 216(2), 2006.
    A. Gams et al., "On-line learning and modulation of periodic movements with nonlinear
    dynamical systems", Autonomous Robots 27(1), 2009.
    """
    total = sum(len(y) for y in recordings)
    together = np.concatenate(recordings)
    spread = together.std(axis=0)
    if not np.any(spread > 0):
        raise DemonstrationError("the demonstration does not move; nothing oscillates.")
    signal = (together - together.mean(axis=0)) / np.where(spread > 0, spread, 1.0)
    passes = max(2, int(np.ceil(_LEAST_SAMPLES / total)))
    start = 2 * np.pi / np.geomspace(slowest, fastest, n_oscillators)
    phase, amplitude = _run(signal, start, passes)  # (total, D, M) of the last pass
    rates = (phase[-1] - phase[0]) / (total - 1)
    power = np.mean(amplitude**2, axis=0) * (spread**2)[:, None]
    strong = np.argwhere((power >= _LEAST_SHARE * power.sum()) & (rates > 0))
    if not len(strong):
        raise DemonstrationError(
            "the oscillators locked to nothing; record a rhythmic movement of several "
            "cycles."
        )
    found = [
        (float(rates[d, i]), float(power[d, i]), int(d), int(i)) for d, i in strong
    ]
    frequency, lowest = _fundamental(found)
    _, _, d, i = lowest
    multiple = max(1, round(lowest[0] / frequency))
    ends = np.cumsum([len(y) for y in recordings])[:-1]
    return Entrainment(
        frequency=frequency, phases=tuple(np.split(phase[:, d, i] / multiple, ends))
    )


def _run(
    signal: NDArray[np.float64], start: NDArray[np.float64], passes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Integrate the pool; return phases and amplitudes of the last pass."""
    n, d = signal.shape
    omega = np.tile(start, (d, 1))
    phi = np.zeros_like(omega)
    a = np.zeros_like(omega)
    phases, amplitudes = np.empty((2, n, *omega.shape))
    h = 1 / _SUBSTEPS
    following = np.vstack([signal[1:], signal[-1:]])
    for _ in range(passes):
        for t in range(n):
            phases[t], amplitudes[t] = phi, a
            for s in range(_SUBSTEPS):
                y = signal[t] + (following[t] - signal[t]) * (s * h)
                wave = np.cos(phi)
                e = (y - np.sum(a * wave, axis=1))[:, None]
                push = -e * np.sin(phi)
                turn = h * omega
                phi = phi + turn * (1 + _PHASE_GAIN * push)
                # A step in log(omega) keeps the frequency positive.
                omega = omega * np.exp(_FREQUENCY_GAIN * turn * push)
                a = a + _AMPLITUDE_GAIN * turn * e * wave
    return phases, amplitudes


_Component = tuple[float, float, int, int]


def _fundamental(found: list[_Component]) -> tuple[float, _Component]:
    """Return the frequency that all components are multiples of, and the lowest.

    Of the lowest component's frequency and its half, third and fourth: the first that
    explains nine tenths of the power; else the first that explains most.
    """
    rates = np.array([f for f, *_ in found])
    power = np.array([p for _, p, *_ in found])
    best, explained = (rates.min(), 1.0), -np.inf
    slowest = rates.min()
    near = rates < slowest * (1 + _HARMONIC)
    base = float(np.average(rates[near], weights=power[near]))
    for divisor in range(1, _MOST_MULTIPLE + 1):
        multiples = np.maximum(1, np.round(rates * divisor / base))
        guess = base / divisor
        fits = np.abs(rates / (multiples * guess) - 1) < _HARMONIC
        share = float(power[fits].sum() / power.sum())
        if share > explained + 1e-9:
            mean = np.average((rates / multiples)[fits], weights=power[fits])
            best, explained = (float(mean), share), share
        if share > 0.9:
            break
    at_base = [c for c, is_near in zip(found, near, strict=True) if is_near]
    return best[0], max(at_base, key=lambda c: c[1])
