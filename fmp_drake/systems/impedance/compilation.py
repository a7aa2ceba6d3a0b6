"""Compilation of the controller's functions by two processes, side by side.

One compiles `impedance_step`, the other those of its last parts that take longest to
compile. These are ready in the cache before the first process needs them.
"""

import gc
import os
import sys
from typing import Any

import numba
import numpy as np
from numba.core import event
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.cpu import CPUContext
from numba.core.dispatcher import Dispatcher
from numba.core.sigutils import normalize_signature

from fmp_drake.systems.impedance.joints import JointLimits, limited_torque
from fmp_drake.systems.impedance.law import ArmDynamics, impedance_law, mobility
from fmp_drake.systems.impedance.records import LAYOUT
from fmp_drake.systems.impedance.step import (
    STEP_TYPES,
    impedance_step,
    measured_motion,
)


class _Progress(event.Listener):
    """Output of one byte for each function that has been compiled."""

    def on_start(self, event: Any) -> None:
        """Output nothing at the start of a compilation."""

    def on_end(self, event: Any) -> None:
        """Output a byte if the function is one of this folder."""
        if event.data["dispatcher"].__module__.startswith(f"{__package__}."):
            os.write(sys.stdout.fileno(), b".")


class _InnerLibrary(JITCodeLibrary):
    """Code of a function that is compiled only as a part of others.

    It is optimised and translated with theirs, not once more on its own.
    """

    def _optimize_final_module(self) -> None:
        """Leave the code as it is."""

    def _finalize_final_module(self) -> None:
        """Make the code ready to be part of another one, without machine code."""
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


def compile_step() -> None:
    """Compile the update, and `measured_motion`, into the cache.

    The other process is a copy of this one, made after the imports and the compilation of
    what both need.
    """
    event.register("numba:compile", _Progress())  # type: ignore[no-untyped-call]
    # Nearly all of the compiler's objects live until its end: a search for garbage among
    # them takes a fifth of the time.
    gc.disable()
    parts = _parts()
    _leave_inside({impedance_step, *(function for function, _ in parts)})
    matrix = np.zeros((6, 6))
    _compile(mobility, (matrix, matrix))
    child = os.fork()
    if child == 0:
        try:
            for function, arguments in parts:
                _compile(function, arguments)
        finally:
            os._exit(0)
    types, _ = normalize_signature(STEP_TYPES)  # type: ignore[no-untyped-call]
    step: Any = impedance_step
    step.compile(types)
    os.waitpid(child, 0)


def _leave_inside(stored: set[Any]) -> None:
    """Compile all other functions only as parts of the stored ones, without code to call them.

    Python could not call them, so they are not stored in the cache. The code that reads
    Python's arguments is a fifth of all, and machine code of the parts another fifth.
    """
    names = {function.py_func.__qualname__ for function in stored}
    codegen: Any = JITCPUCodegen
    context: Any = CPUContext
    get_executable = context.get_executable

    def create_library(self: Any, name: str) -> Any:
        kind: Any = JITCodeLibrary if name in names else _InnerLibrary
        return kind(self, name)

    def get_stored_executable(self: Any, library: Any, *options: Any) -> Any:
        if not isinstance(library, _InnerLibrary):
            return get_executable(self, library, *options)
        library._ensure_finalized()  # type: ignore[no-untyped-call]
        return [].append  # A different builtin for each function, which nobody calls.

    codegen.create_library = create_library
    context.get_executable = get_stored_executable
    for name, module in list(sys.modules.items()):
        if name.startswith(f"{__package__}."):
            for function in vars(module).values():
                if isinstance(function, Dispatcher) and function not in stored:
                    function._cache = NullCache()  # type: ignore[attr-defined]
                    function.targetoptions["no_cpython_wrapper"] = True


def _compile(function: Any, arguments: tuple[Any, ...]) -> None:
    function.compile(tuple(map(numba.typeof, arguments)))


def _parts() -> list[tuple[Any, tuple[Any, ...]]]:
    """Return each part, and `measured_motion`, with arguments of their types."""
    settings: Any = np.zeros(1, LAYOUT).view(np.recarray)[0]
    config, six, matrix = settings.config, np.zeros(6), np.zeros((6, 6))
    n = 7
    joint, M = np.zeros(n), np.eye(n)
    arm = ArmDynamics(joint, M, joint, np.zeros((6, n)), six)
    limits = JointLimits(joint, joint, joint, joint, joint)
    return [
        (impedance_law, (config, arm, matrix, six, six, six, six, joint)),
        (
            limited_torque,
            (
                config.walls,
                limits,
                joint,
                joint,
                1.0,
                1.0,
                joint,
                joint,
                M,
                joint,
                joint,
            ),
        ),
        (
            measured_motion,
            (np.zeros(1, np.uint8), six, np.zeros((4, 3)), six),
        ),
    ]
