"""Coordinates of a tool over a curved board, and the orientation along its normal."""

from typing import Any

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.numeric import Array
from fmp_drake.systems.surface import surface as surfaces
from fmp_drake.systems.surface.surface import Surface

# Step of the finite difference for the velocity of the coordinates, s.
_STEP = 1e-4


class SurfaceCoordinates(LeafSystem):
    """Coordinates of a guided tool over a curved board, and the orientation flat on it.

    Input ports
    -----------
    measured_pose : (7,)
        Quaternion (w, x, y, z) of R_BE, and p_BE in m.
    measured_velocity : (3,)
        v_BE, m/s.

    Output ports
    ------------
    coordinates : (3,)
        (u, v, h), m.
    orientation : (4,)
        Quaternion (w, x, y, z) of R_BE with the tool along the local normal.
    angular_velocity : (3,)
        Of that orientation in B, rad/s.

    Parameters
    ----------
    surface : Surface
        Curvature of the board.
    R_TE : RotationMatrix
        Orientation of the tool relative to the local normal.

    Examples
    --------
    >>> system = SurfaceCoordinates(Surface(kx=0.0, ky=2.0), RotationMatrix())
    >>> context = system.CreateDefaultContext()
    >>> _ = system.GetInputPort("measured_pose").FixValue(context, [1, 0, 0, 0, 0.1, 0.0, 0.02])
    >>> system.GetOutputPort("coordinates").Eval(context).round(3)
    array([0.1 , 0.  , 0.02])
    """

    def __init__(self, surface: Surface, R_TE: RotationMatrix) -> None:
        super().__init__()
        self.set_name("surface_coordinates")
        self._surface, self._R_TE = surface, R_TE
        self._pose = self.DeclareVectorInputPort("measured_pose", 7)
        self._velocity = self.DeclareVectorInputPort("measured_velocity", 3)
        pose, velocity = self._pose.ticket(), self._velocity.ticket()
        declare = self.DeclareVectorOutputPort
        declare("coordinates", 3, self._calc_coordinates, {pose})
        declare("orientation", 4, self._calc_orientation, {pose})
        declare("angular_velocity", 3, self._calc_angular_velocity, {pose, velocity})

    def _position(self, context: Context) -> Array:
        pose: Any = self._pose.Eval(context)
        return pose[4:].copy()

    def _uvh(self, context: Context) -> Array:
        p_BE = self._position(context)
        return surfaces.project(self._surface, p_BE, np.zeros(2))

    def _calc_coordinates(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._uvh(context))

    def _calc_orientation(self, context: Context, output: BasicVector) -> None:
        u, v, _ = self._uvh(context)
        R_BT = RotationMatrix(surfaces.rotation(self._surface, u, v))
        quaternion = (R_BT @ self._R_TE).ToQuaternion()
        output.SetFromVector(quaternion.wxyz())

    def _calc_angular_velocity(self, context: Context, output: BasicVector) -> None:
        v_BE: Any = self._velocity.Eval(context)
        p_BE, uvh = self._position(context), self._uvh(context)
        next_uvh = surfaces.project(self._surface, p_BE + _STEP * v_BE, uvh[:2])
        rate = (next_uvh[:2] - uvh[:2]) / _STEP
        _, _, V_BT, _ = surfaces.moving_frame(
            self._surface, uvh[:2].copy(), rate, np.zeros(2)
        )
        output.SetFromVector(V_BT[:3])
