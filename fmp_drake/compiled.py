"""Compilation of plain numerical functions, in every environment.

`compiled` is `numba.njit` with a cache on disk. The function as it was written stays
at its attribute `py_func`, which is what the tests compare with.
"""

import logging
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

logger = logging.getLogger("fmp_drake")


def _is_writable(folder: Path) -> bool:
    """Tell whether files can be made in a folder, or in the one that would hold it."""
    while not folder.exists():
        folder = folder.parent
    return os.access(folder, os.W_OK)


# Without a place for its cache numba refuses to compile.
_PLACES = (Path(__file__).parent, Path(os.environ.get("HOME", "/")) / ".cache")
if "NUMBA_CACHE_DIR" not in os.environ and not any(map(_is_writable, _PLACES)):
    os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="fmp_drake_")

# numba reads the environment when it is imported.
import numba
from numba.core import event


class _Announcer(event.Listener):
    """Says once that something is compiled, because that takes seconds."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: Any) -> None:  # noqa: ARG002
        """Say it at the first function that is not in the cache."""
        if not self._said:
            self._said = True
            logger.info("compiling, once for this computer; it takes about 10 s")

    def on_end(self, event: Any) -> None:
        """Nothing is said at the end."""


event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]


def compiled[F: Callable[..., Any]](function: F) -> F:
    """Compile a function of arrays, numbers and named tuples of them at its first call.

    Its cache is beside the module, in the user's cache folder where that is read-only,
    or else in a temporary folder for this process.
    """
    return numba.njit(  # type: ignore[call-overload]
        cache=True, error_model="numpy", no_cfunc_wrapper=True
    )(function)
