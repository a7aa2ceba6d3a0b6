"""Modulation of the magnitude and phase of harmonics: section VII of the paper.

`fmp_drake.primitives.editing.spectrum` defines magnitude and phase.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.errors import SkillError
from fmp_drake.numeric import as_floats, check_number
from fmp_drake.primitives.data.channels import channel_indices
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian
from fmp_drake.primitives.model.movement_primitive import (
    FourierMovementPrimitive,
    copy_skill,
)
from fmp_drake.primitives.model.trajectory_mixture import check_skill

_EXTENT_SAMPLES = 200


def modulate_windows(
    windows: ArrayLike,
    *,
    harmonics: Sequence[int],
    gain: float = 1.0,
    phase: float = 0.0,
    channels: Sequence[int] | None = None,
) -> NDArray[np.float64]:
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
    numbers = sorted({int(k) for k in harmonics})
    if not numbers or numbers[0] < 0 or numbers[-1] > n // 2:
        raise SkillError(
            f"the harmonics are {list(harmonics)}; give some from 0 to {n // 2}."
        )
    check_number(gain, "gain", least=0.0)
    check_number(phase, "phase", unit="rad")
    real = [k for k in numbers if k == 0 or 2 * k == n]
    if real and phase != 0:
        raise SkillError(
            f"harmonic {real[0]} is the mean or the Nyquist harmonic of windows of {n} "
            "samples and has no phase to shift."
        )
    spectrum = np.fft.rfft(y, axis=-2)
    spectrum[..., np.array(numbers)[:, None], index] *= gain * np.exp(1j * phase)
    return np.fft.irfft(spectrum, n=n, axis=-2)


def modulate_skill(
    skill: FourierMovementPrimitive,
    *,
    harmonics: Sequence[int],
    gain: float = 1.0,
    phase: float = 0.0,
    channels: Sequence[str] | None = None,
) -> FourierMovementPrimitive:
    """Return a copy of a skill with other magnitudes or phases of some harmonics.

    Means and low-rank factors are mapped exactly, as `modulate_windows` maps
    trajectories, so `sample(with_noise=False)` has exactly the mapped distribution. A
    phase shift is orthogonal and maps the isotropic noise, eps I, exactly as well. A
    gain would make it anisotropic, so the noise is not mapped: the covariance differs from
    the mapped one by eps (1 - gain^2) in the weights of these harmonics. It is white
    noise and the regulariser, which no playback follows.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; not changed.
    harmonics, gain, phase
        See `modulate_windows`.
    channels : sequence of str, optional
        Names; all where None.

    Returns
    -------
    FourierMovementPrimitive
        Its `extent_` is that of 200 samples. It was not demonstrated, so `paths_` is empty.
        It is a mixture without a phase model: the harmonics of a window are not those of a
        cycle.
    """
    check_skill(skill, "modulate_skill(skill)")
    index = channel_indices(channels, skill.channels_)

    def modulated(windows: NDArray[np.float64]) -> NDArray[np.float64]:
        return modulate_windows(
            windows, harmonics=harmonics, gain=gain, phase=phase, channels=index
        )

    def mapped(weights: NDArray[np.float64]) -> NDArray[np.float64]:
        return skill.basis.analyze(modulated(skill.basis.synthesize(weights)))

    components = []
    for component in skill.components_:
        moved = replace(component, mean=mapped(component.mean))
        basis = mapped(component.basis.T).T
        components.append(_with_factor(moved, basis))
    # Drawn from the original: samples of a phase model's Gaussians would leave the cycle.
    samples = modulated(skill.sample(_EXTENT_SAMPLES, with_noise=False))
    return copy_skill(
        skill,
        components_=tuple(components),
        phase_model_=None,
        calibration_=None,
        memory_=(),
        model_="mixture",
        model_reason_="the harmonics of its windows were changed",
        extent_=np.stack([samples.min(axis=(0, 1)), samples.max(axis=(0, 1))]),
        paths_=(),
    )


def _with_factor(
    component: LowRankGaussian, factor: NDArray[np.float64]
) -> LowRankGaussian:
    """Replace U by any n x r factor: the covariance is factor diag(s) factor' + eps I."""
    directions, triangle = np.linalg.qr(factor)
    core = (triangle * component.variances) @ triangle.T
    variances, rotation = np.linalg.eigh((core + core.T) / 2)
    keep = variances > 1e-12 * np.max(variances, initial=1e-300)
    return replace(
        component,
        basis=np.ascontiguousarray(directions @ rotation[:, keep]),
        variances=np.ascontiguousarray(variances[keep]),
    )
