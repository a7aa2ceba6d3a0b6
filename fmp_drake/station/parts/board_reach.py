"""What of a board the arm can reach, as the controller would hold it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from fmp_drake.station.models.hard_points import ArmClearance
from fmp_drake.station.models.whiteboard import BoardBox
from fmp_drake.station.parts.board_scene import MakeArm
from fmp_drake.station.parts.held_arm import HeldArm, HeldMotion
from fmp_drake.station.parts.posture import SolvePosture
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.impedance.arm import joint_limits

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Edge of a cell of the reachable board, m, and the most of them along an edge.
_CELL, _MOST_CELLS = 0.02, 40
# Moves of the board that are tried, m, on every so many-th sample of a few paths.
_MOVES, _SPARSE = (0.05, 0.10, 0.15, 0.20, 0.30), 2


@dataclass(frozen=True, kw_only=True)
class FollowingBounds:
    """What counts as followed.

    Attributes
    ----------
    distance : float
        Between a wanted position and the one that the springs let the arm hold, m: as far
        as a run may be off its path (rms).
    tilt : float
        Of the eraser against the board, rad: its end then lifts by 6 mm, a fifth of the
        felt.
    joint_reserve : float
        What the joints must keep to their walls, rad. Where nothing was limited, runs
        came up to 0.03 from the angles that are foreseen here.
    clearance : float
        Of the arm's links from the board, m.
    torque_fraction : float
        Of the joints' torque limits; what is left is for springs and pushes.
    drag : float
        By which friction may hold the pressed eraser behind its path, m.
    exceptions : float
        Fraction of the samples that may miss a bound: tails of the Gaussians, which
        are hardly ever played.

    Examples
    --------
    >>> FollowingBounds(distance=0.005).tilt
    0.1
    """

    distance: float = 0.010
    tilt: float = 0.1
    joint_reserve: float = 0.03
    clearance: float = 0.02
    torque_fraction: float = 0.9
    drag: float = 0.010
    exceptions: float = 0.002


class BoardReach:
    """The arm with its eraser over boards, held as the controller would hold it.

    Parameters
    ----------
    scenario : Scenario
    bounds : FollowingBounds

    Attributes
    ----------
    limits : JointLimits
        The arm's.
    rail : array, shape (3,)
        From the middle of the rail of a moving board to its end, in B, m.
    """

    def __init__(self, scenario: Scenario, bounds: FollowingBounds) -> None:
        self._scenario, self._bounds = scenario, bounds
        self._arm, self._tip = MakeArm(scenario)
        self._held = HeldArm(self._arm, self._tip, scenario.impedance)
        self._clearance = ArmClearance()
        self.limits = joint_limits(self._arm)
        self.rail = scenario.board.motion.amplitude * scenario.board.axis()
        self._start = np.array(scenario.start) - self.rail

    def start_posture(self) -> Array:
        """Return the posture at the start, as the station solves for it, shape (n,).

        Raises
        ------
        StationError
            Where the arm cannot reach the start.
        """
        X_BE = RigidTransform(self._scenario.eraser_orientation(), self._start)
        return SolvePosture(
            self._arm,
            frame=self._tip,
            X_WE=self._scenario.board.assumed_pose() @ X_BE,
            q_preferred=self._scenario.posture,
        )

    def near_postures(self, X_WB: list[RigidTransform]) -> Array:
        """Return postures near the preferred one at the start on boards, (boards, n)."""
        preferred = np.tile(self._scenario.posture, (len(X_WB), 1))
        there = np.tile(self._start, (1, 2, 1))
        return self.follow(X_WB, there, step=1.0, postures=preferred).q[:, -1]

    def follow(
        self,
        X_WB: list[RigidTransform],
        paths: Array,
        *,
        step: float,
        postures: Array,
    ) -> HeldMotion:
        """Follow the same paths on each of some boards, from a posture for each.

        Parameters
        ----------
        X_WB : list of RigidTransform
        paths : array, shape (B, T, 3)
            Positions of the eraser in the frame of the board, m.
        step : float
            Time from sample to sample, s.
        postures : array, shape (boards, n)
            rad.

        Returns
        -------
        HeldMotion
            Of boards * B paths.
        """
        R_WB = np.array([X.rotation().matrix() for X in X_WB])
        origin = np.array([X.translation() for X in X_WB])[:, None, None]
        p_WE = paths @ R_WB.mT[:, None] + origin
        count = len(paths)
        R_WB = np.repeat(R_WB, count, axis=0)
        return self._held.follow(
            p_WE.reshape(-1, *paths.shape[1:]),
            R_WB @ self._scenario.eraser_orientation().matrix(),
            R_WB,
            q_posture=np.repeat(postures, count, axis=0),
            step=step,
        )

    def missed(self, motion: HeldMotion) -> tuple[Flags, Flags, Array]:
        """Return which samples are out of reach or at a wall, (B, T), and the room.

        The room of each joint to its limit is in rad, shape (B, T, n).
        """
        bounds, error = self._bounds, motion.error
        out = np.linalg.norm(error[..., 3:], axis=-1) > bounds.distance
        out |= np.linalg.norm(error[..., :2], axis=-1) > bounds.tilt
        room = self.limits.half_range - np.abs(motion.q - self.limits.middle)
        wall = self._scenario.impedance.walls.width + bounds.joint_reserve
        return out, np.min(room, axis=-1) < wall, room

    def clearance(
        self, X_WB: list[RigidTransform], motion: HeldMotion, moved: Array
    ) -> tuple[Array, str]:
        """Return how near the arm's links come to the board, and which comes nearest.

        Parameters
        ----------
        X_WB : list of RigidTransform
        motion : HeldMotion
            Of boards * B paths.
        moved : array, shape (B, T, 3)
            How far the board is along its rail by then, in B, m.

        Returns
        -------
        distance : array, shape (boards * B, T)
            m; negative where a link would be in the board.
        link : str
            Name of the body.
        """
        n, shape = motion.q.shape[-1], motion.q.shape[:2]
        X_BW = np.array([X.inverse().GetAsMatrix34() for X in X_WB])
        X = np.repeat(X_BW, moved[..., 0].size, axis=0)
        X[..., 3] -= np.tile(moved.reshape(-1, 3), (len(X_WB), 1))
        box = BoardBox(self._scenario.board)
        distance, link = self._clearance.nearest(motion.q.reshape(-1, n), X, box)
        return distance.reshape(shape), link

    def shortest_move(self, paths: Array, moved: Array, step: float) -> str:
        """Return the shortest move of the board that brings paths into reach, in words.

        Parameters
        ----------
        paths, moved, step
            As for `follow` and `clearance`.
        """
        assumed = self._scenario.board.assumed_pose()
        away = assumed.translation() * np.array([1.0, 1.0, 0.0])
        away, up = away / max(np.linalg.norm(away), 1e-9), np.array([0.0, 0.0, 1.0])
        ways = {"towards the arm": -away, "away from the arm": away}
        ways |= {"up": up, "down": -up}
        moves = [(far, *way) for far in _MOVES for way in ways.items()]
        X_WB = [RigidTransform(far * way) @ assumed for far, _, way in moves]
        # The paths that go farthest to each side, and the one from the start.
        sides = np.concatenate([paths[..., :2], -paths[..., :2]], axis=-1)
        farthest = np.argmax(np.max(sides, axis=1), axis=0)
        some, moved = (each[[0, *farthest], ::_SPARSE] for each in (paths, moved))
        postures = self.near_postures(X_WB)
        motion = self.follow(X_WB, some, step=step * _SPARSE, postures=postures)
        out, at_wall, _ = self.missed(motion)
        near = self.clearance(X_WB, motion, moved)[0] < self._bounds.clearance
        fractions = np.mean((out | at_wall | near).reshape(len(moves), -1), axis=1)
        for (far, way, _), fraction in zip(moves, fractions, strict=True):
            if fraction <= self._bounds.exceptions:
                return f"move the board {100 * far:.0f} cm {way}"
        return (
            f"no move of the board by up to {100 * _MOVES[-1]:.0f} cm towards or away "
            "from the arm, up or down helps; turn it, or make the movement smaller"
        )

    def cells(self, posture: Array) -> tuple[Array, Array, Array]:
        """Return how far the joints are from their walls over the assumed board.

        Parameters
        ----------
        posture : array, shape (n,)
            Of the controller, rad.

        Returns
        -------
        x, y : array, shape (nx,) and (ny,)
            In B, m.
        margin : array, shape (nx, ny)
            rad; NaN where the board is out of reach.
        """
        size = np.array(self._scenario.board.size)
        half = np.ceil(size / 2 / np.maximum(_CELL, size / _MOST_CELLS)).astype(int)
        x, y = (np.linspace(0, s / 2, n + 1) for s, n in zip(size, half, strict=True))
        y = np.concatenate([-y[:0:-1], y])
        # From the middle line outwards, both ways.
        lines = np.zeros((2, len(y), len(x), 3))
        lines[..., 0] = x * np.array([-1.0, 1.0])[:, None, None]
        lines[..., 1] = y[:, None]
        assumed = [self._scenario.board.assumed_pose()]
        motion = self.follow(
            assumed, lines.reshape(-1, len(x), 3), step=0.2, postures=posture[None]
        )
        out, _, room = self.missed(motion)
        walls = self._scenario.impedance.walls.width
        margin = np.where(out, np.nan, np.min(room, axis=-1) - walls)
        below, above = margin.reshape(2, len(y), len(x))
        x = np.concatenate([-x[:0:-1], x])
        return x, y, np.concatenate([below[:, :0:-1], above], axis=1).T
