"""Reading and writing of complete files, and the format of the package's own."""

import glob
import itertools
import json
import math
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from fmp_drake.errors import FmpError, SkillFileError

# Bytes of a file's name that its temporary name repeats; file systems allow 255 in all.
_LONGEST_STEM = 180


@contextmanager
def replaced(path: Path, error: type[FmpError] = FmpError) -> Iterator[Path]:
    """Yield the path of a temporary file that is renamed to `path` if nothing fails.

    The file therefore appears whole or not at all. The temporary file is in the same
    folder and has the same ending. A process that is killed does not change an older
    file; the temporary file that it leaves is deleted when the same file is written
    again. A link is followed.

    Parameters
    ----------
    path : pathlib.Path
    error : type of FmpError
        Raised where the file cannot be written, or is a device or a pipe.
    """
    ending = path.suffix
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():
        raise error(f"cannot write {path}: it is not a regular file.")
    _delete_abandoned(path, ending)
    part = path.with_name(f".{_short_stem(path)}.{os.getpid()}.part{ending}")
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


def _short_stem(path: Path) -> str:
    """Return the beginning of a name, so that a temporary name is not too long."""
    return os.fsdecode(os.fsencode(path.stem)[:_LONGEST_STEM])


def _delete_abandoned(path: Path, ending: str) -> None:
    """Delete temporary files whose processes have ended."""
    stem = _short_stem(path)
    name = f".{glob.escape(stem)}.*.part{glob.escape(ending)}"
    for part in path.parent.glob(name):
        process = part.name.removeprefix(f".{stem}.").partition(".")[0]
        if not process.isdecimal():
            continue
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            with suppress(OSError):
                part.unlink()
        except (OSError, OverflowError):
            continue


def write_text(path: Path, text: str, error: type[FmpError] = FmpError) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    with replaced(path, error) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any, error: type[FmpError] = FmpError) -> None:
    """Write numbers, texts, lists and mappings, with null for infinity and NaN."""
    text = json.dumps(_finite(value), indent=2, allow_nan=False)
    write_text(path, text + "\n", error)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    is_number = isinstance(value, float)
    return None if is_number and not math.isfinite(value) else value


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
        Description of the expected file, for the error.
    error : type of FmpError
        Raised where the file cannot be read in full.
    most : int
        Greatest size when unpacked, bytes.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            _check_sizes(file.zip, most)
            return {name: file[name] for name in file.files}
    except Exception as reason:  # noqa: BLE001
        # Broken bytes surface from NumPy, zipfile and zlib as a dozen types.
        is_other = path.is_file() and not zipfile.is_zipfile(path)
        why = "it is not an archive of arrays" if is_other else reason
        raise error(
            f"{path} is not a readable .npz file ({why}); {expected}."
        ) from None


def _check_sizes(archive: zipfile.ZipFile, most: int) -> None:
    """Refuse arrays that are larger than allowed, or larger than their stored bytes."""
    total = sum(member.file_size for member in archive.infolist())
    if total > most:
        raise ValueError(
            f"unpacked it takes {total / 2**20:.0f} MB; "
            f"at most {most / 2**20:.0f} MB are read"
        )
    for member in archive.infolist():
        with archive.open(member) as stream:
            read = {
                (1, 0): npy.read_array_header_1_0,
                (2, 0): npy.read_array_header_2_0,
            }
            shape, _, dtype = read[npy.read_magic(stream)](stream)
        if math.prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError(f"{member.filename} is shorter than its shape {shape}")


def write_npz(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    error: type[FmpError] = SkillFileError,
    *,
    compressed: bool = True,
) -> None:
    """Write arrays to an `.npz` file, whole or not at all.

    Parameters
    ----------
    path : pathlib.Path
    arrays : mapping from str to ndarray
        A memory map is written in blocks, and is never in memory as a whole.
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
                npy.write_array(stream, array, allow_pickle=False)


def numbered(path: Path, count: int) -> list[Path]:
    """Return names for several files: `a.npz`, `a_2.npz`, `a_3.npz` ..."""
    names = [path.name, *(f"{path.stem}_{i}{path.suffix}" for i in range(2, count + 1))]
    return [path.with_name(name) for name in names[:count]]


def is_numbered(path: Path, first: Path) -> bool:
    """Return whether `numbered` may give a name to one of the files that begin with `first`."""
    form = rf"{re.escape(first.stem)}(_\d+)?{re.escape(first.suffix)}"
    is_beside = path.absolute().parent == first.absolute().parent
    return is_beside and re.fullmatch(form, path.name) is not None


def keep_earlier_files(series: Path, single: Path) -> list[str]:
    """Rename files that are about to be written: `a.npz` becomes `a.1.npz`.

    All of them get the same number, the first that is free.

    Parameters
    ----------
    series : pathlib.Path
        First of several files, as `numbered` names them; the others are renamed, too.
    single : pathlib.Path

    Returns
    -------
    list of str
        The new names.

    Raises
    ------
    FmpError
        If a file cannot be renamed.
    """
    beside = sorted(series.absolute().parent.glob("*"))
    old = [path for path in beside if is_numbered(path, series)]
    if single.exists():
        old.append(single)
    for number in itertools.count(1):
        new = [p.with_name(f"{p.stem}.{number}{p.suffix}") for p in old]
        if not any(path.exists() for path in new):
            break
    for before, after in zip(old, new, strict=True):
        try:
            before.rename(after)
        except OSError as reason:
            raise FmpError(f"cannot rename {before}: {reason.strerror}.") from None
    return [path.name for path in new]


def check_writable(
    path: Path | None,
    what: str = "",
    endings: Sequence[str] = (),
    error: type[FmpError] = FmpError,
) -> None:
    """Raise where an output file cannot be written, before any work is done.

    Parameters
    ----------
    path : pathlib.Path, optional
        Nothing is checked if None.
    what : str
        Content of the file with its article, such as "a film", for the error.
    endings : sequence of str
        Allowed endings of its name; any where empty.
    error : type of FmpError
        Raised for another ending.
    """
    if path is None:
        return
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise FmpError(f"{path} is a link that leads to itself.")
    folder = target.parent
    if not folder.is_dir():
        raise FmpError(f"there is no folder {folder} to write {path.name} into.")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FmpError(f"the folder {folder} of {path.name} is read-only.")
    if path.is_dir():
        raise FmpError(f"{path} is a folder; give the name of a file to write.")
    if path.exists() and not path.is_file():
        raise FmpError(
            f"{path} is a device or a pipe; give the name of a file to write."
        )
    if endings and path.suffix.lower() not in endings:
        *others, last = endings
        expected = f"{', '.join(others)} or {last}" if others else last
        raise error(f"{path} is not {what}; its name must end in {expected}.")


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A kind of `.npz` file: arrays and metadata in JSON, without pickle.

    Attributes
    ----------
    name : str
        Entry `format` of the metadata.
    version : int
        Version that is written, and the newest that can be read.
    what : str
        Name of such a file in errors.
    source : str
        Origin of such files, for errors.
    error : type of FmpError
        Raised for files that cannot be read or written.
    compressed : bool
        False where compression takes long and saves nothing, as with learned numbers.

    Examples
    --------
    >>> tables = FileFormat(
    ...     name="table", version=1, what="table", source="written by hand"
    ... )
    >>> tables.parse(Path("t.npz"), np.array('{"format": "table", "version": 1}'))
    {'format': 'table', 'version': 1}
    """

    name: str
    version: int
    what: str
    source: str
    error: type[FmpError] = SkillFileError
    compressed: bool = True

    def write(
        self,
        path: Path,
        metadata: Mapping[str, Any],
        arrays: Mapping[str, NDArray[Any]],
    ) -> None:
        """Write metadata and arrays to a file, whole or not at all."""
        header = {"format": self.name, "version": self.version, **metadata}
        text = json.dumps(header, default=_as_python)
        arrays = {"metadata": np.array(text), **arrays}
        write_npz(path, arrays, self.error, compressed=self.compressed)

    def read(self, path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return metadata and arrays; refuse a missing, broken or foreign file."""
        if not path.is_file():
            raise self.error(
                f"there is no {self.what} {path}; a {self.what} is {self.source}."
            )
        arrays = read_npz(path, f"a {self.what} is {self.source}", self.error)
        return self.parse(path, arrays.pop("metadata", None)), arrays

    def parse(self, path: Path, array: NDArray[Any] | None) -> dict[str, Any]:
        """Return the metadata in the array of a file; refuse a newer version."""
        try:
            metadata: dict[str, Any] = json.loads(str(array))
            name, version = str(metadata["format"]), int(metadata["version"])
        except (KeyError, TypeError, ValueError, OverflowError):
            name, version = "", 0
        if name != self.name:
            other = f" (its format is {name[:40]})" if name else ""
            raise self.error(
                f"{path} is not a {self.what} of fmp_drake{other}; a {self.what} is "
                f"{self.source}."
            )
        if version > self.version:
            raise self.error(
                f"{path} has version {version}; this fmp_drake reads up to version "
                f"{self.version}. Update fmp_drake."
            )
        return metadata


def _as_python(value: Any) -> Any:
    """Return a NumPy number or array as a Python object, for JSON."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} cannot be written to a file.")
