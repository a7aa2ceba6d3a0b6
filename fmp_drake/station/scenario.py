"""Scenarios: everything that a whiteboard station is built from, as YAML."""

import dataclasses
import re
from collections.abc import Mapping
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
from fmp_drake.settings import bounded, check_settings
from fmp_drake.station.models.eraser import FeltPressLimit
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
)
from fmp_drake.station.skill_config import SkillConfig
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
    impedance: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    friction: FrictionConfig = field(default_factory=FrictionConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    press: PressConfig = field(default_factory=PressConfig)
    ink: InkConfig = field(default_factory=InkConfig)
    skill: SkillConfig = field(default_factory=SkillConfig)
    disturbances: list[Disturbance] = field(default_factory=list)
    posture: list[float] = bounded([0.0, 0.38, 0.0, -2.22, 0.0, 2.60, 0.785])
    start: list[float] = bounded([0.0, 0.0, 0.05])
    camera: CameraConfig = field(default_factory=CameraConfig)
    show: ShowConfig = field(default_factory=ShowConfig)

    def check(self) -> None:
        """Check the values that are not checked by who uses them.

        Raises
        ------
        StationError
            That names the value and what is allowed.
        """
        check_settings(self, StationError)
        self.board.motion.check()
        self.ink.check()
        self.sensors.check()
        self.camera.check()
        self.skill.check()
        if self.press.force > 1.000001 * (limit := FeltPressLimit(self.eraser)):
            raise StationError(
                f"press.force is {self.press.force:g} N; the felt is squeezed to its "
                f"core by {limit:.1f} N. Press less, or take an eraser with a larger "
                "footprint or modulus."
            )
        for disturbance in self.disturbances:
            disturbance.check()

    def contact_friction(self) -> float:
        """Return the coefficient of friction between felt and board, as in Drake."""
        felt, board = self.eraser.friction, self.board.friction
        return 2 * felt * board / (felt + board) if felt + board else 0.0

    def eraser_orientation(self) -> RotationMatrix:
        """Return R_BE, how the eraser is held over the board."""
        return RotationMatrix(RollPitchYaw(np.array(self.impedance.orientation)))


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

    Examples
    --------
    >>> LoadScenario("vertical").skill.tempo
    0.9
    """
    file = Path(path)
    if file.suffix not in (".yaml", ".yml"):
        file = models_dir() / "scenarios" / f"{path}.yaml"
    if not file.is_file():
        raise StationError(
            f"there is no scenario {path}; give a YAML file or one of: "
            f"{', '.join(ListScenarios())}."
        )
    scenario = ParseScenario(file.read_bytes(), name=file.name)
    skill, ink = scenario.skill, scenario.ink
    if skill.demonstration.endswith((".csv", ".npz")):
        skill.demonstration = str(file.parent / skill.demonstration)
    if skill.file:
        skill.file = str(file.parent / skill.file)
    if ink.picture:
        ink.picture = str(file.parent / ink.picture)
    return scenario


def ParseScenario(text: str | bytes, *, name: str = "this") -> Scenario:
    """Read a scenario from YAML text, over the defaults of `Scenario`.

    Files that it names are not looked for.

    Parameters
    ----------
    text : str or bytes
    name : str
        Of the text, for errors.

    Raises
    ------
    StationError
        Where it holds keys or values that do not fit; it lists what is allowed.

    Examples
    --------
    >>> ParseScenario("press: {force: 8.0}").press.force
    8.0
    """
    try:
        _check_types(yaml.safe_load(text), Scenario())
        data = text.decode() if isinstance(text, bytes) else text
        scenario: Scenario = yaml_load_typed(  # type: ignore[no-untyped-call]
            schema=Scenario, data=data, defaults=Scenario()
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
        raise StationError(f"{name} is not a scenario: {reason}") from None
    return scenario


def _check_types(given: Any, default: Any, name: str = "") -> None:
    """Refuse what cannot stand in place of a default value, and say what can."""
    fields = field_names(default)
    if fields:
        place, allowed = name or "a scenario", ", ".join(fields)
        if not isinstance(given, Mapping):
            raise StationError(
                f"{place} is {given!r} ({type(given).__name__}); expected a mapping "
                f"with any of: {allowed}."
            )
        for key, value in given.items():
            if key not in fields:
                raise StationError(
                    f"{place} has no key {key!r}; allowed are: {allowed}."
                )
            _check_types(value, getattr(default, key), f"{name}.{key}".lstrip("."))
    elif default == [] and isinstance(given, list):
        for i, each in enumerate(given):
            _check_types(each, Disturbance(), f"{name}[{i}]")
    elif not _fits(given, default):
        expected = f"a list like {default}" if isinstance(default, list) else "a number"
        expected = _EXPECTED.get(type(default), expected)
        raise StationError(f"{name} is {given!r}; expected {expected}.")


_EXPECTED = {bool: "true or false", str: "text", type(None): "a number or null"}


def _fits(given: Any, default: Any) -> bool:
    if isinstance(default, list):
        return isinstance(given, list) and all(_fits(g, default[0]) for g in given)
    if isinstance(default, bool | str):
        return isinstance(given, type(default))
    if given is None:
        return default is None
    if isinstance(given, str):  # YAML 1.1 reads 1e-3, without a point, as text.
        return re.fullmatch(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+", given) is not None
    return isinstance(given, int | float) and not isinstance(given, bool)


def field_names(value: Any) -> list[str]:
    """Return the names of a dataclass's fields, or of one of Drake's own configs."""
    if dataclasses.is_dataclass(value):
        return [each.name for each in dataclasses.fields(value)]
    return [each.name for each in getattr(type(value), "__fields__", ())]
