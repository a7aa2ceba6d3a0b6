"""Facts about who imports whom: each layer only from those before it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import fmp_drake

PACKAGE = Path(fmp_drake.__file__).parent
LAYERS = (
    "primitives",
    "systems",
    "station",
    "runs",
    "plots",
    "film",
    "experiments",
    "apps",
)
# Below all layers.
BASE = {"errors", "compiled", "__init__"}


def imported(source, module):
    """Yield the absolute names of the modules that a module imports.

    `from a.b import c` may mean the module a.b.c, so it yields that too.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = module.split(".")[: -node.level]
                base = ".".join([*parents, base] if base else parents)
            yield base
            for alias in node.names:
                yield f"{base}.{alias.name}"


def modules():
    """Yield the name, layer and source of every module of the package."""
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        yield ".".join(["fmp_drake", *parts]), parts[0], path.read_text("utf-8")


def broken_rules(name, layer, source):
    """Return what a module imports and must not."""
    if layer in BASE:
        allowed = BASE
    else:
        allowed = BASE | set(LAYERS[: LAYERS.index(layer) + 1])
    broken = []
    for target in imported(source, name):
        parts = target.split(".")
        if parts[0] in ("tests", "examples"):
            broken.append(target)
        if parts[0] == "pydrake" and layer in {*BASE, "primitives"}:
            broken.append(target)
        if target == "pydrake.all" or target.startswith("pydrake.all."):
            broken.append(target)
        is_ours = parts[0] == "fmp_drake" and len(parts) > 1
        if is_ours and parts[1] in LAYERS and parts[1] not in allowed:
            broken.append(target)
    return broken


def test_every_module_belongs_to_a_layer():
    assert {layer for _, layer, _ in modules()} <= {*LAYERS, *BASE}
    assert len(list(modules())) > 15


def test_imports_point_one_way():
    broken = {n: b for n, la, s in modules() if (b := broken_rules(n, la, s))}
    assert broken == {}


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("primitives.x", "from fmp_drake.systems import y"),
        ("primitives.x", "from fmp_drake.systems.y import z"),
        ("primitives.x", "from ..systems import y"),
        ("primitives.x", "from .. import systems"),
        ("primitives.x", "from fmp_drake import systems"),
        ("primitives.x", "import pydrake.math"),
        ("primitives.x", "def f():\n    import fmp_drake.station.z"),
        ("errors", "from fmp_drake.primitives import basis"),
        ("systems.x", "import fmp_drake.station"),
        ("systems.x", "from pydrake.all import LeafSystem"),
        ("systems.x", "from pydrake import all"),
        ("station.x", "from fmp_drake.apps.main import main"),
        ("apps.x", "from tests import conftest"),
    ],
)
def test_wrong_imports_are_found(name, source):
    assert broken_rules(f"fmp_drake.{name}", name.split(".")[0], source)


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("primitives.x", "import numpy\nfrom fmp_drake.errors import FmpError"),
        ("primitives.x", "from . import basis"),
        ("systems.x", "import pydrake.math\nfrom fmp_drake.primitives import y"),
        ("apps.x", "from fmp_drake import station, __version__"),
    ],
)
def test_right_imports_pass(name, source):
    assert not broken_rules(f"fmp_drake.{name}", name.split(".")[0], source)


@pytest.mark.parametrize("module", ["fmp_drake", "fmp_drake.primitives"])
def test_learning_works_without_drake(module):
    # In a process of its own, where importing Drake is an error.
    code = f"""
import sys
sys.modules["pydrake"] = None
import {module}
if "{module}" != "fmp_drake":
    import numpy as np
    from fmp_drake.primitives import FourierMovementPrimitive, Player
    skill = FourierMovementPrimitive(n_steps=8, overlap=2)
    skill.fit(np.random.default_rng(0).standard_normal((9, 8, 2)))
    assert Player(skill).rollout([0.0, 0.0], 3.0).shape == (61, 3, 2)
assert not [m for m in sys.modules if m.startswith("pydrake.")]
"""
    subprocess.run([sys.executable, "-c", code], check=True)
