"""Facts about `fmp-drake scenarios`."""

import re

import matplotlib.image
import numpy as np
import pytest
from trials_stub import Here

from fmp_drake.apps import scenarios as scenarios_module
from fmp_drake.errors import RunError, StationError
from fmp_drake.experiments import scenario_page as page_module
from fmp_drake.experiments.scenario_page import (
    ScenarioRun,
    measure_scenario,
    measure_scenarios,
    scenario_page,
)
from fmp_drake.film import scene as film_scene
from fmp_drake.station.scenario import ListScenarios, LoadScenario

METRICS = {
    "cleaned_fraction_of_demonstrated_area": 0.987,
    "seconds_to_50_percent": 12.3,
    "seconds_to_90_percent": 40.0,
    "seconds_to_99_percent": None,
    "normal_force_p05_n": 8.91,
    "normal_force_p95_n": 11.2,
    "normal_force_precise_fraction": 0.984,
    "normal_force_wanted_fraction": 0.999,
    "tracking_rms_m": 0.00352,
    "torque_ratio_max": 0.48,
    "joint_speed_ratio_max": 0.84,
    "joint_limit_margin_min_rad": 0.444,
    "fault_fraction": 0.0,
}


def rows(page):
    """Return the cells of each row of the page's table."""
    lines = [line for line in page.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def blue_ink(picture):
    r, g, b = np.moveaxis(picture[..., :3], -1, 0)
    return (b > 0.3) & (b > 1.4 * r) & (b > 1.2 * g)


def test_every_scenario_is_listed_with_its_description(command):
    result = command("scenarios")
    assert result.code == 0
    assert result.err == ""
    lines = result.out.splitlines()
    names = ListScenarios()
    assert {"table_top", "vertical", "tilted", "pushed", "words"} < set(names)
    for line, name in zip(lines, names, strict=False):
        assert line.split() == [name, *LoadScenario(name).description.split()]
    assert "fmp-drake wipe --scenario" in lines[-1]
    assert len(lines) == len(names) + 1


def test_page_has_a_row_and_a_picture_of_each(command, outputs, monkeypatch):
    # The names are sent to the processes that simulate.
    monkeypatch.setattr(
        scenarios_module, "ListScenarios", lambda: ["moving_board", "words"]
    )
    monkeypatch.setattr(page_module, "cpu_count", lambda: 1)
    path = outputs / "README.md"
    result = command("scenarios", "--markdown", path, "--duration", 0.5)
    assert result.code == 0, result
    assert result.err == ""
    assert f"wrote {path}" in result.out
    page = path.read_text(encoding="utf-8")
    assert "--markdown FILE --duration 0.5`" in page
    head, line, *body = rows(page)
    assert set("".join(line)) == {"-"}
    assert len(line) == len(head)
    assert [row[0] for row in body] == [
        "[moving_board](#moving_board)",
        "[words](#words)",
    ]
    for row in body:
        assert len(row) == len(head)
        numbers = [float(n) for cell in row for n in re.findall(r"\d+\.?\d*", cell)]
        assert len(numbers) >= 8
        assert float(row[1].removesuffix("%")) < 100
    for name in ("moving_board", "words"):
        assert f"## {name}\n\n{LoadScenario(name).description}" in page
    if not film_scene.renders():
        pytest.skip("pictures need EGL")
    for name in ("moving_board", "words"):
        assert f"]({name}.png)" in page
        picture = matplotlib.image.imread(outputs / f"{name}.png")
        assert picture.shape[:2] == (360, 480)
        assert np.mean(blue_ink(picture)) > 0.003
    assert len(list(outputs.iterdir())) == 3


def test_page_contains_the_metrics():
    measured = {"table_top": ScenarioRun(METRICS, True)}
    page = scenario_page(measured, duration=60.0)
    (row,) = rows(page)[2:]
    assert row == [
        "[table_top](#table_top)",
        "98.7 %",
        "12 / 40 / - s",
        "8.9 to 11.2 N",
        "98.4 / 99.9 %",
        "3.5 mm",
        "48 / 84 %",
        "0.44 rad",
    ]
    assert "![table_top after 60 s](table_top.png)" in page
    assert "--duration 60`" in page
    assert "In a protective stop" not in page


def test_page_has_no_ink_and_no_force_in_free_space():
    free = {
        k: v for k, v in METRICS.items() if "force" not in k and "_percent" not in k
    }
    del free["cleaned_fraction_of_demonstrated_area"]
    free["orientation_rms_deg"] = 0.234
    pressed = METRICS | {"normal_force_error_rms_n": 0.187}
    runs = {
        "stir": ScenarioRun(free, True),
        "table_top": ScenarioRun(pressed, True),
    }
    stir, pulsing = rows(scenario_page(runs, duration=60.0))[2:]
    assert stir[1:6] == ["-", "-", "-", "-", "3.5 mm, 0.23 degrees"]
    assert pulsing[5] == "3.5 mm, 0.19 N"


def test_page_names_faults_and_leaves_out_pictures_that_are_not_there():
    faulty = METRICS | {"fault_fraction": 0.123}
    page = scenario_page({"pushed": ScenarioRun(faulty, False)}, duration=10.0)
    assert (
        "In a protective stop, at a joint limit or below the surface 12.3 % of the time."
        in page
    )
    assert "![" not in page


def test_without_egl_there_are_metrics_and_no_picture(monkeypatch, outputs):
    def blind(*_, **__):
        raise RunError("films are rendered through EGL, which does not work here")

    monkeypatch.setattr(page_module, "render_picture", blind)
    metrics, pictured = measure_scenario("table_top", 0.2, outputs)
    assert not pictured
    assert set(METRICS) <= set(metrics)
    assert list(outputs.iterdir()) == []


def test_picture_shows_the_end(outputs):
    if not film_scene.renders():
        pytest.skip("pictures need EGL")
    _, pictured = measure_scenario("words", 0.02, outputs)
    assert pictured
    assert [path.name for path in outputs.iterdir()] == ["words.png"]


def test_scenario_that_cannot_be_measured_is_an_error(monkeypatch, outputs):
    monkeypatch.setattr(page_module, "LocalWorkers", lambda *_, **__: Here())
    with pytest.raises(StationError, match="billiards"):
        list(measure_scenarios(["billiards"], 0.1, outputs))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--markdown", "page.txt"), "name must end in .md"),
        (("--markdown", "missing/page.md"), "there is no folder"),
        (("--markdown", "."), "is a folder"),
        (("--markdown", "page.md", "--duration", 0), "duration is 0"),
        (("--markdown", "page.md", "--duration", -1), "duration is -1"),
        (("--markdown", "page.md", "--duration", "nan"), "duration is nan"),
        (("--markdown", "page.md", "--duration", "inf"), "duration is inf"),
        (("--pages",), "--pages"),
    ],
)
def test_wrong_option_is_refused_before_the_work(
    refused, outputs, monkeypatch, options, reason
):
    def work(*_, **__):
        raise AssertionError("it began to work")

    monkeypatch.setattr(scenarios_module, "measure_scenarios", work)
    monkeypatch.chdir(outputs)
    assert reason in refused("scenarios", *options)
    assert list(outputs.iterdir()) == []
