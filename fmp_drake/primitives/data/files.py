"""Reading and writing `.npz` files so that nothing broken gets in or out."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import FmpError, SkillFileError


def read_npz(path: Path, expected: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of an `.npz` file, none of them pickled.

    Parameters
    ----------
    path : pathlib.Path
    expected : str
        What the file should have been, for the error.

    Raises
    ------
    SkillFileError
        Where the file cannot be read in full.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception as error:  # noqa: BLE001
        # Broken bytes surface from NumPy, zipfile and zlib as a dozen types.
        raise SkillFileError(
            f"{path} is not a readable .npz file ({error}); {expected}."
        ) from None


def write_npz(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays to an `.npz` file; an existing one is replaced at the end.

    Raises
    ------
    SkillFileError
        Where the file cannot be written; an existing one is then as before.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **arrays)
        os.replace(part, path)
    except OSError as error:
        raise SkillFileError(f"cannot write {path}: {error.strerror}.") from None
    finally:
        part.unlink(missing_ok=True)


def read_versioned(
    path: Path, *, hint: str, foreign: str, form: str, newest: int
) -> tuple[dict[str, Any], dict[str, NDArray[Any]], int]:
    """Read a file whose array `metadata` is JSON with a format and a version.

    Parameters
    ----------
    path : Path
    hint : str
        Where such files come from, for a broken one.
    foreign : str
        What is said of another format.
    form : str
        The format.
    newest : int
        The newest version that can be read.

    Returns
    -------
    metadata, arrays, version

    Raises
    ------
    SkillFileError
        Where the file is broken, foreign or newer.
    """
    arrays = read_npz(path, hint)
    try:
        metadata = json.loads(str(arrays["metadata"]))
        is_foreign, version = metadata["format"] != form, int(metadata["version"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise SkillFileError(foreign) from None
    if is_foreign:
        raise SkillFileError(foreign)
    if version > newest:
        raise SkillFileError(
            f"{path} has version {version}; this fmp_drake reads up to version "
            f"{newest}. Update fmp_drake."
        )
    return metadata, arrays, version


def check_writable(path: Path | None) -> None:
    """Refuse an output file that cannot be written, before any work is done."""
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise FmpError(
            f"there is no folder {path.absolute().parent} to write {path.name} into."
        )
    if path.is_dir():
        raise FmpError(f"{path} is a folder; give the name of a file to write.")
