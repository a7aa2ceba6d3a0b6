"""The package's models: where they are, and the arm with its eraser."""

import math
from pathlib import Path

from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from fmp_drake.errors import StationError
from fmp_drake.station.models.eraser import AddEraser
from fmp_drake.station.models.panda import AddPanda
from fmp_drake.station.scenario_parts import EraserConfig


def models_dir() -> Path:
    """Find the folder of models, in an installed wheel and in a checkout alike.

    Returns
    -------
    Path
        The folder that holds ``package.xml``.

    Raises
    ------
    StationError
        If neither place has it.
    """
    package = Path(__file__).resolve().parents[2]
    candidates = (package / "models", package.parent / "models")
    for folder in candidates:
        if (folder / "package.xml").is_file():
            return folder
    looked = " and ".join(str(folder) for folder in candidates)
    raise StationError(
        f"No models: package.xml is in neither {looked}. "
        "Install fmp_drake again, or run it from a complete checkout."
    )


def AddFmpDrakePackage(parser: Parser) -> None:
    """Teach a parser what ``package://fmp_drake/...`` means.

    A parser that knows it already stays as it is.

    Parameters
    ----------
    parser : Parser
        The parser that will load the models.
    """
    packages = parser.package_map()
    if not packages.Contains("fmp_drake"):
        packages.AddPackageXml(str(models_dir() / "package.xml"))


def AddPandaWithEraser(
    plant: MultibodyPlant,
    *,
    eraser: EraserConfig | None = None,
    visuals: str = "own",
) -> tuple[ModelInstanceIndex, ModelInstanceIndex]:
    """Add the arm, welded to the world, with the eraser on its flange.

    This is the robot as its controller knows it; contact needs a plant that is
    registered with a scene graph. The eraser is turned by -45 degrees about the
    flange's z, as Franka mounts its hand, so that ``R_WE = diag(1, -1, -1)`` at the
    start posture ``q = (0, -pi/4, 0, -3 pi/4, 0, pi/2, pi/4)``.

    Parameters
    ----------
    plant : MultibodyPlant
        A plant that is not finalized and has no model named ``panda`` or ``eraser``.
    eraser : EraserConfig, optional
        The default one where None.
    visuals : {"own", "drake_models"}
        The arm's meshes: our own, or the official ones that Drake downloads.

    Returns
    -------
    panda, eraser : ModelInstanceIndex
        The arm of 7 joints and the eraser.

    Raises
    ------
    StationError
        Where a value is not allowed, or the official meshes are not to be had.
    """
    parser = Parser(plant)
    AddFmpDrakePackage(parser)
    panda = AddPanda(plant, packages=parser.package_map(), visuals=visuals)
    tool = AddEraser(plant, eraser or EraserConfig())
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("panda_link0", panda))
    plant.WeldFrames(
        plant.GetFrameByName("panda_link8", panda),
        plant.GetFrameByName("mount", tool),
        RigidTransform(RotationMatrix.MakeZRotation(-math.pi / 4)),
    )
    return panda, tool
