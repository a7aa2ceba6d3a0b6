"""A system that wears the ink off a whiteboard where an eraser rubs it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import (
    ContactResults,
    HydroelasticContactInfo,
    MultibodyPlant,
)
from pydrake.multibody.tree import Frame, RigidBody
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
    ValueProducer,
)

from fmp_drake.errors import StationError
from fmp_drake.systems.ink.checks import (
    check_ink_options,
    check_touchable,
    checked_ink,
)
from fmp_drake.systems.ink.grid import (
    CLEAN_BELOW,
    WEAR_CONSTANT,
    InkGrid,
    cleaned_fraction,
)
from fmp_drake.systems.ink.patch import (
    PlanarMotion,
    join_patches,
    planar_motion,
    read_patch,
    rubbing,
)
from fmp_drake.systems.ink.sweep import Sweep

type FloatArray = NDArray[np.float64]

NEVER = math.inf
"""Erase time of a cell that has not been erased."""

# What the next update is: in the middle of a period or at its end.
_MIDDLE, _END = 0.0, 1.0
# Periods that are worn at once: a burst takes less time than one now and then.
_QUEUE = 5
# A row of the queue: how many vertices the patch has, when the period ended, in its
# middle the eraser's place (m) and x axis in B, and the velocities at its start, in
# its middle and at its end (m/s, m/s, rad/s). Then comes the patch.
_COUNT, _TIME, _P_BE, _X_B, _VELOCITIES = 0, 1, slice(2, 4), slice(4, 6), slice(6, 15)
_PATCH = 15
_PATCH_SIZE = 4 * 2048


class InkBoard(LeafSystem):
    """Ink on a whiteboard, worn off by the contact patches of an eraser.

    In the middle of every period the hydroelastic contact surfaces between eraser
    and board are read and projected on the board. At its end they are led along the
    eraser's way, from its velocities at the start, in the middle and at the end,
    and the ink under them is worn by pressure times path (see `wear`, `sweep`): for a
    few periods at once, or when an output is asked for.
    With 100 ms the ink is within 0.003 (root mean square) of that with 2 ms while a
    felt wipes at 0.4 m/s, apart from what the last 100 ms will wear.

    .. code-block:: none

        contact_results          -> InkBoard -> ink
        body_poses               ->          -> erase_time
        body_spatial_velocities  ->          -> fade_time
                                             -> cleaned_fraction
                                             -> normal_force
                                             -> contact_area

    Input ports (connect the plant's ports of the same names):

    - `contact_results`: abstract, `ContactResults`.
    - `body_poses`: abstract, list of `RigidTransform` X_WBody.
    - `body_spatial_velocities`: abstract, list of `SpatialVelocity` V_WBody.

    Output ports:

    - `ink`, size ny nx: fraction of the ink left in each cell.
    - `erase_time`, size ny nx: time in seconds at which the cell got clean, that
      is fell below 10 % of full ink; `inf` before that, and for cells that had no
      more from the start.
    - `fade_time`, size ny nx: time in seconds at which the cell fell below half
      of its initial ink, `inf` before that.
    - `cleaned_fraction`, size 1: fraction of the initially inked cells (those
      with 10 % or more) that are clean.
    - `normal_force`, size 1: force of the eraser on the board along -z of B in
      N; positive when it presses. Feedthrough.
    - `contact_area`, size 1: area of the contact patch in m^2. Feedthrough.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized plant that is registered with a SceneGraph.
    eraser : RigidBody
        The body that wipes; its patch counts whichever side of a contact it is.
    surface : Frame
        B, fixed to the board's body: origin at the centre of the wiping surface,
        z outward.
    grid : InkGrid
        Division of the surface into cells.
    initial_ink : array_like, shape (ny, nx), optional
        Ink at the start, from 0 to 1; by default 1 all over.
    wear_constant : float
        Wear constant in Pa m.
    worn : float
        Share of the felt that does not rub any more, from 0 to 1: it is worn in
        stripes, see `worn_felt`.
    period : float
        In seconds: the ink changes once in it.

    Raises
    ------
    StationError
        If the ink does not fit the grid, a number is out of range, or a body has
        no collision geometry.
    """

    def __init__(
        self,
        *,
        plant: MultibodyPlant,
        eraser: RigidBody,
        surface: Frame,
        grid: InkGrid,
        initial_ink: ArrayLike | None = None,
        wear_constant: float = WEAR_CONSTANT,
        worn: float = 0.0,
        period: float = 0.1,
    ) -> None:
        """Declare ports, state and the periodic update."""
        super().__init__()
        self.set_name("ink_board")
        check_ink_options(wear_constant=wear_constant, worn=worn, period=period)
        board = surface.body()
        check_touchable(plant, eraser, board)
        ink = checked_ink(initial_ink, grid)
        self._eraser_ids = frozenset(plant.GetCollisionGeometriesForBody(eraser))
        self._board_ids = frozenset(plant.GetCollisionGeometriesForBody(board))
        self._eraser_index = int(eraser.index())
        self._board_index = int(board.index())
        self._X_BoardB = surface.GetFixedPoseInBodyFrame()
        self._z_Board = self._X_BoardB.rotation().col(2)
        self._grid = grid
        self._initial_ink = ink
        self._inked = ink >= CLEAN_BELOW
        self._half = 0.5 * ink
        self._wear_constant = wear_constant
        self._worn = float(worn)
        self._period = period

        self._contact_results = self.DeclareAbstractInputPort(
            "contact_results", AbstractValue.Make(ContactResults())
        )
        self._poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        )
        never = np.full(grid.num_cells, NEVER)
        self._cells = [
            int(self.DeclareDiscreteState(value))
            for value in (ink.ravel(), never, never)
        ]
        # What the next update is, and how many periods are in the queue.
        self._progress = int(self.DeclareDiscreteState(np.array([_END, 0.0])))
        self._queue = int(self.DeclareDiscreteState(_QUEUE * (_PATCH + _PATCH_SIZE)))
        self._board = self.DeclareCacheEntry(
            description="ink, erase time and fade time with the queue worn",
            value_producer=ValueProducer(allocate=Value[object], calc=self._calc_board),
            prerequisites_of_calc={self.xd_ticket()},
        )
        for i, name in enumerate(("ink", "erase_time", "fade_time")):
            self.DeclareVectorOutputPort(
                name, grid.num_cells, self._calc_layer(i), {self._board.ticket()}
            )
        self.DeclareVectorOutputPort(
            "cleaned_fraction",
            1,
            self._calc_cleaned_fraction,
            {self._board.ticket()},
        )
        contact = {self._contact_results.ticket()}
        self.DeclareVectorOutputPort(
            "normal_force",
            1,
            self._calc_normal_force,
            contact | {self._poses.ticket()},
        )
        self.DeclareVectorOutputPort(
            "contact_area", 1, self._calc_contact_area, contact
        )
        self.DeclarePeriodicDiscreteUpdateEvent(0.5 * period, 0.0, self._update)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        *,
        plant: MultibodyPlant,
        eraser: RigidBody,
        surface: Frame,
        grid: InkGrid,
        initial_ink: ArrayLike | None = None,
        wear_constant: float = WEAR_CONSTANT,
        worn: float = 0.0,
        period: float = 0.1,
    ) -> InkBoard:
        """Add an `InkBoard` to a builder and connect it to the plant.

        Takes the builder and the constructor's parameters.
        """
        board = InkBoard(
            plant=plant,
            eraser=eraser,
            surface=surface,
            grid=grid,
            initial_ink=initial_ink,
            wear_constant=wear_constant,
            worn=worn,
            period=period,
        )
        builder.AddSystem(board)
        for name in ("contact_results", "body_poses", "body_spatial_velocities"):
            builder.Connect(plant.GetOutputPort(name), board.GetInputPort(name))
        return board

    @property
    def grid(self) -> InkGrid:
        """The division of the surface into cells."""
        return self._grid

    @property
    def initial_ink(self) -> FloatArray:
        """Ink at the start, shape (ny, nx); read-only."""
        return self._initial_ink

    def _contacts(
        self, context: Context
    ) -> list[tuple[HydroelasticContactInfo, ContactSurface, float]]:
        """List the contacts of eraser and board.

        With each comes 1 where the eraser is the surface's body M, -1 where it is N.
        """
        results = cast(ContactResults, self._contact_results.Eval(context))
        found = []
        for i in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(i)
            surface = info.contact_surface()
            m, n = surface.id_M(), surface.id_N()
            if m in self._eraser_ids and n in self._board_ids:
                found.append((info, surface, 1.0))
            elif n in self._eraser_ids and m in self._board_ids:
                found.append((info, surface, -1.0))
        return found

    def _calc_cleaned_fraction(self, context: Context, output: BasicVector) -> None:
        layers = cast("list[FloatArray]", self._board.Eval(context))
        output.SetAtIndex(0, cleaned_fraction(layers[0], self._inked))

    def _calc_normal_force(self, context: Context, output: BasicVector) -> None:
        force = 0.0
        contacts = self._contacts(context)
        if contacts:
            poses = cast("list[RigidTransform]", self._poses.Eval(context))
            z_W = poses[self._board_index].rotation().matrix().dot(self._z_Board)
            for info, _, sign in contacts:
                # F_Ac acts on M's body, here turned into the force on the eraser.
                force += sign * float(info.F_Ac_W().translational().dot(z_W))
        output.SetAtIndex(0, force)

    def _calc_contact_area(self, context: Context, output: BasicVector) -> None:
        contacts = self._contacts(context)
        output.SetAtIndex(0, sum(surface.total_area() for _, surface, _ in contacts))

    def _update(self, context: Context, values: DiscreteValues) -> None:
        """Read the patch in the middle of a period, rub at its end."""
        poses = cast("list[RigidTransform]", self._poses.Eval(context))
        velocities = cast("list[SpatialVelocity]", self._velocities.Eval(context))
        motion = planar_motion(
            X_WB=poses[self._board_index].multiply(self._X_BoardB),
            X_WBoard=poses[self._board_index],
            X_WE=poses[self._eraser_index],
            V_WBoard=velocities[self._board_index],
            V_WE=velocities[self._eraser_index],
        )
        progress = values.get_mutable_value(self._progress)
        queue = self._rows(values.get_mutable_value(self._queue))
        row = queue[int(progress[1])]
        middle = progress[0] == _MIDDLE
        progress[0] = _END if middle else _MIDDLE
        velocity = row[_VELOCITIES].reshape(3, 3)
        if middle:
            velocity[1] = motion.velocity
            row[_P_BE], row[_X_B] = motion.p_BE, motion.x_B
            self._read_patch(context, row, motion)
            return
        velocity[2], row[_TIME] = motion.velocity, context.get_time()
        if row[_COUNT]:
            progress[1] += 1.0
        if progress[1] == _QUEUE:
            self._wear(queue, [values.get_mutable_value(i) for i in self._cells])
            progress[1] = 0.0
        row = queue[int(progress[1])]
        row[_VELOCITIES][:3] = motion.velocity
        row[_COUNT] = 0.0

    @staticmethod
    def _rows(queue: FloatArray) -> FloatArray:
        return queue.reshape(_QUEUE, -1)

    def _read_patch(
        self, context: Context, row: FloatArray, motion: PlanarMotion
    ) -> None:
        """Remember the patch between eraser and board."""
        contacts = self._contacts(context)
        if not contacts:
            return
        patch = join_patches([read_patch(part, motion) for _, part, _ in contacts])
        if patch.size > _PATCH_SIZE:
            raise StationError(
                f"The patch of eraser and board has {patch.shape[1]} vertices, but the "
                f"ink board takes {_PATCH_SIZE // 4}: give the eraser a coarser mesh "
                "(a larger hydroelastic resolution hint)."
            )
        row[_PATCH : _PATCH + patch.size] = patch.ravel()
        row[_COUNT] = patch.shape[1]

    def _calc_board(self, context: Any, value: Any) -> None:
        """Wear what is in the queue from copies of the cells."""
        state = context.get_discrete_state()
        layers = [state.value(index).copy() for index in self._cells]
        _, count = state.value(self._progress).tolist()
        self._wear(self._rows(state.value(self._queue))[: int(count)], layers)
        value.set_value(layers)

    def _calc_layer(self, index: int) -> Callable[[Context, BasicVector], None]:
        def calc(context: Context, output: BasicVector) -> None:
            layers = cast("list[FloatArray]", self._board.Eval(context))
            output.SetFromVector(layers[index])

        return calc

    def _wear(self, rows: FloatArray, layers: list[FloatArray]) -> None:
        """Wear the ink of some periods; the layers are changed."""
        for row in rows:
            patch = row[_PATCH : _PATCH + 4 * int(row[_COUNT])].reshape(4, -1)
            rubbed = rubbing(
                self._grid,
                patch,
                p_BE=row[_P_BE],
                x_B=row[_X_B],
                velocities=row[_VELOCITIES].reshape(3, 3),
                period=self._period,
                worn=self._worn,
            )
            self._rub(rubbed, float(row[_TIME]), layers)

    def _rub(self, rubbed: Sweep, now: float, layers: list[FloatArray]) -> None:
        """Wear the ink of the cells that were rubbed."""
        rows, columns, exposure = rubbed
        ink, erase_time, fade_time = (
            layer.reshape(self._grid.shape)[rows, columns] for layer in layers
        )
        half = self._half[rows, columns]
        was_inked, was_strong = ink >= CLEAN_BELOW, ink >= half
        ink *= np.exp(exposure * (-1.0 / self._wear_constant))
        erase_time[was_inked & (ink < CLEAN_BELOW)] = now
        fade_time[was_strong & (ink < half)] = now
