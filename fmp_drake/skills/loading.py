"""Loading of recordings, as recorded or on the board of a scenario."""

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fmp_drake.errors import DemonstrationError, SkillFileError
from fmp_drake.numeric import as_paths, check_number
from fmp_drake.primitives import Demonstration, ReadingOptions, read_demonstrations
from fmp_drake.primitives.data.channels import POSITION_CHANNELS
from fmp_drake.primitives.data.reading.parts import is_part
from fmp_drake.skills.joint_recording import FindRobotOfInverseRotation
from fmp_drake.skills.placement import as_poses, common_placement, place_on_board
from fmp_drake.skills.surface_placement import (
    curved_surface_remark,
    extra_options,
    place_on_fitted_surface,
    with_extra,
)
from fmp_drake.station import Scenario
from fmp_drake.station.scenario import check_scenario


def load_on_board(
    paths: str | Path | Sequence[str | Path],
    *,
    scenario: Scenario,
    transform: Sequence[float] | None = None,
    stretch: float = 1.0,
    reading: ReadingOptions | None = None,
    needs_board: bool = True,
    surface: str | None = None,
    extra: Sequence[str] = (),
    **rhythm: float | None,
) -> tuple[list[Demonstration], list[str]]:
    """Load demonstrations in the frame of the board, with remarks.

    Without `needs_board`, those with neither positions nor a robot's joints are unchanged.
    With a `surface`, "fitted" or one of the shapes, it is fitted to the demonstrations, and
    becomes the scenario's board; `extra` is that of `place_on_fitted_surface`. It returns
    the bouts; otherwise a part between start_time and end_time, of `rhythm` as for
    `find_rhythm`, is placed with the rest of its recording. Recordings of one movement in
    one frame are placed together, by `common_placement`.
    """
    check_scenario(scenario, "load_on_board(paths, scenario=scenario)")
    files = as_paths(paths, "paths", error=SkillFileError)
    demonstrations: list[Demonstration] = []
    remarks: list[str] = []
    if surface is None and extra:
        raise DemonstrationError(
            f"{' and '.join(extra)} can be placed on a fitted surface only (--surface fitted); "
            "a movement in free space: fmp-drake learn --as-recorded."
        )
    if surface is not None:
        if transform is not None:
            raise DemonstrationError(
                "a fitted surface places the recording itself; leave out --transform or "
                "--surface."
            )
        reading = replace(reading or ReadingOptions(), all_arrays=True)
        demonstrations, remarks = load_as_recorded(
            files, stretch=stretch, reading=reading
        )
        if any(d.frame == "board" for d in demonstrations):
            raise DemonstrationError(
                "a recording is relative to its board already (u, v and height), so no "
                "surface can be fitted to it; leave out --surface."
            )
        poses = [as_poses(d, scenario, remarks, **rhythm) for d in demonstrations]
        demonstrations, notes = place_on_fitted_surface(
            poses,
            scenario=scenario,
            shape=None if surface == "fitted" else surface,
            extra=extra,
            **rhythm,
        )
        return demonstrations, [*remarks, *notes]
    loaded = [load_as_recorded([p], stretch=stretch, reading=reading) for p in files]
    parts = [all(is_part(d.channels, d.units) for d in each) for each, _ in loaded]
    common = None
    if transform is None:
        recorded = [d for each, _ in loaded for d in each]
        common = common_placement(recorded, scenario=scenario, **rhythm)
    for path, (recordings, notes), is_one in zip(files, loaded, parts, strict=True):
        remarks += notes
        if is_one and recordings and not all(parts):
            option = f"--surface fitted {extra_options(recordings[0])}"
            remarks.append(f"{path.name} left out: it is learned with {option}")
            continue
        fits_board = transform is not None or all(map(_is_placed, recordings))
        whole = [] if fits_board else _with_all_arrays(path, stretch, reading)
        curved = curved_surface_remark(whole, **rhythm) if whole else ""
        options = extra_options(whole[0]) if whole else ""
        if options and not extra_options(recordings[0]):
            remarks.append(
                f"{path.name}: to learn more of it: --surface fitted {options}"
            )
        for demonstration in recordings:
            try:
                demonstration, notes = place_on_board(
                    demonstration,
                    scenario=scenario,
                    transform=transform,
                    needs_board=needs_board,
                    placement=common,
                    **rhythm,
                )
            except DemonstrationError as error:
                also = f" Also, {curved}." if curved else ""
                raise DemonstrationError(f"{path}: {error}{also}") from None
            demonstrations.append(demonstration)
            remarks += [f"{path.name}: {note}" for note in notes]
        remarks += [f"{path.name}: {curved}"] if curved else []
    return demonstrations, remarks


def _is_placed(demonstration: Demonstration) -> bool:
    """Return whether a recording is in the board's frame, or has no positions."""
    has_position = set(POSITION_CHANNELS) <= set(demonstration.channels)
    return demonstration.frame == "board" or not has_position


def options_for_left_out(
    path: Path, recording: Demonstration, reading: ReadingOptions
) -> str:
    """Return the options that learn arrays which a recording of a file lacks, or ""."""
    # Only an archive of arrays has some that are left out.
    is_archive = zipfile.is_zipfile(path)
    if not is_archive or _is_placed(recording) or extra_options(recording):
        return ""
    whole = _with_all_arrays(path, 1.0, reading)
    return extra_options(whole[0]) if whole else ""


def _with_all_arrays(
    path: Path, stretch: float, reading: ReadingOptions | None
) -> list[Demonstration]:
    """Return the recordings of a file with all its arrays; none where they do not fit."""
    reading = replace(reading or ReadingOptions(), all_arrays=True)
    try:
        return load_as_recorded([path], stretch=stretch, reading=reading)[0]
    except (DemonstrationError, SkillFileError):
        return []


def load_as_recorded(
    paths: Sequence[Path],
    *,
    stretch: float,
    reading: ReadingOptions | None = None,
    extra: Sequence[str] = (),
) -> tuple[list[Demonstration], list[str]]:
    """Load demonstrations with all their channels, and remarks on recognised parts.

    With `extra`, as for `place_on_fitted_surface`, these and the position alone are loaded.
    """
    check_number(stretch, "stretch", above=0, error=DemonstrationError)
    reading = reading or ReadingOptions()
    if extra:
        reading = replace(reading, all_arrays=True)
    demonstrations, remarks = read_demonstrations(paths, reading)
    robots = [*filter(None, map(FindRobotOfInverseRotation, demonstrations))]
    if robots and reading.quaternions is None:
        others, notes = read_demonstrations(paths, replace(reading, quaternions="wxyz"))
        inverse = [*filter(None, map(FindRobotOfInverseRotation, others))]
        if len(inverse) < len(robots):
            demonstrations, remarks = others, notes
            remarks.append(
                "quaternions are read as w, x, y, z: only this order agrees with the "
                f"recorded joints of {min(robots)}"
            )
        robots = inverse
    if robots:
        remarks.append(
            f"the orientation disagrees with the recorded joints of {min(robots)}, which "
            "turn like its inverse: check the names of its columns (--columns)"
        )
    if stretch != 1.0:
        demonstrations = [replace(d, time=d.time * stretch) for d in demonstrations]
    if extra:
        demonstrations = [with_extra(d, extra) for d in demonstrations]
    return demonstrations, remarks
