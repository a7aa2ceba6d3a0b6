"""Scenarios: all settings of a station, as YAML."""

import math
import os
import reprlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import GetIntegrationSchemes, SimulatorConfig

from fmp_drake.errors import StationError
from fmp_drake.numeric import as_path
from fmp_drake.settings import bounded, check_settings
from fmp_drake.station.models.eraser import FELT_DEPTH, FeltForceLimit
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.robots.robot import DEFAULT_ROBOT, LoadRobot
from fmp_drake.station.scenario_parts import (
    BoardConfig,
    CameraConfig,
    EraserConfig,
    InkConfig,
    NormalForceConfig,
    SensorConfig,
    ShowConfig,
    SkillConfig,
    field_names,
    in_one_line,
    load_settings,
)
from fmp_drake.systems import FrictionConfig, ImpedanceConfig
from fmp_drake.systems.scripted_disturbances import Disturbance
from fmp_drake.systems.surface.surface import place, rotation

# More cells would exhaust the memory. With a shorter time step, s, a run would take forever.
_MOST_CELLS, _SHORTEST_STEP = 4e6, 1e-5
# Fields of Drake's types, which neither compare nor can be pickled.
_DRAKE: dict[str, type[Any]] = {
    "plant": MultibodyPlantConfig,
    "simulator": SimulatorConfig,
}


@dataclass(kw_only=True)
class Scenario:
    """All settings of a station.

    Attributes
    ----------
    description : str
        One sentence.
    plant : MultibodyPlantConfig
        Drake's own: time step and contact.
    simulator : SimulatorConfig
        Drake's own; the integrator is used where ``plant.time_step`` is 0.
    board : BoardConfig
    eraser : EraserConfig
    tool : str
        `eraser`; in free space also `spoon`, or a model file (SDF or URDF) with the frames
        `mount` and `tip`, relative to the scenario's.
    scenery : str
        Body without contact at the origin of B: nothing or `pot`.
    impedance : ImpedanceConfig
        The controller.
    friction : FrictionConfig
        Of the simulated arm's joints, if enabled.
    sensors : SensorConfig
    press : NormalForceConfig
    ink : InkConfig
    skill : SkillConfig
    disturbances : list of Disturbance
    robot : str
        Name of a robot of the package, or its YAML file, relative to the scenario's.
    posture : list of floats
        Joint angles that a redundant arm prefers, rad; empty for the robot's.
    start : list of 3 floats
        p_BE of the eraser at the start, in the frame of the board, m.
    tolerance : float
        Greatest acceptable rms distance from the path, m. The check refuses a
        skill whose predicted distance is greater, and a randomised trial fails whose measured
        distance is greater.
    camera : CameraConfig
    show : ShowConfig

    Examples
    --------
    >>> scenario = Scenario(description="A tilted board that is pressed softly.")
    >>> scenario.board.rpy = [0.0, -0.2, 0.0]
    >>> scenario.press.force = 6.0
    >>> scenario.check()
    """

    description: str = ""
    plant: MultibodyPlantConfig = field(
        default_factory=lambda: MultibodyPlantConfig(
            time_step=0.001,
            contact_model="hydroelastic_with_fallback",
            discrete_contact_approximation="lagged",
            use_sampled_output_ports=False,
        )
    )
    simulator: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(
            integration_scheme="cenic", accuracy=1e-3, max_step_size=0.01
        )
    )
    board: BoardConfig = field(default_factory=BoardConfig)
    eraser: EraserConfig = field(default_factory=EraserConfig)
    tool: str = "eraser"
    scenery: str = ""
    impedance: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    friction: FrictionConfig = field(default_factory=FrictionConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    press: NormalForceConfig = field(default_factory=NormalForceConfig)
    ink: InkConfig = field(default_factory=InkConfig)
    skill: SkillConfig = field(default_factory=SkillConfig)
    disturbances: list[Disturbance] = field(default_factory=list)
    robot: str = DEFAULT_ROBOT
    posture: list[float] = bounded([])
    start: list[float] = bounded([0.0, 0.0, 0.05])
    tolerance: float = bounded(0.010, above=0)
    camera: CameraConfig = field(default_factory=CameraConfig)
    show: ShowConfig = field(default_factory=ShowConfig)

    def __getstate__(self) -> dict[str, Any]:
        """Return the values; Drake's own, which cannot be pickled, as dictionaries."""
        return vars(self) | {
            name: {key: getattr(config, key) for key in field_names(config)}
            for name, kind in _DRAKE.items()
            if isinstance(config := getattr(self, name), kind)
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the values."""
        vars(self).update(state)
        for name, kind in _DRAKE.items():
            if isinstance(values := state[name], dict):
                setattr(self, name, kind(**values))

    def __eq__(self, other: object) -> bool:
        """Return whether all values are equal, also Drake's own, which do not compare."""
        is_scenario = isinstance(other, Scenario)
        return is_scenario and self.__getstate__() == other.__getstate__()

    def check(self) -> None:
        """Check every value.

        Raises
        ------
        StationError
            Where a value is not allowed.
        """
        check_settings(self, StationError)

    def inconsistency(self) -> str:
        """Return an error message for an inconsistency beyond the ranges, or ""."""
        sagitta = self.board.curvature().sagitta(self.board_footprint())
        limit = FeltForceLimit(self.eraser, sagitta=sagitta)
        if limit == 0:
            return (
                f"the eraser's edges are {1e3 * sagitta:.0f} mm from a board of radius "
                f"{self.board.radius:g} m, and its felt is {1e3 * FELT_DEPTH:g} mm deep. Use "
                "an eraser with a smaller footprint."
            )
        if self.press.force > 1.000001 * limit:
            other = (
                "smaller footprint" if sagitta > FELT_DEPTH / 2 else "larger footprint"
            )
            return (
                f"press.force is {self.press.force:g} N; the felt is squeezed to its "
                f"core by {limit:.1f} N. Lower it, or use an eraser with a {other} or "
                "a larger modulus."
            )
        if self.has_board and self.start[2] < -FELT_DEPTH:
            return (
                f"start is {-1e3 * self.start[2]:.0f} mm below the surface of the board; "
                f"its height must be at least {-FELT_DEPTH:g} m."
            )
        if self.tool != "eraser" and self.has_board:
            return (
                f"tool is {self.tool}; a board is wiped with the eraser. Set board.shape to "
                "none for another tool."
            )
        if self.scenery not in ("", "pot"):
            return f"scenery is {self.scenery}; expected nothing or pot."
        cells = math.prod(self.board.size) / self.ink.cell**2
        if self.has_board and cells > _MOST_CELLS:
            return (
                f"ink.cell is {self.ink.cell:g} m, and the board has {cells:.2g} cells; at "
                f"most {_MOST_CELLS:.2g} are drawn and wiped."
            )
        if self.simulator.integration_scheme not in GetIntegrationSchemes():
            return (
                f"simulator.integration_scheme is {self.simulator.integration_scheme}; "
                f"choose one of: {', '.join(GetIntegrationSchemes())}."
            )
        if self.simulator.start_time != 0:
            return "simulator.start_time must be 0: a run begins with its station."
        if not self.plant.contact_model.startswith("hydroelastic"):
            return (
                f"plant.contact_model is {self.plant.contact_model}; choose hydroelastic or "
                "hydroelastic_with_fallback, whose contact with the felt is measured."
            )
        for name in ("accuracy", "max_step_size"):
            value = getattr(self.simulator, name)
            if not 0 < value < math.inf:
                return f"simulator.{name} is {value:g}; expected a positive number."
        step = self.plant.time_step
        if step != 0 and not _SHORTEST_STEP <= step < math.inf:
            return (
                f"plant.time_step is {step:g} s; expected 0, or at least "
                f"{_SHORTEST_STEP:g} s."
            )
        robot = LoadRobot(self.robot)
        n = len(robot.posture)
        if len(self.posture) not in (0, n):
            return f"posture is {self.posture}; expected {n} numbers."
        for prefix, friction in (
            ("friction.", self.friction),
            ("impedance.friction_compensation.", self.impedance.friction_compensation),
        ):
            if friction.enabled:
                friction = friction.completed(robot.friction)
            for name in ("height", "slope", "shift"):
                values = getattr(friction, name)
                if len(values) != n and (values or friction.enabled):
                    none = f"none: give them, or {prefix}enabled: false"
                    return (
                        f"{prefix}{name} is {values}; expected {n} numbers. The robot has "
                        f"{'its own' if robot.friction.height else none}."
                    )
        return ""

    def preferred_posture(self) -> list[float]:
        """Return the joint angles that the arm prefers, rad."""
        return self.posture or LoadRobot(self.robot).posture

    @property
    def has_board(self) -> bool:
        """Whether there is a board; False in free space."""
        return self.board.shape != "none"

    def held_tool(self) -> EraserConfig | str:
        """Return the tool, as `AddRobot` takes it."""
        return self.eraser if self.tool == "eraser" else self.tool

    def nominal_force(self) -> float:
        """Return the normal force of a skill without a force channel, N; 0 in free space."""
        return self.press.force if self.has_board else 0.0

    def contact_friction(self) -> float:
        """Return the coefficient of friction between felt and board, as in Drake."""
        felt, board = self.eraser.friction, self.board.friction
        return 2 * felt * board / (felt + board) if felt + board else 0.0

    def eraser_orientation(self) -> RotationMatrix:
        """Return R_TE, the orientation of the eraser over the board; T is B if flat."""
        return RotationMatrix(RollPitchYaw(np.array(self.impedance.orientation)))

    def board_footprint(self) -> tuple[float, float]:
        """Return the edges of the eraser's footprint along x and y of the board, m.

        Where the eraser is yawed, they are those of the rectangle around it.
        """
        R_TE = np.abs(np.round(self.eraser_orientation().matrix()[:2, :2], 9))
        x, y = (R_TE @ self.eraser.footprint).tolist()
        return x, y

    def eraser_pose(self, position: ArrayLike) -> RigidTransform:
        """Return X_BE over a point: its p_BE, or (u, v, h) of a curved board, m."""
        uvh = np.asarray(position, dtype=float)
        surface, R_TE = self.board.curvature(), self.eraser_orientation()
        if surface.is_plane:
            return RigidTransform(R_TE, uvh)
        R_BT = RotationMatrix(rotation(surface, uvh[0], uvh[1]))
        return RigidTransform(R_BT @ R_TE, place(surface, uvh[None])[0])


def ListScenarios() -> list[str]:
    """Return the names of the bundled scenarios."""
    return sorted(path.stem for path in (models_dir() / "scenarios").glob("*.yaml"))


def LoadScenario(path: str | Path, *, robot: str | None = None) -> Scenario:
    """Load a scenario from a YAML file, over the defaults of `Scenario`.

    A bare name, such as `table_top`, is that of a bundled scenario. Paths in a scenario
    are relative to its folder.

    Parameters
    ----------
    path : str or pathlib.Path
    robot : str, optional
        Another robot than the scenario's, with its own preferred posture.

    Raises
    ------
    StationError
        If the file is missing, or has invalid keys or values; it lists the allowed ones.

    Examples
    --------
    >>> LoadScenario("vertical").skill.tempo
    0.9
    """
    file = as_path(path, "the scenario", error=StationError)
    if file.suffix not in (".yaml", ".yml"):
        file = models_dir() / "scenarios" / f"{path}.yaml"
    if not file.is_file():
        raise StationError(
            f"there is no scenario {path}; give a YAML file or one of: "
            f"{', '.join(ListScenarios())}."
        )
    return _Parse(file.read_bytes(), file.name, folder=file.parent, robot=robot)


def check_scenario(scenario: Any, call: str) -> None:
    """Raise a StationError where the argument of a call is not a valid scenario."""
    if not isinstance(scenario, Scenario):
        raise StationError(
            f"{call} needs a scenario, such as LoadScenario('table_top'); "
            f"it is {reprlib.repr(scenario)}."
        )
    scenario.check()


def ParseScenario(text: str | bytes, *, name: str = "this") -> Scenario:
    """Read a scenario from YAML text, over the defaults of `Scenario`.

    Paths in it stay as they are.

    Parameters
    ----------
    text : str or bytes
        A mapping, ``{}`` for the defaults. A text without any key is refused: its file may be
        broken.
    name : str
        Of the text, for errors.

    Raises
    ------
    StationError
        If it has invalid keys or values; it lists the allowed ones.

    Examples
    --------
    >>> ParseScenario("press: {force: 8.0}").press.force
    8.0
    """
    return _Parse(text, name)


def _Parse(
    text: str | bytes,
    name: str,
    folder: Path | None = None,
    robot: str | None = None,
) -> Scenario:
    with in_one_line(f"{name} is not a scenario"):
        scenario: Scenario = load_settings(Scenario, text)
        if folder is not None:
            _Locate(scenario, folder)
        if robot not in (None, scenario.robot):
            scenario.robot, scenario.posture = str(robot), []
            name = f"{name} with {robot}"
    if robot is not None or os.path.isfile(scenario.robot):
        LoadRobot(scenario.robot)  # Its errors do not name the scenario.
    with in_one_line(f"{name} is not a scenario"):
        scenario.check()
    return scenario


def _Locate(scenario: Scenario, folder: Path) -> None:
    """Resolve the paths in a scenario, which are relative to its folder."""
    skill, ink = scenario.skill, scenario.ink
    name = skill.demonstration
    if Path(name).suffix or (name and (folder / name).is_dir()):
        skill.demonstration = str(folder / name)
    if skill.file:
        skill.file = str(folder / skill.file)
    if ink.picture:
        ink.picture = str(folder / ink.picture)
    if scenario.tool.endswith((".sdf", ".urdf")):
        scenario.tool = str(folder / scenario.tool)
    if scenario.robot.endswith((".yaml", ".yml")):
        scenario.robot = str(folder / scenario.robot)
