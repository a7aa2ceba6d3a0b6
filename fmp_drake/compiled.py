"""Compilation of plain numerical functions, in every environment.

`compiled` is `numba.njit` with a cache on disk. The function as it was written stays
at its attribute `py_func`, which is what the tests compare with.
"""

import atexit
import contextlib
import inspect
import logging
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import event

logger = logging.getLogger("fmp_drake")


class _Announcer(event.Listener):
    """Log message at the first compilation, which takes seconds."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: Any = None) -> None:  # noqa: ARG002
        """Log it at the first function that is not in the cache."""
        if not self._said:
            self._said = True
            logger.info("compiling, once per machine; it takes up to half a minute")

    def on_end(self, event: Any) -> None:
        """Nothing is said at the end."""


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}

announcer = _Announcer()
event.register("numba:compile", announcer)  # type: ignore[no-untyped-call]

function_counts: Counter[Path] = Counter()
"""How many compiled functions each folder has."""


def compiled[F: Callable[..., Any]](function: F) -> F:
    """Compile a function of arrays, numbers and named tuples of them at its first call.

    Its cache is beside the module, in the user's cache folder where that is read-only,
    or else in a temporary folder that lasts as long as the process. It may call compiled
    functions of its own folder, and of no other.
    """
    folder = Path(inspect.getfile(function)).parent
    _forget_outdated(folder)
    function_counts[folder] += 1
    compile_later = numba.njit(cache=True, **_OPTIONS)
    try:
        return compile_later(function)
    except RuntimeError:
        # numba refuses to compile without a place for its cache.
        place = tempfile.mkdtemp(prefix="fmp_drake_")
        atexit.register(shutil.rmtree, place, ignore_errors=True)
        numba.config.CACHE_DIR = place  # type: ignore[attr-defined]
        return compile_later(function)


def inlined[F: Callable[..., Any]](function: F) -> F:
    """Compile a function as a part of the only one that calls it.

    It is not compiled on its own before, which takes as long as what it calls is large.
    """
    return numba.njit(inline="always", **_OPTIONS)(function)


@cache
def _forget_outdated(folder: Path) -> None:
    """Delete the compiled functions of a folder that are older than a module in it.

    numba notices a change of a function's own file, and not of those that it calls.
    """
    modules = [Path(__file__), *folder.glob("*.py")]
    newest = max(module.stat().st_mtime for module in modules)
    for kept in (folder / "__pycache__").glob("*.nb[ci]"):
        # Another process may be doing the same, or nobody may write here.
        with contextlib.suppress(OSError):
            if kept.stat().st_mtime < newest:
                kept.unlink()
