"""Ink on a whiteboard, removed where an eraser rubs it."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    LeafSystem,
)

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import Array, as_floats, check_number, check_type, read_only
from fmp_drake.systems.ink.grid import CLEAN_BELOW, InkGrid, cleaned_fraction
from fmp_drake.systems.ink.rubbing import (
    Cells,
    Patch,
    PlanarMotion,
    compile_rubbing,
    exposure,
    planar_motion,
    read_patch,
    rectangle,
    wear,
)
from fmp_drake.systems.interface.callbacks import (
    check_frame,
    collision_ids,
    contact_surfaces,
    declare_bodies,
)
from fmp_drake.systems.surface.surface import project, rotation

# A frame F fixed to a body: index of the body, and X_BodyF.
type _BodyFrame = tuple[int, RigidTransform]


class InkBoard(LeafSystem):
    """Ink on a whiteboard, worn off by the contact patches of an eraser.

    At the end of every period the hydroelastic contact surfaces between eraser and
    board are projected on the board and moved along the eraser's path since the last
    update. The ink under them is worn by pressure times path, see `exposure` and `wear`.
    With 50 ms the ink of a board of 0.4 m x 0.3 m differs from that with 2 ms by 0.003
    (root mean square) after a wipe at 0.4 m/s. It differs by 0.02 after a stroke that
    includes landing or lifting.

    .. code-block:: none

        contact_results          -> InkBoard -> ink
        body_poses               ->          -> cleaned_fraction
        body_spatial_velocities  ->          -> normal_force
                                             -> contact_area

    Both bodies need hydroelastic properties, and one of them must be compliant. Drake
    computes point contact otherwise, which wears no ink and is not in the outputs.

    Input ports (connect the plant's ports of the same names):

    - `contact_results`: abstract, `ContactResults`.
    - `body_poses`: abstract, list of `RigidTransform` X_WBody.
    - `body_spatial_velocities`: abstract, list of `SpatialVelocity` V_WBody.

    Output ports:

    - `ink`, size ny nx: fraction of the ink left in each cell; discrete state.
    - `cleaned_fraction`, size 1: fraction of the initially inked cells (those
      with 10 % or more) that are clean.
    - `normal_force`, size 1: force of the eraser against the board's normal (z of B; on a
      curved board the local one at E), in N; positive when it presses. Feedthrough.
    - `contact_area`, size 1: area of the contact patch in m^2. Feedthrough.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized plant that is registered with a SceneGraph.
    eraser : Frame
        E, fixed to the body that wipes, with its origin at the wiping face and x along
        its length. The body may be on either side of a contact.
    surface : Frame
        B, fixed to the board's body: origin at the centre of the wiping surface,
        z outward.
    grid : InkGrid
        Division of the surface into cells.
    initial_ink : array_like, shape (ny, nx), optional
        Ink at the start, from 0 to 1; by default 1 all over.
    worn : float
        Worn fraction of the felt, from 0 to 1, in stripes; see `exposure`.
    period : float
        Time between two updates of the ink, s.

    Raises
    ------
    SystemsError
        If the ink does not fit the grid, a number is out of range, the frames are on one
        body, or a body has no collision geometry.

    Examples
    --------
    >>> from pydrake.geometry import (
    ...     AddCompliantHydroelasticProperties,
    ...     AddContactMaterial,
    ...     AddRigidHydroelasticProperties,
    ...     Box,
    ...     ProximityProperties,
    ... )
    >>> from pydrake.multibody.plant import (
    ...     AddMultibodyPlantSceneGraph,
    ...     CoulombFriction,
    ... )
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> builder = DiagramBuilder()
    >>> plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    >>> board, eraser = (plant.AddRigidBody(name) for name in ("board", "eraser"))
    >>> hard, soft = ProximityProperties(), ProximityProperties()
    >>> AddRigidHydroelasticProperties(0.05, hard)
    >>> AddCompliantHydroelasticProperties(0.05, 1e6, soft)
    >>> for body, size, properties in ((board, 0.7, hard), (eraser, 0.1, soft)):
    ...     AddContactMaterial(friction=CoulombFriction(1.0, 1.0), properties=properties)
    ...     shape = Box(size, size, 0.02)
    ...     _ = plant.RegisterCollisionGeometry(
    ...         body, RigidTransform(), shape, "box", properties
    ...     )
    >>> plant.Finalize()
    >>> ink = builder.AddSystem(
    ...     InkBoard(
    ...         plant=plant,
    ...         eraser=eraser.body_frame(),
    ...         surface=board.body_frame(),
    ...         grid=InkGrid(size=(0.7, 0.7)),
    ...     )
    ... )
    >>> for name in ("contact_results", "body_poses", "body_spatial_velocities"):
    ...     builder.Connect(plant.GetOutputPort(name), ink.GetInputPort(name))
    >>> ink.GetOutputPort("ink").size()
    19600
    """

    def __init__(
        self,
        *,
        plant: MultibodyPlant,
        eraser: Frame,
        surface: Frame,
        grid: InkGrid,
        initial_ink: ArrayLike | None = None,
        worn: float = 0.0,
        period: float = 0.05,
    ) -> None:
        """Declare ports, state and the periodic update."""
        super().__init__()
        self.set_name("ink_board")
        check_number(worn, "worn", least=0, most=1, error=SystemsError)
        check_number(period, "period", above=0, unit="s", error=SystemsError)
        for what, frame in (("eraser", eraser), ("surface", surface)):
            check_frame(frame, what, plant, error=SystemsError)
        if eraser.body().index() == surface.body().index():
            raise SystemsError(
                f"eraser {eraser.name()} and surface {surface.name()} are both on the body "
                f"'{surface.body().name()}', which cannot rub itself; give frames of two "
                "bodies."
            )
        check_type(grid, "grid", InkGrid, error=SystemsError)
        self._eraser, self._surface = (
            (int(frame.body().index()), frame.GetFixedPoseInBodyFrame())
            for frame in (eraser, surface)
        )
        self._eraser_ids = collision_ids(plant, eraser.body())
        self._board_ids = collision_ids(plant, surface.body())
        self._grid, self._curvature = grid, grid.curvature
        self._cells = Cells.of(grid)
        self._initial_ink = _checked_ink(initial_ink, grid)
        self._worn = float(worn)
        self._period = period

        self._contact_results = self.DeclareAbstractInputPort(
            "contact_results", AbstractValue.Make(ContactResults())
        )
        self._poses, self._velocities = declare_bodies(self)
        ink = self.DeclareDiscreteState(self._initial_ink.ravel())
        self._ink = int(ink)
        self.DeclareStateOutputPort("ink", ink)
        # The eraser at the last update.
        motion = PlanarMotion(-math.inf, *[0.0] * (len(PlanarMotion._fields) - 1))
        self._motion = int(self.DeclareDiscreteState(np.array(motion)))
        self._outline = int(self.DeclareDiscreteState(6))
        contact = {self._contact_results.ticket()}
        pressed = contact | {self._poses.ticket()}
        declare = self.DeclareVectorOutputPort
        declare("cleaned_fraction", 1, self._calc_cleaned_fraction, {self.xd_ticket()})
        declare("normal_force", 1, self._calc_normal_force, pressed)
        declare("contact_area", 1, self._calc_contact_area, contact)
        compile_rubbing(self._cells)
        self.DeclareInitializationDiscreteUpdateEvent(self._begin)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._update)

    @property
    def grid(self) -> InkGrid:
        """The division of the surface into cells."""
        return self._grid

    @property
    def initial_ink(self) -> Array:
        """Ink at the start, shape (ny, nx); read-only."""
        return self._initial_ink

    def _contacts(self, context: Context) -> list[tuple[ContactSurface, Array]]:
        """List the surfaces between eraser and board, with the force on the eraser."""
        results: Any = self._contact_results.Eval(context)
        contacts = contact_surfaces(results, self._eraser_ids)
        return [(s, force) for s, force, other in contacts if other in self._board_ids]

    def _pose(self, context: Context, frame: _BodyFrame) -> RigidTransform:
        """Return X_WF."""
        poses: Any = self._poses.Eval(context)
        body, X_BodyF = frame
        return poses[body] @ X_BodyF

    def _velocity(self, context: Context, frame: _BodyFrame) -> SpatialVelocity:
        """Return V_WF."""
        poses: Any = self._poses.Eval(context)
        velocities: Any = self._velocities.Eval(context)
        body, X_BodyF = frame
        return velocities[body].Shift(poses[body].rotation() @ X_BodyF.translation())

    def _calc_normal_force(self, context: Context, output: BasicVector) -> None:
        contacts = self._contacts(context)
        if not contacts:
            output.SetAtIndex(0, 0.0)
            return
        X_WB = self._pose(context, self._surface)
        z_W = X_WB.rotation().col(2)
        if not self._curvature.is_plane:
            p_WE: Any = self._pose(context, self._eraser).translation()
            p_BE = X_WB.inverse() @ p_WE
            u, v, _ = project(self._curvature, p_BE, np.zeros(2))
            z_W = X_WB.rotation().matrix() @ rotation(self._curvature, u, v)[:, 2]
        output.SetAtIndex(0, sum(float(force.dot(z_W)) for _, force in contacts))

    def _calc_cleaned_fraction(self, context: Context, output: BasicVector) -> None:
        ink = context.get_discrete_state(self._ink).value()
        inked = self._initial_ink >= CLEAN_BELOW
        output.SetAtIndex(0, cleaned_fraction(ink, inked))

    def _calc_contact_area(self, context: Context, output: BasicVector) -> None:
        contacts = self._contacts(context)
        output.SetAtIndex(0, sum(surface.total_area() for surface, _ in contacts))

    def _planar_motion(self, context: Context, near: Array) -> PlanarMotion:
        return planar_motion(
            time=context.get_time(),
            X_WB=self._pose(context, self._surface),
            V_WB=self._velocity(context, self._surface),
            X_WE=self._pose(context, self._eraser),
            V_WE=self._velocity(context, self._eraser),
            curvature=self._curvature,
            near=near,
        )

    def _begin(self, context: Context, values: DiscreteValues) -> None:
        """Begin the first period, unless the run is continued."""
        motion = values.get_mutable_value(self._motion)
        if not 0.0 <= context.get_time() - motion[0] < 1.5 * self._period:
            motion[:] = self._planar_motion(context, np.zeros(2))

    def _update(self, context: Context, values: DiscreteValues) -> None:
        """Wear the ink along the path since the last update."""
        motion = values.get_mutable_value(self._motion)
        before = PlanarMotion(*motion)
        now = self._planar_motion(context, motion[1:3].copy())
        motion[:] = now
        patch = rectangle(values.get_value(self._outline))
        outline = np.zeros(6)
        if surfaces := [surface for surface, _ in self._contacts(context)]:
            X_WB = self._pose(context, self._surface)
            new, outline = read_patch(surfaces, X_WB, now, self._curvature)
            # While the eraser is lifted, the previous patch is the better one.
            if not patch.depth > max(2.0 * new.depth, 0.0):
                patch = new
        values.set_value(self._outline, outline)
        if before.time >= now.time or not patch.vertices.any():
            return
        rubbing = sum(
            exposure(self._cells, patch, *interval, self._worn)
            for interval in self._turns(before, now, patch)
        )
        ink = values.get_mutable_value(self._ink)
        wear(ink, np.ravel(rubbing))

    def _turns(
        self, before: PlanarMotion, now: PlanarMotion, patch: Patch
    ) -> list[tuple[PlanarMotion, PlanarMotion]]:
        """Return the motion on each turn around a wound board that reaches its cells."""
        motions = [(before, now)]
        for axis, name in enumerate(("x", "y")):
            if not self._grid.is_wound(axis):
                continue
            length = self._curvature.circumference[axis]
            reach = self._grid.size[axis] / 2 + float(
                np.max(np.abs(patch.vertices[:, :2]))
            )
            start, end = getattr(before, name), getattr(now, name)
            low = math.ceil((-reach - max(start, end)) / length)
            high = math.floor((reach - min(start, end)) / length)
            motions = [
                (
                    first._replace(**{name: getattr(first, name) + k * length}),
                    last._replace(**{name: getattr(last, name) + k * length}),
                )
                for first, last in motions
                for k in range(low, high + 1)
            ]
        return motions


def _checked_ink(initial_ink: ArrayLike | None, grid: InkGrid) -> Array:
    """Return a read-only copy of the ink at the start, shape (ny, nx)."""
    given = grid.full() if initial_ink is None else initial_ink
    ink = as_floats(given, "initial_ink", grid.shape, error=SystemsError).copy()
    if not bool(np.all((ink >= 0.0) & (ink <= 1.0))):
        raise SystemsError(
            f"InkBoard initial_ink goes from {ink.min()} to {ink.max()}: give "
            "fractions from 0 to 1."
        )
    return read_only(ink)
