"""The hands that may lead the arm in a teaching station."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource

from fmp_drake.station.parts.board_scene import BoardScene
from fmp_drake.station.parts.mouse import AddMouseHand
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.human_hand import HumanHand
from fmp_drake.systems.teaching.hand_motion import HandMotion


class TeachingHand(Protocol):
    """What leads the arm: simulated, by the mouse, or a person's at a real arm.

    Examples
    --------
    >>> hand: TeachingHand = SimulatedHand(HandMotion.make("eight", seconds=5.0, seed=0))
    >>> from fmp_drake.station import LoadScenario, MakeTeachingStation
    >>> station = MakeTeachingStation(LoadScenario("table_top"), hand)
    """

    @property
    def start(self) -> list[float] | None:
        """p_BE where the eraser begins, m; the scenario's start where None."""

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene, scenario: Scenario
    ) -> tuple[OutputPort, OutputPort]:
        """Add the hand; return its forces, and a port (1,) that is 1 while it leads."""


@dataclass(frozen=True)
class SimulatedHand:
    """A model of a person's hand, that leads all the time.

    Attributes
    ----------
    motion : HandMotion

    Examples
    --------
    >>> motion = HandMotion.make("eight", seconds=5.0, seed=0)
    >>> len(SimulatedHand(motion).start)
    3
    """

    motion: HandMotion

    @property
    def start(self) -> list[float]:
        """Just above where the motion begins."""
        (x, y), _ = self.motion.at(0.0)
        return [float(x), float(y), 0.005]

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene, scenario: Scenario
    ) -> tuple[OutputPort, OutputPort]:
        """Add human_hand, and leading, a constant."""
        hand = builder.AddSystem(
            HumanHand(
                scene.plant,
                grip=scene.tip,
                X_WB=scene.X_WB,
                motion=self.motion,
                R_BE=scenario.eraser_orientation(),
            )
        )
        for port in ("body_poses", "body_spatial_velocities"):
            builder.Connect(scene.plant.GetOutputPort(port), hand.GetInputPort(port))
        leading = builder.AddNamedSystem("leading", ConstantVectorSource(np.ones(1)))
        return hand.GetOutputPort("spatial_forces"), leading.get_output_port()


@dataclass(frozen=True)
class MouseOnPage:
    """Somebody who drags the arm on a page.

    Attributes
    ----------
    meshcat : Meshcat

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario, MakeTeachingStation
    >>> hand = MouseOnPage(Meshcat())
    >>> station = MakeTeachingStation(LoadScenario("table_top"), hand)
    """

    meshcat: Meshcat

    @property
    def start(self) -> None:
        """Where the scenario says."""
        return

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene, scenario: Scenario
    ) -> tuple[OutputPort, OutputPort]:
        """Add mouse_hand."""
        hand = AddMouseHand(builder, scene, scenario, self.meshcat)
        return hand.GetOutputPort("spatial_forces"), hand.GetOutputPort("leading")
