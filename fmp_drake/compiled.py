"""Compilation of plain numerical functions, in every environment.

`compiled` is `numba.njit` with a cache on disk. The function as it was written stays
at its attribute `py_func`, which is what the tests compare with.
"""

import atexit
import logging
import shutil
import tempfile
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

logger = logging.getLogger("fmp_drake")


class _Announcer(event.Listener):
    """Says once that something is compiled, because that takes seconds."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: Any) -> None:  # noqa: ARG002
        """Say it at the first function that is not in the cache."""
        if not self._said:
            self._said = True
            logger.info("compiling, once for this computer; it takes some seconds")

    def on_end(self, event: Any) -> None:
        """Nothing is said at the end."""


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}

event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]


def compiled[F: Callable[..., Any]](function: F) -> F:
    """Compile a function of arrays, numbers and named tuples of them at its first call.

    Its cache is beside the module, in the user's cache folder where that is read-only,
    or else in a temporary folder that lasts as long as the process.
    """
    compile_later = numba.njit(cache=True, **_OPTIONS)
    try:
        return compile_later(function)
    except RuntimeError:
        # There is no place for a cache, and without one numba refuses to compile.
        folder = tempfile.mkdtemp(prefix="fmp_drake_")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
        return compile_later(function)


def inlined[F: Callable[..., Any]](function: F) -> F:
    """Compile a function as a part of the only one that calls it.

    It is not compiled on its own before, which takes as long as what it calls is large.
    """
    return numba.njit(inline="always", **_OPTIONS)(function)
