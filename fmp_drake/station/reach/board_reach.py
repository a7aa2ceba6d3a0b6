"""Reachable part of a board with the posture of the controller."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.numeric import Array, Mask
from fmp_drake.station.models.eraser import FELT_DEPTH, FeltForceLimit
from fmp_drake.station.models.whiteboard import BoardBox, closed_axes
from fmp_drake.station.reach.deviation_prediction import Deviation, predict_deviation
from fmp_drake.station.reach.posture import SolveStartPosture, StartForceLimit
from fmp_drake.station.reach.tracking_prediction import (
    NO_CONTACT,
    RESIDUAL,
    FeltContact,
    PredictedMotion,
    TrackingPredictor,
    lengths,
    times,
)
from fmp_drake.station.robots.collision_spheres import CollectCollisionSpheres
from fmp_drake.station.robots.robot import (
    TOOL,
    FilterSelfContact,
    LoadRobot,
    MakeRobotModel,
    RobotConfig,
    Tool,
)
from fmp_drake.station.robots.stability import CheckStability
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.interface.arm_model import joint_damping, joint_limits
from fmp_drake.systems.surface.surface import PLANE, Surface, place, rotations
from fmp_drake.systems.surface_monitor import along, clearances, moved

# Edge of a cell of the reachable board, m, and largest number of cells along an edge.
_CELL, _MAX_CELLS = 0.02, 40
# Viscous damping of a joint that holds the eraser back by less than 1 mm, Nm s/rad.
_SLIGHT_DAMPING = 0.5
# Candidate moves of the board, m, and stride of the samples of their paths.
_MOVES, _STRIDE = (0.05, 0.10, 0.15, 0.20, 0.30, 0.40), 2
LONGEST_MOVE = _MOVES[-1]
"""Longest candidate move of the board, m."""


@dataclass(frozen=True, kw_only=True)
class FollowingBounds:
    """Bounds within which a skill counts as followed.

    Attributes
    ----------
    farthest : float
        Distance between a desired position and the static position of the arm in its springs,
        m. If the scenario's tolerance is exceeded briefly, the tracking error decides, up to
        `farthest`.
    tracking_error : float
        Predicted rms distance from the path, as a fraction of the scenario's tolerance, for
        positions out of reach or braked joints: such runs were up to 1.5 times as far off.
    tilt, steepest : float
        Of the eraser with respect to the board, rad. At `tilt` its end lifts by 6 mm, a fifth
        of the felt. If it is exceeded briefly, the tilt error decides, up to `steepest`.
    tilt_error : float
        Predicted rms tilt, rad: runs with at most 0.032 passed, all with 0.039 or more
        failed.
    orientation_error : float
        Predicted rms error of a skill with rotation channels, rad: half of the limit for a
        run. A run had 0.64 degrees where 0.28 had been predicted.
    force_error, constant_force_error : float
        Predicted rms error of the normal force, N. With a force channel it is half of the
        limit for a run. With a constant force, a run with 4.5 was outside its tolerance for
        21 % of the time, one with 2.8 for 1 %.
    joint_reserve : float
        Margin from a joint-limit spring at which a joint counts as at the spring, rad.
    brief : float
        Fraction of the samples that may exceed a joint's speed limit, even if other joints
        compensate for the braked ones. A quarter of the samples disturbs the normal force,
        half of them the whole motion.
    unsteady : float
        Fraction of the samples at which poses out of reach, braked joints and singularities
        may change the normal force by more than its tolerance. Runs exceed the prediction:
        four of five with 0.0013 to 0.0064 were outside the tolerance for 5.5 to 6.7 % of the
        time, and none of ten with 0.0007 or less for more than 4 %.
    lift : float
        Height to which a push may lift the eraser, in tolerances: 8 cm alone are 10 mm rms in
        a run of 30 s. Three runs with 8.0 or 8.1 cm had 10.0 to 10.4 mm, two with 7.3 cm had
        7.3 and 9.7.
    clearance : float
        Of the arm's links from the board, m.
    torque_fraction : float
        Of the joints' torque limits; the rest is for springs and pushes.
    torque_rate_fraction : float
        Of the greatest rate of torque, for the motion. Of arms of 18, 33 and 360 kg the lighter
        two pressed evenly at 0.2; from 0.42 the 33 kg, from 0.6 all oscillated ever more.
    exceptions : float
        Fraction of the samples that may violate a bound: tails of the Gaussians, which are
        hardly ever played.

    Examples
    --------
    >>> FollowingBounds(lift=5.0).tilt
    0.1
    """

    farthest: float = 0.040
    tracking_error: float = 0.65
    tilt: float = 0.1
    steepest: float = 0.2
    tilt_error: float = 0.035
    orientation_error: float = np.deg2rad(0.25)
    force_error: float = 0.25
    constant_force_error: float = 4.0
    joint_reserve: float = 0.03
    brief: float = 0.2
    unsteady: float = 0.001
    lift: float = 7.7
    clearance: float = 0.02
    torque_fraction: float = 0.9
    torque_rate_fraction: float = 0.4
    exceptions: float = 0.002


class ArmClearance:
    """Clearance of an arm's links, without its tool, from a board, and contact of the arm.

    Parameters
    ----------
    config : RobotConfig
    tool : EraserConfig or str, optional
        The default eraser if None.

    Raises
    ------
    StationError
        Where the arm has no collision geometry, or shapes that cannot be checked.
    """

    def __init__(self, config: RobotConfig, tool: Tool | None = None) -> None:
        builder = DiagramBuilder()
        self._graph = graph = SceneGraph()
        robot = MakeRobotModel(config, tool, scene_graph=graph)
        self._plant, self._tool = robot.plant, robot.tool
        builder.AddSystem(robot.plant)
        builder.AddSystem(graph)
        source: Any = robot.plant.get_source_id()
        builder.Connect(
            robot.plant.get_geometry_pose_output_port(),
            graph.get_source_pose_port(source),
        )
        hard = CollectCollisionSpheres(robot.plant, graph, robot.arm)
        FilterSelfContact(robot, graph)
        indices, self._owner = np.unique(hard.bodies, return_inverse=True)
        self._links = [self._plant.get_body(BodyIndex(i)) for i in indices]
        self._points, self._radii = hard.points, hard.radii
        diagram = builder.Build()
        self._root = diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)

    def self_contact(self, q: Array) -> tuple[Mask, str]:
        """Return where arm and tool touch each other, and two bodies that touch.

        Parameters
        ----------
        q : array, shape (N, n)
            rad.

        Returns
        -------
        touching : array of bool, shape (N,)
        bodies : str
            Names, as in `contact_free`, of the pair that is deepest in one another; empty where
            none touches.
        """
        context = self._graph.GetMyContextFromRoot(self._root)
        touching, deepest, bodies = np.zeros(len(q), dtype=bool), 0.0, ""
        for i in range(len(q)):
            self._plant.SetPositions(self._context, q[i])
            query: Any = self._graph.get_query_output_port().Eval(context)
            for pair in query.ComputePointPairPenetration():
                touching[i] = True
                if pair.depth > deepest:
                    names = map(self._name, (pair.id_A, pair.id_B))
                    deepest, bodies = pair.depth, " and ".join(sorted(names))
        return touching, bodies

    def _name(self, geometry: GeometryId) -> str:
        """Return the name of a geometry's body in `contact_free`."""
        frame = self._graph.model_inspector().GetFrameId(geometry)
        body: Any = self._plant.GetBodyFromFrameId(frame)
        return TOOL if body.model_instance() == self._tool else str(body.name())

    def nearest(
        self, q: Array, X_BW: Array, box: Array, curvature: Surface = PLANE
    ) -> tuple[Array, str]:
        """Return the distance to a board, and the nearest link.

        Parameters
        ----------
        q : array, shape (N, n)
            rad.
        X_BW : array, shape (N, 3, 4)
            The world in the frame of the board.
        box : array, shape (2, 3)
            The board's lower and upper corner in B, or in (u, v, h), m.
        curvature : Surface
            Of the board.

        Returns
        -------
        distance : array, shape (N,)
            Of the nearest link, m; negative inside the board.
        link : str
            Name of the body.
        """
        X = np.empty((len(q), len(self._links), 3, 4))
        for i in range(len(q)):
            self._plant.SetPositions(self._context, q[i])
            for j, link in enumerate(self._links):
                X[i, j] = self._plant.EvalBodyPoseInWorld(
                    self._context, link
                ).GetAsMatrix34()
        distance = np.empty((len(q), len(self._links)))
        for j in range(len(self._links)):  # All at once would take gigabytes.
            is_here = self._owner == j
            X_BL = X_BW[..., :3] @ X[:, j]
            X_BL[..., 3] += X_BW[..., 3]
            p_B = self._points[is_here] @ X_BL[..., :3].mT + X_BL[:, None, :, 3]
            p = along(curvature, p_B)
            distance[:, j] = np.min(clearances(p, self._radii[is_here], box), axis=1)
        nearest = int(np.argmin(np.min(distance, axis=0)))
        return np.min(distance, axis=1), self._links[nearest].name()


class BoardReach:
    """Arm with its eraser over boards, in the postures of the controller.

    Parameters
    ----------
    scenario : Scenario
    bounds : FollowingBounds

    Attributes
    ----------
    limits : JointLimits
        The arm's.
    damping : array, shape (n,)
        Viscous damping of the arm's joints in its model, Nm s/rad; 0 where it is slight.
    p_WBase : array, shape (3,)
        The robot's base in the world, m.
    rail : array, shape (3,)
        Vector from the middle of a moving board's rail to its end, in B, m.
    """

    def __init__(self, scenario: Scenario, bounds: FollowingBounds) -> None:
        self._scenario, self._bounds = scenario, bounds
        config = LoadRobot(scenario.robot)
        self._model = model = MakeRobotModel(config, scenario.held_tool())
        CheckStability(model, scenario.impedance, delay=scenario.sensors.delay)
        self._contact = NO_CONTACT
        if scenario.has_board:
            felt = FeltForceLimit(scenario.eraser) / FELT_DEPTH
            self._contact = FeltContact(scenario.nominal_force(), felt)
        self._predictor = TrackingPredictor(
            model.plant, model.tip, scenario.impedance, self._contact
        )
        self._clearance = ArmClearance(config, scenario.held_tool())
        self._torque_rate = (
            config.complete(scenario.impedance).max_torque_rate or np.inf
        )
        self.p_WBase = np.array(config.base_pose.translation)
        self.limits = joint_limits(model.plant)
        damping = joint_damping(model.plant)
        self.damping = np.where(damping > _SLIGHT_DAMPING, damping, 0.0)
        self.rail = scenario.board.motion.amplitude * scenario.board.rail_axis()
        self._frequency = scenario.board.motion.frequency
        self._surface = scenario.board.curvature()

    def displacements(self, count: int, length: int, step: float) -> Array:
        """Return how far the board is along its rail at samples of paths, (count, length, 3), m.

        Each path starts at another position of the board, the first at the rail's end; `step`
        is the time between two samples, s.
        """
        starts = np.linspace(-0.5, 1.5, count, endpoint=False)[:, None] * np.pi
        turned = 2 * np.pi * self._frequency * step * np.arange(length)
        return np.sin(starts + turned)[..., None] * self.rail

    def start_posture(self) -> Array:
        """Return the posture of a station at the start, shape (n,).

        Raises
        ------
        StationError
            If the arm cannot reach the start.
        """
        return SolveStartPosture(self._scenario, self._model, self._scenario.start)

    def near_postures(
        self, X_WB: list[RigidTransform], position: ArrayLike | None = None
    ) -> Array:
        """Return postures near the preferred one at a position on each board, (boards, n).

        Parameters
        ----------
        X_WB : list of RigidTransform
        position : array_like, shape (3,), optional
            p_BE, m; the start where None.
        """
        preferred = np.tile(self._scenario.preferred_posture(), (len(X_WB), 1))
        path = np.tile(
            self._scenario.start if position is None else position, (1, 2, 1)
        )
        motion = self.follow(X_WB, path, moved=-self.rail, step=1.0, postures=preferred)
        return motion.q[:, -1]

    def pressed(self, paths: Array, boards: int) -> Mask:
        """Return whether paths (B, T, 3) are in desired contact, shape (boards * B, T)."""
        is_low = paths[..., 2] < self._scenario.press.engage_height
        return np.tile(is_low, (boards, 1))

    def friction_lag(self, paths: Array, boards: int, force: Array | float) -> Array:
        """Return how far friction holds the eraser back, m, shape (boards * B, T).

        Parameters
        ----------
        paths : array, shape (B, T, 3)
        boards : int
        force : array, shape (boards * B, T), or float
            Normal force where the eraser presses, N.
        """
        config = self._scenario.impedance
        stiffness = min(config.translational_stiffness[:2])
        soft = config.covariance_stiffness
        if soft.enabled:  # The geometric mean of the range.
            stiffness = float(np.sqrt(soft.min_stiffness * soft.max_stiffness))
        friction = self._scenario.contact_friction() / stiffness
        return friction * np.where(self.pressed(paths, boards), force, 0.0)

    def off_path(self, deviation: float, friction_lag: float) -> float:
        """Return the distance from the path of a deviation with the friction lag, rms, m.

        Damping holds the eraser back along its path, as friction does; other deviations
        have other directions.
        """
        if np.any(self.damping):
            return deviation + friction_lag
        return float(np.hypot(deviation, friction_lag))

    def missing_board(self, paths: Array) -> tuple[list[str], str]:
        """Return the faults of paths (B, T, 3) along which the eraser finds no board to press.

        The last value is what helps where the actual board is farther from the assumed one
        than the arm searches.
        """
        scenario, faults = self._scenario, list[str]()
        if not scenario.has_board:
            return faults, ""
        board, pressed = scenario.board, self.pressed(paths, 1)
        is_beyond = np.abs(paths[..., :2]) > np.divide(board.size, 2)
        is_beyond &= ~np.array(closed_axes(board.size, self._surface))
        beyond = np.mean(pressed & np.any(is_beyond, axis=-1))
        if beyond > self._bounds.exceptions:
            faults.append(
                f"{100 * beyond:.1f} % of the path is beyond the edges of the board, which "
                f"is {board.size[0]:g} x {board.size[1]:g} m"
            )
        X_BA = board.pose().inverse() @ board.assumed_pose()
        p_AE = place(self._surface, (paths * [1, 1, 0])[pressed])
        height = along(self._surface, moved(X_BA.GetAsMatrix34(), p_AE))[:, 2]
        force_control = scenario.impedance.force_control
        most = force_control.search_range
        if force_control.enabled:  # Then the arm yields to a board that is too high.
            height = np.maximum(height, 0.0)
        off = np.sum(np.abs(height) > most) / pressed.size
        setting = ""
        if off > self._bounds.exceptions:
            setting = "a smaller board.error, or a greater impedance.force_control.search_range"
            farthest = height[np.argmax(np.abs(height))]
            faults.append(
                f"on {100 * off:.1f} % of the path the board is up to "
                f"{1e3 * abs(farthest):.0f} mm {'lower' if farthest > 0 else 'higher'} than "
                f"assumed, and the arm searches within {1e3 * most:.0f} mm"
            )
        return faults, setting

    def follow(
        self,
        X_WB: list[RigidTransform],
        paths: Array,
        *,
        step: float,
        postures: Array,
        moved: Array | float = 0.0,
        R_TE: Array | None = None,
    ) -> PredictedMotion:
        """Predict the motion along the same paths on several boards.

        Parameters
        ----------
        X_WB : list of RigidTransform
        paths : array, shape (B, T, 3)
            Positions of the eraser in the frame of the board, or (u, v, h) over a curved
            one, whose normal the eraser follows, m.
        step : float
            Time from sample to sample, s.
        postures : array, shape (boards, n)
            Initial postures, rad.
        moved : array, shape (B, T, 3)
            Displacement of the board along its rail, in B, m.
        R_TE : array, shape (B, T, 3, 3), optional
            Orientation of the tool along the path, the scenario's by default. T is the frame
            of the local normal, which is B on a flat board.

        Returns
        -------
        PredictedMotion
            Of boards * B paths.
        """
        R_WB = np.array([X.rotation().matrix() for X in X_WB])[:, None, None]
        origin = np.array([X.translation() for X in X_WB])[:, None, None]
        p_BE, R_BT = paths, np.eye(3)[None, None]
        if not self._surface.is_plane:
            uvh = np.ascontiguousarray(paths).reshape(-1, 3)
            p_BE = place(self._surface, uvh).reshape(paths.shape)
            R_BT = rotations(self._surface, uvh).reshape(*paths.shape, 3)
        if R_TE is None:
            R_TE = self._scenario.eraser_orientation().matrix()[None, None]
        else:
            R_BT = np.broadcast_to(R_BT, R_TE.shape)
        p_WE = (p_BE + moved) @ R_WB[:, 0].mT + origin
        R_WT = np.broadcast_to(R_WB @ R_BT, (len(X_WB), len(paths), *R_BT.shape[1:]))
        R_WT = R_WT.reshape(-1, *R_BT.shape[1:])
        if len(R_TE) > 1:
            R_TE = np.tile(R_TE, (len(X_WB), 1, 1, 1))
        return self._predictor.follow(
            p_WE.reshape(-1, *paths.shape[1:]),
            R_WT @ R_TE,
            R_WT,
            q_posture=np.repeat(postures, len(paths), axis=0),
            step=step,
            pressed=self.pressed(paths, len(X_WB)),
        )

    def missed(
        self, motion: PredictedMotion, *, has_rotation: bool = False
    ) -> tuple[Mask, Mask, Mask, Array]:
        """Return whether samples miss their position or orientation, or are at a limit spring.

        Each result has shape (B, T). The last value is the margin of each joint from its
        limit, rad, shape (B, T, n).
        """
        bounds = self._bounds
        distance, tilt = lengths(motion.error, has_rotation=has_rotation)
        is_far, is_tilted = distance > self._scenario.tolerance, tilt > bounds.tilt
        margin = self.limits.half_range - np.abs(motion.q - self.limits.middle)
        wall = self._scenario.impedance.walls.width + bounds.joint_reserve
        return is_far, is_tilted, np.min(margin, axis=-1) < wall, margin

    def clearance(
        self, X_WB: list[RigidTransform], motion: PredictedMotion, moved: Array
    ) -> tuple[Array, str]:
        """Return the smallest distance of the arm's links from the board, and the link.

        Parameters
        ----------
        X_WB : list of RigidTransform
        motion : PredictedMotion
            Of boards * B paths.
        moved : array, shape (B, T, 3)
            Displacement of the board along its rail, in B, m.

        Returns
        -------
        distance : array, shape (boards * B, T)
            m; negative for a link inside the board, infinite without a board.
        link : str
            Name of the body.
        """
        if not self._scenario.has_board:
            return np.full(motion.q.shape[:2], np.inf), ""
        n, shape = motion.q.shape[-1], motion.q.shape[:2]
        X_BW = np.array([X.inverse().GetAsMatrix34() for X in X_WB])
        X = np.repeat(X_BW, moved[..., 0].size, axis=0)
        X[..., 3] -= np.tile(moved.reshape(-1, 3), (len(X_WB), 1))
        box = BoardBox(self._scenario.board)
        distance, link = self._clearance.nearest(
            motion.q.reshape(-1, n), X, box, self._surface
        )
        return distance.reshape(shape), link

    def contacts(
        self, X_WB: list[RigidTransform], motion: PredictedMotion, moved: Array
    ) -> tuple[Array, list[str], str]:
        """Return whether the arm is too near the board, or touches itself.

        The parameters are those of `clearance`.

        Returns
        -------
        distance : array, shape (boards * B, T)
            That of `clearance`.
        faults : list of str
        setting : str
            What helps where the arm touches itself all along the paths.
        """
        faults, setting, bounds = list[str](), "", self._bounds
        clearance, link = self.clearance(X_WB, motion, moved)
        near = np.mean(clearance < bounds.clearance)
        if near > bounds.exceptions:
            faults.append(
                f"on {100 * near:.1f} % of the path {link} touches the board, or "
                f"comes nearer than {1e3 * bounds.clearance:.0f} mm"
            )
        q = motion.q.reshape(-1, motion.q.shape[-1])
        touching, bodies = self._clearance.self_contact(q)
        if np.mean(touching) > bounds.exceptions:
            faults.append(
                f"on {100 * np.mean(touching):.1f} % of the path {bodies} touch each other; "
                "choose another posture, or list them in contact_free in the robot's file if "
                "they cannot meet"
            )
            setting = "another posture, or contact_free" if np.all(touching) else ""
        return clearance, faults, setting

    def start_force(self, posture: Array) -> float:
        """Return the greatest normal force at the start, N; infinite in free space."""
        if not self._scenario.has_board:
            return np.inf
        return StartForceLimit(self._scenario, self._model, posture)

    def oscillation(
        self, motion: PredictedMotion, step: float
    ) -> tuple[list[str], str]:
        """Return what is wrong if the greatest rate of torque is too small, and what helps."""
        torque = times(motion.M, np.gradient(motion.v, step, axis=1))
        rates = np.max(np.abs(np.gradient(torque, step, axis=1)), axis=-1)
        rate = float(np.quantile(rates, 1 - self._bounds.exceptions))
        allowed = self._bounds.torque_rate_fraction
        if rate <= allowed * self._torque_rate:
            return [], ""
        fault = (
            f"its torques change by up to {rate:.0f} Nm/s, and it would oscillate with a "
            f"max_torque_rate of {self._torque_rate:g} Nm/s"
        )
        ample = 2 * rate / allowed
        return [fault], f"a max_torque_rate of {ample:.0f} Nm/s, if the arm accepts it"

    def deviation(
        self,
        motion: PredictedMotion,
        paths: Array,
        *,
        force: float,
        q_posture: Array,
        step: float,
    ) -> Deviation:
        """Predict the deviation from a motion with a desired normal force, N.

        Where the arm can neither yield to the board nor reach down to it, the felt bears
        the error of the force. `paths` are those of `follow`, the other parameters those of
        `predict_deviation`.
        """
        pose, error, words = predict_deviation(
            self._scenario.impedance,
            self.limits,
            motion,
            self._contact._replace(force=force),
            q_posture=q_posture,
            step=step,
            joint_damping=self.damping,
        )
        depth = motion.error[..., 5]
        depth = depth - np.clip(depth, -RESIDUAL, RESIDUAL)
        pressed = self.pressed(paths, len(motion.q) // len(paths))
        felt = np.where(pressed, self._contact.stiffness * depth, 0.0)
        if largest := np.max(self.damping):
            damped = (
                f"joints are damped by up to {largest:g} Nm s/rad in the robot's model"
            )
            words = f"{damped}, {words}" if words else damped
        return Deviation(pose, error + felt, words)

    def moves_into_reach(
        self, paths: Array, moved: Array, step: float, R_TE: Array | None = None
    ) -> list[tuple[str, Array]]:
        """Return moves of the board that bring the extreme paths into reach.

        Parameters
        ----------
        paths, moved, step, R_TE
            As for `follow` and `clearance`.

        Returns
        -------
        list of tuple of str and array, shape (3,)
            Text, and displacement in W, m, the shortest one first.
        """
        assumed = self._scenario.board.assumed_pose()
        away = (assumed.translation() - self.p_WBase) * np.array([1.0, 1.0, 0.0])
        away, up = away / max(np.linalg.norm(away), 1e-9), np.array([0.0, 0.0, 1.0])
        left = np.cross(up, away)
        directions = {"towards the arm": -away, "away from the arm": away}
        directions |= {"up": up, "down": -up}
        directions |= {"to the arm's left": left, "to the arm's right": -left}
        moves = [(d, *direction) for d in _MOVES for direction in directions.items()]
        X_WB = [RigidTransform(d * vector) @ assumed for d, _, vector in moves]
        # The paths with the largest extent to each side, and the one from the start.
        sides = np.concatenate([paths[..., :2], -paths[..., :2]], axis=-1)
        farthest = np.argmax(np.max(sides, axis=1), axis=0)
        rows = np.s_[[0, *farthest], ::_STRIDE]
        moved = moved[rows]
        postures = self.near_postures(X_WB)
        motion = self.follow(
            X_WB,
            paths[rows],
            moved=moved,
            step=step * _STRIDE,
            postures=postures,
            R_TE=None if R_TE is None else R_TE[rows],
        )
        is_far, is_tilted, *_ = self.missed(motion, has_rotation=R_TE is not None)
        is_near = self.clearance(X_WB, motion, moved)[0] < self._bounds.clearance
        is_free = not self._scenario.has_board
        what = "the motion (board.translation)" if is_free else "the board"
        fractions = np.mean(
            (is_far | is_tilted | is_near).reshape(len(moves), -1), axis=1
        )
        return [
            (f"move {what} {100 * d:.0f} cm {name}", d * vector)
            for (d, name, vector), fraction in zip(moves, fractions, strict=True)
            if fraction <= self._bounds.exceptions
        ]

    def cells(self, posture: Array) -> tuple[Array, Array, Array]:
        """Return the margin of the joints from their limit springs on the assumed board.

        Parameters
        ----------
        posture : array, shape (n,)
            Of the controller, rad.

        Returns
        -------
        x, y : array, shape (nx,) and (ny,)
            In B, m.
        margin : array, shape (nx, ny)
            rad; NaN out of reach.
        """
        size = np.array(self._scenario.board.size)
        half = np.ceil(size / 2 / np.maximum(_CELL, size / _MAX_CELLS)).astype(int)
        x, y = (np.linspace(0, s / 2, n + 1) for s, n in zip(size, half, strict=True))
        y = np.concatenate([-y[:0:-1], y])
        # From the middle line in both directions.
        lines = np.zeros((2, len(y), len(x), 3))
        lines[..., 0] = x * np.array([-1.0, 1.0])[:, None, None]
        lines[..., 1] = y[:, None]
        assumed = [self._scenario.board.assumed_pose()]
        motion = self.follow(
            assumed, lines.reshape(-1, len(x), 3), step=0.2, postures=posture[None]
        )
        is_far, is_tilted, _, margins = self.missed(motion)
        walls = self._scenario.impedance.walls.width
        margin = np.where(is_far | is_tilted, np.nan, np.min(margins, axis=-1) - walls)
        below, above = margin.reshape(2, len(y), len(x))
        x = np.concatenate([-x[:0:-1], x])
        return x, y, np.concatenate([below[:, :0:-1], above], axis=1).T
