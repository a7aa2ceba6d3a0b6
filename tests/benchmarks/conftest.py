"""A readable table of the benchmarks' results: printed, and in out/benchmark.md."""

import os
import platform
from pathlib import Path

import numpy as np
import pytest

import fmp_drake

OUT = Path(__file__).resolve().parents[2] / "out"
_TABLE = pytest.StashKey()


class Figures:
    """Collects the figures of all benchmarks of a run."""

    def __init__(self):
        self.sections = {}

    def add(self, section, what, value, *, target=None, met=None):
        """Add a line; `value` and `target` are text, `met` tells whether it was."""
        verdict = {True: "yes", False: "no", None: ""}[met]
        self.sections.setdefault(section, []).append((what, value, target, verdict))

    def markdown(self):
        threads = os.environ.get("OPENBLAS_NUM_THREADS", "all")
        machine = (
            f"fmp_drake {fmp_drake.__version__}, Python {platform.python_version()}, "
            f"NumPy {np.__version__}, {platform.machine()} with {os.cpu_count()} cores, "
            f"BLAS threads: {threads}. Every ratio compares two measurements of this "
            "run."
        )
        lines = ["# Benchmarks", "", machine]
        for section, rows in self.sections.items():
            lines += ["", f"## {section}", "", "| | measured | target | met |"]
            lines += ["|---|---|---|---|"]
            lines += [f"| {a} | {b} | {c or ''} | {d} |" for a, b, c, d in rows]
        return "\n".join(lines) + "\n"


def pytest_configure(config):
    config.stash[_TABLE] = Figures()


class Recorder:
    """Writes figures into the table and into the extra information of a benchmark."""

    def __init__(self, figures, benchmark):
        self._figures = figures
        self._benchmark = benchmark
        self.section = benchmark.name

    def add(self, what, value, unit="", *, below=None, above=None, digits=3):
        """Add a number, with the target that it stays below or above."""
        value = float(value)
        target, met = None, None
        if below is not None:
            target, met = f"< {below:g} {unit}".strip(), value < below
        if above is not None:
            target, met = f">= {above:g} {unit}".strip(), value >= above
        text = f"{value:.{digits}g}" if abs(value) < 1000 else f"{value:.0f}"
        self._figures.add(
            self.section, what, f"{text} {unit}".strip(), target=target, met=met
        )
        key = f"{what} [{unit}]" if unit else what
        self._benchmark.extra_info[key] = value
        if met is not None:
            self._benchmark.extra_info[f"{key} target"] = target
            self._benchmark.extra_info[f"{key} met"] = met


@pytest.fixture
def figures(request, benchmark):
    """Where a benchmark writes its figures."""
    return Recorder(request.config.stash[_TABLE], benchmark)


@pytest.fixture(scope="session")
def out():
    """The folder for results."""
    OUT.mkdir(exist_ok=True)
    return OUT


def median_of(benchmark):
    """Return the median seconds of a benchmark, NaN where they are disabled."""
    return benchmark.stats.stats.median if benchmark.stats else float("nan")


@pytest.fixture
def median(benchmark):
    """The function that returns the median seconds of the benchmark."""
    return lambda: median_of(benchmark)


def pytest_terminal_summary(terminalreporter, config):
    figures = config.stash[_TABLE]
    if figures.sections:
        text = figures.markdown()
        terminalreporter.write("\n" + text)
        if not config.getoption("benchmark_disable"):
            OUT.mkdir(exist_ok=True)
            (OUT / "benchmark.md").write_text(text, encoding="utf-8")
