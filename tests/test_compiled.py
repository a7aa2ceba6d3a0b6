"""Facts about the compilation of plain functions."""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path
from types import CodeType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import fmp_drake
from fmp_drake.primitives.playback.motion import decayed_offset

# Nothing can be written but below the folder for temporary files.
READ_ONLY = """
import os, tempfile
real, temporary = tempfile.TemporaryFile, tempfile.gettempdir()

def refuse(*arguments, dir=None, **keywords):
    if not str(dir).startswith(os.path.join(temporary, "fmp_drake_")):
        raise PermissionError(dir)
    return real(*arguments, dir=dir, **keywords)

tempfile.TemporaryFile = refuse
"""

# The disk is full: files can be made, and nothing can be written into them.
FULL = """
from numba.core.caching import IndexDataCacheFile

def fail(*arguments):
    raise OSError(28, "No space left on device")

IndexDataCacheFile._save_index = fail
"""

USE = """
import logging, sys
logging.basicConfig(level=logging.INFO)
import numpy as np
from fmp_drake.primitives.playback.motion import decayed_offset
print(decayed_offset(np.ones((2, 3)), 0.4, 0.1)[0, 0])
print(decayed_offset.stats.cache_path)
"""


def run(code, *arguments):
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True)


def names_in(code):
    """Return the names that a function's code, and functions in it, refer to."""
    inner = [c for c in code.co_consts if isinstance(c, CodeType)]
    return {*code.co_names, *(name for c in inner for name in names_in(c))}


def folder(function):
    return function.__module__.rpartition(".")[0]


def test_compiled_functions_call_only_those_of_their_folder():
    # Otherwise it would not be seen that a called one has changed.
    calls = []
    for found in pkgutil.walk_packages(fmp_drake.__path__, "fmp_drake."):
        known = vars(importlib.import_module(found.name))
        for caller in list(known.values()):
            if isinstance(caller, Dispatcher) and caller.__module__ == found.name:
                names = names_in(caller.py_func.__code__) & known.keys()
                calls += [(caller, known[name]) for name in names]
    calls = [(caller, f) for caller, f in calls if isinstance(f, Dispatcher)]
    assert len(calls) > 60
    for caller, called in calls:
        assert folder(called) == folder(caller), f"{caller} calls {called}"


def test_compiled_function_equals_its_source():
    offset = np.array([[0.1, -0.2], [0.3, 0.0]])
    np.testing.assert_allclose(
        decayed_offset(offset, 0.4, 0.07),
        decayed_offset.py_func(offset, 0.4, 0.07),
        rtol=1e-14,
    )


@pytest.mark.parametrize("elsewhere", [False, True])
def test_change_of_a_called_function_invalidates_the_cache(
    tmp_path, monkeypatch, elsewhere
):
    if elsewhere:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    else:
        monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    inner = tmp_path / "inner.py"
    head = "from fmp_drake.compiled import compiled\n"
    body = "@compiled\ndef {}(x):\n    return {}\n"
    outer = "from inner import twice\n" + body.format("outer", "twice(x) + 1.0")
    (tmp_path / "outer.py").write_text(head + outer)
    use = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import outer; "
    use += "print(outer.outer(5.0), sum(outer.outer.stats.cache_hits.values()))"
    found = []
    for product in ("2.0 * x", "2.0 * x", "3.0 * x"):
        written = head + body.format("twice", product)
        if not inner.exists() or inner.read_text() != written:
            inner.write_text(written)
        found.append(run(use).stdout.split())
    assert found == [["11.0", "0"], ["11.0", "1"], ["16.0", "0"]]


def test_it_works_where_neither_the_package_nor_the_home_can_be_written():
    done = run(READ_ONLY + USE)
    value, place = done.stdout.split()
    assert "fmp_drake_" in place
    assert float(value) == decayed_offset(np.ones((2, 3)), 0.4, 0.1)[0, 0]
    # Nothing was cached, so the compilation is announced, once.
    assert done.stderr.count("compiling") == 1
    assert "compiling for this run: " in done.stderr
    assert "NUMBA_CACHE_DIR names another" in done.stderr


def test_it_works_and_says_why_nothing_is_cached_where_the_disk_is_full(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    done = run(FULL + USE)
    value = done.stdout.split()[0]
    assert float(value) == decayed_offset(np.ones((2, 3)), 0.4, 0.1)[0, 0]
    assert done.stderr.count("lost after this run (No space left on device)") == 1
    assert not [*tmp_path.rglob("*.nbc")]


def test_nothing_is_announced_where_the_cache_holds_it():
    decayed_offset(np.ones((2, 3)), 0.4, 0.1)
    assert "compiling" not in run(USE).stderr


# The law waits here for its parts, which it otherwise needs only after some seconds.
WAIT = """
import os, time
from pathlib import Path
from fmp_drake.systems.impedance.step import impedance_step

fork = os.fork

def fork_and_wait():
    child = fork()
    folder = Path(impedance_step.stats.cache_path)
    before = {file.name for file in folder.glob("*.nbi")}
    for _ in range(2400 if child else 0):
        names = {file.name for file in folder.glob("*.nbi")} - before
        if len(names) == 3:
            Path(os.environ["PARTS"]).write_text(
                " ".join(sorted(name.partition("-")[0] for name in names))
            )
            break
        time.sleep(0.05)
    return child

os.fork = fork_and_wait
"""
CONTROLLER = """
import logging, sys
logging.basicConfig(level=logging.INFO)
from fmp_drake.station import LoadScenario, MakeStation, warm_up
from fmp_drake.systems.impedance.step import impedance_step as step
print(step.stats.cache_path)
warm_up._compile_ink = lambda: None
warm_up._COMPILE_STEP = sys.argv[1] + warm_up._COMPILE_STEP
print(*warm_up.LawCompilation().progress())
MakeStation(LoadScenario("stir"), None)
print(sum(step.stats.cache_hits.values()), sum(step.stats.cache_misses.values()))
"""


@pytest.mark.slow
def test_control_law_and_parts_compiled_in_other_processes_are_found_in_the_cache(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("PARTS", str(tmp_path / "parts"))
    place, progress, counts = run(CONTROLLER, WAIT).stdout.splitlines()
    fractions = [float(fraction) for fraction in progress.split()]
    assert fractions == sorted(fractions)
    assert 0.4 < fractions[-1] <= 3 / 4
    assert Path(place).is_relative_to(tmp_path)
    assert counts == "1 0"
    # The law uses the parts, and nothing else is stored: Python could not call it.
    parts = ["joints.limited_torque", "law.impedance_law", "step.measured_motion"]
    assert (tmp_path / "parts").read_text().split() == parts
    written = sorted(file.name.partition("-")[0] for file in Path(place).glob("*.nbc"))
    assert written == sorted([*parts, "step.impedance_step"])
    # The second time there is nothing to wait for.
    again = run(CONTROLLER, WAIT)
    assert again.stdout.splitlines() == [place, "", "1 0"]
    assert "compiling" not in again.stderr


def test_ink_is_ready_also_where_the_law_is_in_the_cache():
    done = run(
        "from numba.core.dispatcher import Dispatcher\n"
        "from fmp_drake.station import WarmUp\n"
        "from fmp_drake.systems.ink import mesh\n"
        "WarmUp()\n"
        "functions = [f for f in vars(mesh).values() if isinstance(f, Dispatcher)]\n"
        "print(*(len(f.signatures) for f in functions))"
    )
    counts = done.stdout.split()
    assert counts
    assert "0" not in counts
