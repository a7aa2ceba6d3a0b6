"""Facts about the built wheel, used outside the checkout."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

import fmp_drake

REPOSITORY = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.slow
needs_make = pytest.mark.skipif(
    shutil.which("make") is None, reason="make is not installed"
)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel of this checkout, without network."""
    pytest.importorskip("build", reason="building a wheel needs the package build")
    pytest.importorskip("hatchling", reason="building a wheel needs hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    done = subprocess.run(
        [
            *(sys.executable, "-m", "build", "--wheel", "--no-isolation"),
            *("--outdir", folder, REPOSITORY),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Unpack the wheel, and return the function that runs Python on it."""
    site = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)

    def run(*arguments):
        elsewhere = tmp_path_factory.mktemp("elsewhere")
        done = subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=elsewhere,
            env={**os.environ, "PYTHONPATH": str(site)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    run.site = site
    return run


def names(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_wheel_has_name_and_version_of_the_package(wheel):
    assert wheel.name == f"fmp_drake-{fmp_drake.__version__}-py3-none-any.whl"


def test_citation_names_the_version_of_the_package():
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    assert citation["version"] == fmp_drake.__version__


def test_workflows_run_what_the_checkout_has():
    for path in sorted((REPOSITORY / ".github" / "workflows").glob("*.yml")):
        for job in yaml.safe_load(path.read_text())["jobs"].values():
            for step in job["steps"]:
                assert set(step) <= {"uses", "with", "run", "env"}, path.name
                if step.get("run", "").startswith("."):
                    assert (REPOSITORY / step["run"]).is_file()


def test_wheel_holds_every_module_and_model(wheel):
    held = names(wheel)
    package = REPOSITORY / "fmp_drake"
    files = [*package.rglob("*.py"), *package.rglob("*.html")]
    assert {p.relative_to(REPOSITORY).as_posix() for p in files} <= held
    models = [p for p in (REPOSITORY / "models").rglob("*") if p.is_file()]
    assert len(models) > 5
    for path in models:
        assert f"fmp_drake/{path.relative_to(REPOSITORY).as_posix()}" in held


def test_wheel_holds_nothing_else(wheel):
    about = f"fmp_drake-{fmp_drake.__version__}.dist-info"
    assert {name.split("/")[0] for name in names(wheel)} == {"fmp_drake", about}
    assert not [name for name in names(wheel) if "__pycache__" in name]
    assert f"{about}/licenses/LICENSE" in names(wheel)


def test_unpacked_wheel_is_imported_whole_and_finds_its_models(installed):
    code = """
import importlib, pkgutil, fmp_drake
print(fmp_drake.__file__)
for module in pkgutil.walk_packages(fmp_drake.__path__, "fmp_drake."):
    importlib.import_module(module.name)
    print(module.name)
from fmp_drake.station import AddBoardScene, LoadScenario, models_dir
from pydrake.systems.framework import DiagramBuilder
scenario = LoadScenario("table_top")
AddBoardScene(DiagramBuilder(), scenario, start=scenario.start)
print(models_dir())
"""
    package, *imported, models = installed("-c", code).splitlines()
    assert Path(package).parent == installed.site / "fmp_drake"
    assert Path(models) == installed.site / "fmp_drake" / "models"
    assert "fmp_drake.apps.main" in imported
    assert "fmp_drake.station.station" in imported
    assert len(imported) > 30


def test_wheel_installs_the_script(wheel):
    about = f"fmp_drake-{fmp_drake.__version__}.dist-info"
    with zipfile.ZipFile(wheel) as archive:
        entries = archive.read(f"{about}/entry_points.txt").decode()
    assert "fmp-drake = fmp_drake.apps.main:main" in entries


@pytest.fixture
def checkout(tmp_path):
    """Return a folder with all that make reads before it runs Python."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt", ".python-version"):
        (tmp_path / name).write_bytes((REPOSITORY / name).read_bytes())
    return tmp_path


def run_make(folder, *arguments, env=None):
    """Return what make prints in a folder."""
    done = subprocess.run(
        [shutil.which("make"), "--no-print-directory", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env=env,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@needs_make
@pytest.mark.parametrize("command", ["wipe", "teach"])
def test_make_runs_a_checkout_that_was_moved_with_its_environment(checkout, command):
    # The installed script fmp-drake names the folder in which it was installed.
    python = checkout / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text('#!/bin/sh\necho "$@"\n')
    python.chmod(0o755)
    (checkout / ".venv" / ".installed").touch()
    printed = run_make(checkout, command, "ARGS=--seed 3")
    assert printed.strip() == f"-m fmp_drake {command} --seed 3"


def write_programs(checkout, python):
    """Write what makes an environment; return the folder of the other programs.

    A copy of `python` is the Python of the environment that its last argument names.
    """
    programs = checkout / "programs"
    programs.mkdir()
    for name in ("sh", "rm", "mkdir", "touch", "cp"):
        (programs / name).symlink_to(shutil.which(name))
    python.write_text(
        "#!/bin/sh\nfor last; do :; done\n"
        'if [ "$last" = .venv ]; then mkdir -p .venv/bin && cp "$0" .venv/bin/python; fi\n'
    )
    python.chmod(0o755)
    return programs


@needs_make
@pytest.mark.parametrize("program", ["uv", "python3"])
def test_make_leaves_an_environment_alone_that_is_only_linked(checkout, program):
    shared = checkout / "shared"
    shared.mkdir()
    (shared / "kept").touch()
    (checkout / ".venv").symlink_to(shared)
    programs = write_programs(checkout, checkout / "programs" / program)
    run_make(checkout, ".venv/.installed", env={"PATH": str(programs)})
    assert (shared / "kept").exists()
    assert not (checkout / ".venv").is_symlink()


@needs_make
def test_make_renews_an_environment_that_is_active(checkout):
    active = checkout / ".venv" / "bin"
    active.mkdir(parents=True)
    programs = write_programs(checkout, active / "python3")
    run_make(checkout, ".venv/.installed", env={"PATH": f"{active}:{programs}"})
    assert (active / "python").exists()
