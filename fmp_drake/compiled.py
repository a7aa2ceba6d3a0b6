"""Compilation of plain numerical functions, in every environment.

`compiled` is `numba.njit` with a cache on disk. The attribute `py_func` is the function
before compilation; tests compare with it.
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
from numba.core.caching import FunctionCache

logger = logging.getLogger("fmp_drake")


class _Announcer(event.Listener):
    """Listener that logs a message at the first compilation, which takes seconds."""

    def __init__(self) -> None:
        self.is_kept, self._has_announced = True, False

    def on_start(self, event: Any = None) -> None:  # noqa: ARG002
        """Log the message at the first function that is not in the cache."""
        if self._has_announced:
            return
        self._has_announced = True
        purpose = (
            "this machine, once for each kind of run" if self.is_kept else "this run"
        )
        logger.info("compiling for %s: up to half a minute", purpose)
        if not self.is_kept:
            logger.info("no folder can keep it; NUMBA_CACHE_DIR names another one")

    def on_end(self, event: Any) -> None:
        """Log nothing at the end of a compilation."""


_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}

announcer = _Announcer()
event.register("numba:compile", announcer)  # type: ignore[no-untyped-call]

function_counts: Counter[Path] = Counter()
"""Number of compiled functions in each folder."""


class _OptionalCache(FunctionCache):
    """Cache of a compiled function that may be lost, as on a full disk."""

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled function where that is possible."""
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            _warn_of_loss(error.strerror or str(error))


@cache
def _warn_of_loss(reason: str) -> None:
    """Log once that the next process compiles again."""
    logger.warning(
        "compiled code is lost after this run (%s); NUMBA_CACHE_DIR names another folder",
        reason,
    )


def compiled[F: Callable[..., Any]](function: F) -> F:
    """Compile, at its first call, a function of arrays, numbers and named tuples.

    Its cache is beside the module. Where that folder is read-only, it is in the user's
    cache folder, or else in a temporary folder that is deleted with the process. On a
    full disk nothing is stored. The function may call compiled functions of the same
    folder only: the cache is invalidated by folder.
    """
    folder = Path(inspect.getfile(function)).parent
    function_counts[folder] += 1
    dispatcher: Any = numba.njit(**_OPTIONS)(function)
    cache_of: Any = _OptionalCache
    try:
        dispatcher._cache = cache_of(function)
    except RuntimeError:
        # numba refuses to compile without a place for its cache.
        cache_dir = tempfile.mkdtemp(prefix="fmp_drake_")
        atexit.register(shutil.rmtree, cache_dir, ignore_errors=True)
        announcer.is_kept = False
        numba.config.CACHE_DIR = cache_dir  # type: ignore[attr-defined]
        dispatcher._cache = cache_of(function)
    else:
        _forget_outdated(folder, Path(dispatcher.stats.cache_path))
    return dispatcher


def inlined[F: Callable[..., Any]](function: F) -> F:
    """Compile a function as a part of its only caller.

    Compiling it separately would take time in proportion to the functions that it calls.
    """
    return numba.njit(inline="always", **_OPTIONS)(function)


@cache
def _forget_outdated(folder: Path, cached: Path) -> None:
    """Delete the compiled functions of a folder that are older than a module in it.

    numba detects a change of a function's own file, but not of the functions it calls.
    """
    modules = [Path(__file__), *folder.glob("*.py")]
    newest = max(module.stat().st_mtime for module in modules)
    for cache_file in cached.glob("*.nb[ci]"):
        # Another process may delete it at the same time, or the folder is read-only.
        with contextlib.suppress(OSError):
            if cache_file.stat().st_mtime < newest:
                cache_file.unlink()
