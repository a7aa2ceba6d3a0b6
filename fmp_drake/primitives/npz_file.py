"""Reading and writing `.npz` files so that nothing broken gets in or out."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError


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
