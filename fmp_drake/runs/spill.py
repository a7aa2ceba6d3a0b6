"""Arrays that grow in a temporary file instead of in memory."""

import math
import os
import tempfile
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

_BLOCK_BYTES = 1 << 20


class Spill:
    """Rows of numbers that are appended to a temporary file without a name.

    The file takes no memory, and it vanishes with the process, also when that is
    killed. It lies in the system's folder for temporary files (`TMPDIR`).

    Parameters
    ----------
    row : tuple of int
        Shape of a row, () for a number.
    dtype : data type
    """

    def __init__(
        self, row: tuple[int, ...] = (), dtype: DTypeLike = np.float64
    ) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        self._dtype = np.dtype(dtype)
        self._row = row
        self._rows = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the rows so far."""
        return self._rows, *self._row

    def append(self, rows: ArrayLike) -> None:
        """Append rows, shape (n, ...)."""
        added = np.asarray(rows, dtype=self._dtype).reshape(-1, *self._row)
        self._file.write(added.tobytes())
        self._rows += len(added)

    def array(self) -> NDArray[Any]:
        """Return all rows so far, read only; they are read from the file when used."""
        if not self._rows:
            return np.zeros(self.shape, dtype=self._dtype)
        self._file.flush()
        return np.asarray(np.memmap(self._file, self._dtype, "r", shape=self.shape))

    def blocks(self) -> Iterator[NDArray[Any]]:
        """Yield all rows so far in blocks of about a megabyte."""
        self._file.flush()
        size = math.prod(self._row) * self._dtype.itemsize
        step = max(1, _BLOCK_BYTES // size) * size
        for start in range(0, self._rows * size, step):
            count = min(step, self._rows * size - start)
            data = os.pread(self._file.fileno(), count, start)
            yield np.frombuffer(data, self._dtype).reshape(-1, *self._row)
