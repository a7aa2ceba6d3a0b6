"""Methods of the benchmark that come with the package."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from fmp_drake.errors import ExperimentError
from fmp_drake.experiments.baselines.gaussian_processes import (
    DelayGP,
    PeriodicGP,
    RecordingGP,
)
from fmp_drake.experiments.baselines.method import HORIZON, PAST, RATE, Forecast, Method
from fmp_drake.experiments.baselines.periodic_dmp import (
    AdaptiveOscillatorDMP,
    PeriodicDMP,
)
from fmp_drake.experiments.baselines.periodic_kmp import PeriodicKMP
from fmp_drake.experiments.baselines.promp import AlignedProMP, WindowedProMP
from fmp_drake.numeric import Array
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    sliding_windows,
)
from fmp_drake.primitives.model.movement_primitive import copy_skill
from fmp_drake.primitives.model.phase.phase_model import LEAST_COMPONENTS
from fmp_drake.primitives.model.trajectory_mixture import PredictionPlan

# Nearest neighbours of a replay, and the time constant of its offset, samples.
_NEIGHBOURS, _OFFSET_TIME = 5, 20.0


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
        """Remove a part of the fitted skill, for an ablation."""

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        prediction = self._plan.predict(past)
        return Forecast(
            values=prediction.values[:horizon],
            covariances=prediction.covariances[:horizon],
            degrees_of_freedom=prediction.degrees_of_freedom,
        )

    def play(self, past: Array, count: int, *, seed: int) -> Array:
        """Return the samples that a player tracks from the last one of `past`."""
        player = Player(self.skill, sample=True, seed=seed)
        return player.rollout(past[-1], count / RATE)[1 : count + 1, 0]


class MixtureFMP(FMP):
    """A Fourier movement primitive without a phase model."""

    name = "FMP, mixture"
    settings: ClassVar[dict[str, Any]] = {"model": "mixture"}


class FewComponentsFMP(FMP):
    """Ablation: the least number of components of a phase model."""

    name = "FMP, few components"
    settings: ClassVar[dict[str, Any]] = {"n_components": LEAST_COMPONENTS}


class UncalibratedFMP(FMP):
    """Ablation: the covariances of the phase model alone, without its calibration."""

    name = "FMP, not calibrated"

    def simplify(self) -> None:
        """Prepare predictions without replay, whose covariances are those of the model."""
        self._plan_without_replay = PredictionPlan(
            copy_skill(self.skill, memory_=()), HORIZON
        )

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        forecast, calibration = super().predict(past, horizon), self.skill.calibration_
        if calibration is None or self.skill.phase_model_ is None:
            return forecast
        calibration = calibration.at(HORIZON).transformed(np.diag(self.skill.scales_))
        covariances = (
            self._plan_without_replay.predict(past).covariances
            - calibration.error_covariances
        )
        covariances = covariances / calibration.factors[:, None, None]
        covariances += 1e-9 * np.eye(past.shape[1])
        return Forecast(values=forecast.values, covariances=covariances[:horizon])


class UnblendedFMP(FMP):
    """Ablation: the phase model alone, without replay of few cycles."""

    name = "FMP, no blend"

    def simplify(self) -> None:
        """Give replay no weight in the mean."""
        calibration = self.skill.calibration_
        if calibration is not None and self.skill.phase_model_ is not None:
            self.skill.calibration_ = replace(calibration, model_weight=1.0)
            self.skill.memory_ = ()


class ReplayMethod(Method):
    """The median continuation of the nearest neighbours of the observed samples.

    Each of the five continuations is offset to begin at the present value; the offset
    decays within a second. The covariances are those of the errors of predictions inside
    the recordings, which leave out the neighbourhood of the predicted sample.
    """

    name = "replay"

    def fit(self, recordings: Sequence[Array]) -> None:
        """Learn from recordings (n, D)."""
        size = PAST + HORIZON
        self._recordings = [y for y in recordings if len(y) > size]
        if not self._recordings:
            raise ExperimentError(f"no recording is longer than {size} samples.")
        windows = [sliding_windows(y, n_steps=size, stride=1) for y in self._recordings]
        self._windows = np.concatenate(windows)
        # Windows of one recording are independent where they begin 1.5 s apart.
        recording = np.repeat(np.arange(len(windows)), list(map(len, windows)))
        times = np.arange(len(recording)) + size * recording
        errors = []
        for i in np.linspace(0, len(times) - 1, min(len(times), 100)).astype(int):
            is_other = np.abs(times - times[i]) >= size
            if is_other.sum() >= _NEIGHBOURS:
                past, truth = np.split(self._windows[i], [PAST])
                errors.append(truth - _continuation(self._windows[is_other], past))
        self._covariances = None
        if len(errors) >= 2 * self._windows.shape[2]:
            stacked = np.stack(errors)
            self._covariances = np.einsum("nhd,nhe->hde", stacked, stacked)
            self._covariances /= len(stacked)
            self._covariances += 1e-9 * np.eye(stacked.shape[2])

    def predict(self, past: Array, horizon: int) -> Forecast:
        """Predict the samples after `past`, shape (PAST, D), at most a second."""
        covariances = self._covariances
        return Forecast(
            values=_continuation(self._windows, past)[:horizon],
            covariances=None if covariances is None else covariances[:horizon],
        )

    def play(self, past: Array, count: int, *, seed: int) -> Array:  # noqa: ARG002
        """Replay the longest recording from its sample most similar to the past.

        From its end it continues at the sample that is most similar to the end.
        """
        recording = max(self._recordings, key=len)
        windows = sliding_windows(recording, n_steps=PAST, stride=1)

        def sample_after(past: Array, count: int) -> int:
            """Return the index after the nearest one of the first windows."""
            distances = np.sum((windows[:count] - past) ** 2, axis=(1, 2))
            return int(np.argmin(distances)) + PAST

        last = len(recording) - PAST
        first = sample_after(past, last)
        restart = sample_after(recording[last:], max(1, last - PAST))
        parts = [recording[first:]]
        while sum(map(len, parts)) < count:
            parts.append(recording[restart:])
        path = np.concatenate(parts)[:count]
        # The jumps at the start and between the parts decay.
        offset, start = past[-1] - recording[first - 1], 0
        for part in parts:
            stop = min(start + len(part), count)
            steps = np.arange(1, stop - start + 1)[:, None]
            path[start:stop] += np.exp(-steps / _OFFSET_TIME) * offset
            offset, start = recording[-1] - recording[restart - 1], stop
        return path


def _continuation(windows: Array, past: Array) -> Array:
    """Return the median end (H, D) of the windows (N, PAST + H, D) nearest to a past."""
    k = len(past)
    distances = np.sum((windows[:, :k] - past) ** 2, axis=(1, 2))
    nearest = windows[np.argsort(distances, kind="stable")[:_NEIGHBOURS]]
    offsets = past[-1] - nearest[:, k - 1]
    decay = np.exp(-np.arange(1, windows.shape[1] - k + 1) / _OFFSET_TIME)
    out: Array = np.median(nearest[:, k:] + decay[:, None] * offsets[:, None], axis=0)
    return out


ABLATIONS: tuple[type[Method], ...] = (
    FewComponentsFMP,
    UncalibratedFMP,
    UnblendedFMP,
)
"""FMP, each without one of its parts."""

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
    WindowedProMP,
)
