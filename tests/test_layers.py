"""Facts about the rooms: their imports, their modules and their public names."""

import ast
import importlib
import inspect
import io
import subprocess
import sys
import tokenize
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from pydrake.systems.framework import LeafSystem

import fmp_drake

PACKAGE = Path(fmp_drake.__file__).parent
LAYERS = (
    "primitives",
    "systems",
    "station",
    "skills",
    "runs",
    "plots",
    "film",
    "experiments",
    "apps",
)
# Below all layers.
BASE = {
    "errors",
    "numeric",
    "settings",
    "compiled",
    "processes",
    "__init__",
    "__main__",
}
FRONT_DOORS = (
    "fmp_drake",
    *(f"fmp_drake.{layer}" for layer in LAYERS[:-1]),
    "fmp_drake.experiments.baselines",
    "fmp_drake.experiments.benchmark",
    "fmp_drake.experiments.trials",
)
MOST_MODULES = 20
# Lines of code: no docstrings, comments and blank lines.
MOST_LINES = 400
LEAST_LINES = 40
MOST_LINES_OF_A_FUNCTION = 100
SMALL_MODULES = 0
PUBLIC_NAMES = 130
# Folders whose modules are alternatives beside a base, of any size.
ALTERNATIVES = (
    "apps",
    "experiments/baselines",
    "primitives/data/reading",
    "station/robots",
    "station/tasks",
)
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


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
    elif layer == "__main__":
        allowed = {"apps"}
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


def leaf_systems(name):
    """Return the names of the LeafSystems that a module defines."""
    module = importlib.import_module(name)
    return [
        system.__name__
        for _, system in inspect.getmembers(module, inspect.isclass)
        if issubclass(system, LeafSystem) and system.__module__ == module.__name__
    ]


def class_name(name):
    """Return the name of the class that a module is named after."""
    return "".join(word.capitalize() for word in name.split(".")[-1].split("_"))


SYSTEMS = [n for n, layer, _ in modules() if layer == "systems"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_leaf_system_has_a_module_of_its_name(name):
    if name.endswith("__init__"):
        return
    is_at_the_top = name.count(".") == 2
    expected = [class_name(name)] if is_at_the_top or leaf_systems(name) else []
    assert leaf_systems(name) == expected


def code_lines(source):
    """Return the numbers of the lines without docstrings, comments and blank lines."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docstrings = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, documented) and ast.get_docstring(node) is not None
        for line in range(node.body[0].lineno, node.body[0].end_lineno + 1)
    }
    code = {
        line
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type not in NO_CODE
        for line in range(token.start[0], token.end[0] + 1)
    }
    return code - docstrings


def lines_of_code(source):
    """Return the number of lines without docstrings, comments and blank lines."""
    return len(code_lines(source))


def test_lines_of_code_leave_out_text():
    source = '"""Text.\n\nMore.\n"""\n\nX = [\n    1,  # One.\n]\n# No code.\n'
    assert lines_of_code(source) == 3


def test_no_folder_has_more_than_20_modules():
    folders = {path.parent for path in PACKAGE.rglob("*.py")}
    crowded = {}
    for folder in folders:
        modules_of = [p for p in folder.glob("*.py") if p.stem != "__init__"]
        if len(modules_of) > MOST_MODULES:
            crowded[str(folder.relative_to(PACKAGE))] = len(modules_of)
    assert crowded == {}


def test_no_module_has_more_than_400_lines_of_code():
    lengths = {name: lines_of_code(source) for name, _, source in modules()}
    assert {n: length for n, length in lengths.items() if length > MOST_LINES} == {}


def test_no_function_has_more_than_100_lines_of_code():
    long = {}
    for name, _, source in modules():
        code = code_lines(source)
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.FunctionDef):
                length = len(code & {*range(node.lineno, node.end_lineno + 1)})
                if length > MOST_LINES_OF_A_FUNCTION:
                    long[f"{name}.{node.name}"] = length
    assert long == {}


def repeated_constants(source):
    """Return names that a module assigns more than once outside of functions."""
    targets = [
        name.id
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign)
        for target in node.targets
        for name in ast.walk(target)
        if isinstance(name, ast.Name)
    ]
    return sorted({name for name in targets if targets.count(name) > 1})


def test_no_constant_of_a_module_replaces_another_one():
    assert repeated_constants("_A = 1\n_B, _A = 2, 3\n") == ["_A"]
    repeated = {name: repeated_constants(source) for name, _, source in modules()}
    assert not {name: names for name, names in repeated.items() if names}


def test_few_modules_have_less_than_40_lines_of_code():
    # This number may only fall.
    small = {}
    for name, layer, source in modules():
        folder = "/".join(name.split(".")[1:-1])
        if layer in BASE or name.endswith("__init__") or folder in ALTERNATIVES:
            continue
        length = lines_of_code(source)
        if length < LEAST_LINES and not (layer == "systems" and leaf_systems(name)):
            small[name] = length
    assert len(small) <= SMALL_MODULES, small


def import_graph(sources):
    """Return which of some modules each of them imports.

    A name that a front door offers is the front door's.
    """
    graph = {}
    for name, source in sources.items():
        targets = set()
        for node in ast.walk(ast.parse(source)):
            line = (
                ast.unparse(node)
                if isinstance(node, ast.Import | ast.ImportFrom)
                else ""
            )
            found = [t for t in imported(line, name) if line]
            own = [t for t in found[1:] if t in sources]
            doors = [f"{t}.__init__" for t in found if f"{t}.__init__" in sources]
            targets |= {*own} if own else {t for t in found if t in sources} | {*doors}
        graph[name] = targets - {name}
    return graph


def circle(graph):
    """Return the modules of a circle of imports, or none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_modules_import_each_other():
    graph = import_graph({name: source for name, _, source in modules()})
    assert circle(graph) == []


def test_circle_of_imports_is_found():
    sources = {"a.x": "from a import y", "a.y": "import a.x", "a.z": "import a.y"}
    assert set(circle(import_graph(sources))) == {"a.x", "a.y"}
    assert circle(import_graph({"a.x": "from a import y", "a.y": ""})) == []


# What the front doors offer.


@pytest.mark.parametrize("door", FRONT_DOORS)
def test_front_door_offers_names_that_exist(door):
    module = importlib.import_module(door)
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)


def test_front_doors_offer_few_names():
    # This number may only fall: a name is public because others use it.
    offered = [n for door in FRONT_DOORS for n in importlib.import_module(door).__all__]
    assert len(offered) <= PUBLIC_NAMES


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
