"""Scenarios: everything that a whiteboard station is built from, as YAML."""

import dataclasses
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig

from fmp_drake.errors import StationError
from fmp_drake.station.models.model_files import models_dir
from fmp_drake.station.scenario_parts import (
    BoardConfig,
    CameraConfig,
    Disturbance,
    EraserConfig,
    InkConfig,
    PressConfig,
    SensorConfig,
    ShowConfig,
    SkillConfig,
    finite,
)
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.friction import FrictionConfig


@dataclass(kw_only=True)
class Scenario:
    """Everything that a whiteboard station is built from.

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
    impedance : ImpedanceConfig
        The controller.
    friction : FrictionConfig
        Of the simulated arm's joints, if enabled.
    sensors : SensorConfig
    press : PressConfig
    ink : InkConfig
    skill : SkillConfig
    disturbances : list of Disturbance
    posture : list of 7 floats
        Joint angles that the redundant arm prefers, rad.
    start : list of 3 floats
        p_BE of the eraser at the start, in the frame of the board, m.
    camera : CameraConfig
    show : ShowConfig
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
    impedance: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    friction: FrictionConfig = field(default_factory=FrictionConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    press: PressConfig = field(default_factory=PressConfig)
    ink: InkConfig = field(default_factory=InkConfig)
    skill: SkillConfig = field(default_factory=SkillConfig)
    disturbances: list[Disturbance] = field(default_factory=list)
    posture: list[float] = field(
        default_factory=lambda: [0.0, 0.38, 0.0, -2.22, 0.0, 2.60, 0.785]
    )
    start: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.05])
    camera: CameraConfig = field(default_factory=CameraConfig)
    show: ShowConfig = field(default_factory=ShowConfig)

    def check(self) -> None:
        """Check the values that are not checked by who uses them.

        Raises
        ------
        StationError
            That names the value and what is allowed.
        """
        for part in (
            self.board,
            self.eraser,
            self.press,
            self.ink,
            self.skill,
            self.sensors,
        ):
            part.check()
        for disturbance in self.disturbances:
            disturbance.check()
        self.camera.check()
        self.start_position()
        self.eraser_orientation()

    def eraser_orientation(self) -> RotationMatrix:
        """Return R_BE, how the eraser is held over the board."""
        rpy = finite("impedance.orientation", self.impedance.orientation, 3)
        return RotationMatrix(RollPitchYaw(np.array(rpy)))

    def start_position(self) -> list[float]:
        """Return the checked start p_BE."""
        return finite("start", self.start, 3)


def ListScenarios() -> list[str]:
    """Return the names of the scenarios that come with the package."""
    return sorted(path.stem for path in (models_dir() / "scenarios").glob("*.yaml"))


def LoadScenario(path: str | Path) -> Scenario:
    """Load a scenario from a YAML file, over the defaults of `Scenario`.

    A bare name, such as `table_top`, means a scenario that comes with the package.
    Files that a scenario names are looked for beside it.

    Raises
    ------
    StationError
        Where the file is missing, or holds keys or values that do not fit; it lists
        what is allowed.
    """
    file = Path(path)
    if file.suffix not in (".yaml", ".yml"):
        file = models_dir() / "scenarios" / f"{path}.yaml"
    if not file.is_file():
        raise StationError(
            f"there is no scenario {path}; give a YAML file or one of: "
            f"{', '.join(ListScenarios())}."
        )
    try:
        _check_keys(yaml.safe_load(file.read_bytes()), Scenario())
        scenario: Scenario = yaml_load_typed(  # type: ignore[no-untyped-call]
            schema=Scenario, filename=str(file), defaults=Scenario()
        )
        scenario.check()
    except (
        RuntimeError,
        TypeError,
        ValueError,
        KeyError,
        AssertionError,  # Drake's loader, for a number in place of a mapping.
        yaml.YAMLError,
    ) as error:
        reason = str(error).strip().splitlines()[0]
        raise StationError(f"{file.name} is not a scenario: {reason}") from None
    if scenario.skill.demonstration.endswith((".csv", ".npz")):
        scenario.skill.demonstration = str(file.parent / scenario.skill.demonstration)
    if scenario.skill.file:
        scenario.skill.file = str(file.parent / scenario.skill.file)
    if scenario.ink.picture:
        scenario.ink.picture = str(file.parent / scenario.ink.picture)
    return scenario


def _check_keys(given: Any, default: Any, where: str = "") -> None:
    """Refuse keys and types that a default value has not, and list what it has."""
    fields = _fields(default)
    if not fields:
        expected, fits = _expected(default)
        if not fits(given):
            raise StationError(
                f"{where.rstrip('.')} is {given!r}; expected {expected}."
            )
        return
    place = where.rstrip(".") or "a scenario"
    if not isinstance(given, Mapping):
        raise StationError(
            f"{place} is {given!r} ({type(given).__name__}); expected a mapping with "
            f"any of: {', '.join(fields)}."
        )
    for key, value in given.items():
        if key not in fields:
            raise StationError(
                f"{place} has no key {key!r}; allowed are: {', '.join(fields)}."
            )
        if key == "disturbances":
            if not isinstance(value, list):
                raise StationError(f"{key} is {value!r}; expected a list of mappings.")
            for i, entry in enumerate(value):
                _check_keys(entry, Disturbance(), f"disturbances[{i}].")
        else:
            _check_keys(value, getattr(default, key), f"{where}{key}.")


def _expected(default: Any) -> tuple[str, Callable[[Any], bool]]:
    """Return what may stand in place of a default value, and its check."""
    if isinstance(default, bool):
        return "true or false", _is_bool
    if isinstance(default, str):
        return "text", lambda given: isinstance(given, str)
    if isinstance(default, list):
        what, each = "numbers", _is_number
        if default and isinstance(default[0], bool):
            what, each = "true and false", _is_bool
        return (
            f"a list of {what}",
            lambda given: isinstance(given, list) and all(map(each, given)),
        )
    if default is None:
        return "a number or null", lambda given: given is None or _is_number(given)
    return "a number", _is_number


def _is_bool(given: Any) -> bool:
    return isinstance(given, bool)


def _is_number(given: Any) -> bool:
    if isinstance(given, str):  # YAML 1.1 reads 1e-3, without a point, as text.
        return re.fullmatch(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+", given) is not None
    return isinstance(given, int | float) and not isinstance(given, bool)


def _fields(value: Any) -> list[str]:
    """Return the names of a dataclass's fields, or of one of Drake's own configs."""
    if dataclasses.is_dataclass(value):
        return [each.name for each in dataclasses.fields(value)]
    return [each.name for each in getattr(type(value), "__fields__", ())]
