"""Drake systems: primitive, impedance controller, ink, models of a hand, visualizers.

Every module directly in this folder is one LeafSystem of its name. The visualizers are in
`page`, the gate of a real Panda is in `panda`. The other folders contain the mathematics.
"""

from fmp_drake.systems.fourier_primitive_system import FourierPrimitiveSystem
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.controller_status import ImpedanceStatus, StatusFlag
from fmp_drake.systems.impedance.force_control import ForceControlConfig
from fmp_drake.systems.impedance.joints import FrictionConfig, JointWallConfig
from fmp_drake.systems.impedance.stiffness import (
    CovarianceStiffnessConfig,
    EnergyTankConfig,
)
from fmp_drake.systems.impedance.supervision import WatchdogConfig
from fmp_drake.systems.ink.grid import InkGrid
from fmp_drake.systems.ink_board import InkBoard
from fmp_drake.systems.normal_force_estimator import NormalForceEstimator
from fmp_drake.systems.operational_space_impedance_controller import (
    OperationalSpaceImpedanceController,
)
from fmp_drake.systems.page.page_panel import InlinePage, PagePanel, hidden_meshcat
from fmp_drake.systems.page.paths import AddPathToRecording, draw_demonstrations
from fmp_drake.systems.panda.gate import GateConfig, GateMode
from fmp_drake.systems.teaching.hand_motion import HandMotion

__all__ = [
    "AddPathToRecording",
    "CovarianceStiffnessConfig",
    "EnergyTankConfig",
    "ForceControlConfig",
    "FourierPrimitiveSystem",
    "FrictionConfig",
    "GateConfig",
    "GateMode",
    "HandMotion",
    "ImpedanceConfig",
    "ImpedanceStatus",
    "InkBoard",
    "InkGrid",
    "InlinePage",
    "JointWallConfig",
    "NormalForceEstimator",
    "OperationalSpaceImpedanceController",
    "PagePanel",
    "StatusFlag",
    "WatchdogConfig",
    "draw_demonstrations",
    "hidden_meshcat",
]
