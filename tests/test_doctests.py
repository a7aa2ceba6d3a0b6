"""Facts about the examples in the docstrings of public names."""

import doctest
import importlib
import inspect

import pytest

FRONT_DOORS = (
    "primitives",
    "systems",
    "station",
    "runs",
    "plots",
    "film",
    "experiments",
    "experiments.baselines",
    "experiments.benchmark",
    "experiments.trials",
)


def examples():
    """Yield one doctest for each exported class or function that has examples."""
    finder = doctest.DocTestFinder(recurse=False)
    for door in FRONT_DOORS:
        module = importlib.import_module(f"fmp_drake.{door}")
        offered = {name: getattr(module, name) for name in module.__all__}
        for name, exported in offered.items():
            if not (inspect.isclass(exported) or inspect.isfunction(exported)):
                continue
            # As after `from fmp_drake.<room> import *`, in the module's own place.
            for test in finder.find(exported, name, extraglobs=offered):
                if test.examples:
                    yield pytest.param(test, id=f"fmp_drake.{door}.{name}")


@pytest.mark.parametrize("test", list(examples()))
def test_example(test, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = []
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    doctest.DocTestRunner(optionflags=flags).run(test, out=said.append)
    assert not said, "".join(said)
