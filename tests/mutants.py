"""Break the package one line at a time, and list the changes that no test detects.

    python tests/mutants.py [--each 20] [--seed 0] [MODULE ...]

Each mutant is a copy of the package in which one operator, comparison or number is another
one. The module's tests run on it up to the first failure, in a process forked from this one:
those in `NEAREST`, or else the test files that import the module. Survivors are printed to be
read: a survivor needs a test, or an argument that nothing changes.
"""

import argparse
import ast
import contextlib
import copy
import importlib
import os
import random
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "fmp_drake"
NEAREST = {
    "station/reach/feasibility.py": "station/test_feasibility_verdict.py "
    "station/test_feasibility.py",
    "station/reach/board_reach.py": "station/test_reach.py station/test_feasibility.py",
    "systems/surface_monitor.py": "systems/test_surface_monitor.py",
    "station/reach/tracking_prediction.py": "station/test_tracking_prediction.py",
    "station/reach/deviation_prediction.py": "station/test_deviation_prediction.py "
    "station/test_push_prediction.py",
    "runs/metrics.py": "runs/test_metrics.py",
    "runs/judging.py": "runs/test_judging.py",
    "systems/panda/gate.py": "systems/test_torque_gate.py systems/test_plausibility.py",
    "systems/panda/arm_status.py": "systems/test_plausibility.py systems/test_torque_gate.py",
    "runs/arm_bench.py": "runs/test_arm_bench.py",
    "systems/impedance/supervision.py": "systems/test_impedance_safety.py",
    "systems/interface/arm_model.py": "-m 'not browser' station/test_robots.py "
    "systems/test_operational_space_impedance_controller.py",
    "systems/ink/rubbing.py": "systems/test_ink_rubbing.py systems/test_ink_board.py",
    "systems/ink/grid.py": "systems/test_ink_grid.py systems/test_ink_metrics.py",
    "primitives/data/channels.py": "primitives/test_channels.py "
    "primitives/test_scaling.py primitives/test_demonstration.py",
    "primitives/data/reading/table.py": "primitives/test_recorded_files.py",
    "primitives/data/reading/rows.py": "primitives/test_recorded_files.py",
    "primitives/data/reading/columns.py": "primitives/test_recorded_files.py "
    "primitives/test_recorded_orientations.py",
    "primitives/data/reading/angles.py": "primitives/test_recorded_orientations.py "
    "primitives/test_recorded_files.py",
    "primitives/model/phase/calibration.py": "primitives/test_calibration.py "
    "primitives/test_phase_model.py",
    "skills/loading.py": "skills/test_placement.py skills/test_surface_placement.py",
    "skills/placement.py": "skills/test_placement.py skills/test_surface_placement.py",
}
# Imported once, and not by each mutant.
HEAVY = """numba scipy.signal scipy.interpolate scipy.optimize scipy.spatial sklearn.mixture
matplotlib.figure click rich.progress yaml pydrake.multibody.plant
pydrake.systems.analysis pydrake.visualization pydrake.multibody.inverse_kinematics"""
SWAPS = {
    (ast.Lt, ast.LtE): ast.Gt,
    (ast.Gt, ast.GtE): ast.Lt,
    (ast.Eq, ast.Is): ast.NotEq,
    (ast.NotEq, ast.IsNot): ast.Eq,
    (ast.Add,): ast.Sub,
    (ast.Sub,): ast.Add,
    (ast.Mult, ast.MatMult): ast.Div,
    (ast.Div, ast.FloorDiv): ast.Mult,
    (ast.And,): ast.Or,
    (ast.Or,): ast.And,
}
NAMES = {"min": "max", "any": "all", "minimum": "maximum", "sin": "cos", "abs": "float"}
NAMES |= {other: name for name, other in NAMES.items() if name != "abs"}
# Texts, errors and defaults of settings: what is in them is not worth a test.
SKIPPED = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.AnnAssign)


def changed(node):
    """Return another node in place of one; None where there is no mutant of it."""
    new = copy.deepcopy(node)
    op = getattr(node, "op", None) or (getattr(node, "ops", None) or [None])[0]
    other = next((v() for k, v in SWAPS.items() if isinstance(op, k)), None)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        return node.operand
    if isinstance(node, ast.Compare) and other and len(node.ops) == 1:
        new.ops = [other]
    elif isinstance(node, ast.BinOp | ast.BoolOp) and other:
        new.op = other
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        new.value = 1.5 * node.value if node.value not in (0, 1) else 1 - node.value
        new.value = type(node.value)(new.value)
        return new if new.value != node.value else None
    elif isinstance(node, ast.Name) and node.id in NAMES:
        new.id = NAMES[node.id]
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        new.attr = NAMES[node.attr]
    else:
        return None
    return new


def candidates(node):
    """Yield the nodes of a module that are worth a change."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, SKIPPED):
            continue
        if isinstance(child, ast.FunctionDef):
            child = ast.Module(body=[*child.args.defaults, *child.body])
        elif isinstance(child, ast.expr) and changed(child) is not None:
            yield child
        yield from candidates(child)


def mutants(source):
    """Return line, change and text of every mutant of a module."""
    lines = source.encode().splitlines(keepends=True)
    starts = [sum(map(len, lines[:i])) for i in range(len(lines))]
    found = []
    for node in candidates(ast.parse(source)):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[node.end_lineno - 1] + node.end_col_offset
        old, new = source.encode()[begin:end], ast.unparse(changed(node)).encode()
        text = source.encode()[:begin] + b"(" + new + b")" + source.encode()[end:]
        words = f"{' '.join(old.decode().split())}  ->  {new.decode()}"
        found.append((node.lineno, words, text))
    return found


def nearest(name):
    """Return the tests of a module, as words of a command line of pytest."""
    if name in NEAREST:
        return NEAREST[name]
    tests = REPOSITORY / "tests"
    wanted = f"fmp_drake.{name.removesuffix('.py').replace('/', '.')} import"
    found = [
        str(path.relative_to(tests))
        for path in sorted(tests.rglob("test_*.py"))
        if wanted in path.read_text(encoding="utf-8")
    ]
    if not found:
        raise SystemExit(f"no test file has '{wanted}'; add its tests to NEAREST.")
    return " ".join(found)


class Alone:
    """Plugin that compiles nothing beforehand."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_configure(self, config):
        config.workerinput = {}


def run(tree, tests, limit):
    """Return whether the tests pass on a tree, and their processor time, s.

    They fail where they take more of it than the limit: a loaded machine is not a failure.
    """
    if (child := os.fork()) == 0:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        os.dup2(os.open(tree / "log", os.O_CREAT | os.O_WRONLY), 1)
        os.dup2(1, 2)
        sys.path[:0] = [str(tree), str(REPOSITORY / "tests")]
        os.environ["PYTHONPATH"] = str(tree)
        os.environ["FMP_COMPILED"] = str(tree / "log")
        wanted = ["-xq", "-m", "not slow and not browser", "-p", "no:cacheprovider"]
        wanted += ["-p", "no:rerunfailures", "-p", "no:cov"]
        words = [
            str(REPOSITORY / "tests" / word) if word.endswith(".py") else word
            for word in shlex.split(tests)
        ]
        os._exit(int(pytest.main([*wanted, *words], plugins=[Alone()])))
    end, status = time.monotonic() + 20 * limit, (0, 0, None)
    while status[0] == 0 and time.monotonic() < end:
        time.sleep(0.05)
        status = os.wait4(child, os.WNOHANG)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if status[0] == 0:
        status = os.wait4(child, 0)
    return status[1] == 0, status[2].ru_utime + status[2].ru_stime


def main():
    """Run the mutants of the modules that are given, or of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*")
    parser.add_argument("--each", type=int, default=20, help="mutants of a module")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for name in HEAVY.split():
        importlib.import_module(name)
    work = Path(tempfile.mkdtemp(prefix="mutants_"))
    shutil.copytree(PACKAGE, work / "whole")
    for name in options.modules or NEAREST:
        tests = nearest(name)
        source = (PACKAGE / name).read_text(encoding="utf-8")
        chosen = [(0, "nothing", source.encode()), *mutants(source)]
        if len(chosen) > options.each + 1:
            some = random.Random(options.seed).sample(chosen[1:], options.each)
            chosen = [chosen[0], *sorted(some)]
        caught, limit = 0, 600
        for line, words, text in chosen:
            tree = work / "tree"
            shutil.copytree(work / "whole", tree / "fmp_drake", copy_function=os.link)
            (tree / "models").symlink_to(REPOSITORY / "models")
            if line:
                (tree / "fmp_drake" / name).unlink()
                (tree / "fmp_drake" / name).write_bytes(text)
            passed, seconds = run(tree, tests, limit)
            if not line:
                limit = 10 + round(3 * seconds)
                if not passed:
                    print(f"{name}: its tests fail", (tree / "log").read_text()[-2000:])
                    break
            elif passed:
                print(f"  survives: {name}:{line}: {words}", flush=True)
            caught += line > 0 and not passed
            shutil.rmtree(tree)
        else:
            print(f"{name}: {caught} of {len(chosen) - 1} caught", flush=True)
        shutil.rmtree(work / "tree", ignore_errors=True)
    shutil.rmtree(work)


if __name__ == "__main__":
    main()
