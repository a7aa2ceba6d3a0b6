"""The task of following a motion."""

from pydrake.systems.framework import DiagramBuilder, System

from fmp_drake.station.arm_controller import AddNormalForceEstimator
from fmp_drake.station.board_scene import BoardScene
from fmp_drake.station.tasks.task import Measurements, Task


class Following(Task):
    """Tracking only, with the normal force from the arm's external torque.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario, MakeStation
    >>> station = MakeStation(LoadScenario("table_top"), None, task=Following())
    >>> station.HasOutputPort("ink")
    False
    """

    def AddTo(
        self,
        builder: DiagramBuilder,
        scene: BoardScene,
        *,
        controller: System,
        driver: System,
    ) -> Measurements:
        """Add and export normal_force, from the arm's external torque."""
        force = AddNormalForceEstimator(builder, scene, driver)
        builder.ExportOutput(force, "normal_force")
        status = controller.GetOutputPort("status")
        builder.ExportOutput(status, "status")
        return Measurements(status=status, normal_force=force)
