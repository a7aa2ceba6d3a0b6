"""The examples in the docstrings of what the front doors offer do what they say."""

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
)


def examples():
    """Yield one doctest for each exported class or function that has examples."""
    finder = doctest.DocTestFinder(recurse=False)
    for door in FRONT_DOORS:
        module = importlib.import_module(f"fmp_drake.{door}")
        for name in module.__all__:
            exported = getattr(module, name)
            if not (inspect.isclass(exported) or inspect.isfunction(exported)):
                continue
            for test in finder.find(exported, name, globs={}):
                if test.examples:
                    yield pytest.param(test, id=f"fmp_drake.{door}.{name}")


@pytest.mark.parametrize("test", list(examples()))
def test_example(test, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = []
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    doctest.DocTestRunner(optionflags=flags).run(test, out=said.append)
    assert not said, "".join(said)
