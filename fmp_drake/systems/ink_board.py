"""A system that wears the ink off a whiteboard where an eraser rubs it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import ContactSurface
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import ContactResults, MultibodyPlant
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
from fmp_drake.systems.ink_grid import (
    CLEAN_BELOW,
    WEAR_CONSTANT,
    InkGrid,
    cleaned_fraction,
    wear,
)

type FloatArray = NDArray[np.float64]

NEVER = math.inf
"""Erase time of a cell that has not been erased."""

_ERASED_BELOW = 0.5


@dataclass(frozen=True)
class _Contacts:
    """The contacts between eraser and board at one time.

    `indices` count hydroelastic contacts (a cached reference to a surface would
    outlive it), `normal_force` is in N, `area` in m^2.
    """

    indices: tuple[int, ...] = ()
    normal_force: float = 0.0
    area: float = 0.0


class InkBoard(LeafSystem):
    """Ink on a whiteboard, worn off by the contact patches of an eraser.

    Every period the hydroelastic contact surfaces between eraser and board are
    projected on the board and the ink under them is worn by pressure times
    sliding speed (see `wear`), exactly for a patch that keeps its pressure and
    velocity over the period. The patch is taken half a period back along its
    velocity, so what is left is the resolution in time: a patch that moves far
    in a period comes down on the board in steps of that length.

    .. code-block:: none

        contact_results          -> InkBoard -> ink
        body_poses               ->          -> erase_time
        body_spatial_velocities  ->          -> cleaned_fraction
                                             -> normal_force
                                             -> contact_area

    Input ports (connect the plant's ports of the same names):

    - `contact_results`: abstract, `ContactResults`.
    - `body_poses`: abstract, list of `RigidTransform` X_WBody.
    - `body_spatial_velocities`: abstract, list of `SpatialVelocity` V_WBody.

    Output ports:

    - `ink`, size ny nx: fraction of the ink left in each cell (state).
    - `erase_time`, size ny nx: time in seconds at which the cell fell below
      50 % of its initial ink, `inf` before that (state).
    - `cleaned_fraction`, size 1: fraction of the initially inked cells (those
      with more than 10 %) that have less than 10 % left.
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
    period : float
        Update period in seconds.

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
        period: float = 0.01,
    ) -> None:
        """Declare ports, state and the periodic update."""
        super().__init__()
        self.set_name("ink_board")
        for name, value in (("wear_constant", wear_constant), ("period", period)):
            if not (np.isfinite(value) and value > 0.0):
                raise StationError(
                    f"InkBoard {name} is {value}: give a positive number."
                )
        ink = grid.full() if initial_ink is None else np.array(initial_ink, dtype=float)
        if ink.shape != grid.shape:
            raise StationError(
                f"InkBoard initial_ink has shape {ink.shape}, but the grid has "
                f"{grid.shape} (ny, nx) cells."
            )
        if not bool(np.all((ink >= 0.0) & (ink <= 1.0))):
            raise StationError(
                f"InkBoard initial_ink goes from {ink.min()} to {ink.max()}: give "
                "fractions from 0 to 1."
            )
        ink.setflags(write=False)

        board = surface.body()
        for body in (eraser, board):
            if not plant.GetCollisionGeometriesForBody(body):
                raise StationError(
                    f"The body '{body.name()}' has no collision geometry, so the "
                    "eraser and the board can never touch: add hydroelastic "
                    "collision geometries to both, and register the plant with a "
                    "SceneGraph first."
                )
        self._eraser_ids = frozenset(plant.GetCollisionGeometriesForBody(eraser))
        self._board_ids = frozenset(plant.GetCollisionGeometriesForBody(board))
        self._eraser_index = int(eraser.index())
        self._board_index = int(board.index())
        self._X_BoardB = surface.GetFixedPoseInBodyFrame()
        self._grid = grid
        self._initial_ink = ink
        self._wear_constant = wear_constant
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
        ink_state = self.DeclareDiscreteState(ink.ravel())
        erase_time_state = self.DeclareDiscreteState(np.full(grid.num_cells, NEVER))
        self._ink_index = int(ink_state)
        self._erase_time_index = int(erase_time_state)
        self._contacts = self.DeclareCacheEntry(
            "contacts between eraser and board",
            ValueProducer(
                allocate=Value[object],
                calc=cast(Callable[[object, object], None], self._calc_contacts),
            ),
            {
                self.input_port_ticket(self._contact_results.get_index()),
                self.input_port_ticket(self._poses.get_index()),
            },
        )
        self.DeclareStateOutputPort("ink", ink_state)
        self.DeclareStateOutputPort("erase_time", erase_time_state)
        self.DeclareVectorOutputPort(
            "cleaned_fraction",
            1,
            self._calc_cleaned_fraction,
            {self.discrete_state_ticket(ink_state)},
        )
        self.DeclareVectorOutputPort(
            "normal_force", 1, self._calc_normal_force, {self._contacts.ticket()}
        )
        self.DeclareVectorOutputPort(
            "contact_area", 1, self._calc_contact_area, {self._contacts.ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._update)

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
        period: float = 0.01,
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

    def _X_WB(self, context: Context) -> RigidTransform:
        poses = cast(list[RigidTransform], self._poses.Eval(context))
        X_WB: RigidTransform = poses[self._board_index].multiply(self._X_BoardB)
        return X_WB

    def _calc_contacts(self, context: Context, output: AbstractValue) -> None:
        results = cast(ContactResults, self._contact_results.Eval(context))
        z_W = self._X_WB(context).rotation().col(2)
        indices = []
        normal_force = area = 0.0
        for i in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(i)
            surface = info.contact_surface()
            m, n = surface.id_M(), surface.id_N()
            if m in self._eraser_ids and n in self._board_ids:
                sign = 1.0
            elif n in self._eraser_ids and m in self._board_ids:
                sign = -1.0
            else:
                continue
            # F_Ac acts on M's body, here turned into the force on the eraser.
            normal_force += sign * float(z_W @ info.F_Ac_W().translational())
            area += surface.total_area()
            indices.append(i)
        output.set_value(_Contacts(tuple(indices), normal_force, area))

    def _eval_contacts(self, context: Context) -> _Contacts:
        return cast(_Contacts, self._contacts.Eval(context))

    def _calc_cleaned_fraction(self, context: Context, output: BasicVector) -> None:
        ink = context.get_discrete_state(self._ink_index).value()
        inked = self._initial_ink > CLEAN_BELOW
        output.SetAtIndex(0, cleaned_fraction(ink, inked))

    def _calc_normal_force(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._eval_contacts(context).normal_force)

    def _calc_contact_area(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._eval_contacts(context).area)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        contacts = self._eval_contacts(context)
        if not contacts.indices:
            return
        results = cast(ContactResults, self._contact_results.Eval(context))
        ink = values.get_mutable_value(self._ink_index)
        erase_time = values.get_mutable_value(self._erase_time_index)
        for i in contacts.indices:
            surface = results.hydroelastic_contact_info(i).contact_surface()
            cells, exposure = self._exposure(context, surface)
            if not len(cells):
                continue
            before = ink[cells]
            after = wear(before, exposure, constant=self._wear_constant)
            ink[cells] = after
            half = _ERASED_BELOW * self._initial_ink.ravel()[cells]
            erased = cells[(before >= half) & (after < half)]
            erase_time[erased] = context.get_time()

    def _exposure(
        self, context: Context, surface: ContactSurface
    ) -> tuple[NDArray[np.intp], FloatArray]:
        """Cells under a patch and pressure times path over one period (Pa m)."""
        X_WB = self._X_WB(context)
        R_BW = X_WB.rotation().matrix().T
        poses = cast(list[RigidTransform], self._poses.Eval(context))
        velocities = cast(list[SpatialVelocity], self._velocities.Eval(context))
        p_WE = poses[self._eraser_index].translation()
        V_WE = velocities[self._eraser_index]
        p_WBoard = poses[self._board_index].translation()
        V_WBoard = velocities[self._board_index]
        # Velocity in B of the eraser's points: v_E + w x (p - p_E) in the plane.
        w_W = V_WE.rotational() - V_WBoard.rotational()
        v_W = (
            V_WE.translational()
            - V_WBoard.translational()
            - np.cross(V_WBoard.rotational(), p_WE - p_WBoard)
        )
        w_B, v_B = R_BW @ w_W, R_BW @ v_W
        p_BE = R_BW @ (p_WE - X_WB.translation())
        # In the plane z = 0: v(p) = v_0 + w_z (-y, x).
        v_0 = np.array(
            [
                v_B[0] - w_B[1] * p_BE[2] + w_B[2] * p_BE[1],
                v_B[1] + w_B[0] * p_BE[2] - w_B[2] * p_BE[0],
            ]
        )
        p_WV, pressure, polygons = _patch(surface)
        p_BV = ((p_WV - X_WB.translation()) @ R_BW.T)[:, :2]
        p_BV -= 0.5 * self._period * _velocity(p_BV, v_0, w_B[2])
        cells, cell_pressure = self._grid.rasterise(p_BV, pressure, polygons)
        v = _velocity(self._grid.centres[cells], v_0, w_B[2])
        return cells, cell_pressure * np.hypot(v[:, 0], v[:, 1]) * self._period


def _velocity(p_B: FloatArray, v_0: FloatArray, w_z: float) -> FloatArray:
    """Velocity in B (m/s) of the eraser's points at p_B (metres), both (n, 2)."""
    return v_0 + w_z * np.column_stack([-p_B[:, 1], p_B[:, 0]])


def _patch(surface: ContactSurface) -> tuple[FloatArray, FloatArray, list[int]]:
    """Vertices in W (metres), their pressures (Pa) and the counted polygons."""
    if surface.is_triangle():
        triangles = surface.tri_mesh_W()
        field = surface.tri_e_MN()
        count = triangles.num_vertices()
        p_WV = np.array([triangles.vertex(i) for i in range(count)])
        faces: list[int] = []
        for triangle in triangles.triangles():
            faces += [3, *(triangle.vertex(i) for i in range(3))]
        return p_WV, np.array([field.EvaluateAtVertex(i) for i in range(count)]), faces
    mesh = surface.poly_mesh_W()
    pressure = surface.poly_e_MN()
    count = mesh.num_vertices()
    return (
        np.array([mesh.vertex(i) for i in range(count)]),
        np.array([pressure.EvaluateAtVertex(i) for i in range(count)]),
        mesh.face_data(),
    )
