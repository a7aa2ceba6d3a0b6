"""Facts about the rooms: who imports whom, what is in them, what their doors offer."""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from pydrake.systems.framework import LeafSystem

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
BASE = {
    "blas",
    "errors",
    "numeric",
    "settings",
    "compiled",
    "processes",
    "__init__",
}
FRONT_DOORS = (
    "fmp_drake",
    *(f"fmp_drake.{layer}" for layer in LAYERS[:-1]),
    "fmp_drake.experiments.baselines",
    "fmp_drake.experiments.worlds",
)
MOST_MODULES = 16
MOST_LINES = 400


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
    if layer == "__init__":
        allowed = {*BASE, "primitives"}  # The front door opens into the skill layer.
    elif layer in BASE:
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
        ("__init__", "from fmp_drake.systems import InkBoard"),
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
        ("__init__", "from fmp_drake.primitives import Player"),
    ],
)
def test_right_imports_pass(name, source):
    assert not broken_rules(f"fmp_drake.{name}", name.split(".")[0], source)


def run_alone(code):
    """Run a program in a process of its own, where importing Drake is an error."""
    alone = f"import sys\nsys.modules['pydrake'] = None\n{code}"
    subprocess.run([sys.executable, "-c", alone], check=True)


@pytest.mark.slow
def test_skill_is_learned_and_played_without_drake():
    run_alone("""
import numpy as np
from fmp_drake.primitives import FourierMovementPrimitive, Player
skill = FourierMovementPrimitive(n_steps=8, overlap=2)
skill.fit(np.random.default_rng(0).standard_normal((9, 8, 2)))
assert Player(skill).rollout([0.0, 0.0], 3.0).shape == (61, 3, 2)
import fmp_drake
assert fmp_drake.Player is Player
""")


def test_importing_the_package_imports_nothing_heavy():
    run_alone("""
import fmp_drake
from fmp_drake.errors import FmpError
assert fmp_drake.FmpError is FmpError
assert {"Player", "load_skill", "__version__"} <= set(dir(fmp_drake))
heavy = {"numpy", "scipy", "sklearn", "numba", "matplotlib", "click", "logging"}
assert not heavy & set(sys.modules)
""")


# What is in the rooms.


@pytest.mark.parametrize(
    "name",
    [
        f"{folder}.{path.stem}"
        for folder in ("systems", "systems.page")
        for path in (PACKAGE / folder.replace(".", "/")).glob("*.py")
        if path.stem != "__init__"
    ],
)
def test_every_module_of_systems_is_one_leaf_system_of_its_name(name):
    module = importlib.import_module(f"fmp_drake.{name}")
    systems = [
        each.__name__
        for _, each in inspect.getmembers(module, inspect.isclass)
        if issubclass(each, LeafSystem) and each.__module__ == module.__name__
    ]
    words = name.split(".")[-1].split("_")
    assert systems == ["".join(word.capitalize() for word in words)]


def test_no_folder_is_crowded():
    folders = {path.parent for path in PACKAGE.rglob("*.py")}
    crowded = {}
    for folder in folders:
        modules_of = [p for p in folder.glob("*.py") if p.stem != "__init__"]
        if len(modules_of) > MOST_MODULES:
            crowded[str(folder.relative_to(PACKAGE))] = len(modules_of)
    assert crowded == {}


def test_no_file_is_long():
    lengths = {
        str(path.relative_to(PACKAGE)): len(path.read_text("utf-8").splitlines())
        for path in PACKAGE.rglob("*.py")
    }
    assert {p: n for p, n in lengths.items() if n > MOST_LINES} == {}


# What the front doors offer.


@pytest.mark.parametrize("door", FRONT_DOORS)
def test_front_door_offers_names_that_exist(door):
    module = importlib.import_module(door)
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)


def exported_classes():
    """Yield the classes that the front doors offer, but for errors."""
    for door in FRONT_DOORS[1:]:
        module = importlib.import_module(door)
        for name in module.__all__:
            if inspect.isclass(getattr(module, name)):
                yield pytest.param(getattr(module, name), id=f"{door}.{name}")


@pytest.mark.parametrize("exported", list(exported_classes()))
def test_exported_class_shows_an_example(exported):
    assert "Examples\n--------" in inspect.getdoc(exported)


def test_name_that_no_front_door_has_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Robot'"):
        _ = fmp_drake.Robot
