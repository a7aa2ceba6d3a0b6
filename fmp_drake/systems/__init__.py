"""Drake systems: the primitive, an impedance controller, ink, people and visualizers.

Every module directly in here and in `page` is one LeafSystem of its name: what acts, and
what only shows it. The mathematics is in the other folders.
"""

from fmp_drake.systems.erase_times import EraseTimes
from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.human_hand import GripConfig, HumanHand
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.impedance.friction import FrictionConfig
from fmp_drake.systems.impedance.limits import JointWallConfig
from fmp_drake.systems.impedance.status import ImpedanceStatus, StatusFlag
from fmp_drake.systems.impedance.stiffness import (
    CovarianceStiffnessConfig,
    EnergyTankConfig,
)
from fmp_drake.systems.impedance.supervision import WatchdogConfig
from fmp_drake.systems.ink.coverage_choice import CoverageChoice
from fmp_drake.systems.ink.drawing import draw_picture, draw_words
from fmp_drake.systems.ink.grid import InkGrid, cleaned_fraction
from fmp_drake.systems.ink.metrics import (
    MissedSpots,
    cleaned_history,
    missed_spots,
    times_to_clean,
)
from fmp_drake.systems.ink.recording import AddInkToRecording
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.joint_friction import JointFriction
from fmp_drake.systems.mouse_hand import MouseHand
from fmp_drake.systems.normal_force_estimator import NormalForceEstimator
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)
from fmp_drake.systems.page.force_arrow import ForceArrow
from fmp_drake.systems.page.ink_visualizer import InkVisualizer
from fmp_drake.systems.page.page_controls import PageControls
from fmp_drake.systems.page.page_status import PageStatus
from fmp_drake.systems.page.plan_visualizer import PlanVisualizer
from fmp_drake.systems.page.trail_visualizer import TrailVisualizer
from fmp_drake.systems.panda.gating import GateConfig, GateMode
from fmp_drake.systems.panda.reading import GateFault
from fmp_drake.systems.scripted_disturbances import Grasp, Push, ScriptedDisturbances
from fmp_drake.systems.sensor_model import SensorModel
from fmp_drake.systems.spatial_force_sum import SpatialForceSum
from fmp_drake.systems.surface_monitor import SurfaceMonitor
from fmp_drake.systems.teaching.hand_motion import HandMotion, HandVariability
from fmp_drake.systems.teaching.mouse_drag import BoardPlane, DragConfig
from fmp_drake.systems.torque_gate import TorqueGate
from fmp_drake.systems.viewer.inline_page import InlinePage
from fmp_drake.systems.viewer.page_panel import PagePanel
from fmp_drake.systems.viewer.path_drawing import draw_demonstrations
from fmp_drake.systems.viewer.path_recording import AddPathToRecording
from fmp_drake.systems.wiped_area import WipedArea

__all__ = [
    "AddInkToRecording",
    "AddPathToRecording",
    "BoardPlane",
    "CovarianceStiffnessConfig",
    "CoverageChoice",
    "DragConfig",
    "EnergyTankConfig",
    "EraseTimes",
    "ForceArrow",
    "ForceControlConfig",
    "FourierPrimitiveSystem",
    "FrictionConfig",
    "GateConfig",
    "GateFault",
    "GateMode",
    "Grasp",
    "GripConfig",
    "HandMotion",
    "HandVariability",
    "HumanHand",
    "ImpedanceConfig",
    "ImpedanceStatus",
    "InkBoard",
    "InkGrid",
    "InkVisualizer",
    "InlinePage",
    "JointFriction",
    "JointWallConfig",
    "MissedSpots",
    "MouseHand",
    "NormalForceEstimator",
    "OperationalSpaceImpedanceController",
    "PageControls",
    "PagePanel",
    "PageStatus",
    "PlanVisualizer",
    "Push",
    "ScriptedDisturbances",
    "SensorModel",
    "SpatialForceSum",
    "StatusFlag",
    "SurfaceMonitor",
    "TorqueGate",
    "TrailVisualizer",
    "WatchdogConfig",
    "WipedArea",
    "cleaned_fraction",
    "cleaned_history",
    "draw_demonstrations",
    "draw_picture",
    "draw_words",
    "missed_spots",
    "times_to_clean",
]
