"""The Fourier movement primitive: a skill that is learned from demonstrations."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.numeric import GREATEST, Array, check_number, one_blas_thread
from fmp_drake.primitives.data.channels import (
    ChannelScales,
    channel_scales,
    default_channels,
)
from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.primitives.data.windows import (
    UNSTATED_RATE,
    as_learned,
    check_window_size,
    cut_demonstrations,
    demonstration_list,
    extent_of,
    weighted_windows,
)
from fmp_drake.primitives.model.mixture import (
    MOST_COMPONENTS,
    ComponentCount,
    Progress,
    fit_mixture,
    learn_continuation,
)
from fmp_drake.primitives.model.phase.calibration import (
    calibrate_playback,
    calibrate_replay,
)
from fmp_drake.primitives.model.phase.phase_model import (
    LEAST_COMPONENTS,
    fit_phase_model,
)
from fmp_drake.primitives.model.phase.rhythm import Rhythm
from fmp_drake.primitives.model.phase.search import TrackedRhythm, search_rhythm
from fmp_drake.primitives.model.trajectory_mixture import TrajectoryMixture

ModelChoice = Literal["mixture", "phase", "automatic"]

# Default window, samples and s; the greater counts. For a phase model: periods in a window up
# to that size, which is less for more than three channels, because the time to learn grows
# with the cube of their values; and the least number of periods.
_DEFAULT_STEPS, _DEFAULT_WINDOW = 120, 6.0
_PERIODS, _LEAST_PERIODS = 3.2, 1.2
# Shortest window (s) that is played smoothly: of real movements, shorter ones have two to four
# times the acceleration.
_SMOOTH_WINDOW = 1.2

# Values in a window of a phase model: 80 dense covariances of 1500 take 2.5 GB.
_MOST_VALUES = 1500
# A mixture of fewer windows that do not overlap cannot predict; replay of the past can.
_FEW_WINDOWS = 10

# Section V of the paper.
PAPER_SETTINGS: dict[str, Any] = {
    "model": "mixture",
    "n_components": 10,
    "stride": 10,
    "shrinkage": 0.0,
}


class FourierMovementPrimitive(TrajectoryMixture):
    """Rhythmic skill, learned from demonstrations that need no preparation.

    Demonstrations are cut into overlapping windows; the Fourier weights of the windows
    follow a Gaussian mixture (section IV of the paper). Observed samples of a movement
    are mapped to weights of that mixture (Algorithm 1), which give its continuation. A
    `Player` plays the skill (Algorithm 2).

    The defaults generalise best: learned from 2 minutes of simulated hands that wipe,
    polish and draw an 8, they give the next minute a mean log-likelihood of 17.0 nats
    per sample, `PAPER_SETTINGS` 6.7 (from 30 s: 15.5 against -771). Phase is an angle,
    so the weights lie near a closed curve: many components follow it, and shrinkage
    keeps their covariances from overfitting the few windows of each. The phase model
    represents the phase explicitly: it gives 20.8 and predicts the next second with 0.84
    to 0.90 of the error. It is learned where the demonstrations allow it.

    Parameters
    ----------
    model : {"automatic", "phase", "mixture"}
        Method of learning. "phase": the phase of the movement is tracked, and there is a
        Gaussian for each of many phases; it needs about 1.5 cycles or more, or a single
        one that ends where it begins.
        "mixture": by EM over all windows, as in the paper. "automatic": the phase model
        where the demonstrations have such cycles that look alike and n_components is at
        least 30, else the mixture; `model_` and `model_reason_` say which and why.
    n_steps : int, optional
        T, samples in a window. Where None it is 3.2 periods, but at most 6 s (or 120
        samples at rates below 20 Hz) and the longest bout, unless 1.2 periods are more
        (one closed cycle has one period).
        The mixture has 6 s, or half of a short recording. A window that is longer than
        the longest bout is shortened to it, which `model_reason_` states.
    stride : int, optional
        Samples between the starts of two windows; a sixtieth of a window (2 samples of
        120) where None.
    rate : float
        Samples per second (Hz); demonstrations are resampled to it. High rates learn
        slowly (20 Hz: a second, 100 Hz: half a minute), and above 250 Hz a window has at
        most 1500 samples: give such an array as ``Demonstration(time=time,
        values=array)``, which is resampled to 20 Hz.
    n_components : int or "automatic"
        M, Gaussians in the mixture. "automatic": 80, or fewer where the recordings are
        short: one for each 7 windows, at least 5. It is an upper limit for the phase
        model, which has one for each sample of a period, from 30 to 80.
    overlap : int, optional
        K, samples that two consecutive windows share when a skill is played. Where None:
        half a second, at most a quarter of `window`; 10 with `n_steps`.
    explained_variance : float
        Fraction of the windows' variance that the components model in full; the
        remainder is isotropic.
    regularization : float
        Variance added to every weight (m^2 for a position); 1e-8 is 0.1 mm per sample.
    shrinkage : float
        Pseudo-counts (windows) of the covariance that all components share, mixed into
        each; 0 is the paper's plain EM.
    scales : "units" or array_like, shape (D,)
        Divisor of the values of each channel, so that metres, newtons and radians can
        be in one model. "units": 1 where all channels have the same unit, else the
        standard deviation of all channels of a unit. The regularization and the
        tolerance are in scaled units.
    tolerance : float
        lambda of (13).
    random_state : int
        Seed of the k-means initialisation.
    window : float, optional
        Duration of a window, s, in place of `n_steps`. It is read as `skill.window`.

    Attributes
    ----------
    proportions_ : ndarray, shape (M,)
        The pi_j of (9), in decreasing order.
    components_ : tuple of LowRankGaussian
        The Gaussians of (9) over the D*T weights of the scaled values.
    scales_ : ndarray, shape (D,)
    model_ : {"mixture", "phase"}
        The model that was learned.
    model_reason_ : str
        Reason for the choice of the model.
    n_steps_, overlap_ : int
        T and K that were chosen.
    rhythm_ : Rhythm or None
        Period, cycles and bouts of the demonstrations, and the parts that are left out.
    phase_model_ : PhaseModel or None
        Cycle, residual and phase velocity.
    calibration_ : Calibration or None
        Corrections of predictions; the components of a phase model contain them.
    memory_ : tuple of ndarray, shape (n, D)
        Scaled recordings, which predictions from few cycles also replay; empty where
        replay does not help.
    period_ : float
        Mean period, s; only with a phase model, as the next two.
    tempos_, amplitudes_ : ndarray, shape (C,)
        Tempo and size of each demonstrated cycle, relative to the mean.
    n_channels_ : int
        D.
    n_windows_ : int
        N, whole windows in the demonstrations.
    extent_ : ndarray, shape (2, D)
        Least and greatest value of each channel in the demonstrations.
    paths_ : tuple of ndarray, shape (samples, D)
        The demonstrations; empty if unknown, as for windows given as an array. The phase
        model leaves out pauses, approach and retreat.
    channels_, units_ : tuple of str
    frame_ : str
        Channels, units and frame of the demonstrations.
    rotation_reference_ : tuple of float or None
        Quaternion (x, y, z, w) of the rotation at which the channels `rx`, `ry`, `rz`
        are 0; None where the skill has no orientation.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 20, 0.05)
    >>> circles = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time)])
    >>> demonstration = Demonstration(time=time, values=circles)
    >>> skill = FourierMovementPrimitive(n_components=2).fit(demonstration)
    >>> mapping = skill.map_partial(circles[:10])  # half a second has been seen
    >>> future = skill.synthesize(mapping.weights)
    >>> bool(np.allclose(future, circles[:120], atol=1e-3))
    True

    An array is a recording at the skill's rate:

    >>> skill = FourierMovementPrimitive(rate=20, window=6.0, n_components=2).fit(circles)
    >>> skill
    <FourierMovementPrimitive: mixture of 2 components; x (m), y (m); 141 windows of 6 s at 20 Hz>
    """

    def __repr__(self, N_CHAR_MAX: int = 700) -> str:
        """Return the parameters before `fit`, and what was learned after it."""
        if not hasattr(self, "components_"):
            return str(super().__repr__(N_CHAR_MAX))
        model = f"mixture of {len(self.components_)} components"
        windows = f"{self.n_windows_} windows"
        if self.phase_model_ is not None:
            # A bout may be shorter than a window.
            windows = "windows"
            cycles = count_text(self.phase_model_.cycles, "cycle")
            model = f"phase model of {cycles} of {self.period_:.2f} s"
        channels = ", ".join(
            f"{channel} ({unit})"
            for channel, unit in zip(self.channels_, self.units_, strict=True)
        )
        return (
            f"<{type(self).__name__}: {model}; {channels}; {windows} of "
            f"{self.window:g} s at {self.rate:g} Hz>"
        )

    def __init__(
        self,
        *,
        model: ModelChoice = "automatic",
        n_steps: int | None = None,
        stride: int | None = None,
        rate: float = UNSTATED_RATE,
        n_components: ComponentCount = "automatic",
        overlap: int | None = None,
        explained_variance: float = 0.9999,
        regularization: float = 1e-8,
        shrinkage: float = 5.0,
        scales: ChannelScales = "units",
        tolerance: float = 1e-8,
        random_state: int = 0,
        window: float | None = None,
    ) -> None:
        if window is not None:
            check_number(rate, "rate", least=1e-6, most=1e6, unit="Hz")
            check_number(window, "window", least=8 / rate, most=1e6 / rate, unit="s")
        self.model = model
        self.n_steps = n_steps
        self.window = window
        self.stride = stride
        self.rate = rate
        self.n_components = n_components
        self.overlap = overlap
        self.explained_variance = explained_variance
        self.regularization = regularization
        self.shrinkage = shrinkage
        self.scales = scales
        self.tolerance = tolerance
        self.random_state = random_state

    def fit(
        self,
        X: Demonstration | Sequence[Demonstration] | ArrayLike,
        y: object = None,  # noqa: ARG002 - scikit-learn's signature
        *,
        weights: ArrayLike | None = None,
        start_time: float | None = None,
        end_time: float | None = None,
        period: float | None = None,
        progress: Progress | None = None,
    ) -> Self:
        """Learn from demonstrations, arrays (N, D), or windows of shape (N, T, D).

        Parameters
        ----------
        X : Demonstration, ndarray, or a sequence of them
            Demonstrations may differ in length. An array (N, D) is a recording, sampled
            at the skill's rate; an array of three dimensions contains windows.
        y : ignored
        weights : array_like, optional
            Relative weight of each demonstration (or window); one with weight 0 is left
            out.
        start_time, end_time : float, optional
            Part of every demonstration to learn from, s from its first sample.
        period : float, optional
            Duration of a cycle, s; estimated where None.
        progress : callable, optional
            Called with a sentence about each step of the fit.

        Raises
        ------
        DemonstrationError
            If the demonstrations cannot be used or are too short.
        SkillError
            If a parameter is out of range.
        """
        self.check_parameters()
        if period is not None:
            check_number(period, "period", least=8 / self.rate, unit="s")
        with _unchanged_on_error(self), one_blas_thread():
            for name in ("n_steps_", "overlap_"):
                self.__dict__.pop(name, None)
            X = cut_demonstrations(X, start_time, end_time, self.rate)
            recorded, counts = weighted_windows(self._windows(X, at_least=0), weights)
            recordings, example = recorded.recordings(), recorded.example
            samples = np.concatenate(recordings)
            d = self.n_channels_ = samples.shape[1]
            self.channels_ = example.channels if example else default_channels(d)
            self.units_ = example.units if example else ("m",) * d
            self.frame_ = example.frame if example else ""
            self.rotation_reference_ = example.rotation_reference if example else None
            self.scales_ = channel_scales(self.scales, samples, self.units_)
            tracked = self._tracked_rhythm(recordings, counts, period, progress)
            if tracked is not None and self._fits(tracked, are_windows=example is None):
                self.rhythm_: Rhythm | None
                origins = recorded.origins()
                self.rhythm_ = tracked.rhythm.located(origins, start_time or 0.0)
                self._learn_phase(tracked, are_windows=example is None)
            else:
                self._learn_mixture(X, weights, progress)
            # A copy of another tempo has another rate and the same samples.
            self.n_steps_, self.overlap_ = self.n_steps, self.overlap
        return self

    def score_samples(self, X: Any) -> Array:
        """Return the log density per window; see `TrajectoryMixture`, shape (N,).

        Demonstrations may have the channels in another order, and another rotation
        reference.

        Raises
        ------
        DemonstrationError
            Where a demonstration has other channels or units than the skill.
        """
        self.check_fitted()
        demonstrations = X if isinstance(X, Sequence) else [X]
        has_one = any(isinstance(d, Demonstration) for d in demonstrations)
        if has_one or X is None or isinstance(X, str):
            demonstrations = demonstration_list(X, "score_samples")
            X = [as_learned(d, self) for d in demonstrations]
        return super().score_samples(X)

    def _learn_phase(self, tracked: TrackedRhythm, *, are_windows: bool) -> None:
        """Learn the phase model of a rhythm."""
        self.model_: Literal["phase", "mixture"] = "phase"
        if not are_windows:
            self.n_steps_ = self._steps_for(tracked)
        given_steps = self._given_steps
        if given_steps is not None and self.n_steps < given_steps:
            self.model_reason_ += (
                f"; the window is {self.window:g} s instead of {given_steps / self.rate:g} s, "
                "because no bout lasts that long"
            )
        elif self.window < _SMOOTH_WINDOW:
            self.model_reason_ += f"; windows shorter than {_SMOOTH_WINDOW:g} s are played with high accelerations"
        count = self.n_components
        self.phase_model_, self.components_, self.calibration_ = fit_phase_model(
            tracked.track,
            n_steps=self.n_steps,
            reference_step=self.overlap,
            most_components=MOST_COMPONENTS if isinstance(count, str) else count,
        )
        has_few_cycles = self.calibration_.model_weight < 1
        self.memory_ = tuple(tracked.recordings) if has_few_cycles else ()
        m = len(self.components_)
        self.proportions_ = np.full(m, 1 / m)
        # Parts that are left out must not be played.
        bouts = [y * self.scales_ for y in tracked.track.recordings]
        self.extent_ = extent_of(bouts)
        self.paths_ = () if are_windows else tuple(bouts)
        self.n_windows_ = sum(
            max(0, (len(y) - self.n_steps) // self.window_stride + 1) for y in bouts
        )

    def _learn_mixture(
        self, X: Any, weights: ArrayLike | None, progress: Progress | None
    ) -> None:
        """Learn the mixture of all windows."""
        if self._given_steps is None and self.model == "automatic":
            recordings = self._windows(X, at_least=0).recordings()
            self.n_steps_ = self.mixture_steps(max(map(len, recordings)))
        windows, counts = weighted_windows(self._windows(X, at_least=2), weights)
        values = windows.values
        self.model_, self.rhythm_, self.phase_model_ = "mixture", None, None
        self.n_windows_ = len(values)
        self.scales_ = channel_scales(self.scales, values, self.units_)
        self.paths_ = windows.paths(self.window_stride)
        self.extent_ = extent_of([values.reshape(-1, self.n_channels_)])
        self.proportions_, self.components_ = fit_mixture(
            self.analyze(values),
            sample_weights=counts,
            progress=progress,
            **self._mixture_options,
        )
        self.memory_, self.calibration_ = (), None
        recordings = [y / self.scales_ for y in windows.recordings()]
        has_few_windows = sum(map(len, recordings)) < _FEW_WINDOWS * self.n_steps
        calibration = calibrate_replay(
            recordings, self.overlap, self.n_steps - self.overlap
        )
        if calibration is not None and self.model == "automatic" and has_few_windows:
            self.memory_, self.calibration_ = tuple(recordings), calibration
        elif calibration is not None:
            # The errors of replay are added to the mixture's own covariance. A
            # requested mixture has the density of the paper.
            calibration = replace(calibration, model_weight=1.0, local_factor=0.0)
            if not self.model == self.n_components == "automatic":
                calibration = replace(calibration, background_weight=0.0)
            self.calibration_ = calibration

        if self.calibration_ is not None and has_few_windows:
            self.calibration_ = calibrate_playback(
                self.calibration_, recordings, self._continuation, seen=self.overlap
            )

    def _continuation(self, recordings: list[Array]) -> Callable[[Array], Array] | None:
        """Learn a mixture of scaled recordings; return what it plays after K samples."""
        return learn_continuation(
            recordings,
            n_steps=min(self.n_steps, self.mixture_steps(max(map(len, recordings)))),
            n_observed=self.overlap,
            tolerance=self.tolerance,
            **self._mixture_options,
        )

    @property
    def _mixture_options(self) -> dict[str, Any]:
        """Options of `fit_mixture`."""
        return {
            "n_components": self.n_components,
            "explained_variance": self.explained_variance,
            "regularization": self.regularization,
            "shrinkage": self.shrinkage,
            "seed": self.random_state,
        }

    def _tracked_rhythm(
        self,
        recordings: Sequence[Array],
        counts: Array | None,
        period: float | None,
        progress: Progress | None,
    ) -> TrackedRhythm | None:
        """Choose the model: return the rhythm to learn, None for the mixture."""
        if self.model == "mixture":
            self.model_reason_ = "it was requested"
            return None
        check_window_size(recordings, self.n_steps, self.rate)
        count = self.n_components
        is_small = count != "automatic" and count < LEAST_COMPONENTS
        if self.model == "automatic" and is_small:
            self.model_reason_ = (
                f"n_components is {count}; the phase model has "
                f"{LEAST_COMPONENTS} or more"
            )
            return None
        if progress is not None:
            progress("tracking the phase")
        try:
            if counts is not None and np.ptp(counts) > 0:
                raise DemonstrationError("its demonstrations have different weights.")
            scaled = [y / self.scales_ for y in recordings]
            units = dict(zip(self.channels_, self.units_, strict=True))
            result = search_rhythm(scaled, rate=self.rate, period=period, units=units)
        except DemonstrationError as error:
            if self.model == "phase":
                raise DemonstrationError(
                    f"the movement has no phase that could be learned: {error} Choose "
                    "model='automatic' or 'mixture'."
                ) from None
            self.model_reason_ = f"the phase cannot be tracked: {error}".removesuffix(
                "."
            )
            return None
        self.model_reason_ = result.describe()
        return result

    def _fits(self, tracked: TrackedRhythm, *, are_windows: bool) -> bool:
        """Return whether the phase model has few enough values to be learned."""
        steps = self.n_steps if are_windows else self._steps_for(tracked)
        if (count := steps * self.n_channels_) <= _MOST_VALUES:
            return True
        self.model_reason_ = (
            f"a window of {steps} samples of {self.n_channels_} channels has {count} "
            f"values, and the phase model has at most {_MOST_VALUES}: choose fewer channels "
            "or a lower rate"
        )
        if self.model == "phase":
            raise DemonstrationError(f"{self.model_reason_}, or model='mixture'.")
        return False

    @property
    def n_steps(self) -> int:
        """T, samples in a window: chosen by `fit`, or as given."""
        given = self._most_steps if self._given_steps is None else self._given_steps
        return self.__dict__.get("n_steps_", given)

    @n_steps.setter
    def n_steps(self, value: int | None) -> None:
        self._n_steps = value
        self.__dict__.pop("n_steps_", None)

    @property
    def window(self) -> float:
        """Duration of a window, s."""
        return self.n_steps / self.rate

    @window.setter
    def window(self, value: float | None) -> None:
        self._window = value
        self.__dict__.pop("n_steps_", None)

    @property
    def overlap(self) -> int:
        """K, samples that two consecutive windows share: as given, or about half a second."""
        return self.__dict__.get("overlap_", self._nominal_overlap)

    @overlap.setter
    def overlap(self, value: int | None) -> None:
        self._overlap = value
        self.__dict__.pop("overlap_", None)

    @property
    def _nominal_overlap(self) -> int:
        """K as given, or about half a second."""
        if self._overlap is not None:
            return self._overlap
        if self._window is not None:
            quarter = round(self._window * self.rate) // 4
            return max(2, min(round(0.5 * self.rate), quarter))
        return 10 if self._n_steps is not None else max(10, round(0.5 * self.rate))

    @property
    def _given_steps(self) -> int | None:
        """T as given, in samples or in seconds."""
        if self._window is None:
            return self._n_steps
        return round(self._window * self.rate)

    @property
    def _most_steps(self) -> int:
        """Greatest window by default, samples; long periods need a longer one."""
        return max(_DEFAULT_STEPS, round(_DEFAULT_WINDOW * self.rate))

    def _steps_for(self, tracked: TrackedRhythm) -> int:
        """Return the samples in a window for a rhythm, within what can be learned."""
        longest = max(map(len, tracked.track.recordings))
        if self._given_steps is not None:
            return min(self._given_steps, max(longest, 4 * self.overlap))
        values = max(_DEFAULT_STEPS, _MOST_VALUES // self.n_channels_)
        usual = self._most_steps * 3 // max(3, self.n_channels_)
        most = min(usual, values, longest)
        period = tracked.rhythm.period * self.rate
        nominal = min(_PERIODS * period, float(most))
        least = longest if tracked.rhythm.is_one_cycle else _LEAST_PERIODS * period
        # Part of a long cycle suffices.
        least = min(least, values, 2 * self._most_steps)
        return max(round(max(nominal, least)), 4 * self.overlap)

    def mixture_steps(self, longest: int) -> int:
        """Return the default size of a window of a mixture, samples.

        It follows from the length of the longest recording, samples.
        """
        return int(np.clip(longest // 2, 4 * self.overlap, self._most_steps))

    def get_params(self, deep: bool = True) -> dict[str, Any]:  # noqa: ARG002
        """Return the parameters of the constructor, as they were given."""
        given = {
            "n_steps": self._n_steps,
            "window": self._window,
            "overlap": self._overlap,
        }
        names = self._get_param_names()
        return {n: given[n] if n in given else getattr(self, n) for n in names}

    def check_parameters(self) -> None:
        """Raise SkillError where a parameter is out of range.

        `scales` is checked where it is used, against the channels.
        """
        choices = ("mixture", "phase", "automatic")
        if not isinstance(self.model, str) or self.model not in choices:
            raise SkillError(
                f"model is {self.model!r}; it must be 'mixture', 'phase' or 'automatic'."
            )
        check_number(self.rate, "rate", least=1e-6, most=1e6, unit="Hz")
        if self._window is not None:
            check_number(self._window, "window", above=0, unit="s")
        steps = self._most_steps if self._given_steps is None else self._given_steps
        check_number(steps, "n_steps", least=8, whole=True)
        overlap = self._nominal_overlap
        check_number(overlap, "overlap", least=2, most=steps // 2, whole=True)
        if self.stride is not None:
            check_number(self.stride, "stride", least=1, whole=True)
        count = self.n_components
        if not isinstance(count, str) or count != "automatic":
            hint = "or 'automatic'"
            check_number(count, "n_components", least=1, whole=True, hint=hint)
        check_number(
            self.random_state, "random_state", least=0, most=2**32 - 1, whole=True
        )
        check_number(self.explained_variance, "explained_variance", above=0.0, most=1.0)
        check_number(self.shrinkage, "shrinkage", least=0.0)
        check_number(self.regularization, "regularization", least=1 / GREATEST)
        check_number(self.tolerance, "tolerance", least=1 / GREATEST)


def build_skill(
    parameters: Mapping[str, Any], fitted: Mapping[str, Any]
) -> FourierMovementPrimitive:
    """Return a skill with given parameters and fitted attributes, without a fit.

    Parameters
    ----------
    parameters : mapping
        Parameters of the constructor.
    fitted : mapping
        Attributes that `fit` would set; their names end with an underscore.
    """
    skill = FourierMovementPrimitive(**parameters)
    for name, value in fitted.items():
        setattr(skill, name, value)
    return skill


def copy_skill(
    skill: FourierMovementPrimitive,
    *,
    parameters: Mapping[str, Any] | None = None,
    **fitted: Any,
) -> FourierMovementPrimitive:
    """Return a copy of a fitted skill with some parts replaced.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted; it is not changed.
    parameters : mapping, optional
        Parameters of the constructor that differ.
    **fitted
        Fitted attributes that differ.
    """
    skill.check_fitted()
    attributes = {
        name: value
        for name, value in vars(skill).items()
        if name.endswith("_") and not name.startswith("_")
    }
    return build_skill(
        {**skill.get_params(deep=False), **(parameters or {})}, {**attributes, **fitted}
    )


@contextmanager
def _unchanged_on_error(skill: FourierMovementPrimitive) -> Iterator[None]:
    """Give a skill back its attributes where learning fails or is interrupted."""
    before = skill.__dict__.copy()
    try:
        yield
    except BaseException:
        skill.__dict__.clear()
        skill.__dict__.update(before)
        raise
