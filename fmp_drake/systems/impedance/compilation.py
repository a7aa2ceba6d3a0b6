"""Compilation of the controller's update by two processes, side by side.

One compiles `impedance_step`, the other the two of its parts that take longest. The parts
are ready in the cache before the first process needs them.
"""

import gc
import os
import shutil
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.sigutils import normalize_signature

from fmp_drake.systems.impedance.algebra import Pose
from fmp_drake.systems.impedance.config import ImpedanceConfig
from fmp_drake.systems.impedance.joints import JointLimits, limited_torque
from fmp_drake.systems.impedance.law import ArmDynamics, impedance_law
from fmp_drake.systems.impedance.records import settings_of
from fmp_drake.systems.impedance.step import STEP_TYPES, impedance_step


def compile_step() -> None:
    """Compile the update, and the functions that it calls, into the cache."""
    types, _ = normalize_signature(STEP_TYPES)  # type: ignore[no-untyped-call]
    _compile(impedance_step, types)


def compile_parts(destination: str) -> None:
    """Compile two parts of the update, and copy their compiled code to a folder.

    Parameters
    ----------
    destination : str
        The folder of the update's cache. The cache of this process must be another one:
        two processes that compile one function for different types would overwrite each
        other's files.
    """
    for function, arguments in _parts():
        _compile(function, tuple(map(numba.typeof, arguments)))
        name = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        # The code (.nbc) before the index that names it (.nbi).
        for file in sorted(Path(function.stats.cache_path).glob(f"{name}-*")):
            copy = Path(destination, f"{file.name}.{os.getpid()}")
            shutil.copyfile(file, copy)
            copy.replace(Path(destination, file.name))


def _compile(function: Any, types: tuple[Any, ...]) -> None:
    # Nearly all of the compiler's objects live until its end: a search for garbage among
    # them takes a fifth of the time.
    gc.disable()
    function.compile(types)


def _parts() -> list[tuple[Any, tuple[Any, ...]]]:
    """Return each part with arguments of the types that the update passes to it."""
    settings: Any = settings_of(
        ImpedanceConfig(), X_WT=Pose(np.eye(3), np.zeros(3)), engage_height=1.0
    ).view(np.recarray)[0]
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
    ]
