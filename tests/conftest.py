"""Shared fixtures: demonstrations of a simulated hand, and skills learned from them.

The skills are shared by all tests of a run: treat them as read-only.
"""

import functools
import gc
import hashlib
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time

# Before anything imports pydrake, matplotlib or numpy.
os.environ["DRAKE_ALLOW_NETWORK"] = "meshcat:package_map"
os.environ["MPLBACKEND"] = "Agg"
# The matrices are small: threads that spin beside other work cost ten times the
# run time of these tests.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Background processes of a shell ignore it, and so would the processes of tests.
signal.signal(signal.SIGINT, signal.default_int_handler)

from dataclasses import dataclass
from pathlib import Path

import dense_paper
import numpy as np
import pytest
from hypothesis import settings
from pydrake.common.yaml import yaml_dump_typed

from fmp_drake.apps import wipe as wipe_module
from fmp_drake.apps.page import log_natively
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.runs import rehearsal
from fmp_drake.station import CheckFeasibility
from fmp_drake.systems.teaching.hand_motion import HandMotion

# The same examples in every run: a red test means a changed package.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

log_natively()

REPOSITORY = Path(__file__).resolve().parents[1]
_PRIMITIVES = REPOSITORY / "tests" / "primitives"
_LEARNING = ("tests/primitives", "tests/benchmarks", "tests/test_blas")
# Where it fails, nobody waits for it: a test says why.
_WARM_UP = """
import pathlib, sys
try:
    from fmp_drake.station import WarmUp
    WarmUp()
finally:
    pathlib.Path(sys.argv[1]).touch()
"""


def pytest_configure(config):
    """Begin to compile what a station needs, once for all processes."""
    if not hasattr(config, "workerinput"):
        compiled = Path(tempfile.mkdtemp(prefix="fmp_drake_")) / "compiled"
        os.environ["FMP_COMPILED"] = str(compiled)
        config.add_cleanup(lambda: shutil.rmtree(compiled.parent))
        process = subprocess.Popen([sys.executable, "-c", _WARM_UP, compiled])
        config.add_cleanup(process.wait)


def pytest_collection_modifyitems(items):
    """Put first what needs no station, and then what takes long.

    So nobody waits for what is compiled, and no process is left with long tests at the end.
    """
    items.sort(
        key=lambda item: (
            not item.path.is_relative_to(_PRIMITIVES),
            not any(item.get_closest_marker(m) for m in ("slow", "browser")),
        )
    )


def pytest_collection_finish():
    """Look for garbage seldom, and not among the imports."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)


def pytest_runtest_setup(item):
    """Wait for what is compiled with the first test that may need it."""
    if not item.path.is_relative_to(_PRIMITIVES):
        deadline = time.monotonic() + 300
        while not Path(os.environ["FMP_COMPILED"]).exists():
            assert time.monotonic() < deadline, "what tests need is not compiled"
            time.sleep(0.1)


def hand_demonstration(task, *, seconds, seed, rate=50):
    """Return a demonstration (x, y, z) in metres, with a height that wanders."""
    position = HandMotion.make(task, duration=seconds, seed=seed).position
    position = position[:: 200 // rate]
    time = np.arange(len(position)) / rate
    height = 0.002 * np.sin(1.3 * time + seed)
    return Demonstration(
        time=time, values=np.column_stack([position, height]), frame="board"
    )


class Once:
    """Results of a function that all processes of a test run share, by what it is given.

    They are kept as bytes, so that a test may change what it got.
    """

    is_on = True

    def __init__(self, folder):
        self._folder, self._known = folder, {}
        folder.mkdir(exist_ok=True)

    def of(self, given, compute):
        """Return what was computed of the same before, or compute it."""
        key = hashlib.sha256(pickle.dumps(given)).hexdigest()
        file = self._folder / key
        if self.is_on and (key in self._known or file.exists()):
            if key not in self._known:
                self._known[key] = file.read_bytes()
            return pickle.loads(self._known[key])
        result = compute()
        self._known[key] = pickle.dumps(result)
        part = file.with_suffix(f".{os.getpid()}")
        part.write_bytes(self._known[key])
        part.replace(file)
        return result


@pytest.fixture(scope="session", autouse=True)
def learned_once():
    """Learn once, for all processes, what several runs play and examples show.

    Tests and benchmarks of learning itself learn anew.
    """
    once = Once(Path(os.environ["FMP_COMPILED"]).with_name("learned"))
    learn = FourierMovementPrimitive.fit

    def fit(self, X, y=None, **options):
        test = os.environ.get("PYTEST_CURRENT_TEST", "")
        if test.startswith(_LEARNING):
            return learn(self, X, y, **options)
        named = [each for each in sorted(options.items()) if each[0] != "progress"]
        given = type(self), self.get_params(), X, named
        vars(self).update(once.of(given, lambda: vars(learn(self, X, y, **options))))
        return self

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FourierMovementPrimitive, "fit", functools.wraps(learn)(fit))
        yield once


@pytest.fixture(scope="session", autouse=True)
def checked_once():
    """Check and rehearse once, for all processes, what commands play."""
    once = Once(Path(os.environ["FMP_COMPILED"]).with_name("checked"))

    def check(scenario, skill, *, suggest=True):
        given = yaml_dump_typed(scenario), vars(skill), suggest
        return once.of(
            given, lambda: CheckFeasibility(scenario, skill, suggest=suggest)
        )

    def rehearse(scenario, skill):
        given = yaml_dump_typed(scenario), vars(skill), "rehearsal"
        return once.of(given, lambda: simulate(scenario, skill))

    simulate = rehearsal.rehearse
    with pytest.MonkeyPatch.context() as patch:
        for module in (rehearsal, wipe_module):
            patch.setattr(module, "CheckFeasibility", check)
        patch.setattr(rehearsal, "rehearse", rehearse)
        yield


@pytest.fixture
def nothing_is_freed():
    """For tests with threads: pages of tests before, freed in them, end the process."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture(scope="session")
def make_demonstration():
    """The function that draws demonstrations."""
    return hand_demonstration


@pytest.fixture(scope="session")
def wiping_demonstration():
    """90 s of wiping at 50 Hz, three channels."""
    return hand_demonstration("wiping", seconds=90, seed=1)


@pytest.fixture(scope="session")
def polishing_demonstration():
    """40 s of polishing at 40 Hz, two channels."""
    full = hand_demonstration("polishing", seconds=40, seed=2, rate=40)
    return full.select(["x", "y"])


@pytest.fixture(scope="session")
def wiping_skill(wiping_demonstration):
    """A skill with the defaults, a phase model: T = 120, K = 10, D = 3, 20 Hz."""
    return FourierMovementPrimitive().fit(wiping_demonstration)


@pytest.fixture(scope="session")
def wiping_mixture(wiping_demonstration):
    """As `wiping_skill`, by EM over all windows."""
    return FourierMovementPrimitive(model="mixture").fit(wiping_demonstration)


@pytest.fixture(scope="session")
def small_skill(polishing_demonstration):
    """A skill that dense matrices can follow: T = 24, K = 4, M = 3, D = 2, 10 Hz."""
    return FourierMovementPrimitive(
        n_steps=24, rate=10.0, overlap=4, n_components=3, stride=3
    ).fit(polishing_demonstration)


@pytest.fixture(scope="session")
def odd_skill(polishing_demonstration):
    """As `small_skill`, with T = 25: no Nyquist weight."""
    return FourierMovementPrimitive(
        n_steps=25, rate=10.0, overlap=5, n_components=2, stride=3
    ).fit(polishing_demonstration)


def _real_demonstration_folder():
    named = os.environ.get("FMP_REAL_DEMOS")
    return Path(named) if named else REPOSITORY.parent / "shared" / "real_demos"


@pytest.fixture(scope="session")
def real_demonstration_paths():
    """Recordings from real robots, which are not part of the repository."""
    folder = _real_demonstration_folder()
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        pytest.skip(f"no real demonstrations in {folder}; set FMP_REAL_DEMOS")
    return {path.stem: path for path in paths}


@pytest.fixture(scope="session")
def paper_mixture():
    """The function that turns a skill into pi_j, mu_j, Sigma_j of the paper (9)."""

    def of(skill):
        windows = skill.basis.synthesize
        gaussians = [
            dense_paper.gaussian_of(
                windows(c.mean), windows(c.basis.T), c.variances, c.noise
            )
            for c in skill.components_
        ]
        mu, sigma = zip(*gaussians, strict=True)
        return skill.proportions_, mu, sigma

    return of


# The command line ---------------------------------------------------------------------


COMPILING = (
    "fmp-drake: compiling for this machine, once for each kind of run: "
    "up to half a minute\n"
)


@dataclass(frozen=True)
class Result:
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def command(capsys):
    """The function that runs `fmp-drake` in this process."""
    from fmp_drake.apps.main import main

    def run(*arguments):
        code = 0
        capsys.readouterr()
        try:
            main([str(argument) for argument in arguments])
        except SystemExit as stop:
            code = stop.code
        out, err = capsys.readouterr()
        return Result(code, out, err)

    return run


@pytest.fixture
def refused(command):
    """The function that runs a command that must be refused, and returns why."""

    def run(*arguments):
        result = command(*arguments)
        # The first command in a new checkout may compile.
        _, _, err = result.err.rpartition(COMPILING)
        assert result.code == 2, result
        assert err.startswith("fmp-drake: ")
        assert err.count("\n") == 1
        assert "Traceback" not in result.out + err
        return err

    return run


@pytest.fixture
def enter(monkeypatch):
    """The function that presses Enter in the terminal of the command."""
    ours, theirs = os.openpty()
    with open(theirs) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield lambda: os.write(ours, b"\n")
    os.close(ours)


@pytest.fixture
def outputs(tmp_path):
    """A folder for what a command writes."""
    folder = tmp_path / "outputs"
    folder.mkdir()
    return folder


def circling(seconds, rate=20):
    """Return times (N,) and a wandering path (N, 3) on a board, s and m."""
    time = np.arange(round(seconds * rate)) / rate
    phase = 2 * np.pi * (time / 2 + 0.05 * np.sin(0.7 * time))
    path = [0.08 * np.cos(phase), 0.12 * np.sin(phase), np.zeros_like(phase)]
    return time, np.column_stack(path)


@pytest.fixture
def make_npz(tmp_path):
    """The function that writes a recording of circles to a file."""

    def make(name="circles.npz", *, seconds=20, **arrays):
        time, position = circling(seconds)
        path = tmp_path / name
        np.savez(path, **{"time": time, "position": position, **arrays})
        return path

    return make


@pytest.fixture
def make_csv(tmp_path):
    """The function that writes a recording of circles to a .csv file."""

    def make(header="time,x,y,z", *, seconds=20):
        path = tmp_path / "circles.csv"
        table = np.column_stack(circling(seconds))
        np.savetxt(path, table, delimiter=",", header=header, comments="")
        return path

    return make
