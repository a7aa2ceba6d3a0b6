"""Facts about files that are written: whole or not at all."""

import contextlib
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from fmp_drake.errors import FmpError, RunError
from fmp_drake.primitives.data.files import (
    check_writable,
    replaced,
    write_npz,
    write_text,
)

# Writes half of a file, says so, and waits to be killed.
HALF = """
import sys, time
from pathlib import Path
from fmp_drake.primitives.data.files import replaced, write_npz, write_text
import numpy as np

kind, path = sys.argv[1], Path(sys.argv[2])

def wait():
    print("half", flush=True)
    time.sleep(60)

class Endless:
    shape = (10**9, 3)
    def blocks(self):
        yield np.zeros((10**5, 3))
        wait()

if kind == "npz":
    write_npz(path, {"x": Endless()})
elif kind == "text":
    with replaced(path) as part:
        part.write_text("half")
        wait()
"""


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "older"), [("npz", b"precious"), ("text", None)])
def test_a_writer_that_is_killed_leaves_the_older_file_or_none(kind, older, tmp_path):
    path = tmp_path / f"out.{kind}"
    if older is not None:
        path.write_bytes(older)
    with subprocess.Popen(
        [sys.executable, "-c", HALF, kind, str(path)], stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout.readline() == b"half\n"
        writer.send_signal(signal.SIGKILL)
    assert (path.read_bytes() if path.exists() else None) == older
    # Afterwards it is written as if nothing had happened, and nothing is left over.
    assert len(list(tmp_path.glob(".out.*.part*"))) == 1
    write_text(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_writer_that_fails_leaves_the_older_file_and_nothing_else(tmp_path):
    path = tmp_path / "out.txt"
    path.write_text("precious")
    with contextlib.suppress(KeyError), replaced(path) as part:
        part.write_text("half")
        raise KeyError
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_an_error_of_the_layer_that_writes(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "out.txt"
    path.write_text("precious")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RunError, match=r"cannot write .*out\.txt: No space left"):
        write_text(path, "new", RunError)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


def test_the_temporary_file_of_another_process_is_kept(tmp_path):
    others = [tmp_path / f".out.{n}.part.txt" for n in (os.getppid(), "mine")]
    others.append(tmp_path / f".outer.{2**22 + 1}.part.txt")
    for other in others:
        other.touch()
    write_text(tmp_path / "out.txt", "new")
    assert set(tmp_path.iterdir()) == {tmp_path / "out.txt", *others}


def test_a_folder_that_is_missing_is_an_error(tmp_path):
    with pytest.raises(FmpError, match=r"cannot write .*No such file"):
        write_text(tmp_path / "no" / "out.txt", "new")


def test_the_temporary_file_has_the_same_ending(tmp_path):
    with replaced(tmp_path / "run.svg") as part:
        assert part.suffix == ".svg"
        part.write_text("<svg/>")


def test_an_array_in_blocks_is_written_as_if_it_were_whole(tmp_path):
    whole = np.random.default_rng(0).normal(size=(50, 3))

    class Halves:
        shape = whole.shape

        def blocks(self):
            yield from np.split(whole, 2)

    write_npz(tmp_path / "x.npz", {"whole": whole, "halves": Halves()})
    with np.load(tmp_path / "x.npz", allow_pickle=False) as file:
        np.testing.assert_array_equal(file["whole"], whole)
        np.testing.assert_array_equal(file["halves"], whole)


def test_names_that_cannot_be_written_are_refused_before(tmp_path):
    check_writable(None, "a log", [".npz"])
    check_writable(tmp_path / "run.any")
    check_writable(tmp_path / "run.NPZ", "a log", [".npz"])
    with pytest.raises(FmpError, match=r"is not a log; its name must end in \.npz\."):
        check_writable(tmp_path / "run.csv", "a log", [".npz"])
    with pytest.raises(RunError, match=r"end in \.a, \.b or \.c\."):
        check_writable(tmp_path / "run", "a film", [".a", ".b", ".c"], RunError)
    with pytest.raises(FmpError, match="there is no folder"):
        check_writable(tmp_path / "no" / "run.npz", "a log", [".npz"])
    with pytest.raises(FmpError, match="is a folder"):
        check_writable(tmp_path)
