"""Formats of the package's own `.npz` files: a name, a version, who writes them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmp_drake.errors import FmpError, SkillFileError
from fmp_drake.primitives.data.files import Blocks, read_npz, write_npz


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A kind of `.npz` file: arrays, one of them metadata in JSON, without pickle.

    Attributes
    ----------
    name : str
        In the metadata, as `format`.
    version : int
        The newest that can be read, and the one that is written.
    what : str
        How errors call such a file.
    source : str
        Where such files come from, as errors say it.
    error : type of FmpError
        Raised for files that cannot be read or written.
    compressed : bool
        Not where it would save nothing and take long: learned numbers have no pattern.

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
        arrays: Mapping[str, NDArray[Any] | Blocks],
    ) -> None:
        """Write metadata and arrays to a file, whole or not at all."""
        about = {"format": self.name, "version": self.version, **metadata}
        text = json.dumps(about, default=_plain)
        arrays = {"metadata": np.array(text), **arrays}
        write_npz(path, arrays, self.error, compressed=self.compressed)

    def read(self, path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return metadata and arrays; refuse a missing, broken or foreign file."""
        if not path.is_file():
            raise self.error(f"there is no {self.what} {path}.")
        arrays = read_npz(path, f"a {self.what} is {self.source}", self.error)
        return self.parse(path, arrays.pop("metadata", None)), arrays

    def parse(self, path: Path, array: NDArray[Any] | None) -> dict[str, Any]:
        """Return the metadata in the array of a file; refuse a newer version."""
        try:
            metadata: dict[str, Any] = json.loads(str(array))
            is_ours, version = metadata["format"] == self.name, int(metadata["version"])
        except (KeyError, TypeError, ValueError, OverflowError):
            is_ours, version = False, 0
        if not is_ours:
            raise self.error(
                f"{path} is no {self.what} of fmp_drake; a {self.what} is {self.source}."
            )
        if version > self.version:
            raise self.error(
                f"{path} has version {version}; this fmp_drake reads up to version "
                f"{self.version}. Update fmp_drake."
            )
        return metadata


def _plain(value: Any) -> Any:
    """Return a NumPy number or array, as parameters may be, as Python's own."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{value!r} cannot be written to a file.")
