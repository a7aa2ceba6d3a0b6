"""Playing a skill at a tempo that changes, beside a robot that may be pushed."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.playback.playback_state import PlaybackState
from fmp_drake.primitives.playback.player import Player
from fmp_drake.primitives.playback.polynomial_segment import HORIZON, PolynomialSegment
from fmp_drake.primitives.playback.segment import Segment, critically_damped

# A share of a tick that rounding may make.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveState:
    """Where a playback stands at an instant between two ticks.

    Attributes
    ----------
    playback : PlaybackState
        At the last tick, with an offset of zero.
    offset : ndarray, shape (2, D)
        What the desired values and velocities (per second of real time) still add to
        those of the weights. It decays in real time, whatever the tempo.
    rest : float
        Seconds of the skill since the tick.
    tempo, slope : float
        Seconds of the skill per second, and their change per second.
    sample : bool
        Whether re-mappings draw samples.
    blend_time : float
        Time constant of the offset's decay, s.
    """

    playback: PlaybackState
    offset: NDArray[np.float64]
    blend_time: float
    rest: float = 0.0
    tempo: float = 1.0
    slope: float = 0.0
    sample: bool = False

    def skill_seconds(self, seconds: float) -> float:
        """Return the seconds of the skill since the tick, some seconds later."""
        return self.rest + (self.tempo + 0.5 * self.slope * seconds) * seconds

    def tempo_after(self, seconds: float) -> float:
        """Return the tempo some seconds later."""
        return self.tempo + self.slope * seconds

    def seconds_to(self, skill_seconds: float) -> float:
        """Return when so many seconds of the skill since the tick have passed."""
        left = skill_seconds - self.rest
        under_root = self.tempo**2 + 2 * self.slope * left
        return 2 * left / (self.tempo + math.sqrt(max(under_root, 0.0)))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Piece:
    """The motion from a tick to the next: `begin` is the tick's time.

    `shown` is the playback with what of the offset is part of the segment.
    """

    player: Player
    playback: PlaybackState
    shown: PlaybackState
    begin: float
    offset: NDArray[np.float64]

    @cached_property
    def segment(self) -> Segment | PolynomialSegment:
        return self.player.segment(self.shown)

    def prepare(self) -> None:
        """Make the segment now."""
        _ = self.segment


class LivePlayback:
    """The desired motion from an instant on, until something changes it.

    Ticks, and the re-mappings at the ends of windows, are made when they are asked
    for, each once; several in a row take much less time than one now and then.

    Parameters
    ----------
    player : Player
    state : LiveState
        At the instant from which times count.
    ticks_at_once : int
    """

    def __init__(
        self, player: Player, state: LiveState, *, ticks_at_once: int = 1
    ) -> None:
        self.state = state
        self._player = player
        self._at_once = ticks_at_once
        # At the usual tempo the offset is part of a segment, which is faster.
        self._usual = (
            state.rest == 0
            and state.tempo == 1
            and state.slope == 0
            and state.blend_time == player.blend_time
        )
        self._pieces = [self._piece_of(state.playback, state.offset, begin=0.0)]

    def playback(self, seconds: float) -> tuple[PlaybackState, float]:
        """Return the last tick before a time, and the seconds of the skill since."""
        piece, since = self._at(seconds)
        return piece.playback, since

    def motion(self, seconds: float) -> NDArray[np.float64]:
        """Return value, velocity and acceleration at a time, shape (3, D)."""
        return self._motion(*self._at(seconds), seconds)

    def motion_and_jerk(self, seconds: float, window: float) -> NDArray[np.float64]:
        """Return the motion and the mean jerk over a window from then on, (4, D).

        The window is in seconds. A tick in it is left out, and so it is shortened
        where it would lead half a tick beyond.
        """
        piece, since = self._at(seconds)
        motion = self._motion(piece, since, seconds)
        fastest = max(self.state.tempo_after(seconds + h) for h in (0.0, window))
        room = HORIZON * self._player.tick_seconds - since
        if fastest * window > room:
            window = room / fastest
        later = seconds + window
        since += self.state.skill_seconds(later) - self.state.skill_seconds(seconds)
        change = self._motion(piece, since, later)[2] - motion[2]
        return np.concatenate((motion, change[None] / window))

    def _motion(
        self, piece: _Piece, since: float, seconds: float
    ) -> NDArray[np.float64]:
        motion = piece.segment.motion(since)
        if self._usual:
            return motion
        state = self.state
        if state.tempo != 1 or state.slope != 0:
            tempo = state.tempo_after(seconds)
            motion[2] = tempo**2 * motion[2] + state.slope * motion[1]
            motion[1] *= tempo
        motion += self._offset(piece, seconds)
        return motion

    def after(self, seconds: float) -> LiveState:
        """Return the state at a later time, with the tick that is due then made."""
        ticks, since = self._ticks(seconds, due=True)
        piece = self._piece(ticks)
        offset = piece.offset
        if seconds > piece.begin:
            offset = self._offset(piece, seconds)[:2]
        return replace(
            self.state,
            playback=piece.playback,
            offset=offset,
            rest=0.0 if since < _ROUNDING * self._player.tick_seconds else since,
            tempo=self.state.tempo_after(seconds),
        )

    def _ticks(self, seconds: float, *, due: bool = False) -> tuple[int, float]:
        """Return the ticks made by a time, and the seconds of the skill since."""
        tick, passed = self._player.tick_seconds, self.state.skill_seconds(seconds)
        if due:
            ticks = math.floor(passed / tick + _ROUNDING)
        else:
            ticks = max(math.ceil(passed / tick - _ROUNDING) - 1, 0)
        return ticks, passed - ticks * tick

    def _at(self, seconds: float) -> tuple[_Piece, float]:
        ticks, since = self._ticks(seconds)
        if self._at_once > 1:
            self._piece(ticks + 1)
        return self._piece(ticks), since

    def _piece(self, ticks: int) -> _Piece:
        pieces = self._pieces
        if ticks >= len(pieces):
            last = -(-ticks // self._at_once) * self._at_once
            while len(pieces) <= last:
                if self._at_once > 1:
                    pieces[-1].prepare()
                pieces.append(self._next(pieces[-1], len(pieces)))
        return pieces[ticks]

    def _next(self, piece: _Piece, ticks: int) -> _Piece:
        player = self._player
        begin = self.state.seconds_to(ticks * player.tick_seconds)
        offset = self._offset(piece, begin)[:2]
        playback = player.tick(piece.playback)
        history = playback.history.copy()
        history[-1] += offset[0]
        playback = replace(playback, history=history)
        if playback.step == player.skill.n_steps - 1:
            tempo = self.state.tempo_after(begin)
            playback, offset = remapped(
                player, playback, offset, tempo=tempo, sample=self.state.sample
            )
        return self._piece_of(playback, offset, begin=begin)

    def _piece_of(
        self, playback: PlaybackState, offset: NDArray[np.float64], *, begin: float
    ) -> _Piece:
        return _Piece(
            player=self._player,
            playback=playback,
            shown=replace(playback, offset=offset) if self._usual else playback,
            begin=begin,
            offset=offset,
        )

    def _offset(self, piece: _Piece, seconds: float) -> NDArray[np.float64]:
        """Return the offset at a time and two derivatives, shape (3, D)."""
        rate = 1 / self.state.blend_time
        return critically_damped(piece.offset, rate, seconds - piece.begin)


def remapped(
    player: Player,
    playback: PlaybackState,
    offset: NDArray[np.float64],
    *,
    tempo: float,
    seconds: float = 0.0,
    observed: NDArray[np.float64] | None = None,
    sample: bool | None = None,
) -> tuple[PlaybackState, NDArray[np.float64]]:
    """Re-map without a jump of the desired value and velocity.

    Parameters
    ----------
    player : Player
    playback : PlaybackState
        With an offset of zero.
    offset : ndarray, shape (2, D)
        See `LiveState`.
    tempo : float
    seconds, observed, sample
        As for `Player.remap`.

    Returns
    -------
    playback, offset
    """
    new = player.remap(playback, seconds=seconds, observed=observed, sample=sample)
    change = new.offset * np.array([[1.0], [tempo]])
    return replace(new, offset=np.zeros_like(offset)), offset + change


def retargeted(
    player: Player,
    playback: PlaybackState,
    offset: NDArray[np.float64],
    *,
    target: NDArray[np.float64],
    tempo: float,
    seconds: float = 0.0,
) -> tuple[PlaybackState, NDArray[np.float64]]:
    """Track another target from a tick on, without a jump.

    Parameters
    ----------
    player : Player
    playback : PlaybackState
        With an offset of zero.
    offset : ndarray, shape (2, D)
        See `LiveState`.
    target : ndarray, shape (D*T,)
        Weights.
    tempo : float
    seconds : float
        Of the skill, since the tick: where the motion shall not jump.

    Returns
    -------
    playback, offset
    """
    new = replace(playback, target=target)
    change = player.motion(playback, seconds)[:2] - player.motion(new, seconds)[:2]
    return new, offset + change * np.array([[1.0], [tempo]])
