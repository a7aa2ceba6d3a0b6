"""The Fourier movement primitive: a skill that is learned from demonstrations."""

from collections.abc import Sequence
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmp_drake.blas import one_blas_thread
from fmp_drake.errors import DemonstrationError
from fmp_drake.primitives.data.demonstration import Demonstration, default_channels
from fmp_drake.primitives.data.scaling import ChannelScales, channel_scales
from fmp_drake.primitives.data.windows import (
    Windows,
    extent_of,
    weighted_windows,
)
from fmp_drake.primitives.model.mapping import Selection
from fmp_drake.primitives.model.mixture import MOST_COMPONENTS, Progress, fit_mixture
from fmp_drake.primitives.model.parameters import (
    ComponentCount,
    ModelChoice,
    check_parameters,
)
from fmp_drake.primitives.model.phase.fit import (
    LEAST_COMPONENTS,
    fit_phase_model,
    tracked,
)
from fmp_drake.primitives.model.phase.tracking import PhaseTrack
from fmp_drake.primitives.model.trajectory_mixture import TrajectoryMixture

# Section V of the paper.
PAPER_SETTINGS: dict[str, Any] = {
    "model": "mixture",
    "n_components": 10,
    "stride": 10,
    "shrinkage": 0.0,
}


class FourierMovementPrimitive(TrajectoryMixture):
    """A rhythmic skill, learned from demonstrations that need no preparation.

    Demonstrations are cut into overlapping windows; the Fourier weights of the windows
    follow a Gaussian mixture (section IV of the paper). What has been seen of a movement
    is mapped to weights of that mixture (Algorithm 1), which give its continuation; a
    `Player` plays the skill (Algorithm 2).

    The defaults are those that generalise: learned from 2 minutes of simulated hands
    that wipe, polish and draw an 8, they give the next minute a mean log-likelihood of
    17.0 nats per sample, `PAPER_SETTINGS` 6.7 (from 30 s: 15.5 against -771). Phase
    is an angle, so the weights lie near a closed curve: many components follow it,
    and shrinkage keeps their covariances from fitting the few windows of each. The phase
    model, which knows that it is an angle, gives 20.8 and predicts the next second with
    0.84 to 0.90 of the error. It is what is learned where the demonstrations allow it.

    Parameters
    ----------
    model : {"automatic", "phase", "mixture"}
        How the Gaussians are found. "phase": the phase of the movement is tracked, and
        there is a Gaussian for each of many phases; it needs four cycles or more.
        "mixture": by EM over all windows, as in the paper. "automatic": the phase model
        where the demonstrations have four cycles that look alike and n_components is at
        least 30, else the mixture; `model_` and `model_reason_` say which and why.
    n_steps : int
        T, samples in a window: enough for one or more periods.
    stride : int, optional
        Samples between the starts of two windows; a sixtieth of a window (2 samples of
        120) where None.
    rate : float
        Samples per second (Hz); demonstrations are resampled to it.
    n_components : int, "automatic" or "bic"
        M, Gaussians in the mixture. "automatic": 80, or fewer where the recordings are
        short: one for each 7 windows, at least 5. "bic" chooses by the Bayesian
        information criterion. The phase model has at most so many: one for each sample
        of a period, from 30 to 80.
    overlap : int
        K, samples that two consecutive windows share when a skill is played.
    explained_variance : float
        Fraction of the windows' variance that the components model in full; what is
        left is isotropic.
    regularization : float
        Variance added to every weight (m^2 for a position); 1e-8 is 0.1 mm per sample.
    shrinkage : float
        Pseudo-counts (windows) of the covariance that all components share, mixed into
        each; 0 is the paper's plain EM.
    scales : "units" or array_like, shape (D,)
        What the values of a channel are divided by before anything else, so that
        metres, newtons and radians can live in one model. "units": 1 where all
        channels have the same unit, else the standard deviation of all channels
        of a unit. The regularization and the tolerance are in scaled units.
    tolerance : float
        lambda of (13).
    selection : {"cost", "evidence"}
        How a mapping chooses its component: (15), or the evidence.
    random_state : int
        Seed of the k-means initialisation.

    Attributes
    ----------
    proportions_ : ndarray, shape (M,)
        The pi_j of (9), falling.
    components_ : tuple of LowRankGaussian
        The Gaussians of (9) over the D*T weights of the scaled values.
    scales_ : ndarray, shape (D,)
    model_ : {"mixture", "phase"}
        Which model was learned.
    model_reason_ : str
        Why.
    phase_model_ : PhaseModel or None
        What the phase model has learned: cycle, residual and tempo.
    period_ : float
        Mean period, s; only with a phase model, as the next two.
    tempos_, amplitudes_ : ndarray, shape (C,)
        Of the demonstrated cycles one after the other; 1 is the mean tempo, and the size
        of the mean cycle.
    n_channels_ : int
        D.
    n_windows_ : int
        N, the windows learned from.
    extent_ : ndarray, shape (2, D)
        Least and greatest value of each channel in the demonstrations.
    paths_ : tuple of ndarray, shape (samples, D)
        The demonstrations; empty where unknown, as for windows given as an array. The
        phase model leaves out pauses, and the ways to and from the movement.
    channels_, units_ : tuple of str
    frame_ : str
        Of the demonstrations.
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

    >>> FourierMovementPrimitive(rate=20, n_components=2).fit(circles).n_windows_
    141
    """

    def __init__(
        self,
        *,
        model: ModelChoice = "automatic",
        n_steps: int = 120,
        stride: int | None = None,
        rate: float = 20.0,
        n_components: ComponentCount = "automatic",
        overlap: int = 10,
        explained_variance: float = 0.9999,
        regularization: float = 1e-8,
        shrinkage: float = 5.0,
        scales: ChannelScales = "units",
        tolerance: float = 1e-8,
        selection: Selection = "cost",
        random_state: int = 0,
    ) -> None:
        self.model = model
        self.n_steps = n_steps
        self.stride = stride
        self.rate = rate
        self.n_components = n_components
        self.overlap = overlap
        self.explained_variance = explained_variance
        self.regularization = regularization
        self.shrinkage = shrinkage
        self.scales = scales
        self.tolerance = tolerance
        self.selection = selection
        self.random_state = random_state

    def fit(
        self,
        X: Demonstration | Sequence[Demonstration] | ArrayLike,
        y: object = None,  # noqa: ARG002 - scikit-learn's signature
        *,
        weights: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> Self:
        """Learn from demonstrations, arrays (N, D), or windows of shape (N, T, D).

        Parameters
        ----------
        X : Demonstration, ndarray, or a sequence of them
            Demonstrations may differ in length. An array (N, D) is a recording, sampled
            at the skill's rate; one of three dimensions is windows that are cut already.
        y : ignored
        weights : array_like, optional
            How much each demonstration (or window) counts, relative to the others; one
            of 0 is left out.
        progress : callable, optional
            Called with a sentence about each step of the fit.

        Raises
        ------
        DemonstrationError
            Where the demonstrations cannot be used or are too short.
        SkillError
            Where a parameter is out of range.
        """
        self.check_parameters()
        windows, counts = weighted_windows(self._windows(X, at_least=2), weights)
        values, example = windows.values, windows.example
        d = values.shape[2]
        self.n_windows_ = len(values)
        self.n_channels_ = d
        self.paths_ = windows.paths(self.window_stride)
        self.extent_ = extent_of([values.reshape(-1, d)])
        self.channels_ = example.channels if example else default_channels(d)
        self.units_ = example.units if example else ("m",) * d
        self.frame_ = example.frame if example else ""
        self.rotation_reference_ = example.rotation_reference if example else None
        self.scales_ = channel_scales(self.scales, values, self.units_)
        with one_blas_thread():
            self._learn(windows, counts, progress)
        return self

    def _learn(
        self,
        windows: Windows,
        counts: NDArray[np.float64] | None,
        progress: Progress | None,
    ) -> None:
        """Choose the model and learn it."""
        track = self._chosen_track(windows, counts, progress)
        self.model_: Literal["phase", "mixture"] = (
            "mixture" if track is None else "phase"
        )
        if track is not None:
            self.phase_model_, self.components_ = fit_phase_model(
                track,
                n_steps=self.n_steps,
                pinned=self.overlap,
                most_components=(
                    MOST_COMPONENTS
                    if isinstance(self.n_components, str)
                    else self.n_components
                ),
            )
            m = len(self.components_)
            self.proportions_ = np.full(m, 1 / m)
            if track.paused or track.approach:
                # What was left out of the recordings was not meant to be played.
                kept = [y * self.scales_ for y in track.recordings]
                self.extent_ = extent_of(kept)
                self.paths_ = tuple(kept) if self.paths_ else ()
            return
        self.phase_model_ = None
        self.proportions_, self.components_ = fit_mixture(
            self.analyze(windows.values),
            n_components=self.n_components,
            explained_variance=self.explained_variance,
            regularization=self.regularization,
            shrinkage=self.shrinkage,
            seed=self.random_state,
            sample_weights=counts,
            progress=progress,
        )

    def _chosen_track(
        self,
        windows: Windows,
        counts: NDArray[np.float64] | None,
        progress: Progress | None,
    ) -> PhaseTrack | None:
        """Choose the model: return the track to learn it from, None for the mixture."""
        if self.model == "mixture":
            self.model_reason_ = "it was asked for"
            return None
        asked = self.n_components
        few = asked == "bic" or (asked != "automatic" and asked < LEAST_COMPONENTS)
        if self.model == "automatic" and few:
            self.model_reason_ = (
                f"n_components is {asked}; the phase model has "
                f"{LEAST_COMPONENTS} or more"
            )
            return None
        if progress is not None:
            progress("tracking the phase")
        try:
            if counts is not None and np.ptp(counts) > 0:
                raise DemonstrationError("its demonstrations have different weights.")
            scaled = [y / self.scales_ for y in windows.recordings()]
            track = tracked(scaled, n_steps=self.n_steps)
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
        self.model_reason_ = (
            f"{track.cycles:.1f} cycles, of which one cycle and its tempo explain "
            f"{100 * (1 - track.unexplained):.1f} %"
        )
        return track

    def check_parameters(self) -> None:
        """Raise SkillError where a parameter is out of range."""
        check_parameters(self.get_params())
