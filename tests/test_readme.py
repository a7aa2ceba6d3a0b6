"""Every command and the program of the README run, with shorter durations."""

import os
import re
import shlex
import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from fmp_drake.apps.main import app
from fmp_drake.film.checks import renders

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[1]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")
SHORTER = (
    ("--duration 20", "--duration 0.2"),
    ("--minutes 3", "--minutes 0.05"),
    ("--count 100 --seconds 20", "--count 2 --seconds 0.2 --jobs 1"),
)
# tests/experiments/test_reproduce.py runs it.
REPRODUCE = "fmp-drake reproduce --quick --out report"


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands():
    """Return the lines of the README that call fmp-drake, in order."""
    lines = "".join(blocks("sh")).splitlines()
    return [line for line in lines if line.startswith("fmp-drake ")]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the files that the README calls the reader's own."""
    monkeypatch.chdir(tmp_path)
    time = np.arange(400) / 20
    angle = 2 * np.pi * time / 2.5
    motion = np.column_stack(
        [time, 0.4 + 0.08 * np.cos(angle), 0.1 * np.sin(angle), 0.2 + 0 * time]
    )
    np.savetxt("my_motion.csv", motion, delimiter=",", header="time,x,y,z", comments="")
    with tarfile.open("frames.tar", "w") as archive:
        for number in range(5):
            name = f"{number:07d}.png"
            image.imsave(name, np.full((16, 16, 3), 40 * number, dtype=np.uint8))
            archive.add(name)
    return tmp_path


def test_commands_run_in_the_order_of_the_readme(folder):
    from click.testing import CliRunner

    pytest.importorskip("imageio_ffmpeg", reason="films need the extra packages")
    assert len(commands()) >= 7
    for line in commands():
        if line.split("#")[0].rstrip() == REPRODUCE:
            continue
        if "--video" in line and not renders():
            continue
        for long, short in SHORTER:
            line = line.replace(long, short)
        words = shlex.split(line, comments=True)
        assert words[0] == "fmp-drake"
        result = CliRunner().invoke(app, words[1:], catch_exceptions=False)
        assert result.exit_code == 0, (line, result.output)
    written = {p.name for p in folder.iterdir()} | {"report"}
    for name in re.findall(
        r"--(?:report|html|out|plot|log|graphviz) (\S+)", "\n".join(commands())
    ):
        assert name in written
    assert "film.mp4" in written


def test_program_runs(tmp_path):
    (program,) = blocks("python")
    assert len(program.strip().splitlines()) <= 16
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.strip(" []\n")) > 0.01


def test_targets_of_make_exist():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"\bmake (\w+)", "".join(blocks("sh")))):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


def test_links_and_pictures_are_there():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (REPOSITORY / target).exists(), target
