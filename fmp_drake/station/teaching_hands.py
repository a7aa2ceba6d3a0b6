"""Kinesthetic teaching: hands that guide the arm, and the recording of the motion."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, VectorLog

from fmp_drake.errors import StationError
from fmp_drake.primitives import Demonstration, add_orientation
from fmp_drake.primitives.data.channels import FORCE_CHANNEL, POSITION_CHANNELS
from fmp_drake.station.external_forces import AddMouseHand
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.scene import BoardScene
from fmp_drake.systems import HandMotion, ImpedanceConfig
from fmp_drake.systems.human_hand import HumanHand

# Compliant in translation and rotation, with a fixed posture of the elbow.
TURNING = ImpedanceConfig(
    translational_stiffness=[1e-3, 1e-3, 1e-3],
    rotational_stiffness=[1e-3, 1e-3, 1e-3],
)

# Compliant in translation, with a level eraser and a fixed posture of the elbow.
GUIDING = ImpedanceConfig(
    translational_stiffness=[1e-3, 1e-3, 1e-3],
    rotational_stiffness=[30.0, 30.0, 30.0],
)


class TeachingHand(Protocol):
    """Hand that guides the arm: simulated, by the mouse, or a person's at a real arm.

    Examples
    --------
    >>> hand: TeachingHand = SimulatedHand(HandMotion.make("eight", seconds=5.0, seed=0))
    >>> from fmp_drake.station import LoadScenario, MakeStation
    >>> station = MakeStation(LoadScenario("table_top"), hand)
    """

    @property
    def start(self) -> list[float] | None:
        """Initial p_BE of the eraser, m; the scenario's if None."""

    def recorded(self, scenario: Scenario) -> tuple[str, ...]:
        """Return the outputs to record beside the position.

        They are `measured_pose` and `normal_force`, or none.
        """

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene
    ) -> tuple[OutputPort, OutputPort]:
        """Add the hand; return its forces, and a port (1,) that is 1 during guiding."""


@dataclass(frozen=True)
class SimulatedHand:
    """Model of a person's hand that guides the arm all the time.

    On a curved board, where the tool turns, it is slower; see `HandMotion.slowed`.

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
        """Start of the motion; just above the board if the motion has no height."""
        values, _ = self.motion.at(0.0)
        x, y = (float(value) for value in values[:2])
        has_height = "z" in self.motion.channels
        z = float(values[self.motion.channels.index("z")]) if has_height else 0.005
        return [x, y, z]

    def recorded(self, scenario: Scenario) -> tuple[str, ...]:  # noqa: ARG002
        """Return the outputs of the teaching station to record beside the position."""
        names = {"rx": "measured_pose", "force": "normal_force"}
        return tuple(port for c, port in names.items() if c in self.motion.channels)

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene
    ) -> tuple[OutputPort, OutputPort]:
        """Add human_hand, and leading, a constant."""
        if scene.whiteboard is None and "z" not in self.motion.channels:
            raise StationError(
                f"the motion has {', '.join(self.motion.channels)}, and the scenario no board "
                "to guide the tool over; take a motion with a height, such as stirring, or a "
                "scenario with a board."
            )
        hand = builder.AddSystem(
            HumanHand(
                scene.plant,
                grip=scene.robot.tip,
                X_WB=scene.X_WB,
                motion=self.motion.slowed(scene.curvature),
                R_BE=scene.scenario.eraser_orientation(),
                surface=scene.curvature,
            )
        )
        for port in ("body_poses", "body_spatial_velocities"):
            builder.Connect(scene.plant.GetOutputPort(port), hand.GetInputPort(port))
        leading = builder.AddNamedSystem("leading", ConstantVectorSource(np.ones(1)))
        return hand.GetOutputPort("spatial_forces"), leading.get_output_port()


@dataclass(frozen=True)
class MouseOnPage:
    """Hand guiding by the mouse on a page.

    Attributes
    ----------
    meshcat : Meshcat

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario, MakeStation
    >>> hand = MouseOnPage(Meshcat())
    >>> station = MakeStation(LoadScenario("table_top"), hand)
    """

    meshcat: Meshcat

    @property
    def start(self) -> None:
        """None: the scenario's start is used."""
        return

    def recorded(self, scenario: Scenario) -> tuple[str, ...]:
        """Return the pose in free space, where the tool may be turned."""
        return () if scenario.has_board else ("measured_pose",)

    def AddTo(
        self, builder: DiagramBuilder, scene: BoardScene
    ) -> tuple[OutputPort, OutputPort]:
        """Add mouse_hand."""
        hand = AddMouseHand(builder, scene, self.meshcat)
        return hand.GetOutputPort("spatial_forces"), hand.GetOutputPort("leading")


def DemonstrationFromRecorder(
    diagram: Diagram, context: Context, *, skip: float, note: str
) -> Demonstration:
    """Return the recording of a teaching station, with and without guiding.

    The channels are x, y and z, and orientation and force if the hand guides them.

    Parameters
    ----------
    diagram : Diagram
        From `MakeStation` with a hand.
    context : Context
        Of the diagram, after a simulation.
    skip : float
        Duration to omit at the start, s.
    note : str
    """
    log = _Log(diagram, context, "recorder")
    times = log.sample_times()
    mask = times >= skip - 1e-9
    values = log.data()[:, mask].T
    channels: tuple[str, ...] = POSITION_CHANNELS
    units: tuple[str, ...] = ("m",) * 3
    recorded = {
        name: _Log(diagram, context, f"record_{name}").data()[:, mask].T
        for name in ("measured_pose", "normal_force")
        if diagram.HasSubsystemNamed(f"record_{name}")
    }
    if "normal_force" in recorded:
        values = np.column_stack([values, recorded["normal_force"]])
        channels, units = (*channels, FORCE_CHANNEL), (*units, "N")
    demonstration = Demonstration(
        time=np.round(times[mask] - skip, 9),
        values=np.array(values),
        channels=channels,
        units=units,
        frame="board",
        note=note,
    )
    if "measured_pose" in recorded:
        quaternions = recorded["measured_pose"][:, :4]
        demonstration = add_orientation(demonstration, quaternions, order="wxyz")
    return demonstration


def _Log(diagram: Diagram, context: Context, name: str) -> VectorLog:
    """Return the log of a log sink of a diagram."""
    sink: Any = diagram.GetSubsystemByName(name)
    return sink.FindLog(context)
