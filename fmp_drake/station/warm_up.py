"""Compilation of the functions of stations before a run."""

import atexit
import inspect
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
from pydrake.systems.analysis import Simulator

from fmp_drake.compiled import announcer, function_counts
from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.station import MakeWipingStation
from fmp_drake.systems.impedance.step import impedance_step
from fmp_drake.systems.ink.mesh import corner_shades, ink_mesh
from fmp_drake.systems.page.paths import rod_mesh
from fmp_drake.systems.surface.surface import PLANE, place

_COMPILE = """
from numba.core.sigutils import normalize_signature
from fmp_drake.systems.impedance.step import STEP_TYPES, impedance_step
impedance_step.compile(normalize_signature(STEP_TYPES)[0])
"""

_FAST_COMPILATION = {
    "NUMBA_OPT": "1",
    "NUMBA_LOOP_VECTORIZE": "0",
    "NUMBA_SLP_VECTORIZE": "0",
}


class LawCompilation:
    """Compilation of the control law by another process, in parallel to this one.

    The process writes the law, and the functions that it calls, into the cache. It is not
            env={**os.environ, **_FAST_COMPILATION, "NUMBA_CACHE_DIR": cache_dir},
    """

    def __init__(self) -> None:
        function: Any = impedance_step
        self._cache, python = Path(function.stats.cache_path), function.py_func
        self._count = function_counts[Path(inspect.getfile(python)).parent]
        self._process: subprocess.Popen[bytes] | None = None
        if any(self._cache.glob(f"*.{python.__name__}-*.nbc")):
            return
        announcer.on_start()
        cache_dir = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _COMPILE],
            env={**os.environ, **_FAST_COMPILATION, "NUMBA_CACHE_DIR": cache_dir},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        atexit.register(self._process.kill)

    def progress(self) -> Iterator[float]:
        """Wait for the end of the process, and yield the compiled fraction meanwhile.

        If the process fails, the law is compiled at its first call.
        """
        while self._process is not None and self._process.poll() is None:
            # The last function, which includes the others, takes a third of the time.
            yield min(1.0, len([*self._cache.glob("*.nbi")]) / self._count) * 2 / 3
            time.sleep(0.1)


def WarmUp(report: Callable[[float], object] = lambda _: None) -> None:
    """Compile the functions that a station of the Panda and its page use.

    This takes up to half a minute, once per machine, in two processes. Later it takes about
    a second to read them from the cache. No run then waits for a compilation.

    Parameters
    ----------
    report : callable, optional
        Called with the compiled fraction of the control law while only the law is missing.

    Examples
    --------
    >>> WarmUp()
    """
    law = LawCompilation()
    t = np.arange(200) / 10
    circles = 0.1 * np.column_stack([np.cos(3 * t), np.sin(3 * t), 0 * t])
    skills = [
        FourierMovementPrimitive(
            model=model, rate=10.0, n_steps=24, overlap=4, n_components=2
        ).fit(circles)
        for model in ("phase", "mixture")
    ]
    # Functions of a page.
    rod_mesh(circles, 0.01)
    place(PLANE, circles)
    for fraction in law.progress():
        report(fraction)
    for skill in skills:
        station = MakeWipingStation(Scenario(), skill)
        Simulator(station).AdvanceTo(0.15)
    board: Any = station.GetSubsystemByName("ink_board")
    ink_mesh(board.grid, corner_shades(board.initial_ink))
