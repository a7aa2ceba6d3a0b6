"""Compilation of the controller's update by two processes, side by side.

One compiles `impedance_step`, the other those of its parts that take longest. The parts
are ready in the cache before the first process needs them.
"""

import gc
import os
import sys
from typing import Any

import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
from numba.core.sigutils import normalize_signature

from fmp_drake.systems.impedance.joints import JointLimits, limited_torque
from fmp_drake.systems.impedance.law import ArmDynamics, impedance_law, mobility
from fmp_drake.systems.impedance.records import LAYOUT, MEMORY, PACKED
from fmp_drake.systems.impedance.step import (
    STEP_TYPES,
    impedance_step,
    next_stiffness,
)


def compile_step() -> None:
    """Compile the update, and the functions that it calls, into the cache.

    The other process is a copy of this one: it has imported and compiled already what
    both need.
    """
    # Nearly all of the compiler's objects live until its end: a search for garbage among
    # them takes a fifth of the time.
    gc.disable()
    matrix = np.zeros((6, 6))
    _compile(mobility, (matrix, matrix))
    if os.fork() == 0:
        try:
            _compile_parts()
        finally:
            os._exit(0)
    types, _ = normalize_signature(STEP_TYPES)  # type: ignore[no-untyped-call]
    step: Any = impedance_step
    step.compile(types)


def _compile_parts() -> None:
    """Compile some parts of the update, and store only these in the cache.

    Two processes that store one function for different types at once would overwrite each
    other's files.
    """
    parts = _parts()
    stored = [function for function, _ in parts]
    for name, module in list(sys.modules.items()):
        if name.startswith(f"{__package__}."):
            for function in vars(module).values():
                if isinstance(function, Dispatcher) and function not in stored:
                    function._cache = NullCache()  # type: ignore[attr-defined]
    for function, arguments in parts:
        _compile(function, arguments)


def _compile(function: Any, arguments: tuple[Any, ...]) -> None:
    function.compile(tuple(map(numba.typeof, arguments)))


def _parts() -> list[tuple[Any, tuple[Any, ...]]]:
    """Return each part with arguments of the types that the update passes to it."""
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
            next_stiffness,
            (settings, np.zeros(1, MEMORY)[0], np.zeros(1, PACKED)[0], six),
        ),
    ]
