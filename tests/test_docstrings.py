"""The examples in docstrings give what they say."""

import doctest
import importlib
import pkgutil

import pytest

PACKAGES = ("fmp_drake.primitives", "fmp_drake.experiments.baselines")
MODULES = [
    module.name
    for name in PACKAGES
    for module in pkgutil.walk_packages(
        importlib.import_module(name).__path__, f"{name}."
    )
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(name):
    failed, _ = doctest.testmod(importlib.import_module(name))
    assert failed == 0


@pytest.mark.parametrize("package", PACKAGES)
def test_exported_classes_have_an_example(package):
    front = importlib.import_module(package)
    abstract = {"TrajectoryModel", "Tracker", "AlignedPeriods"}
    being_rewritten = {"Player", "PlaybackState"}
    without = {
        name
        for name in front.__all__
        if isinstance(getattr(front, name), type)
        and "Examples\n" not in (getattr(front, name).__doc__ or "")
    }
    assert {
        n for n in without if not n.endswith("Tracker")
    } <= abstract | being_rewritten
