"""Scenarios: what stands where, as dataclasses that mirror the YAML files."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlantConfig

from fmp_drake.errors import StationError
from fmp_drake.station.model_files import models_dir
from fmp_drake.systems.impedance_config import ImpedanceConfig
from fmp_drake.systems.impedance_friction import FrictionConfig


@dataclass(kw_only=True)
class BoardConfig:
    """Where the whiteboard stands.

    Attributes
    ----------
    translation : list of 3 floats
        p_WB, the centre of the surface in the frame of the robot's base, m.
    rpy : list of 3 floats
        Roll, pitch, yaw of R_WB, rad; z of B is the normal out of the surface.
    """

    translation: list[float] = field(default_factory=lambda: [0.55, 0.0, 0.10])
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def pose(self) -> RigidTransform:
        """Return X_WB."""
        rpy = RollPitchYaw(np.array(_finite("board.rpy", self.rpy, 3)))
        return RigidTransform(
            rpy, np.array(_finite("board.translation", self.translation, 3))
        )


@dataclass(kw_only=True)
class PressConfig:
    """How the eraser is pressed on the board: see `NormalPress`."""

    force: float = 10.0
    engage_height: float = 0.01


@dataclass(kw_only=True)
class InkConfig:
    """The ink on the board.

    Attributes
    ----------
    cell : float
        Edge of a cell, m.
    period : float
        Seconds between updates.
    """

    cell: float = 0.005
    period: float = 0.01


@dataclass(kw_only=True)
class Scenario:
    """Everything that a whiteboard station is built from.

    Attributes
    ----------
    plant : MultibodyPlantConfig
        Drake's own.
    board : BoardConfig
    impedance : ImpedanceConfig
    friction : FrictionConfig
        Of the simulated arm's joints, if enabled.
    press : PressConfig
    ink : InkConfig
    posture : list of 7 floats
        Joint angles that the redundant arm prefers, rad.
    start : list of 3 floats
        p_BE of the eraser at the start, in the frame of the board, m.
    """

    plant: MultibodyPlantConfig = field(
        default_factory=lambda: MultibodyPlantConfig(
            time_step=0.001,
            contact_model="hydroelastic_with_fallback",
            discrete_contact_approximation="lagged",
        )
    )
    board: BoardConfig = field(default_factory=BoardConfig)
    impedance: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    friction: FrictionConfig = field(default_factory=FrictionConfig)
    press: PressConfig = field(default_factory=PressConfig)
    ink: InkConfig = field(default_factory=InkConfig)
    posture: list[float] = field(
        default_factory=lambda: [0.0, 0.38, 0.0, -2.22, 0.0, 2.60, 0.785]
    )
    start: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.05])

    def eraser_orientation(self) -> RotationMatrix:
        """Return R_BE, how the eraser is held over the board."""
        rpy = _finite("impedance.orientation", self.impedance.orientation, 3)
        return RotationMatrix(RollPitchYaw(np.array(rpy)))

    def start_position(self) -> list[float]:
        """Return the checked start p_BE."""
        return _finite("start", self.start, 3)


def LoadScenario(path: str | Path) -> Scenario:
    """Load a scenario from a YAML file, over the defaults of `Scenario`.

    A bare name, such as `table_top`, means a scenario that comes with the package.

    Raises
    ------
    StationError
        Where the file is missing, or holds keys or values that do not fit.
    """
    scenarios = models_dir() / "scenarios"
    file = Path(path)
    if file.suffix not in (".yaml", ".yml"):
        file = scenarios / f"{path}.yaml"
    if not file.is_file():
        known = ", ".join(sorted(p.stem for p in scenarios.glob("*.yaml")))
        raise StationError(
            f"there is no scenario {path}; give a YAML file or one of: {known}."
        )
    try:
        scenario: Scenario = yaml_load_typed(  # type: ignore[no-untyped-call]
            schema=Scenario, filename=str(file), defaults=Scenario()
        )
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
    return scenario


def _finite(name: str, values: list[float], size: int) -> list[float]:
    if len(values) != size or not np.all(np.isfinite(values)):
        raise StationError(f"{name} is {values}; expected {size} finite numbers.")
    return values
