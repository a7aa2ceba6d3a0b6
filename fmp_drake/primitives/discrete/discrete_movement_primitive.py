"""Discrete movements: footnote 1 of the paper."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import dct
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.numeric import Array, as_floats, check_number, finite_array
from fmp_drake.primitives.data.channels import channel_indices, channel_scales
from fmp_drake.primitives.data.demonstration import Demonstration
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.primitives.data.windows import demonstration_list
from fmp_drake.primitives.model.mapping import MappingPlan
from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive
from fmp_drake.primitives.playback.motion import Motion

# Onset of a movement: two distances from the start, relative to the greatest, and the time
# to the first, relative to the time between them, for a movement of minimum jerk.
_ONSET_DISTANCES, _ONSET_TIME = (0.01, 0.1), 0.75
# Greatest swing of a correction relative to the errors that it corrects.
_MOST_SWING = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ViaPoint:
    """Point that a discrete movement passes at a given phase.

    Attributes
    ----------
    phase : float
        Time as a fraction of the duration, between 0 and 1.
    values : array_like, shape (C,)
        Values of the C channels, in their units.
    channels : sequence of str or int, optional
        Names or indices of the channels; all D where None.

    Examples
    --------
    >>> half_way_up = ViaPoint(phase=0.5, values=[0.3], channels=["z"])

    `DiscreteMovementPrimitive.plan` takes it.
    """

    phase: float
    values: ArrayLike
    channels: Sequence[str | int] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class DiscreteMovement:
    """Movement from a start to a goal, as a cosine series in time.

    The value at time t is sum_k coefficients_k cos(pi k t / duration): the Fourier
    series of the mirrored movement, in which all sines vanish. So the velocity is
    0 at the start and, up to rounding, at the end, whatever the coefficients.

    Attributes
    ----------
    coefficients : ndarray, shape (T, D)
        In the units of the channels.
    duration : float
        Seconds.
    component : int
        Index of the component of the mixture.
    """

    coefficients: Array
    duration: float
    component: int

    def __post_init__(self) -> None:
        """Make the array read-only."""
        self.coefficients.setflags(write=False)

    def motion(self, seconds: ArrayLike) -> Motion:
        """Return the desired motion at any time.

        Parameters
        ----------
        seconds : array_like, shape (...)
            Time since the start. Before it, the movement rests at its start; after
            `duration`, at its end.

        Returns
        -------
        Motion, shape (..., 3, D)
            Position, velocity (per second) and acceleration (per second^2) of each
            channel. Position and velocity are continuous everywhere; the acceleration
            is not 0 at the start and the end, and is 0 outside.
        """
        t = as_floats(seconds, "the time")
        omega = np.pi * np.arange(len(self.coefficients)) / self.duration
        angle = np.clip(t, 0.0, self.duration)[..., None] * omega
        is_during = ((t >= 0) & (t <= self.duration))[..., None]
        moving = np.where(is_during, omega, 0.0)
        cosine, sine = np.cos(angle), np.sin(angle)
        rows = np.stack([cosine, -moving * sine, -(moving**2) * cosine], axis=-2)
        return Motion(rows @ self.coefficients, time=t if t.ndim else None)


class DiscreteMovementPrimitive(BaseEstimator):  # type: ignore[misc]
    """Model of movements from a start to a goal, learned from whole demonstrations.

    Each demonstration is one movement, of any duration; rest before and after it is left
    out. It is resampled to T samples and mirrored, which gives a window of 2T samples that
    closes (footnote 1 of the paper); a `FourierMovementPrimitive` learns the mirrored
    windows. The samples are taken in the middle of T equal parts of the duration, so that
    the mirrors of the period lie at the very start and end of the movement.

    Parameters
    ----------
    n_steps : int
        T, samples of a movement, at most 10,000.
    n_components : int
        M, Gaussians in the mixture; at most half the number of demonstrations are used.
    explained_variance, regularization, tolerance, random_state
        See `FourierMovementPrimitive`.
    confidence : float
        Probability mass of the ellipsoid to which the weights of an adapted movement
        are confined, in (0, 1]; 1 is no bound. A smooth correction covers the remaining
        distance to start, goal and via-points.

    Attributes
    ----------
    skill_ : FourierMovementPrimitive
        Skill of the mirrored windows: 2T samples in two mean durations.
    duration_ : float
        Mean duration of the demonstrated movements, s.
    n_channels_ : int
        D.
    channels_, units_ : tuple of str
    frame_ : str
    rotation_reference_ : tuple of float or None
        That of the demonstrations.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.linspace(0, 1, 50)
    >>> reach = 0.5 - 0.5 * np.cos(np.pi * time)
    >>> demonstrations = [
    ...     Demonstration(time=time, values=size * reach) for size in (0.8, 1.0, 1.2)
    ... ]
    >>> primitive = DiscreteMovementPrimitive().fit(demonstrations)
    >>> path = primitive.rollout(start=[0.1], goal=[0.9], rate=10.0)
    >>> path[[0, -1], 0, 0].round(6)
    array([0.1, 0.9])
    """

    def __init__(
        self,
        *,
        n_steps: int = 100,
        n_components: int = 1,
        explained_variance: float = 0.9999,
        regularization: float = 1e-8,
        tolerance: float = 1e-8,
        confidence: float = 0.99,
        random_state: int = 0,
    ) -> None:
        self.n_steps = n_steps
        self.n_components = n_components
        self.explained_variance = explained_variance
        self.regularization = regularization
        self.tolerance = tolerance
        self.confidence = confidence
        self.random_state = random_state

    def fit(
        self,
        X: Demonstration | Sequence[Demonstration],
        y: object = None,  # noqa: ARG002 - scikit-learn's signature
    ) -> Self:
        """Learn from at least two demonstrations, each one whole movement.

        Raises
        ------
        DemonstrationError
            Where the demonstrations cannot be used.
        SkillError
            Where a parameter is out of range.
        """
        demonstrations = demonstration_list(X, "fit")
        if len(demonstrations) < 2:
            raise DemonstrationError(
                f"got {count_text(len(demonstrations), 'demonstration')}; a discrete "
                "movement needs at least 2, each one whole movement."
            )
        check_number(self.n_steps, "n_steps", least=8, most=10_000, whole=True)
        check_number(self.confidence, "confidence", above=0.0, most=1.0)
        demonstrations = [_without_rest(d) for d in demonstrations]
        duration = float(np.mean([d.duration for d in demonstrations]))
        rate = self.n_steps / duration
        skill = FourierMovementPrimitive(
            model="mixture",
            n_steps=2 * self.n_steps,
            stride=1,
            rate=rate,
            n_components=self.n_components,
            overlap=2,
            explained_variance=self.explained_variance,
            regularization=self.regularization,
            tolerance=self.tolerance,
            random_state=self.random_state,
        )
        skill.fit([_mirrored(d, self.n_steps, rate) for d in demonstrations])
        self.skill_ = skill
        self.duration_ = duration
        self.n_channels_ = skill.n_channels_
        self.channels_ = skill.channels_
        self.units_ = skill.units_
        self.frame_ = skill.frame_
        self.rotation_reference_ = skill.rotation_reference_
        return self

    def plan(
        self,
        start: ArrayLike,
        goal: ArrayLike | None = None,
        *,
        via: Sequence[ViaPoint] = (),
        duration: float | None = None,
    ) -> DiscreteMovement:
        """Return the movement from a measured start at rest.

        The observation is mapped to weights as in Algorithm 1, kept in the span of the
        component and inside its ellipsoid of the given confidence. The cosine series of
        least squared acceleration covers the remaining distances to start, goal and
        via-points, so all are met exactly.

        Parameters
        ----------
        start : array_like, shape (D,)
        goal : array_like, shape (D,), optional
            End of the movement, at rest; where None, the end of demonstrations that start
            here.
        via : sequence of ViaPoint
            Points at different phases.
        duration : float, optional
            s; the mean of the demonstrations where None.

        Raises
        ------
        SkillError
            Where a point or the duration cannot be used.
        """
        check_is_fitted(self, "skill_")
        seconds = self.duration_ if duration is None else duration
        check_number(seconds, "duration", above=0.0, unit="s")
        channels, shape = list(range(self.n_channels_)), (self.n_channels_,)
        points = [(0.0, channels, finite_array(start, "the start", shape))]
        if goal is not None:
            end = finite_array(goal, "the goal", shape)
            points.append((1.0, channels, end))
        if not isinstance(via, Sequence):
            raise SkillError(f"via is {via!r}; give a list of ViaPoint(phase, values).")
        for number, point in enumerate(via):
            if not isinstance(point, ViaPoint):
                raise SkillError(
                    f"via has {point!r}; give a list of ViaPoint(phase, values)."
                )
            index = channel_indices(point.channels, self.channels_)
            name = f"via-point {number}"
            check_number(point.phase, f"the phase of {name}", above=0.0, below=1.0)
            values = finite_array(point.values, name, (len(index),))
            points.append((float(point.phase), index, values))
        weights, component = self._mapped(points)
        window = self.skill_.synthesize(weights)
        coefficients = dct(window[: self.n_steps], type=2, axis=0) / self.n_steps
        coefficients[0] /= 2
        if goal is None:
            # The end of the mapped movement.
            signs = (-1.0) ** np.arange(self.n_steps)
            points.append((1.0, channels, signs @ coefficients))
        for channel in channels:
            phases = np.array([p for p, index, _ in points if channel in index])
            desired = [v[i.index(channel)] for _, i, v in points if channel in i]
            coefficients[:, channel] += _correction(
                phases, np.array(desired), coefficients[:, channel]
            )
        return DiscreteMovement(
            coefficients=coefficients, duration=float(seconds), component=component
        )

    def rollout(
        self,
        start: ArrayLike,
        goal: ArrayLike | None = None,
        *,
        via: Sequence[ViaPoint] = (),
        duration: float | None = None,
        rate: float = 100.0,
    ) -> Motion:
        """Return a movement as samples of position, velocity and acceleration.

        Parameters
        ----------
        start, goal, via, duration
            See `plan`.
        rate : float
            Samples per second (Hz), raised a little so that the last sample is the end.

        Returns
        -------
        Motion, shape (samples, 3, D)
            Position, velocity and acceleration, as `DiscreteMovement.motion` gives them,
            and their `time`.
        """
        check_number(rate, "rate", above=0.0, unit="Hz")
        movement = self.plan(start, goal, via=via, duration=duration)
        count = int(np.ceil(movement.duration * rate * (1 - 1e-9))) + 1
        return movement.motion(np.linspace(0.0, movement.duration, count))

    def sample(self, n: int = 1, *, seed: int = 0, with_noise: bool = True) -> Array:
        """Draw movements from the mixture, shape (n, T, D), at the phases (i + 1/2) / T."""
        check_is_fitted(self, "skill_")
        samples = self.skill_.sample(n, seed=seed, with_noise=with_noise)
        return samples[:, : self.n_steps]

    def _mapped(
        self, points: Sequence[tuple[float, list[int], Array]]
    ) -> tuple[Array, int]:
        """Return weights in the span and the ellipsoid of the best component."""
        skill = self.skill_
        n, d = self.n_steps, self.n_channels_
        rows, values, tolerances = [], [], []
        for phase, index, desired in points:
            # Both halves contribute: the mirrored step has the same value.
            step = n * phase - 0.5
            row = skill.basis.series([step, 2 * n - 1 - step]).mean(axis=0)
            block = np.zeros((len(index), d, 2 * n))
            block[range(len(index)), index] = row * skill.scales_[index, None]
            rows.append(block.reshape(len(index), -1))
            values.append(desired)
            tolerances.append(skill.tolerance * skill.scales_[index] ** 2)
        plan = MappingPlan(
            skill.proportions_,
            skill.components_,
            rows=np.concatenate(rows),
            tolerance=np.concatenate(tolerances),
        )
        mapping = plan.map(np.concatenate(values))
        gaussian = skill.components_[mapping.component]
        weights = gaussian.confined(mapping.weights, self.confidence)
        return weights, mapping.component


def _without_rest(demonstration: Demonstration) -> Demonstration:
    """Return a movement without the rest before and after it."""
    time, values = demonstration.time, demonstration.values
    path = values / channel_scales("units", values, demonstration.units)
    start, end = _onset(time, path), -_onset(-time[::-1], path[::-1])
    first = int(np.searchsorted(time, start, side="right")) - 1
    last = int(np.searchsorted(time, end))
    return demonstration.rows(np.arange(first, last + 1))


def _onset(time: Array, path: Array) -> float:
    """Return the time at which a path (n, D) leaves its start.

    It is extrapolated from two distances, as for a movement of minimum jerk.
    """
    distances = np.linalg.norm(path - path[0], axis=1)
    near, far = np.array(_ONSET_DISTANCES) * distances.max()
    if far == 0:
        return float(time[0])
    beyond = int(np.argmax(distances > far))
    before = int(np.flatnonzero(distances[:beyond] <= near)[-1])
    early, late = (
        np.interp(distance, distances[i : i + 2], time[i : i + 2])
        for i, distance in ((before, near), (beyond - 1, far))
    )
    return max(float(early - _ONSET_TIME * (late - early)), float(time[0]))


def _mirrored(demonstration: Demonstration, n_steps: int, rate: float) -> Demonstration:
    """Return a movement of n_steps samples and its mirror, as if at a given rate."""
    # Every second sample of a grid that ends with the movement is the middle of a part.
    resampled = demonstration.resample(2 * n_steps / demonstration.duration)
    half = resampled.values[1 : 2 * n_steps : 2]
    return replace(
        demonstration,
        time=np.arange(2 * n_steps) / rate,
        values=np.concatenate([half, half[::-1]]),
    )


def _correction(
    phases: Array,
    values: Array,
    coefficients: Array,
) -> Array:
    """Return the cosine coefficients of least acceleration that reach the values.

    Minimises sum_k k^4 c_k^2 subject to the values at the phases; a constant is free.
    """
    k = np.arange(len(coefficients))
    rows = np.cos(np.pi * phases[:, None] * k)
    errors = values - rows @ coefficients
    flexibility = np.concatenate([[0.0], 1.0 / k[1:] ** 4])
    kernel = (rows * flexibility) @ rows.T
    size = len(phases)
    system = np.ones((size + 1, size + 1))
    system[:size, :size] = kernel
    system[size, size] = 0.0
    solution = np.linalg.lstsq(system, np.append(errors, 0.0))[0]
    out = flexibility * (rows.T @ solution[:size])
    out[0] = solution[size]
    largest = np.max(np.abs(errors))
    curve = (dct(out, type=1, n=4 * len(k)) + out[0]) / 2  # At equal phases.
    is_met = np.max(np.abs(rows @ out - errors)) < 1e-6 * (1 + largest)
    if not is_met or np.max(np.abs(curve)) > _MOST_SWING * largest:
        raise SkillError(
            "two via-points of a channel are at the same phase or too near to each "
            "other; move them apart."
        )
    return out
