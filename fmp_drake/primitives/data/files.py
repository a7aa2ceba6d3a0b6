"""Reading and writing files so that nothing broken gets in or out."""

import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from math import prod
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from fmp_drake.errors import FmpError, SkillFileError


class Blocks(Protocol):
    """A float64 array that is read block by block, for it may not fit in memory."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array."""

    def blocks(self) -> Iterator[NDArray[np.float64]]:
        """Yield the rows of the array in their order, some at a time."""


@contextmanager
def replaced(path: Path, error: type[FmpError] = FmpError) -> Iterator[Path]:
    """Yield the path of a temporary file that becomes `path` if nothing fails.

    The file appears whole or not at all: it is written under another name in the same
    folder, with the same ending, and renamed at the end. A process that is killed
    before leaves an older file as it was.

    Parameters
    ----------
    path : pathlib.Path
    error : type of FmpError
        Raised where the operating system does not let the file be written.
    """
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        with part.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(part, path)
    except OSError as reason:
        raise error(f"cannot write {path}: {reason.strerror or reason}.") from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_text(path: Path, text: str, error: type[FmpError] = FmpError) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    with replaced(path, error) as part:
        part.write_text(text, encoding="utf-8")


def read_npz(
    path: Path,
    expected: str,
    error: type[FmpError] = SkillFileError,
    *,
    most: int = 2**32,
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an `.npz` file, none of them pickled.

    Parameters
    ----------
    path : pathlib.Path
    expected : str
        What the file should have been, for the error.
    error : type of FmpError
        Raised where the file cannot be read in full.
    most : int
        Bytes that it may take when it is unpacked.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            _check_sizes(file.zip, most)
            return {name: file[name] for name in file.files}
    except Exception as reason:  # noqa: BLE001
        # Broken bytes surface from NumPy, zipfile and zlib as a dozen types.
        raise error(
            f"{path} is not a readable .npz file ({reason}); {expected}."
        ) from None


def _check_sizes(archive: zipfile.ZipFile, most: int) -> None:
    """Refuse arrays that claim to be larger than is allowed, or than their bytes."""
    total = sum(member.file_size for member in archive.infolist())
    if total > most:
        raise ValueError(
            f"unpacked it takes {total / 2**20:.0f} MB, allowed are {most / 2**20:.0f}"
        )
    for member in archive.infolist():
        with archive.open(member) as stream:
            read = {
                (1, 0): npy.read_array_header_1_0,
                (2, 0): npy.read_array_header_2_0,
            }
            shape, _, dtype = read[npy.read_magic(stream)](stream)
        if prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError(f"{member.filename} is shorter than its shape {shape}")


def write_npz(
    path: Path,
    arrays: Mapping[str, NDArray[Any] | Blocks],
    error: type[FmpError] = SkillFileError,
    *,
    compressed: bool = True,
) -> None:
    """Write arrays to an `.npz` file, whole or not at all.

    Parameters
    ----------
    path : pathlib.Path
    arrays : mapping from str to ndarray or Blocks
        Those given in blocks are never in memory as a whole.
    error : type of FmpError
        Raised where the file cannot be written.
    compressed : bool
    """
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with (
        replaced(path, error) as part,
        zipfile.ZipFile(part, "w", method) as archive,
    ):
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                if isinstance(array, np.ndarray):
                    npy.write_array(stream, array, allow_pickle=False)
                    continue
                header = {"descr": "<f8", "fortran_order": False, "shape": array.shape}
                npy.write_array_header_1_0(stream, header)
                for block in array.blocks():
                    stream.write(np.ascontiguousarray(block, dtype="<f8").tobytes())


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
