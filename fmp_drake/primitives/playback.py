"""Playing a skill for any duration: Algorithm 2 and section V-D of the paper."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from fmp_drake.errors import SkillError
from fmp_drake.primitives.mapping import Mapping
from fmp_drake.primitives.tracking import LqrTracker, Tracker

if TYPE_CHECKING:
    from fmp_drake.primitives.movement_primitive import FourierMovementPrimitive


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaybackState:
    """Where a playback stands at a tick.

    Attributes
    ----------
    weights : ndarray, shape (D*T,)
        The current Fourier weights w.
    target : ndarray, shape (D*T,)
        What the weights are brought to: a component's mean or a sample of it.
    component : int
        The tracked component j*.
    step : int
        The current sample of the window, K - 1 to T - 1.
    history : ndarray, shape (K, D)
        The desired values at the last K ticks, the newest last.
    offset : ndarray, shape (2, D)
        What the desired values and velocities still add to those of the weights.
    remaps : int
        How often the weights have been re-mapped.
    """

    weights: NDArray[np.float64]
    target: NDArray[np.float64]
    component: int
    step: int
    history: NDArray[np.float64]
    offset: NDArray[np.float64]
    remaps: int


class Player:
    """Plays a fitted skill from any start, for as long as wanted.

    The start is mapped onto sample K - 1 of a window. From there the weights drift to
    their target while the window is played to its last sample. Then the last K values
    are mapped onto the first K samples of a new window (Algorithm 1), which may
    change the component, and the movement goes on from sample K - 1: every T - K
    ticks, for ever.

    A mapped window meets the observation partly by the component's isotropic rest,
    which is white noise in time: a peak at the observed samples, nothing between
    or after them. A robot should not follow that (from a start 10 cm above
    a demonstration that never left the board it fell at 2 m/s). And far from the
    demonstrations it meets the observation by variations that nobody has shown (from
    the middle of a wiping pattern, 22 standard deviations: a stroke three times
    as wide as the widest demonstrated). So the weights are kept in the span of the
    component and inside its ellipsoid of a given confidence, and what that leaves of
    the position and velocity is an offset that decays like a critically damped
    spring. It also makes position and velocity exactly continuous at every
    re-mapping, and lets the movement start from rest.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    tracker : Tracker
        How the weights drift; `LqrTracker()` where None.
    sample : bool
        Track a sample of the component, drawn anew at every mapping, instead of its
        mean: more variation (Fig. 10b).
    seed : int
        Of the samples.
    blend_time : float
        Seconds, the time constant of the offset's decay.
    confidence : float
        Share of a component's own samples inside the ellipsoid that mapped weights
        are kept in, in (0, 1]; 1 is no bound.
    """

    def __init__(
        self,
        skill: "FourierMovementPrimitive",
        *,
        tracker: Tracker | None = None,
        sample: bool = False,
        seed: int = 0,
        blend_time: float = 0.4,
        confidence: float = 0.99,
    ) -> None:
        skill.check_fitted()
        if not (np.isfinite(blend_time) and blend_time > 0):
            raise SkillError(f"blend_time is {blend_time} s; it must be positive.")
        if not 0 < confidence <= 1:
            raise SkillError(f"confidence is {confidence}; it must be in (0, 1].")
        self.skill = skill
        self.sample = sample
        self.seed = int(seed)
        self.blend_time = float(blend_time)
        self.tick_seconds = 1 / skill.rate
        self.ticks_between_remaps = skill.n_steps - skill.overlap
        rule = LqrTracker() if tracker is None else tracker
        self._drifts = [
            rule.drift(c, n_steps=skill.n_steps, tick=self.tick_seconds)
            for c in skill.components_
        ]
        self._radii = [
            float(np.sqrt(chi2.ppf(confidence, max(c.rank, 1))))
            for c in skill.components_
        ]
        self._start_plan = skill.mapping_plan([skill.overlap - 1])
        self._remap_plan = skill.mapping_plan(np.arange(skill.overlap))

    def start(self, position: ArrayLike, *, step: int | None = None) -> PlaybackState:
        """Map a measured start, shape (D,), at rest, to a sample of a window.

        Parameters
        ----------
        position : array_like, shape (D,)
        step : int, optional
            The sample, from K - 1 (where None) to T - 1.
        """
        y = np.asarray(position, dtype=float)
        first = self.skill.overlap - 1
        step = first if step is None else step
        if not first <= step <= self.skill.n_steps - 1:
            raise SkillError(
                f"the start is at step {step}; it must be from {first} to "
                f"{self.skill.n_steps - 1}."
            )
        if y.shape != (self.skill.n_channels_,) or not np.all(np.isfinite(y)):
            raise SkillError(
                f"the start is {y}; expected {self.skill.n_channels_} finite numbers."
            )
        blank = PlaybackState(
            weights=np.zeros(0),
            target=np.zeros(0),
            component=0,
            step=step,
            history=np.tile(y, (self.skill.overlap, 1)),
            offset=np.zeros((2, len(y))),
            remaps=0,
        )
        at_rest = np.stack([y, np.zeros_like(y)])
        plan = self._start_plan
        if step != first:
            plan = self.skill.mapping_plan([step])
        return self._mapped(blank, plan.map(y), at_rest)

    def tick(self, state: PlaybackState) -> PlaybackState:
        """Return the state one sample later."""
        if state.step >= self.skill.n_steps - 1:
            raise SkillError(
                f"the window ends at step {state.step}; re-map before the next tick."
            )
        moved = replace(
            state,
            weights=self.weights(state, self.tick_seconds),
            offset=self._offset(state, self.tick_seconds)[:2],
            step=state.step + 1,
        )
        history = np.roll(state.history, -1, axis=0)
        history[-1] = self.motion(moved)[0]
        return replace(moved, history=history)

    def remap(self, state: PlaybackState) -> PlaybackState:
        """Map the last K desired values onto the start of a new window."""
        mapping = self._remap_plan.map(state.history.ravel())
        entered = replace(state, step=self.skill.overlap - 1, remaps=state.remaps + 1)
        return self._mapped(entered, mapping, self.motion(state)[:2])

    def motion(self, state: PlaybackState, seconds: float = 0.0) -> NDArray[np.float64]:
        """Return the desired motion some seconds after the tick of a state.

        Parameters
        ----------
        state : PlaybackState
        seconds : float
            From 0 to one tick.

        Returns
        -------
        ndarray, shape (3, D)
            Value, velocity (per second) and acceleration (per second^2) of every
            channel. The drift of the weights is part of the derivatives.
        """
        w, w_dot, w_ddot = self._drifts[state.component].advance(
            state.weights, state.target, seconds
        )
        by_channel = self.skill.basis.by_channel
        rate = self.skill.rate
        rows = self.skill.basis.local_rows(self._step(state, seconds))
        scaled = rows * np.array([[1.0], [rate], [rate**2]])
        w0, w1, w2 = by_channel(w), by_channel(w_dot), by_channel(w_ddot)
        p = w0 @ scaled.T
        v = w1 @ scaled[:2].T
        out: NDArray[np.float64] = self._offset(state, seconds)
        out[0] += p[:, 0]
        out[1] += p[:, 1] + v[:, 0]
        out[2] += p[:, 2] + 2 * v[:, 1] + w2 @ scaled[0]
        return out

    def weights(
        self, state: PlaybackState, seconds: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the weights some seconds after the tick of a state, (D*T,)."""
        return self._drifts[state.component].advance(
            state.weights, state.target, seconds
        )[0]

    def covariance(
        self, state: PlaybackState, seconds: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the covariance (18) of the desired value, shape (D, D)."""
        return self.skill.covariance(state.component, self._step(state, seconds))

    def rollout(self, start: ArrayLike, duration: float) -> NDArray[np.float64]:
        """Play from a start for some seconds, sampled at every tick.

        Parameters
        ----------
        start : array_like, shape (D,)
        duration : float
            Seconds.

        Returns
        -------
        ndarray, shape (ticks + 1, 3, D)
            Value, velocity and acceleration, as `motion` gives them.
        """
        if not (np.isfinite(duration) and duration >= 0):
            raise SkillError(f"duration is {duration} s; it must not be negative.")
        state = self.start(start)
        ticks = int(np.floor(duration * self.skill.rate * (1 + 1e-9)))
        out = np.empty((ticks + 1, 3, self.skill.n_channels_))
        out[0] = self.motion(state)
        for i in range(1, ticks + 1):
            state = self.tick(state)
            if state.step == self.skill.n_steps - 1:
                state = self.remap(state)
            out[i] = self.motion(state)
        return out

    def _mapped(
        self,
        state: PlaybackState,
        mapping: Mapping,
        motion: NDArray[np.float64],
    ) -> PlaybackState:
        """Take up mapped weights without a jump from the given motion (2, D)."""
        gaussian = self.skill.components_[mapping.component]
        inside = (mapping.weights - gaussian.mean) @ gaussian.basis
        deviation = np.linalg.norm(
            inside / np.sqrt(gaussian.variances + gaussian.noise)
        )
        inside *= min(1.0, self._radii[mapping.component] / max(deviation, 1e-12))
        entered = replace(
            state,
            weights=gaussian.mean + gaussian.basis @ inside,
            target=self._target(mapping.component, state.remaps),
            component=mapping.component,
            offset=np.zeros_like(state.offset),
        )
        return replace(entered, offset=motion - self.motion(entered)[:2])

    def _offset(self, state: PlaybackState, seconds: float) -> NDArray[np.float64]:
        """Return the critically damped offset and two derivatives, (3, D)."""
        rate = 1 / self.blend_time
        value, velocity = state.offset
        slope = velocity + rate * value
        decay = np.exp(-rate * seconds)
        here = value + slope * seconds
        return decay * np.stack(
            [here, slope - rate * here, rate * (rate * here - 2 * slope)]
        )

    def _step(self, state: PlaybackState, seconds: float) -> float:
        return min(
            state.step + seconds * self.skill.rate, float(self.skill.n_steps - 1)
        )

    def _target(self, component: int, remaps: int) -> NDArray[np.float64]:
        gaussian = self.skill.components_[component]
        if not self.sample:
            return gaussian.mean
        rng = np.random.default_rng([self.seed, remaps])
        return gaussian.sample(rng, with_noise=False)[0]
