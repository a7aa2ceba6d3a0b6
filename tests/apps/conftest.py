"""What the tests of the command line share."""

from dataclasses import dataclass

import numpy as np
import pytest

from fmp_drake.apps.main import main


@dataclass(frozen=True)
class Result:
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def command(capsys):
    """The function that runs `fmp-drake` in this process."""

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
        assert result.code == 2, result
        assert result.err.startswith("fmp-drake: ")
        assert result.err.count("\n") == 1
        assert "Traceback" not in result.out + result.err
        return result.err

    return run


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
