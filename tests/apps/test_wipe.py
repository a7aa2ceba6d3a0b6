"""Facts about `fmp-drake wipe`."""

import json
import os
import signal

import matplotlib.image
import numpy as np
import pytest

from fmp_drake.runs.simulation_loop import advance

KEYS = {
    "simulated_seconds",
    "wall_seconds",
    "real_time_factor",
    "learn_seconds",
    "cleaned_fraction",
    "cleaned_fraction_of_demonstrated_area",
    "normal_force_mean_n",
    "normal_force_p05_n",
    "normal_force_p95_n",
    "normal_force_precise_fraction",
    "contact_fraction",
    "tracking_rms_m",
    "remap_count",
    "desired_position_jump_max_m",
    "torque_ratio_max",
    "torque_rate_max_nm_per_s",
    "joint_limit_margin_min_rad",
}
# What depends on the machine, not on the robot.
CLOCKS = {"wall_seconds", "real_time_factor", "learn_seconds"}


@pytest.fixture
def wipe(command, outputs):
    """The function that wipes, and returns the metrics of the report."""

    def run(*options, duration=0.5):
        path = outputs / "report.json"
        result = command(
            "wipe", "--headless", "--duration", duration, "--report", path, *options
        )
        assert result.code == 0, result
        assert result.err == ""
        return json.loads(path.read_text(encoding="utf-8"))

    return run


def timeless(metrics):
    return {key: value for key, value in metrics.items() if key not in CLOCKS}


def test_movement_above_the_board_cleans_nothing(command, outputs, monkeypatch):
    figures = []
    monkeypatch.setattr(
        "fmp_drake.plots.run_page.save", lambda figure, _: figures.append(figure)
    )
    page = outputs / "run.html"
    files = ("--plot", outputs / "run.png", "--html", page)
    above = ("--transform", 0, 0, 0.2, 0, 0, 0)
    result = command("wipe", "--headless", "--duration", 0.5, *above, *files)
    text = " ".join(result.out.split())
    assert "It never comes nearer to the board than 50 mm." in text
    assert "cleaned 0.0 % of the board; the demonstrated paths touch no ink" in text
    assert "time to clean" not in text
    titles = [ax.get_title(loc="left") for ax in figures[0].axes]
    assert "clean: the demonstrated paths touch no ink" in titles
    replayed = page.read_text(encoding="utf-8")
    assert '"force": [' in replayed
    assert '"cleaned": [' not in replayed


def test_interrupted_run_writes_its_files(command, outputs, monkeypatch):
    def interrupted(*arguments, **options):
        for now in advance(*arguments, **options):
            if now > 0.55:
                os.kill(os.getpid(), signal.SIGINT)
            yield now

    monkeypatch.setattr("fmp_drake.apps.wipe.advance", interrupted)
    report = outputs / "report.json"
    result = command("wipe", "--headless", "--duration", 30, "--report", report)
    assert (result.code, result.err) == (130, "fmp-drake: stopped.\n")
    metrics = json.loads(report.read_text(encoding="utf-8"))
    assert 0.55 < metrics["simulated_seconds"] < 0.7
    report.unlink()
    result = command("wipe", "--headless", "--duration", 30)
    assert (result.code, result.err.strip()) == (130, "fmp-drake: stopped.")
    assert "what went wrong" not in result.out


def test_three_seconds_write_report_picture_and_page(command, outputs):
    report, plot, html = (outputs / n for n in ("report.json", "run.png", "run.html"))
    result = command(
        *("wipe", "--headless", "--duration", 3),
        *("--report", report, "--plot", plot, "--html", html),
    )
    assert result.code == 0
    assert result.err == ""
    for path in (report, plot, html):
        assert f"wrote {path}" in result.out
    assert "http://" not in result.out

    metrics = json.loads(report.read_text(encoding="utf-8"))
    assert metrics["events"] == []
    assert "what went wrong  nothing" in result.out
    precise = 100 * metrics["normal_force_precise_fraction"]
    assert f"{precise:.1f} % within 10 % and " in result.out
    assert set(metrics) >= KEYS
    assert metrics["scenario"] == "table_top"
    assert metrics["seconds_to_99_percent"] is None
    numbers = [value for value in metrics.values() if isinstance(value, float | int)]
    assert len(numbers) > 20
    assert np.all(np.isfinite(numbers))
    assert metrics["simulated_seconds"] == 3
    assert metrics["wall_seconds"] > 0
    assert metrics["real_time_factor"] == pytest.approx(3 / metrics["wall_seconds"])
    assert metrics["learn_seconds"] > 0
    assert 0 < metrics["cleaned_fraction"] < 0.3
    assert (
        metrics["cleaned_fraction"]
        < metrics["cleaned_fraction_of_demonstrated_area"]
        < 1
    )
    assert (
        5
        < metrics["normal_force_p05_n"]
        < metrics["normal_force_mean_n"]
        < metrics["normal_force_p95_n"]
        < 15
    )
    assert metrics["contact_fraction"] > 0.9
    assert 0 < metrics["tracking_rms_m"] < 0.01
    assert metrics["remap_count"] == 0
    assert 0 < metrics["torque_ratio_max"] < 1
    assert 0 < metrics["torque_rate_max_nm_per_s"] < 1000
    assert metrics["joint_limit_margin_min_rad"] > 0
    assert 0 < metrics["joint_speed_ratio_max"] < 1

    picture = matplotlib.image.imread(plot)
    assert picture.shape[0] > 500
    assert np.ptp(picture[..., :3]) > 0.9
    page = html.read_text(encoding="utf-8")
    assert "<html" in page.lower()
    assert "</html>" in page.lower()
    assert sorted(p.name for p in outputs.iterdir()) == [
        "report.json",
        "run.html",
        "run.png",
    ]


def test_remappings_are_counted(wipe):
    metrics = wipe("--window", 1.0, "--n-components", 5, "--force", duration=0.95)
    # Windows of 20 samples overlap by 5: one every 0.75 s at most.
    assert metrics["remap_count"] == 1
    assert 0 <= metrics["desired_position_jump_max_m"] < 1e-3


def test_run_depends_on_the_seed(wipe):
    one, same, other = (timeless(wipe("--seed", seed)) for seed in (1, 1, 2))
    assert one == same
    assert one != other


def test_runs_of_means_do_not_depend_on_the_seed(wipe):
    one, two = (timeless(wipe("--mean", "--seed", seed)) for seed in (1, 2))
    assert one == two
    assert one != timeless(wipe("--sample", "--seed", 1))


def test_learned_skill_plays_like_its_demonstration(command, wipe, make_npz, outputs):
    demo, skill = make_npz(), outputs / "skill.npz"
    options = ("--window", 2.5, "--n-components", 3, "--stretch", 1.25)
    assert command("learn", demo, "--out", skill, *options).code == 0
    played = timeless(wipe("--skill", skill))
    learned = timeless(wipe("--demo", demo, *options))
    # Without its demonstration, the area is that of the skill's own paths.
    of_the_area = ("demonstrated_area", "missed", "seconds_to")
    same = {
        key: value
        for key, value in played.items()
        if not any(part in key for part in of_the_area)
    }
    assert len(same) > 15
    assert same.items() <= learned.items()


def test_several_demonstrations_are_learned_together(command, wipe, make_npz):
    paths = [make_npz("one.npz"), make_npz("two.npz", seconds=15)]
    options = [part for path in paths for part in ("--demo", path)]
    assert wipe(*options, "--window", 2.5)["cleaned_fraction"] >= 0
    out = command("wipe", "--headless", "--duration", 0.1, *options).out
    for path in paths:
        assert f"{path.name}: placed in" in out


def test_csv_is_a_demonstration(wipe, make_csv):
    assert wipe("--demo", make_csv())["tracking_rms_m"] < 0.01


def test_csv_with_units_is_a_demonstration(wipe, make_csv):
    header = "time [s],x [m],y [m],z [m]"
    assert wipe("--demo", make_csv(header))["tracking_rms_m"] < 0.01


def test_start_is_set_by_the_option(wipe):
    high = wipe("--start", 0.0, 0.1, 0.2)
    assert high["cleaned_fraction"] == 0
    assert high["contact_fraction"] == 0
    assert high["normal_force_mean_n"] == 0
    low = wipe("--start", 0.0, 0.1, 0.0)
    assert low["contact_fraction"] > 0


def test_transform_replaces_the_fit(command, make_npz):
    laid = ("--demo", make_npz(), "--transform", 0.05, 0, 0, 0, 0, 1.5)
    result = command("wipe", "--headless", "--duration", 0.1, *laid)
    assert result.code == 0
    assert "placed in" not in result.out


def test_stretch_makes_a_short_demonstration_long_enough(refused, wipe, make_npz):
    short = make_npz(seconds=1.4)
    message = refused("wipe", "--headless", "--demo", short)
    assert "at least 2 are needed" in message
    assert "choose shorter windows, of" in message
    assert wipe("--demo", short, "--stretch", 10)["tracking_rms_m"] < 0.01


def test_scenario_may_be_a_file(wipe, tmp_path):
    scene = tmp_path / "hard.yaml"
    scene.write_text("press: {force: 14.0}\n", encoding="utf-8")
    default, hard = (
        wipe("--scenario", name, "--start", 0, 0, 0)["normal_force_mean_n"]
        for name in ("table_top", scene)
    )
    assert hard > default + 1


def test_rate_slows_the_simulation_down(wipe):
    assert wipe("--target-realtime-rate", 2.0, duration=0.1)["simulated_seconds"] == 0.1


def test_page_stays_open_until_enter(command, enter):
    enter()
    result = command("wipe", "--duration", 0.05)
    assert result.code == 0
    assert result.out.endswith("the page stays open; press Enter to quit ")


def test_report_replaces_an_older_one(wipe, outputs):
    (outputs / "report.json").write_text("old", encoding="utf-8")
    assert wipe(duration=0.1)["simulated_seconds"] == 0.1


def test_table_of_metrics_is_printed(command):
    out = command("wipe", "--headless", "--duration", 0.5).out
    for name in (
        "simulated",
        "cleaned",
        "normal force",
        "tracking error",
        "re-mapped",
        "limits",
    ):
        assert name in out
    assert "% of the demonstrated area, " in out
    assert "nan" not in out


@pytest.mark.parametrize("option", ["--skill", "--demo"])
def test_an_input_is_not_replaced_by_an_output(refused, tmp_path, option):
    file = tmp_path / "a.npz"
    file.write_bytes(b"precious")
    line = refused("wipe", "--headless", option, file, "--log", file)
    assert "a.npz is read; give the output a file of its own" in line
    assert file.read_bytes() == b"precious"
