"""Methods that come with the package."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.adaptive_oscillator import AdaptiveOscillatorDMP
from fmp_drake.experiments.baselines.aligned_promp import AlignedProMP
from fmp_drake.experiments.baselines.delay_gp import DelayGP
from fmp_drake.experiments.baselines.method import (
    HORIZON,
    PAST,
    RATE,
    Array,
    Forecast,
    Method,
)
from fmp_drake.experiments.baselines.periodic_dmp import PeriodicDMP
from fmp_drake.experiments.baselines.periodic_gp import PeriodicGP
from fmp_drake.experiments.baselines.periodic_kmp import PeriodicKMP
from fmp_drake.experiments.baselines.promp import ProMP
from fmp_drake.experiments.baselines.recording_gp import RecordingGP
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    sliding_windows,
)
from fmp_drake.primitives.model.movement_primitive import copy_skill
from fmp_drake.primitives.model.phase.phase_model import LEAST_COMPONENTS
from fmp_drake.primitives.model.trajectory_mixture import PredictionPlan

# Samples of the windows of ProMP.
_MOST_WINDOW = 120
# Of replay: least continuations, and the time constant of an offset in samples.
_NEIGHBOURS, _ANCHOR_TIME = 5, 20.0


class FMP(Method):
    """A Fourier movement primitive with its default settings."""

    name = "FMP"
    settings: ClassVar[dict[str, Any]] = {}

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        demonstrations = [
            Demonstration(time=np.arange(len(y)) / RATE, values=y) for y in recordings
        ]
        self.skill = FourierMovementPrimitive(rate=RATE, **self.settings)
        self.skill.fit(demonstrations)
        self.simplify()
        self._plan = PredictionPlan(self.skill, HORIZON)

    def simplify(self) -> None:
        """Take a part from the fitted skill, for an ablation."""

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        prediction = self._plan.predict(past)
        return Forecast(
            values=prediction.values[:horizon],
            covariances=prediction.covariances[:horizon],
            degrees=prediction.degrees,
        )

    def play(self, past: Array, count: int, *, seed: int) -> Array:
        """Return the samples that the player tracks from the last of `past`."""
        player = Player(self.skill, sample=True, seed=seed)
        return player.rollout(past[-1], count / RATE)[1 : count + 1, 0]


class MixtureFMP(FMP):
    """A Fourier movement primitive without a phase model."""

    name = "FMP, mixture"
    settings: ClassVar[dict[str, Any]] = {"model": "mixture"}


class FewComponentsFMP(FMP):
    """Ablation: as few components as a phase model may have."""

    name = "FMP, few components"
    settings: ClassVar[dict[str, Any]] = {"n_components": LEAST_COMPONENTS}


class UncalibratedFMP(FMP):
    """Ablation: Gaussians with the covariances of the model itself."""

    name = "FMP, not calibrated"

    def simplify(self) -> None:
        """Prepare predictions without replay, whose covariances contain no more."""
        self._alone = PredictionPlan(copy_skill(self.skill, memory_=()), HORIZON)

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        forecast, calibration = super().predict(past, horizon), self.skill.calibration_
        if calibration is None or self.skill.phase_model_ is None:
            return forecast
        calibration = calibration.at(HORIZON).transformed(np.diag(self.skill.scales_))
        covariances = self._alone.predict(past).covariances - calibration.errors
        covariances = covariances / calibration.factors[:, None, None]
        least = 1e-9 * np.eye(past.shape[1])
        return Forecast(
            values=forecast.values, covariances=(covariances + least)[:horizon]
        )


class UnblendedFMP(FMP):
    """Ablation: the phase model alone, without replay of few cycles."""

    name = "FMP, no blend"

    def simplify(self) -> None:
        """Give replay no weight in the mean."""
        calibration = self.skill.calibration_
        if calibration is not None and self.skill.phase_model_ is not None:
            self.skill.calibration_ = replace(calibration, weight=1.0)
            self.skill.memory_ = ()


class ReplayMethod(Method):
    """The nearest neighbours of the observed samples, and their continuations.

    The median of five continuations is offset to begin at the present value; the offset
    decays within a second. The covariances are those of predictions inside the
    recordings, from which the neighbourhood of each is left out.
    """

    name = "replay"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        size = PAST + HORIZON
        view = np.lib.stride_tricks.sliding_window_view
        self._recordings = [y for y in recordings if len(y) > size]
        if not self._recordings:
            raise ExperimentError(f"no recording is longer than {size} samples.")
        self._windows = np.concatenate(
            [np.swapaxes(view(y, size, axis=0), 1, 2) for y in self._recordings]
        )
        number = np.repeat(
            np.arange(len(self._recordings)),
            [len(y) - size + 1 for y in self._recordings],
        )
        # A second window of the same movement begins at least 1.5 s away.
        index = np.arange(len(number)) + 10 * size * number
        chosen = np.linspace(0, len(index) - 1, min(len(index), 100)).astype(int)
        errors = []
        for i in chosen:
            other = np.abs(index - index[i]) >= size
            if other.sum() >= _NEIGHBOURS:
                past, truth = np.split(self._windows[i], [PAST])
                errors.append(truth - _continuation(self._windows[other], past))
        self._covariances = None
        if len(errors) >= 2 * self._windows.shape[2]:
            off = np.stack(errors)
            self._covariances = np.einsum("nhd,nhe->hde", off, off) / len(off)
            self._covariances += 1e-9 * np.eye(off.shape[2])

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        covariances = self._covariances
        return Forecast(
            values=_continuation(self._windows, past)[:horizon],
            covariances=None if covariances is None else covariances[:horizon],
        )

    def play(self, past: Array, count: int, *, seed: int) -> Array:  # noqa: ARG002
        """Return the longest recording from the most similar sample on.

        At its end it continues from the sample that is most like the end.
        """
        longest = max(self._recordings, key=len)
        view = np.lib.stride_tricks.sliding_window_view
        windows = np.swapaxes(view(longest, PAST, axis=0), 1, 2)

        def nearest(samples: Array, before: int) -> int:
            off = np.sum((windows[:before] - samples) ** 2, axis=(1, 2))
            return int(np.argmin(off)) + PAST

        last = len(longest) - PAST
        first = nearest(past, last)
        back = nearest(longest[last:], max(1, last - PAST))
        path = [longest[first:]]
        while sum(map(len, path)) < count:
            path.append(longest[back:])
        joined = np.concatenate(path)[:count]
        # Jumps at the start and at the seams decay as offsets do.
        offset, start = past[-1] - longest[first - 1], 0
        for part in path:
            stop = min(start + len(part), count)
            steps = np.arange(1, stop - start + 1)[:, None]
            joined[start:stop] += np.exp(-steps / _ANCHOR_TIME) * offset
            offset, start = longest[-1] - longest[back - 1], stop
            if stop == count:
                break
        return joined


def _continuation(windows: Array, past: Array) -> Array:
    """Return the median end (H, D) of the windows (N, PAST + H, D) most like a past."""
    known = len(past)
    distances = np.sum((windows[:, :known] - past) ** 2, axis=(1, 2))
    best = windows[np.argsort(distances, kind="stable")[:_NEIGHBOURS]]
    offsets = past[-1] - best[:, known - 1]
    left = np.exp(-np.arange(1, windows.shape[1] - known + 1) / _ANCHOR_TIME)
    out: Array = np.median(best[:, known:] + left[:, None] * offsets[:, None], axis=0)
    return out


class ProMPMethod(Method):
    """ProMP-VM-Mult with the movement's own frequency and many Gaussians."""

    name = "ProMP, own frequencies"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        longest = max(map(len, recordings))
        size = int(np.clip(longest // 2, PAST + HORIZON, _MOST_WINDOW))
        stride = 1 if longest < 2 * _MOST_WINDOW else 2
        windows = [
            sliding_windows(y, n_steps=size, stride=stride)
            for y in recordings
            if len(y) >= size
        ]
        if not windows:
            raise ExperimentError(f"no recording has {size} samples.")
        model = ProMP(frequencies=5, n_components=80)
        self._model = model.fit(np.concatenate(windows))

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (K, D)."""
        prediction = self._model.predict(past, horizon)
        return Forecast(values=prediction.values, covariances=prediction.covariances)


ABLATIONS: tuple[type[Method], ...] = (
    FewComponentsFMP,
    UncalibratedFMP,
    UnblendedFMP,
)
"""FMP without one of its parts each."""

METHODS: tuple[type[Method], ...] = (
    FMP,
    *ABLATIONS,
    MixtureFMP,
    ReplayMethod,
    DelayGP,
    RecordingGP,
    PeriodicGP,
    PeriodicKMP,
    PeriodicDMP,
    AdaptiveOscillatorDMP,
    AlignedProMP,
    ProMPMethod,
)
