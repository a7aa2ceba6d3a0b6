"""The page with the metrics and a picture of each scenario."""

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from os import cpu_count
from pathlib import Path
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from fmp_drake.errors import RunError
from fmp_drake.film import FilmCamera, FilmReel, render_picture
from fmp_drake.processes import LocalWorkers, run_tasks
from fmp_drake.runs.metrics import Metrics
from fmp_drake.runs.skills import shared_skill
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.station.scenario import LoadScenario

_SIZE = (480, 360)


class Measured(NamedTuple):
    """One run: its metrics, and whether there is a picture of it."""

    metrics: Metrics
    pictured: bool


def measure_scenario(name: str, duration: float, folder: Path) -> Measured:
    """Run a scenario and render a picture NAME.png of its end into a folder.

    Parameters
    ----------
    name : str
        One of `ListScenarios`.
    duration : float
        Simulated time, s.
    folder : pathlib.Path
        Exists; it gets no picture where EGL does not work.
    """
    scenario = LoadScenario(name)
    with threadpool_limits(limits=1):
        skill, demonstrations = shared_skill(scenario)
        run = WipingRun(scenario, skill, demonstrations=demonstrations)
        run.advance_to(duration)
        metrics = run.metrics()
        reel = FilmReel(run.station, fps=1.0)
        reel.observe(run.simulator.get_context())
        camera = FilmCamera(eye=scenario.camera.eye, target=scenario.camera.target)
        try:
            render_picture(
                folder / f"{name}.png",
                station=run.station,
                diagram=run.diagram,
                grid=run.grid,
                positions=reel.positions[-1],
                ink=reel.ink[-1],
                camera=camera,
                size=_SIZE,
            )
        except RunError:
            return Measured(metrics, False)
    return Measured(metrics, True)


def measure_scenarios(
    names: Iterable[str], duration: float, folder: Path
) -> Iterator[tuple[str, Measured]]:
    """Run scenarios in parallel processes; yield names with what was measured, in any order."""
    measure = partial(measure_scenario, duration=duration, folder=folder)
    workers = LocalWorkers(cpu_count() or 1, attempts=1)
    for done in run_tasks(measure, names, workers):
        if isinstance(done.result, Exception):
            raise done.result
        yield done.task, done.result


def scenario_page(measured: Mapping[str, Measured], *, duration: float) -> str:
    """Return the page in Markdown: a table of all scenarios, then each with its picture.

    Parameters
    ----------
    measured : mapping of str to Measured
        By the names of the scenarios, in the order of the page.
    duration : float
        Simulated time of each run, s.
    """
    lines = [
        "# Scenarios",
        "",
        (
            "Written by `fmp-drake scenarios --page README.md`: "
            f"{duration:g} s of each, headless, with its own seed."
        ),
        "",
        (
            "| | demonstrated area cleaned | 50 / 90 / 99 % after | force, 90 % within "
            "| in 5 to 15 N | followed to | largest joint torque / speed | nearest joint "
            "limit |"
        ),
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [_row(name, each.metrics) for name, each in measured.items()]
    lines += [
        "",
        (
            "The normal force and how long it was within 5 to 15 N are of the time in "
            "contact; torque and speed are relative to the joints' limits. No run had a "
            "protective stop or a joint at a wall unless it is said here."
        ),
    ]
    for name, each in measured.items():
        lines += ["", f"## {name}", "", LoadScenario(name).description]
        faults = each.metrics["fault_fraction"] or 0.0
        if faults > 0:
            lines += [
                "",
                f"Stopped, at a wall or below the surface {100 * faults:.1f} % of the time.",
            ]
        if each.pictured:
            lines += ["", f"![{name} after {duration:g} s]({name}.png)"]
    return "\n".join(lines) + "\n"


def _row(name: str, metrics: Metrics) -> str:
    f = {key: 0.0 if value is None else value for key, value in metrics.items()}
    reached = " / ".join(
        "-" if metrics[key] is None else f"{metrics[key]:.0f}"
        for key in (f"seconds_to_{percent}_percent" for percent in (50, 90, 99))
    )
    cells = [
        f"[{name}](#{name})",
        f"{100 * f['cleaned_fraction_of_demonstrated_area']:.1f} %",
        f"{reached} s",
        f"{f['normal_force_p05_n']:.1f} to {f['normal_force_p95_n']:.1f} N",
        f"{100 * f['normal_force_wanted_fraction']:.1f} %",
        f"{1e3 * f['tracking_rms_m']:.1f} mm",
        f"{100 * f['torque_ratio_max']:.0f} / {100 * f['joint_speed_ratio_max']:.0f} %",
        f"{f['joint_limit_margin_min_rad']:.2f} rad",
    ]
    return f"| {' | '.join(cells)} |"
