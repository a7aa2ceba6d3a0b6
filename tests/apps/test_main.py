"""Facts about the command line as a whole: what it refuses, and how."""

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import fmp_drake
from fmp_drake.apps import commands
from fmp_drake.errors import RunError
from fmp_drake.station.models.model_files import models_dir

SCRIPT = Path(sys.executable).parent / "fmp-drake"


# Wrong options: one line, exit code 2, nothing written.


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--start", 5, 0, 0), "the start is out of reach"),
        (("--start", 0, 0, "nan"), "finite"),
        (("--start", 0, 0), "--start"),
        (("--duration", -1), "duration is -1"),
        (("--duration", 0), "duration is 0"),
        (("--duration", "nan"), "duration is nan"),
        (("--duration", "inf"), "duration is inf"),
        (("--duration", "soon"), "soon"),
        (("--target-realtime-rate", -1), "target_realtime_rate is -1"),
        (("--target-realtime-rate", "nan"), "target_realtime_rate is nan"),
        (("--target-realtime-rate", "inf"), "target_realtime_rate is inf"),
        (("--window", 0), "window is 0"),
        (("--window", "nan"), "window is nan"),
        (("--window", 1000), "--window"),
        (("--stretch", 0), "stretch is 0"),
        (("--stretch", -2), "stretch is -2"),
        (("--stretch", "nan"), "stretch is nan"),
        (("--stretch", 0.01), "--stretch"),
        (("--n-components", 0), "n_components is 0"),
        (("--n-components", -3), "n_components is -3"),
        (("--n-components", 2.5), "2.5"),
        (("--seed", -1), "seed is -1"),
        (("--transform", "nan", 0, 0, 0, 0, 0), "NaN"),
        (("--transform", 1, 2, 3), "--transform"),
        (("--scenario", "billiards"), "table_top"),
        (("--scenario", "nowhere.yaml"), "nowhere.yaml"),
        (("--demo", "nowhere.npz"), "nowhere.npz"),
        (("--skill", "nowhere.npz"), "nowhere.npz"),
        (("--demo", "a.npz", "--skill", "b.npz"), "not both"),
        (
            ("--skill", "b.npz", "--stretch", 2, "--unit", "mm"),
            "leave out the options for l",
        ),
        (("--scenario", "pulsing_force", "--press-force", 3), "its own normal force"),
        (("--scenario", "stir", "--press-force", 3), "there is no board"),
        (("--spin",), "--spin"),
        (("--spin",), "See fmp-drake wipe -h."),
        (("pushed.yaml",), "did you mean --scenario pushed.yaml?"),
        (("ur5e",), "did you mean --robot ur5e?"),
        (("skill.npz",), "did you mean --skill skill.npz?"),
        (("mine.csv",), "did you mean --demo mine.csv?"),
    ],
)
def test_wrong_option_is_refused_in_one_line(refused, outputs, options, reason):
    message = refused(
        *("wipe", "--headless", "--duration", 0.2),
        *("--report", outputs / "report.json", "--plot", outputs / "plot.png"),
        *options,
    )
    assert reason in message
    assert list(outputs.iterdir()) == []


def test_wrong_call_is_refused_with_the_commands_or_where_the_help_is(refused):
    message = refused("wip")
    assert all(name in message for name in ("wipe", "teach", "inspect"))
    assert refused("learn").endswith(" See fmp-drake learn -h.\n")
    assert refused("inspect", "a.csv", "--help-all").endswith(
        "Did you mean '--help'? See fmp-drake inspect -h.\n"
    )
    extra = refused("record", "eight.npz", "--out", "a.npz")
    assert extra.endswith("(eight.npz). See fmp-drake record -h.\n")


@pytest.mark.parametrize("option", ["--report", "--plot", "--html"])
def test_output_that_cannot_be_written_is_refused_before_the_work(
    refused, tmp_path, option
):
    # An hour of simulation is not waited for.
    long = ("wipe", "--headless", "--duration", 3600)
    missing = tmp_path / "missing" / "file.png"
    assert "there is no folder" in refused(*long, option, missing)
    assert not missing.parent.exists()
    assert "is a folder" in refused(*long, option, tmp_path)
    assert f"'{option}': the name is empty" in refused(*long, option, "")


@pytest.mark.parametrize("name", ["plot.exe", "plot"])
def test_picture_of_an_unknown_kind_is_refused_before_the_work(
    refused, outputs, make_npz, name
):
    plot, skill = outputs / name, outputs / "skill.npz"
    report = outputs / "report.json"
    for arguments in (
        ("wipe", "--headless", "--duration", 3600, "--report", report),
        ("learn", make_npz(), "--out", skill),
    ):
        assert "is not a picture" in refused(*arguments, "--plot", plot)
    assert list(outputs.iterdir()) == []


def test_page_is_not_announced_before_a_refusal(refused, outputs):
    html = outputs / "run.html"
    refused("wipe", "--headless", "--html", html, "--start", 5, 0, 0)
    assert list(outputs.iterdir()) == []


# Wrong files.


def infinity_in_the_values():
    position = np.zeros((200, 3))
    position[7, 1] = np.inf
    return {"position": position, "time": np.arange(200) / 20}


@pytest.mark.parametrize(
    ("arrays", "reason"),
    [
        (infinity_in_the_values(), "NaN"),
        ({"time": np.arange(3) / 20, "position": np.eye(3)}, "3 samples"),
        ({"time": np.zeros(400)}, "the time stays the same"),
        ({"time": np.arange(7)}, "shape"),
        ({"values": np.array(["a"] * 400)}, "numbers"),
        ({"position": np.zeros((400, 3))}, "point or a line"),
    ],
)
@pytest.mark.parametrize("name", ["wipe", "learn"])
def test_demonstration_with_wrong_numbers_is_refused(
    refused, outputs, make_npz, name, arrays, reason
):
    bad = make_npz("bad.npz", **arrays)
    arguments = {
        "wipe": ("wipe", "--headless", "--demo", bad, "--report"),
        "learn": ("learn", bad, "--out"),
    }[name]
    ending = {"wipe": ".json", "learn": ".npz"}[name]
    message = refused(*arguments, outputs / f"out{ending}")
    assert reason in message
    assert "--surface" not in message
    assert "bad.npz" in message or reason == "point or a line"
    assert list(outputs.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "empty"),
        ("a,b,c\n1,2,3\n", "columns are a, b, c"),
        ("time,x,y,z\n0,1,2,3\n1,1,2,three\n", "line 3: 'three'"),
        ("time,x,y,z\n0,1,2\n", "line 2 has 3 cells"),
        ("time,x,y,z\n0,1,2,3\n", "1 samples"),
    ],
)
def test_invalid_table_is_refused(refused, outputs, tmp_path, text, reason):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    assert reason in refused("learn", path, "--out", outputs / "skill.npz")
    assert list(outputs.iterdir()) == []


@pytest.mark.parametrize("option", ["--demo", "--skill", "--scenario"])
def test_meaningless_bytes_are_refused(refused, tmp_path, option):
    suffix = ".yaml" if option == "--scenario" else ".npz"
    path = tmp_path / f"noise{suffix}"
    path.write_bytes(np.random.default_rng(0).bytes(300))
    assert path.name in refused("wipe", "--headless", option, path)


def test_demonstration_is_not_a_skill_and_a_skill_not_a_demonstration(
    command, refused, make_npz, outputs
):
    demo, skill = make_npz(), outputs / "skill.npz"
    assert command("learn", demo, "--out", skill).code == 0
    assert "is not a skill file" in refused("wipe", "--headless", "--skill", demo)
    assert skill.name in refused("wipe", "--headless", "--demo", skill)


def test_scenario_with_wrong_keys_or_values_is_refused(refused, tmp_path):
    scene = tmp_path / "scene.yaml"
    for text, reason in (
        ("robot: ur5\n", "robot"),
        ("press: {force: -1}\n", "force is -1"),
        ("ink: {cell: 0}\n", "cell"),
        ("plant: {contact_model: glue}\n", "glue"),
        ("impedance: {damping_ratio: 0}\n", "damping_ratio"),
    ):
        scene.write_text(text, encoding="utf-8")
        assert reason in refused("wipe", "--headless", "--scenario", scene)


# The command itself.


def test_help_names_every_command(command):
    result = command("--help")
    assert result.code == 0
    for name in ("wipe", "learn", "record", "video"):
        assert f"  {name} " in result.out
        assert command(name, "--help").code == 0


def test_no_command_shows_the_help(command):
    result = command()
    assert "Commands:\n" in result.out
    assert result.err == ""


def test_version_is_that_of_the_package(command):
    assert fmp_drake.__version__ in command("--version").out


def test_unknown_command_is_refused(refused):
    assert "dance" in refused("dance")


def test_interruption_ends_without_a_traceback(command, monkeypatch):
    def interrupted(**_):
        raise KeyboardInterrupt

    monkeypatch.setattr(commands.app, "main", interrupted)
    result = command("wipe")
    assert result.code == 130
    assert result.err == "fmp-drake: stopped.\n"


def test_error_while_compiled_code_is_fetched_is_an_interrupt(command, monkeypatch):
    def interrupted(**_):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise SystemError("returned a result with an exception set") from stop

    monkeypatch.setattr(commands.app, "main", interrupted)
    assert command("wipe").err == "fmp-drake: stopped.\n"


def test_other_errors_of_the_interpreter_are_shown(command, monkeypatch):
    def broken(**_):
        raise SystemError("broken")

    monkeypatch.setattr(commands.app, "main", broken)
    with pytest.raises(SystemError, match="broken"):
        command("wipe")


def test_debug_messages_of_drake_are_not_printed(command, caplog):
    command("--version")
    with caplog.at_level(logging.DEBUG, "drake"):
        logging.getLogger("drake").info("listening")
        logging.getLogger("drake").warning("the mesh is empty")
    assert caplog.messages == ["the mesh is empty"]


def test_full_disk_ends_without_a_traceback(refused, monkeypatch):
    def full(**_):
        raise OSError(28, "No space left on device", "report.json")

    monkeypatch.setattr(commands.app, "main", full)
    assert refused("wipe") == "fmp-drake: report.json: No space left on device\n"


def test_full_disk_without_a_folder_for_temporary_files_ends_without_a_traceback(
    refused, monkeypatch
):
    def full(**_):
        raise OSError(28, "No space left on device")

    def no_folder():
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setattr(commands.app, "main", full)
    monkeypatch.setattr("tempfile.gettempdir", no_folder)
    assert refused("wipe") == "fmp-drake: No space left on device\n"


# The installed script, in a process of its own.


@pytest.fixture
def script(tmp_path):
    if not SCRIPT.exists():
        pytest.skip("the script fmp-drake is not installed beside this Python")

    def run(*arguments):
        return subprocess.run(
            [SCRIPT, *map(str, arguments)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    return run


def test_deleted_current_folder_is_named(tmp_path):
    folder = tmp_path / "deleted"
    folder.mkdir()
    done = subprocess.run(
        ["sh", "-c", 'rmdir "$PWD" && exec "$0" inspect a.npz', SCRIPT],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "fmp-drake: No such file or directory (the current folder was deleted)\n"
    )


def test_installed_script_wipes(script, tmp_path):
    done = script(
        *("wipe", "--headless", "--duration", 0.5, "--report", "report.json"),
        *("--window", 2, "--n-components", 2),
    )
    assert done.returncode == 0
    # The only allowed message is that of compilation, once per machine.
    assert "Traceback" not in done.stderr
    figures = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert figures["simulated_seconds"] == 0.5


def test_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "fmp_drake", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert fmp_drake.__version__ in done.stdout


def test_installed_script_refuses_like_the_function(script):
    done = script("wipe", "--headless", "--demo", "nowhere.npz")
    assert done.returncode == 2
    assert done.stderr == "fmp-drake: there is no demonstration file nowhere.npz.\n"
    assert done.stdout == ""


def test_bundled_demonstrations_are_found():
    for task in ("wiping", "polishing", "eight"):
        assert (models_dir() / "demonstrations" / f"{task}.npz").is_file()


def test_letters_that_the_terminal_lacks_are_escaped(make_npz):
    file = make_npz("ä.npz")
    done = subprocess.run(
        [SCRIPT, "inspect", file],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"next: fmp-drake learn" in done.stdout
    assert rb"\xe4.npz" in done.stdout


def test_file_with_a_leading_dash_is_none_of_the_options(
    command, make_npz, tmp_path, monkeypatch
):
    make_npz("-e.npz")
    monkeypatch.chdir(tmp_path)
    result = command("inspect", "./-e.npz")
    assert "next: fmp-drake learn ./-e.npz --out skill.npz" in result.out


def test_loop_of_links_is_refused(refused, tmp_path, make_npz):
    loop = tmp_path / "loop.npz"
    loop.symlink_to(loop)
    assert "loop" in refused("learn", make_npz("mine.npz"), "--out", loop)


def test_other_files_are_written_where_one_fails(command, monkeypatch, outputs):
    def fail(*_):
        raise RunError("cannot write the picture.")

    monkeypatch.setattr("fmp_drake.apps.run_report.plot_run", fail)
    picture, page = outputs / "run.png", outputs / "run.html"
    options = ("--headless", "--duration", 0.1, "--plot", picture, "--html", page)
    result = command("wipe", *options)
    assert (result.code, result.err) == (2, "fmp-drake: cannot write the picture.\n")
    assert page.is_file()
    assert f"wrote {page}" in result.out


def test_pictures_do_not_depend_on_the_settings_of_the_user(command, monkeypatch):
    monkeypatch.setitem(matplotlib.rcParams, "font.size", 30.0)
    command("robots")
    assert matplotlib.rcParams["font.size"] == 10.0


def test_names_with_brackets_are_printed_as_they_are(command, tmp_path):
    table = tmp_path / "circle[red].csv"
    t = np.arange(0, 20, 0.05)
    np.savetxt(
        table,
        np.column_stack([t, 0.1 * np.cos(3 * t), 0.1 * np.sin(3 * t), 0 * t]),
        delimiter=",",
        header="time [s],x [m],y [m],z [m]",
        comments="",
    )
    out = tmp_path / "skill[" / "x[:b].npz"
    out.parent.mkdir()
    text = command("learn", table, "--out", out).out
    assert f"wrote {out}" in text
    assert "circle[red].csv" in text
