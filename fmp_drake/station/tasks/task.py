"""Base class of the tasks of a robot."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, System

from fmp_drake.station.board_scene import BoardScene
from fmp_drake.systems import InkBoard


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurements:
    """Output ports of the measurements of a task.

    Attributes
    ----------
    status : OutputPort
        Of the controller, with the flags that the task adds.
    normal_force : OutputPort
        Of the tool on the surface, N.
    ink : OutputPort or None
        Remaining ink, for the selection of samples.
    ink_position : InputPort or None
        For the position on the surface, where the ink follows from it.
    ink_board : InkBoard or None
        The simulated ink.
    """

    status: OutputPort
    normal_force: OutputPort
    ink: OutputPort | None = None
    ink_position: InputPort | None = None
    ink_board: InkBoard | None = None


class Task(ABC):
    """Surroundings of a robot, and the measurements of its task."""

    @abstractmethod
    def AddTo(
        self,
        builder: DiagramBuilder,
        scene: BoardScene,
        *,
        controller: System,
        driver: System,
    ) -> Measurements:
        """Add the systems that measure the task, and export their outputs.

        Parameters
        ----------
        builder : DiagramBuilder
        scene : BoardScene
        controller : System
            With the outputs measured_position and status.
        driver : System
            From `MakeDriver`.
        """
