"""Facts about files that are written: whole or not at all."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from fmp_drake.errors import FmpError, RunError
from fmp_drake.primitives.data.files import (
    check_writable,
    keep_earlier_files,
    replaced,
    write_json,
    write_text,
)

# Writes halves of a table and of a text, says so, and waits to be killed.
HALVES = """
import sys, time
from pathlib import Path
from fmp_drake.primitives.data.files import replaced, write_npz
import numpy as np

folder = Path(sys.argv[1])

class Endless(dict):
    def items(self):
        yield "x", np.zeros((10**5, 3))
        print("half", flush=True)
        time.sleep(60)

with replaced(folder / "text" / "out.text") as part:
    part.write_text("half")
    write_npz(folder / "npz" / "out.npz", Endless())
"""
OLDER = {"npz": b"precious", "text": None}


def test_all_files_of_a_series_are_kept_also_after_a_gap(tmp_path):
    for name in ("taught_2.npz", "taught_5.npz", "skill.npz", "taught.1.npz"):
        (tmp_path / name).write_text(name)
    renamed = keep_earlier_files(tmp_path / "taught.npz", tmp_path / "skill.npz")
    assert sorted(renamed) == ["skill.1.npz", "taught_2.1.npz", "taught_5.1.npz"]
    for name in renamed:
        assert (tmp_path / name).read_text() == name.replace(".1.", ".")
    assert (tmp_path / "taught.1.npz").exists()
    assert keep_earlier_files(tmp_path / "taught.npz", tmp_path / "skill.npz") == []


@pytest.fixture(scope="module")
def half_written(tmp_path_factory):
    """A folder for each kind of file, in which its writer was killed."""
    folder = tmp_path_factory.mktemp("half")
    for kind, older in OLDER.items():
        (folder / kind).mkdir()
        if older is not None:
            (folder / kind / f"out.{kind}").write_bytes(older)
    with subprocess.Popen(
        [sys.executable, "-c", HALVES, str(folder)], stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout.readline() == b"half\n"
        writer.send_signal(signal.SIGKILL)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("kind", OLDER)
def test_a_writer_that_is_killed_leaves_the_older_file_or_none(kind, half_written):
    folder = half_written / kind
    path = folder / f"out.{kind}"
    assert (path.read_bytes() if path.exists() else None) == OLDER[kind]
    # Afterwards it is written as if nothing had happened, and nothing is left over.
    assert len(list(folder.glob(".out.*.part*"))) == 1
    write_text(path, "new")
    assert path.read_text() == "new"
    assert list(folder.iterdir()) == [path]


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


def test_long_names_and_links_to_other_endings_are_written(tmp_path):
    name = tmp_path / f"{'ä' * 120}.json"
    write_text(name, "text")
    assert name.read_text() == "text"
    link, target = tmp_path / "run.svg", tmp_path / "blob"
    link.symlink_to(target)
    with replaced(link) as part:
        assert part.suffix == ".svg"
        part.write_text("<svg/>")
    assert target.read_text() == "<svg/>"


def test_read_only_folders_and_links_into_no_folder_are_refused_before(
    tmp_path, monkeypatch
):
    link = tmp_path / "run.svg"
    link.symlink_to(tmp_path / "no" / "run.svg")
    with pytest.raises(FmpError, match=r"there is no folder .*no to write run"):
        check_writable(link)
    # The superuser may write everywhere.
    monkeypatch.setattr(os, "access", lambda _, mode: not mode & os.W_OK)
    with pytest.raises(FmpError, match=r"of run\.npz is read-only"):
        check_writable(tmp_path / "run.npz")


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


def test_a_link_is_followed_and_a_pipe_is_not_replaced(tmp_path):
    link, target, pipe = (tmp_path / name for name in ("link", "target", "pipe"))
    target.write_text("old")
    link.symlink_to(target.name)
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    os.mkfifo(pipe)
    with pytest.raises(FmpError, match="pipe: it is not a regular file"):
        write_text(pipe, "new")
    with pytest.raises(FmpError, match="pipe is a device or a pipe; give the name"):
        check_writable(pipe)
    assert pipe.is_fifo()
    assert sorted(tmp_path.iterdir()) == [link, pipe, target]


def test_a_json_file_has_null_for_what_json_does_not_have(tmp_path):
    path = tmp_path / "out.json"
    write_json(path, {"a": [1.5, np.nan], "b": {"c": -np.inf}, "d": ("e", None, True)})
    expected = {"a": [1.5, None], "b": {"c": None}, "d": ["e", None, True]}
    assert json.loads(path.read_text(), parse_constant=pytest.fail) == expected
