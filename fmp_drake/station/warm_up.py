"""Compilation of the functions of stations before a run."""

import atexit
import gc
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
from fmp_drake.primitives import FourierMovementPrimitive, Player
from fmp_drake.station.scenario import Scenario
from fmp_drake.station.station import MakeWipingStation
from fmp_drake.systems.impedance.step import impedance_step
from fmp_drake.systems.ink.grid import CoverageChoice, InkGrid
from fmp_drake.systems.ink.mesh import corner_shades, ink_mesh
from fmp_drake.systems.ink.rubbing import Cells, compile_rubbing
from fmp_drake.systems.page.paths import rod_mesh

# The law needs nothing that the package `systems` imports, which would take a second. Another
# second would be needed to free the compiler's memory: os._exit skips that.
_COMPILE_STEP = """
import os, sys, types
import fmp_drake
systems = types.ModuleType("fmp_drake.systems")
systems.__path__ = [os.path.join(fmp_drake.__path__[0], "systems")]
sys.modules[systems.__name__] = systems
from fmp_drake.systems.impedance.compilation import compile_step
compile_step()
os._exit(0)
"""

_FAST_COMPILATION = {
    "NUMBA_OPT": "1",
    "NUMBA_LOOP_VECTORIZE": "0",
    "NUMBA_SLP_VECTORIZE": "0",
}


class LawCompilation:
    """Compilation of the control law by two other processes, in parallel to this one.

    They write the law and the measured motion into the cache. The level of optimisation is
    low: this saves time, and the compiled law is as fast.
    """

    def __init__(self) -> None:
        function: Any = impedance_step
        cache, python = Path(function.stats.cache_path), function.py_func
        self._count = function_counts[Path(inspect.getfile(python)).parent]
        self._process: subprocess.Popen[bytes] | None = None
        if any(cache.glob(f"*.{python.__name__}-*.nbc")):
            return
        announcer.on_start()
        # Nearly all of the compiler's objects live until its end: a search for garbage among
        # them takes a tenth of the time.
        gc.disable()
        cache_dir = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _COMPILE_STEP],
            env={**os.environ, **_FAST_COMPILATION, "NUMBA_CACHE_DIR": cache_dir},
            bufsize=0,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        output: Any = self._process.stdout
        os.set_blocking(output.fileno(), False)
        self._output, self._done = output, 0
        atexit.register(self._process.kill)

    def progress(self) -> Iterator[float]:
        """Wait for the end of the processes, and yield the compiled fraction meanwhile.

        The functions of the ink are compiled first, in this process. If the others fail,
        the law is compiled at its first call.
        """
        if self._process is None:
            return
        try:
            yield self._fraction()
            _compile_ink()
            while self._process.poll() is None:
                yield self._fraction()
                time.sleep(0.1)
        finally:
            gc.enable()

    def _fraction(self) -> float:
        # The last function, which includes the others, takes a quarter of the time.
        self._done += len(self._output.read() or b"")
        return min(1.0, self._done / self._count) * 3 / 4


def _compile_ink() -> None:
    """Compile the wear and the mesh of the ink, and the choice of samples by ink."""
    grid = InkGrid(size=(0.1, 0.1))
    compile_rubbing(Cells.of(grid))
    ink_mesh(grid, corner_shades(grid.full()))
    choice = CoverageChoice(grid=grid, footprint=(0.05, 0.05), candidates=1)
    choice.wiped(grid.full(), np.zeros((1, 2, 3)))


def WarmUp(report: Callable[[float], object] = lambda _: None) -> None:
    """Compile the functions that a station and its page use.

    This takes up to half a minute, once per machine, in three processes. Later it takes about
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
    rod_mesh(circles, 0.01)  # A function of a page.
    for skill in skills:
        Player(skill).rollout(start=circles[0], duration=1.0)
    for fraction in law.progress():
        report(fraction)
    # The law may be in the cache when these are not.
    _compile_ink()
    for skill in skills:
        station = MakeWipingStation(Scenario(), skill)
        Simulator(station).AdvanceTo(0.15)
