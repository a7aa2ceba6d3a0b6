"""A model of a person who guides the arm by hand."""

from dataclasses import dataclass
from typing import Any

from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from fmp_drake.errors import SystemsError
from fmp_drake.numeric import check_number
from fmp_drake.systems.framework.callbacks import weakly
from fmp_drake.systems.teaching.hand_motion import HandMotion


@dataclass(kw_only=True)
class GripConfig:
    """How the hand holds the tool.

    Attributes
    ----------
    stiffness : float
        Of the hand in the plane of the board, N/m.
    damping : float
        Of the hand in every direction, Ns/m.
    normal_force : float
        Force on the board, N.
    rotational_stiffness : float
        Nm/rad.
    rotational_damping : float
        Nms/rad.

    Examples
    --------
    >>> firm = GripConfig(stiffness=3000.0, damping=200.0)
    >>> firm.rotational_stiffness
    60.0
    """

    stiffness: float = 1500.0
    damping: float = 120.0
    normal_force: float = 9.0
    rotational_stiffness: float = 60.0
    rotational_damping: float = 6.0


class HumanHand(LeafSystem):
    """Guides a tool over a board: a spring to a wandering target, and a normal force.

    Input ports
    -----------
    body_poses, body_spatial_velocities : abstract
        The plant's ports of the same names.

    Output ports
    ------------
    spatial_forces : abstract
        For the plant's applied_spatial_force port: the hand's wrench at the grip.
    position : (3,)
        p_BE, the grip in the frame of the board, m.

    Parameters
    ----------
    plant : MultibodyPlant
        Finalized.
    grip : Frame
        E, the frame that the hand holds.
    X_WB : RigidTransform
        The board, z out of it.
    motion : HandMotion
        Where the hand wants to be in the plane of the board.
    R_BE : RotationMatrix
        How the hand holds the tool.
    config : GripConfig, optional

    Examples
    --------
    >>> from pydrake.systems.framework import DiagramBuilder
    >>> plant = MultibodyPlant(time_step=0.001)
    >>> tool = plant.AddRigidBody("tool")
    >>> plant.Finalize()
    >>> builder = DiagramBuilder()
    >>> _ = builder.AddSystem(plant)
    >>> hand = HumanHand(
    ...     plant,
    ...     grip=tool.body_frame(),
    ...     X_WB=RigidTransform([0.5, 0.0, 0.0]),
    ...     motion=HandMotion.make("wiping", seconds=5.0, seed=0),
    ...     R_BE=RotationMatrix(),
    ... )
    >>> _ = builder.AddSystem(hand)
    >>> for name in ("body_poses", "body_spatial_velocities"):
    ...     builder.Connect(plant.GetOutputPort(name), hand.GetInputPort(name))
    >>> builder.Connect(
    ...     hand.GetOutputPort("spatial_forces"),
    ...     plant.GetInputPort("applied_spatial_force"),
    ... )
    >>> diagram = builder.Build()
    >>> context = diagram.CreateDefaultContext()
    >>> hand.GetOutputPort("position").Eval(hand.GetMyContextFromRoot(context))
    array([-0.5,  0. ,  0. ])
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        *,
        grip: Frame,
        X_WB: RigidTransform,
        motion: HandMotion,
        R_BE: RotationMatrix,
        config: GripConfig | None = None,
    ) -> None:
        super().__init__()
        self.set_name("human_hand")
        if not plant.is_finalized():
            raise SystemsError("the plant is not finalized; call Finalize() first.")
        self._config = GripConfig() if config is None else config
        for name, value in vars(self._config).items():
            check_number(value, name, least=0, error=SystemsError)
        self._motion = motion
        self._X_WB = X_WB
        self._X_BW = X_WB.inverse()
        self._R_WE = X_WB.rotation() @ R_BE
        self._body = grip.body().index()
        self._X_LE = grip.GetFixedPoseInBodyFrame()
        self._poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        )
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            Value[list[ExternallyAppliedSpatialForce]],
            weakly(self._calc_forces),
            prerequisites_of_calc={
                self.time_ticket(),
                self._poses.ticket(),
                self._velocities.ticket(),
            },
        )
        self.DeclareVectorOutputPort(
            "position",
            3,
            self._calc_position,
            prerequisites_of_calc={self._poses.ticket()},
        )

    def _grip_pose(self, context: Context) -> RigidTransform:
        poses: Any = self._poses.Eval(context)
        return poses[int(self._body)] @ self._X_LE

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        p_WE: Any = self._grip_pose(context).translation()
        output.SetFromVector(self._X_BW.multiply(p_WE))

    def _calc_forces(self, context: Any, output: Any) -> None:
        config = self._config
        X_WE = self._grip_pose(context)
        velocities: Any = self._velocities.Eval(context)
        R_WL = X_WE.rotation() @ self._X_LE.rotation().inverse()
        V_WE = velocities[int(self._body)].Shift(R_WL @ self._X_LE.translation())
        R_BW = self._X_BW.rotation()
        p_WE: Any = X_WE.translation()
        p_BE = self._X_BW.multiply(p_WE)
        wanted, wanted_velocity = self._motion.at(context.get_time())
        f_B = -config.damping * (R_BW @ V_WE.translational())
        f_B[:2] += config.stiffness * (wanted - p_BE[:2])
        f_B[:2] += config.damping * wanted_velocity
        f_B[2] -= config.normal_force
        rotation = (self._R_WE @ X_WE.rotation().inverse()).ToAngleAxis()
        tau_W = config.rotational_stiffness * rotation.angle() * rotation.axis()
        tau_W -= config.rotational_damping * V_WE.rotational()
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._body
        force.p_BoBq_B = self._X_LE.translation()
        force.F_Bq_W = SpatialForce(tau_W, self._X_WB.rotation() @ f_B)
        output.set_value([force])
