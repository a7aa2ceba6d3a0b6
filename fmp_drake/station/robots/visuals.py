"""Arms with the meshes of their own models, or with those that Drake downloads."""

import xml.etree.ElementTree as ET
from pathlib import Path

from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.tree import ModelInstanceIndex

from fmp_drake.errors import StationError

# Prefix of Drake's own elements.
ET.register_namespace("drake", "http://drake.mit.edu")

VISUALS = ("own", "drake_models")


def AddArm(
    parser: Parser, model: Path, *, visuals: str = "own", official: str = ""
) -> ModelInstanceIndex:
    """Add an arm; the visuals do not change the dynamics of its own model.

    Parameters
    ----------
    parser : Parser
        Of a plant that is not finalized and has no model with this name. It has the
        packages of the model, and ``drake_models`` for these visuals.
    model : Path
        URDF or SDF file.
    visuals : {"own", "drake_models"}
        Meshes of the model, or the official ones, which Drake downloads when it first
        needs them.
    official : str
        The official description in the package ``drake_models``.

    Returns
    -------
    ModelInstanceIndex

    Raises
    ------
    StationError
        If the visuals are of another kind, or the official ones are not available.
    """
    if visuals not in VISUALS:
        raise StationError(
            f"visuals is {visuals!r}; it must be one of {', '.join(VISUALS)}."
        )
    if visuals == "own":
        (arm,) = parser.AddModels(str(model))
        return arm
    if not official:
        raise StationError(
            f"{model.name} has no official meshes in drake_models. Take visuals: own."
        )
    folder = _OfficialFolder(parser.package_map())
    description = ET.fromstring(model.read_text())
    _ReplaceVisuals(description, folder / official)
    text = ET.tostring(description, encoding="unicode")
    try:
        (arm,) = parser.AddModelsFromString(text, "urdf")
    except RuntimeError as error:
        raise StationError(
            f"the official meshes in {folder} cannot be used: {error}. "
            "Take visuals: own, which needs no download."
        ) from None
    return arm


def _OfficialFolder(packages: PackageMap) -> Path:
    """Return the folder of drake_models, which Drake downloads if it is missing."""
    try:
        return Path(packages.GetPath("drake_models"))
    except RuntimeError as error:
        raise StationError(
            "the official meshes (Drake's package drake_models) are not on this "
            "machine and could not be downloaded. Connect to the network once, with "
            "the environment variable DRAKE_ALLOW_NETWORK unset or naming "
            "package_map; Drake keeps what it has downloaded. Or take visuals: own, "
            f"which needs no download. Drake said: {error}"
        ) from None


def _ReplaceVisuals(arm: ET.Element, official: Path) -> None:
    """Replace the arm's visuals with those of the official description."""
    try:
        root = ET.fromstring(official.read_text())
    except (OSError, ET.ParseError) as error:
        raise StationError(
            f"the official arm {official} cannot be read: {error}. Remove Drake's "
            "download cache (~/.cache/drake) to load it again, or take visuals: own."
        ) from None
    links = {link.get("name"): link for link in root.iter("link")}
    arm.extend(root.findall("material"))
    for link in arm.iter("link"):
        own_visuals = link.findall("visual")
        if not own_visuals:
            continue
        name = link.get("name")
        visuals = links[name].findall("visual") if name in links else []
        if not visuals:
            raise StationError(
                f"the official arm {official} has no visual on {name}: this Drake "
                "brings another version of it. Take visuals: own."
            )
        for visual in own_visuals:
            link.remove(visual)
        link.extend(visuals)
