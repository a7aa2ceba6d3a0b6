"""Break the package one line at a time: which changes does no test notice?

    python tests/mutants.py [--each 20] [--seed 0] [MODULE ...]

In each mutant one operator, comparison or number of a module is another one. The tests beside
`NEAREST` run on it, and the survivors are printed to be read: a survivor needs a test, or an
argument that nothing changes.

A process forked from one that has imported the package gives the functions and numbers of the
module new values, which takes as long as the tests do. Where functions are compiled it imports
a copy of the package instead.
"""

import argparse
import ast
import contextlib
import copy
import functools
import importlib
import os
import pkgutil
import random
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
import types
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGE = REPOSITORY / "fmp_drake"
NEAREST = {
    "station/reach/feasibility.py": "station/test_feasibility.py",
    "station/reach/board_reach.py": "station/test_feasibility.py",
    "station/reach/clearance.py": "station/test_feasibility.py",
    "station/reach/normal_force_limit.py": "station/test_feasibility.py",
    "station/reach/tracking_prediction.py": "station/test_feasibility.py",
    "runs/metrics.py": "runs/test_metrics.py",
    "experiments/trials/trial.py": "experiments/test_trials.py -k 'fault or judged'",
    "systems/panda/gate.py": "systems/test_torque_gate.py systems/test_plausibility.py",
    "systems/panda/plausibility.py": "systems/test_plausibility.py",
    "systems/panda/status.py": "systems/test_torque_gate.py",
    "systems/panda/firmware.py": "systems/test_firmware.py",
    "systems/impedance/supervision.py": "systems/test_impedance_safety.py",
    "systems/ink/metrics.py": "systems/test_ink_metrics.py",
    "systems/ink/rubbing.py": "systems/test_ink_rubbing.py",
    "systems/ink/patch.py": "systems/test_ink_rubbing.py systems/test_ink_board.py",
    "systems/ink/grid.py": "systems/test_ink_grid.py",
    "primitives/data/channels.py": "primitives/test_scaling.py "
    "primitives/test_demonstration.py",
    "primitives/data/reading/table.py": "primitives/test_recorded_files.py",
    "primitives/data/reading/columns.py": "primitives/test_recorded_files.py",
    "primitives/model/phase/calibration.py": "primitives/test_phase_model.py",
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


class Alone:
    """Plugin that compiles nothing beforehand."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_configure(self, config):
        config.workerinput = {}


def functions(owner):
    """Return the functions and methods of a module or class, by their names."""
    found = {}
    for name, value in vars(owner).items():
        if isinstance(value, type) and value.__module__ == owner.__name__:
            found |= {f"{name}.{k}": v for k, v in functions_of_class(value).items()}
        elif (function := function_of(value)) is not None:
            found[name] = function
    return found


def functions_of_class(owner):
    """Return the methods of a class, by their names."""
    found = {name: function_of(value) for name, value in vars(owner).items()}
    return {name: function for name, function in found.items() if function is not None}


def function_of(value):
    """Return the plain function that a name stands for, or None."""
    if isinstance(value, property):
        value = value.fget
    elif isinstance(value, functools.cached_property):
        value = value.func
    elif isinstance(value, staticmethod | classmethod):
        value = value.__func__
    while hasattr(value, "__wrapped__"):
        value = value.__wrapped__
    return value if isinstance(value, types.FunctionType) else None


def change(name, text):
    """Give the functions and numbers of an imported module those of another text."""
    module = importlib.import_module(f"fmp_drake.{name[:-3].replace('/', '.')}")
    other = types.ModuleType(module.__name__)
    vars(other).update({k: v for k, v in vars(module).items() if k[:2] == "__"})
    exec(compile(text, module.__file__, "exec"), vars(other))  # noqa: S102
    theirs = functions(other)
    for place, function in functions(module).items():
        if function.__module__ == module.__name__ and place in theirs:
            function.__code__ = theirs[place].__code__
            function.__defaults__ = theirs[place].__defaults__
            function.__kwdefaults__ = theirs[place].__kwdefaults__
    for key, value in vars(other).items():
        if not (callable(value) or isinstance(value, types.ModuleType)):
            vars(module)[key] = value


def run(work, name, text, limit):
    """Return whether the tests pass on a text of a module, and their processor time, s.

    They fail where they take more of it than the limit: a loaded machine is not a failure.
    """
    tree = work / "tree"
    if (child := os.fork()) == 0:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        os.dup2(os.open(work / "log", os.O_CREAT | os.O_TRUNC | os.O_WRONLY), 1)
        os.dup2(1, 2)
        if "fmp_drake" in sys.modules:
            change(name, text)
        else:
            shutil.copytree(work / "whole", tree / "fmp_drake", copy_function=os.link)
            (tree / "models").symlink_to(REPOSITORY / "models")
            (tree / "fmp_drake" / name).unlink()
            (tree / "fmp_drake" / name).write_bytes(text)
            sys.path[:0] = [str(tree), str(REPOSITORY / "tests")]
            os.environ["PYTHONPATH"] = str(tree)
        os.environ["FMP_COMPILED"] = str(work / "log")
        wanted = ["-xq", "-m", "not slow and not browser", "-p", "no:cacheprovider"]
        wanted += ["-p", "no:rerunfailures", "-p", "no:cov"]
        words = [
            str(REPOSITORY / "tests" / word) if word.endswith(".py") else word
            for word in shlex.split(NEAREST[name])
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
    for kept in ("tree", "learned", "checked"):
        shutil.rmtree(work / kept, ignore_errors=True)
    return status[1] == 0, status[2].ru_utime + status[2].ru_stime


def import_package():
    """Import the package as the tests do, and all of its modules."""
    sys.path.insert(0, str(REPOSITORY / "tests"))
    importlib.import_module("conftest")
    package = importlib.import_module("fmp_drake")
    for module in pkgutil.walk_packages(package.__path__, "fmp_drake."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def try_module(work, name, options):
    """Run the mutants of a module, and print those that survive."""
    source = (PACKAGE / name).read_text(encoding="utf-8")
    chosen = mutants(source)
    if len(chosen) > options.each:
        chosen = sorted(random.Random(options.seed).sample(chosen, options.each))
    if "\n@compiled" not in source:
        import_package()
    passed, seconds = run(work, name, source.encode(), 600)
    if not passed:
        print(f"{name}: its tests fail", (work / "log").read_text()[-2000:])
        return
    caught = 0
    for line, words, text in chosen:
        passed, _ = run(work, name, text, 10 + round(3 * seconds))
        caught += not passed
        if passed:
            print(f"  survives: {name}:{line}: {words}", flush=True)
    print(
        f"{name}: {caught} of {len(chosen)} caught ({seconds:.1f} s each)", flush=True
    )


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
        if (child := os.fork()) == 0:
            try_module(work, name, options)
            sys.stdout.flush()
            os._exit(0)
        os.waitpid(child, 0)
    shutil.rmtree(work)


if __name__ == "__main__":
    main()
