"""Hand guiding by a mouse or finger on the page."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RotationMatrix
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    LeafSystem,
)
from scipy.spatial.transform import Rotation

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, check_number
from fmp_drake.settings import check_settings
from fmp_drake.systems.human_hand import hand_torque
from fmp_drake.systems.interface.callbacks import (
    declare_bodies,
    declare_spatial_forces,
    spatial_force,
)
from fmp_drake.systems.teaching.mouse_drag import (
    GUIDING,
    PULLING_DRAG,
    STARTED,
    STATE,
    BoardSurface,
    Drag,
    DragConfig,
    cursor_of,
    follow,
    hand_force,
    is_idle,
    no_drag,
)

TURN_SWITCH = "turn the tool"
"""Name of the page's switch that makes a drag turn the tool."""

SAMPLE_PERIOD = 0.016
"""Time between two samples of the mouse, s."""

MOST_TORQUE = 15.0
"""Greatest torque of the hand, Nm."""


class MouseHand(LeafSystem):
    """Forces of a mouse that guides a tool over a board, or pulls a dragged body.

    With a `board` a drag of any movable body guides the tool parallel to the board,
    for any view of the page's camera. Without one, a drag pulls at the dragged point of
    the body, in the plane of the screen. The mouse is an external input: it is sampled
    at a fixed rate, and the sample is the state. A drag ends at a jump of the cursor, or
    where the page sends no message for 0.3 s although the arm moves; see `follow`.

    With an orientation at rest, `R_WE`, the hand also holds the tool's orientation, and the
    page has a switch, `TURN_SWITCH`. While it is on, a drag turns the tool around its end:
    the grabbed point follows the cursor. The initialisation of a simulation adds the switch.

    Input ports
    -----------
    spring : abstract
        Forces of Drake's mouse spring during a drag, else an empty list.
    body_poses, body_spatial_velocities : abstract
        The plant's ports of the same names.

    Output ports
    ------------
    spatial_forces : abstract
        For the plant's applied_spatial_force port.
    is_guided : (1,)
        1 while the arm is guided, else 0.
    cursor_interval : (1,)
        Time between two positions of the cursor from the page, s.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized; source of the masses.
    meshcat : Meshcat, optional
        Its page sends the pose of its camera (``?tracked_camera=on``).
    specific_stiffness : float
        Of the mouse spring, 1/s^2.
    config : DragConfig
    bodies : iterable of BodyIndex, optional
        Bodies that may be dragged; all where None.
    tip : Frame, optional
        The tool that is guided over the `board`.
    board : BoardSurface, optional
    R_WE : RotationMatrix, optional
        Orientation at rest of the tool that may be turned; needs a `tip`.
    eye : array_like, shape (3,)
        Position of the camera in W, where the page does not send it, m.

    Raises
    ------
    SystemsError
        Where the plant is not finalized, a number is out of range, or a tip has no board.

    Examples
    --------
    >>> from fmp_drake.station import AddRobot, LoadRobot
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> _ = AddRobot(plant, LoadRobot("panda"))
    >>> plant.Finalize()
    >>> hand = MouseHand(plant, specific_stiffness=100.0)
    >>> float(hand.GetOutputPort("is_guided").Eval(hand.CreateDefaultContext())[0])
    0.0
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        specific_stiffness: float,
        meshcat: Meshcat | None = None,
        config: DragConfig = PULLING_DRAG,
        bodies: Iterable[BodyIndex] | None = None,
        tip: Frame | None = None,
        board: BoardSurface | None = None,
        R_WE: RotationMatrix | None = None,
        eye: Any = (1.0, 0.0, 1.0),
    ) -> None:
        super().__init__()
        self.set_name("mouse_hand")
        if (tip is None) != (board is None):
            raise SystemsError(
                "give both a tip and a board to guide it on, or neither."
            )
        if R_WE is not None and tip is None:
            raise SystemsError("a tool that may be turned needs a tip.")
        if not plant.is_finalized():
            raise SystemsError("the plant is not finalized; call Finalize() first.")
        check_number(
            specific_stiffness, "specific_stiffness", above=0, error=SystemsError
        )
        check_settings(config, SystemsError)
        self._meshcat, self._config, self._board = meshcat, config, board
        self._specific = float(specific_stiffness)
        self._eye = np.array(eye, dtype=float)
        self._tip_body, self._p_LE = 0, np.zeros(3)
        self._R_WL: RotationMatrix | None = None
        if tip is not None:
            X_LE = tip.GetFixedPoseInBodyFrame()
            self._tip_body = int(tip.body().index())
            self._p_LE = np.array(X_LE.translation())
            if R_WE is not None:
                self._R_WL = R_WE @ X_LE.rotation().inverse()
                self.DeclareInitializationPublishEvent(self._show)
        # Bodies that must not be dragged have mass 0.
        self._masses = np.zeros(plant.num_bodies())
        for i in range(plant.num_bodies()) if bodies is None else map(int, bodies):
            self._masses[i] = plant.get_body(BodyIndex(i)).default_mass()
        self._spring = self.DeclareAbstractInputPort(
            "spring", Value[list[ExternallyAppliedSpatialForce]]()
        )
        self._poses, self._velocities = declare_bodies(self)
        state = self.DeclareDiscreteState(no_drag())
        self._state = int(state)
        ticket = self.discrete_state_ticket(state)
        prerequisites = {ticket, self._poses.ticket(), self._velocities.ticket()}
        declare_spatial_forces(self, self._calc_forces, prerequisites)
        for name, field in (("is_guided", "guiding"), ("cursor_interval", "interval")):
            calc = partial(self._calc_number, field)
            self.DeclareVectorOutputPort(name, 1, calc, {ticket})
        self.DeclarePeriodicDiscreteUpdateEvent(SAMPLE_PERIOD, 0.0, self._read)

    def _calc_number(self, field: str, context: Context, output: BasicVector) -> None:
        values: Any = context.get_discrete_state(self._state).value()
        output[0] = values.view(STATE)[0][field]

    def _point(
        self, context: Context, body: int, p_BoQ_B: Array
    ) -> tuple[Array, Array]:
        """Return position and velocity of a point of a body, in W."""
        poses: Any = self._poses.Eval(context)
        velocities: Any = self._velocities.Eval(context)
        p_BoQ_W = poses[body].rotation() @ p_BoQ_B
        v = velocities[body].Shift(p_BoQ_W).translational()
        return poses[body].translation() + p_BoQ_W, v

    def _show(self, _: Context) -> None:
        """Show the switch, initially off."""
        page = self._meshcat
        if page is None:
            return
        if TURN_SWITCH in page.GetSliderNames():
            page.SetSliderValue(TURN_SWITCH, 0.0)
        else:
            page.AddSlider(TURN_SWITCH, 0.0, 1.0, 1.0, 0.0)

    def _turns_tool(self) -> bool:
        """Return whether the switch is on; a page may send any number."""
        page = self._meshcat
        if page is None or self._R_WL is None:
            return False
        has_switch = TURN_SWITCH in page.GetSliderNames()
        return has_switch and page.GetSliderValue(TURN_SWITCH) > 0.5

    def _rotation(self, context: Context) -> Array | None:
        """Return the rotation vector of the tool from its orientation at rest, in W."""
        if self._R_WL is None:
            return None
        poses: Any = self._poses.Eval(context)
        R = poses[self._tip_body].rotation() @ self._R_WL.inverse()
        rotation = R.ToAngleAxis()
        return rotation.angle() * rotation.axis()

    def _guided(self, state: Any) -> tuple[int, Array]:
        """Return the body that the hand acts on, and the point p_BoQ_B."""
        if self._board is not None:
            return self._tip_body, self._p_LE
        return int(state["body"]), state["point"]

    def _drag(self, context: Context) -> Drag | None:
        springs: Any = self._spring.Eval(context)
        for spring in springs:
            body = int(spring.body_index)
            force = np.array(spring.F_Bq_W.translational())
            if not self._masses[body] > 0 or not np.all(np.isfinite(force)):
                continue
            point = np.array(spring.p_BoBq_B)
            anchor, velocity = self._point(context, body, point)
            cursor = cursor_of(
                force,
                anchor=anchor,
                velocity=velocity,
                mass=self._masses[body],
                stiffness=self._specific,
            )
            return Drag(body, point, anchor, cursor)
        return None

    def _read(self, context: Context, values: DiscreteValues) -> None:
        state: Any = context.get_discrete_state(self._state).value()
        drag = self._drag(context)
        if drag is None and is_idle(state):
            return
        s = state.view(STATE)[0]
        if self._board is None and not s["guiding"] and drag is not None:
            p_WQ = drag.anchor
        else:
            p_WQ, _ = self._point(context, *self._guided(s))
        page = self._meshcat
        camera = None if page is None else page.GetTrackedCameraPose()
        new = follow(
            state,
            drag,
            time=context.get_time(),
            period=SAMPLE_PERIOD,
            guided_point=p_WQ,
            eye=self._eye if camera is None else np.array(camera.translation()),
            config=self._config,
            board=self._board,
            rotation=self._rotation(context),
            turns_tool=self._turns_tool(),
        )
        values.set_value(self._state, new)

    def _calc_forces(self, context: Any, output: Any) -> None:
        config, board = self._config, self._board
        # Read plain numbers: fields of the record would take five times as long, each ms.
        numbers: Any = context.get_discrete_state(self._state).value()
        if not (numbers[GUIDING] or (config.holds and numbers[STARTED])):
            output.set_value([])
            return
        s = numbers.view(STATE)[0]
        body, point = self._guided(s)
        p_WQ, velocity = self._point(context, body, point)
        normal, height = None, 0.0
        if board is not None and board.is_solid:
            normal, height = board.normal(p_WQ), board.height(p_WQ)
        f_W = hand_force(
            s["set_point"] - p_WQ, velocity, config=config, normal=normal, height=height
        )
        tau_W = np.zeros(3)
        if self._R_WL is not None:
            poses: Any = self._poses.Eval(context)
            velocities: Any = self._velocities.Eval(context)
            R = Rotation.from_rotvec(s["rotation"]).as_matrix()
            R_WL = RotationMatrix(R) @ self._R_WL
            tau_W = hand_torque(
                R_WL @ poses[body].rotation().inverse(),
                velocities[body].rotational(),
                MOST_TORQUE,
            )
        output.set_value([spatial_force(body, point, tau_W, f_W)])
