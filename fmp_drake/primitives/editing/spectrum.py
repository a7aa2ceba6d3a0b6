"""Magnitude and phase of each harmonic: spectra and modulation (section VII of the paper).

A channel of a window is the sum over the harmonics k = 0 to T/2 of

    magnitude_k cos(2 pi k n / T + phase_k),

so the magnitude is in the unit of the channel (2 |w~_k| / T of (1), and |w~_k| / T for
the mean and the Nyquist harmonic) and the phase is that of w~_k.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import circmean, circstd

from fmp_drake.errors import SkillError
from fmp_drake.numeric import (
    Array,
    Indices,
    as_floats,
    check_number,
    check_type,
    finite_array,
)
from fmp_drake.primitives.data.channels import channel_indices
from fmp_drake.primitives.data.windows import extent_of
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.movement_primitive import (
    FourierMovementPrimitive,
    copy_skill,
)
from fmp_drake.primitives.model.phase.phase_model import PhaseModel
from fmp_drake.primitives.model.trajectory_mixture import check_skill

_SAMPLES, _EXTENT_SAMPLES = 1000, 200


@dataclass(frozen=True, kw_only=True)
class SpectralPeak:
    """Dominant frequency of a channel: a local maximum of its spectrum.

    Attributes
    ----------
    frequency : float
        Hz, interpolated between harmonics.
    harmonic : int
        The strongest harmonic of the peak, cycles per window.
    fraction : float
        Fraction of the variance of the channel within windows, 0 to 1.

    Examples
    --------
    >>> peak = SpectralPeak(frequency=0.52, harmonic=3, fraction=0.8)
    >>> round(1 / peak.frequency, 2)  # The period, s.
    1.92
    """

    frequency: float
    harmonic: int
    fraction: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """Statistics of the magnitudes and phases of many windows.

    Arrays have a row for each harmonic, 0 to T/2, and a column for each channel. They
    are read-only. The phase of a harmonic that is only noise has no meaning.

    Attributes
    ----------
    channels : tuple of str
    frequencies : ndarray, shape (H,)
        Hz.
    fractions : ndarray, shape (H, D)
        Fractions of the variance of each channel within windows; 0 for the mean.
    magnitude_mean, magnitude_std : ndarray, shape (H, D)
        In the units of the channels.
    phase_mean, phase_std : ndarray, shape (H, D)
        Circular mean, -pi to pi, and circular standard deviation, rad. They are not
        informative for sliding windows, which start at any phase: use the relative
        ones.
    relative_phase_mean, relative_phase_std : ndarray, shape (H, D)
        The same for the phase relative to that of the first channel, rad, which does not
        depend on the start of a window.

    Examples
    --------
    >>> from fmp_drake.primitives.editing.spectrum import window_spectrum
    >>> phase = 2 * np.pi * np.arange(40) / 10
    >>> windows = np.array([[np.cos(phase + start)] for start in range(8)])
    >>> spectrum = window_spectrum(windows.transpose(0, 2, 1), rate=20.0)
    >>> [round(peak.frequency, 3) for peak in spectrum.peaks(0)]
    [2.0]
    """

    channels: tuple[str, ...]
    frequencies: Array
    fractions: Array
    magnitude_mean: Array
    magnitude_std: Array
    phase_mean: Array
    phase_std: Array
    relative_phase_mean: Array
    relative_phase_std: Array

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def peaks(
        self, channel: str | int, *, count: int = 3, least_fraction: float = 0.01
    ) -> tuple[SpectralPeak, ...]:
        """Return the dominant frequencies of a channel, the strongest first.

        A peak is a local maximum of the variance over the harmonics, with all harmonics
        down to the valleys beside it. A movement that does not fit into the window a
        whole number of times spreads over two harmonics; its frequency is interpolated
        by the ratio of their magnitudes, which is exact for a sinusoid (D. Rife, G.
        Vincent, "Use of the discrete Fourier transform in the measurement of
        frequencies and levels of tones", Bell System Technical Journal 49, 1970).

        Parameters
        ----------
        channel : str or int
        count : int
            Greatest number of peaks.
        least_fraction : float
            Weaker peaks are left out.
        """
        from scipy.signal import find_peaks  # Slow to import.

        (index,) = channel_indices([channel], self.channels)
        fractions = self.fractions[1:, index]
        padded = np.concatenate([[-1.0], fractions, [-1.0]])
        tops = find_peaks(padded, height=np.finfo(float).tiny)[0] - 1
        valleys = [a + int(np.argmin(fractions[a : b + 1])) for a, b in pairwise(tops)]
        edges = [0, *valleys, len(fractions)]
        resolution = float(self.frequencies[1])
        peaks = []
        for i, top in enumerate(tops):
            left, right = padded[top], padded[top + 2]
            neighbour, sign = (left, -1) if left > right else (right, 1)
            ratio = np.sqrt(max(neighbour, 0.0) / fractions[top])
            harmonic = int(top) + 1
            peaks.append(
                SpectralPeak(
                    frequency=float(harmonic + sign * ratio / (1 + ratio)) * resolution,
                    harmonic=harmonic,
                    fraction=float(fractions[edges[i] : edges[i + 1]].sum()),
                )
            )
        peaks = [peak for peak in peaks if peak.fraction >= least_fraction]
        peaks.sort(key=lambda peak: -peak.fraction)
        return tuple(peaks[:count])


def window_spectrum(
    windows: ArrayLike,
    *,
    rate: float,
    channels: Sequence[str] = (),
) -> Spectrum:
    """Return the statistics of magnitude and phase of windows.

    Parameters
    ----------
    windows : array_like, shape (N, T, D)
        For example from `sliding_windows`.
    rate : float
        Samples per second (Hz).
    channels : sequence of str
        Names of the channels; `c0`, `c1` and so on where empty.

    Raises
    ------
    SkillError
        Where the windows or the rate cannot be used.
    """
    y = finite_array(windows, "the windows", ("windows", "samples", "channels"))
    check_number(rate, "rate", above=0.0, unit="Hz")
    names = tuple(channels) or tuple(f"c{i}" for i in range(y.shape[2]))
    if len(names) != y.shape[2]:
        raise SkillError(f"{len(names)} channel names for {y.shape[2]} channels.")
    n = y.shape[1]
    magnitude, phase = polar(y)
    relative = phase - phase[:, :, :1]
    power = np.mean(magnitude**2, axis=0) / 2
    power[0] = 0
    if n % 2 == 0:
        power[-1] *= 2
    # The rounding errors of a constant channel have no frequencies.
    power[:, power.sum(axis=0) <= (1e-14 * np.max(np.abs(y), axis=(0, 1))) ** 2] = 0
    total = power.sum(axis=0)
    return Spectrum(
        channels=names,
        frequencies=np.arange(n // 2 + 1) * rate / n,
        fractions=power / np.where(total > 0, total, 1.0),
        magnitude_mean=magnitude.mean(axis=0),
        magnitude_std=magnitude.std(axis=0),
        phase_mean=circmean(phase, low=-np.pi, high=np.pi, axis=0),
        phase_std=_circular_std(phase),
        relative_phase_mean=circmean(relative, low=-np.pi, high=np.pi, axis=0),
        relative_phase_std=_circular_std(relative),
    )


def skill_spectrum(skill: FourierMovementPrimitive) -> Spectrum:
    """Return the statistics of magnitude and phase of a fitted skill.

    They have no closed form for a Gaussian over weights, so they are those of 1000
    samples without white noise.
    """
    check_skill(skill, "skill_spectrum(skill)")
    return window_spectrum(
        skill.sample(_SAMPLES, with_noise=False),
        rate=skill.rate,
        channels=skill.channels_,
    )


def polar(
    windows: Array,
) -> tuple[Array, Array]:
    """Return magnitudes and phases of windows (N, T, D), each (N, H, D)."""
    n = windows.shape[1]
    spectrum = np.fft.rfft(windows, axis=1) * 2 / n
    spectrum[:, 0] /= 2
    if n % 2 == 0:
        spectrum[:, -1] /= 2
    return np.abs(spectrum), np.angle(spectrum)


def _circular_std(phase: Array) -> Array:
    with np.errstate(divide="ignore"):  # Infinite where phases cancel exactly.
        return circstd(phase, low=-np.pi, high=np.pi, axis=0)


def modulate_windows(
    windows: ArrayLike,
    *,
    harmonics: Sequence[int],
    gain: float = 1.0,
    phase: float = 0.0,
    channels: Sequence[int] | None = None,
) -> Array:
    """Scale the magnitude and shift the phase of some harmonics.

    Parameters
    ----------
    windows : array_like, shape (..., T, D)
    harmonics : sequence of int
        From 0 (the mean) to T/2.
    gain : float
        Factor of the magnitudes, not negative.
    phase : float
        Shift of the phases, rad; positive is earlier. The mean and the Nyquist harmonic
        have no phase to shift.
    channels : sequence of int, optional
        Indices; all where None.

    Returns
    -------
    ndarray, shape (..., T, D)

    Raises
    ------
    SkillError
        Where a harmonic or a channel does not exist, the gain is negative, or the phase
        of the mean or the Nyquist harmonic would be shifted.
    """
    y = as_floats(windows, "the windows", ("...", "T", "D"))
    n = y.shape[-2]
    index = channel_indices(channels, [f"c{i}" for i in range(y.shape[-1])])
    numbers = _checked_harmonics(harmonics, gain, phase, n)
    return _modulated(y, numbers, gain * np.exp(1j * phase), index)


def _modulated(
    windows: Array, harmonics: Indices, factor: complex, channels: list[int]
) -> Array:
    spectrum = np.fft.rfft(windows, axis=-2)
    spectrum[..., harmonics[:, None], channels] *= factor
    return np.fft.irfft(spectrum, n=windows.shape[-2], axis=-2)


def _checked_harmonics(
    harmonics: Iterable[int], gain: float, phase: float, n_steps: int
) -> Indices:
    """Return increasing harmonics of a window; see `modulate_windows`."""
    check_type(harmonics, "harmonics", Iterable, error=SkillError)
    harmonics = list(harmonics)
    for k in harmonics:
        check_number(k, "a harmonic", whole=True)
    numbers = sorted({int(k) for k in harmonics})
    if not numbers or numbers[0] < 0 or numbers[-1] > n_steps // 2:
        raise SkillError(
            f"the harmonics are {harmonics}; give some from 0 to {n_steps // 2}."
        )
    check_number(gain, "gain", least=0.0)
    check_number(phase, "phase", unit="rad")
    real = [k for k in numbers if k == 0 or 2 * k == n_steps]
    if real and phase != 0:
        raise SkillError(
            f"harmonic {real[0]} is the mean or the Nyquist harmonic of windows of {n_steps} "
            "samples and has no phase to shift."
        )
    return np.array(numbers)


def modulate_skill(
    skill: FourierMovementPrimitive,
    *,
    harmonics: Sequence[int],
    gain: float = 1.0,
    phase: float = 0.0,
    channels: Sequence[str] | None = None,
) -> FourierMovementPrimitive:
    """Return a copy of a skill with other magnitudes or phases of some harmonics.

    Means and low-rank factors of a mixture are mapped exactly, as `modulate_windows` maps
    trajectories, so `sample(with_noise=False)` has exactly the mapped distribution. A
    phase shift is orthogonal and maps the isotropic noise, eps I, exactly as well. A
    gain would make it anisotropic, so the noise is not mapped: the covariance differs from
    the mapped one by eps (1 - gain^2) in the weights of these harmonics. It is white
    noise and the regulariser, which no playback follows.

    With a phase model, the harmonics of the cycle are changed instead: each one by the
    part of it that a window has in the named harmonics. Mapped windows would not repeat
    where these are not those of a cycle. Its residual and the covariances do not change.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; not changed.
    harmonics, gain, phase
        See `modulate_windows`; those of a window also with a phase model.
    channels : sequence of str, optional
        Names; all where None.

    Returns
    -------
    FourierMovementPrimitive
        Its `extent_` is that of 200 samples. It was not demonstrated, so `paths_` is empty
        and its predictions are not calibrated.
    """
    check_skill(skill, "modulate_skill(skill)")
    index = channel_indices(channels, skill.channels_)
    numbers = _checked_harmonics(harmonics, gain, phase, skill.n_steps)
    factor = gain * np.exp(1j * phase)

    def mapped(weights: Array) -> Array:
        windows = skill.basis.synthesize(weights)
        return skill.basis.analyze(_modulated(windows, numbers, factor, index))

    model = skill.phase_model_
    if model is None:
        components = [
            _with_factor(replace(c, mean=mapped(c.mean)), mapped(c.basis.T).T)
            for c in skill.components_
        ]
    else:
        factors = np.ones((model.cycle.harmonics + 1, skill.n_channels_), complex)
        factors[:, index] = _cycle_factors(model, numbers, factor, skill.n_steps)
        cycle = model.cycle.modulated(factors)
        steps = np.arange(skill.n_steps) - model.reference_step
        paths = model.grid.phases[:, None] + model.velocity.mean * steps
        changes = skill.basis.analyze(cycle.values(paths) - model.cycle.values(paths))
        components = [
            replace(c, mean=c.mean + change)
            for c, change in zip(skill.components_, changes, strict=True)
        ]
        model = replace(model, cycle=cycle)
    out = copy_skill(
        skill,
        components_=tuple(components),
        phase_model_=model,
        calibration_=None,
        memory_=(),
        model_reason_="the harmonics of its windows were changed",
        paths_=(),
    )
    samples = out.sample(_EXTENT_SAMPLES, with_noise=False)
    return copy_skill(out, extent_=extent_of(list(samples)))


def _cycle_factors(
    model: PhaseModel, harmonics: Indices, factor: complex, n_steps: int
) -> Array:
    """Return the factors (h + 1, 1) of a cycle's mean and harmonics, complex.

    Each one is a sum of all harmonics of a window, of which some have the given factor; it
    is the average of their factors, weighted by their energies.
    """
    order = np.arange(model.cycle.harmonics + 1)
    phases = model.velocity.mean * np.arange(n_steps)
    energy = np.abs(np.fft.fft(np.exp(1j * order[:, None] * phases), axis=1)) ** 2
    factors = np.ones((n_steps, 1), complex)
    factors[-harmonics] = np.conj(factor)  # Of negative frequencies.
    factors[harmonics] = factor
    return energy @ factors / energy.sum(axis=1, keepdims=True)


def _with_factor(component: LowRankGaussian, factor: Array) -> LowRankGaussian:
    """Replace U by any n x r factor: the covariance is factor diag(s) factor' + eps I."""
    directions, triangle = np.linalg.qr(factor)
    core = (triangle * component.variances) @ triangle.T
    variances, rotation = np.linalg.eigh((core + core.T) / 2)
    is_kept = variances > 1e-12 * np.max(variances, initial=1e-300)
    return replace(
        component,
        basis=np.ascontiguousarray(directions @ rotation[:, is_kept]),
        variances=np.ascontiguousarray(variances[is_kept]),
    )
