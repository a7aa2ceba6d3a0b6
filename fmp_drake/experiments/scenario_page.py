"""Page with the metrics and a picture of every scenario."""

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from os import cpu_count
from pathlib import Path
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from fmp_drake.errors import RunError
from fmp_drake.experiments.report import markdown_table
from fmp_drake.film import FilmReel, render_picture
from fmp_drake.processes import LocalWorkers, run_tasks
from fmp_drake.runs import MakeRun, WipingRun
from fmp_drake.runs.metrics import Metrics
from fmp_drake.skills.learning import shared_skill
from fmp_drake.station import LoadScenario

_SIZE = (480, 360)
_COLUMNS = (
    "",
    "demonstrated area cleaned",
    "50 / 90 / 99 % after",
    "force, 90 % within",
    "within 10 % / 5 N of desired",
    "tracking error",
    "largest joint torque / speed",
    "nearest joint limit",
)


class ScenarioRun(NamedTuple):
    """Metrics of one run, and whether a picture of it was written."""

    metrics: Metrics
    has_picture: bool


def measure_scenario(name: str, duration: float, folder: Path) -> ScenarioRun:
    """Run a scenario and render a picture NAME.png of its end into a folder.

    Parameters
    ----------
    name : str
        One of `ListScenarios`.
    duration : float
        Simulated time, s.
    folder : pathlib.Path
        Existing folder; no picture is written where EGL does not work.
    """
    scenario = LoadScenario(name)
    with threadpool_limits(limits=1):
        skill, demonstrations = shared_skill(scenario)
        run = MakeRun(scenario, skill, demonstrations=demonstrations)
        run.advance_to(duration)
        metrics = run.metrics()
        reel = FilmReel(run.station, fps=1.0)
        reel.observe(run.simulator.get_context())
        try:
            render_picture(
                folder / f"{name}.png",
                reel,
                camera=scenario.camera,
                size=_SIZE,
                grid=run.grid if isinstance(run, WipingRun) else None,
            )
        except RunError:
            return ScenarioRun(metrics, False)
    return ScenarioRun(metrics, True)


def measure_scenarios(
    names: Iterable[str], duration: float, folder: Path
) -> Iterator[tuple[str, ScenarioRun]]:
    """Run scenarios in parallel processes; yield names and results in any order."""
    measure = partial(measure_scenario, duration=duration, folder=folder)
    workers = LocalWorkers(cpu_count() or 1, attempts=1)
    for name, _, result in run_tasks(measure, names, workers):
        if isinstance(result, Exception):
            raise result
        yield name, result


def scenario_page(runs: Mapping[str, ScenarioRun], *, duration: float) -> str:
    """Return the page in Markdown: a table, then a section and picture per scenario.

    Parameters
    ----------
    runs : mapping of str to ScenarioRun
        Keys are names of scenarios, in the order of the page.
    duration : float
        Simulated time of each run, s.
    """
    lines = [
        "# Scenarios",
        "",
        (
            f"Written by `fmp-drake scenarios --markdown FILE --duration {duration:g}`: "
            "each is run headless, with its own seed."
        ),
        "",
        markdown_table(
            [_COLUMNS, *(_row(name, run.metrics) for name, run in runs.items())]
        ),
        "",
        (
            "The normal force, and the fractions of time within 10 % and 5 N of the desired "
            "force, refer to the time in contact. "
            "Torque and speed are relative to the joint limits. Protective stops and "
            "joints at their limits are listed in the section of the scenario."
        ),
    ]
    for name, run in runs.items():
        lines += ["", f"## {name}", "", LoadScenario(name).description]
        fault_fraction = run.metrics["fault_fraction"] or 0.0
        if fault_fraction > 0:
            time = f"{100 * fault_fraction:.1f} % of the time"
            lines += [
                "",
                f"In a protective stop, at a joint limit or below the surface {time}.",
            ]
        if run.has_picture:
            lines += ["", f"![{name} after {duration:g} s]({name}.png)"]
    return "\n".join(lines) + "\n"


def _row(name: str, metrics: Metrics) -> list[str]:
    """Return a row of the table; metrics of a board are "-" where there is none."""
    f = {key: 0.0 if value is None else value for key, value in metrics.items()}
    board_cells = ["-"] * 4
    if "normal_force_p05_n" in metrics:
        times = " / ".join(
            "-" if metrics[key] is None else f"{metrics[key]:.0f}"
            for key in (f"seconds_to_{percent}_percent" for percent in (50, 90, 99))
        )
        desired_percent = 100 * f["normal_force_wanted_fraction"]
        board_cells = [
            f"{100 * f['cleaned_fraction_of_demonstrated_area']:.1f} %",
            f"{times} s",
            f"{f['normal_force_p05_n']:.1f} to {f['normal_force_p95_n']:.1f} N",
            f"{100 * f['normal_force_precise_fraction']:.1f} / {desired_percent:.1f} %",
        ]
    tracking = f"{1e3 * f['tracking_rms_m']:.1f} mm"
    if "orientation_rms_deg" in metrics:
        tracking += f", {f['orientation_rms_deg']:.2f} degrees"
    if "normal_force_error_rms_n" in metrics:
        tracking += f", {f['normal_force_error_rms_n']:.2f} N"
    return [
        f"[{name}](#{name})",
        *board_cells,
        tracking,
        f"{100 * f['torque_ratio_max']:.0f} / {100 * f['joint_speed_ratio_max']:.0f} %",
        f"{f['joint_limit_margin_min_rad']:.2f} rad",
    ]
