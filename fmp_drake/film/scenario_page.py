"""The page that says how the scenarios go."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from fmp_drake.errors import RunError
from fmp_drake.film import FilmCamera, FilmReel, render_picture
from fmp_drake.runs.metrics import Figures, run_figures
from fmp_drake.runs.skills import scenario_skill
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.station.scenario import LoadScenario

_SIZE = (480, 360)


class Measured(NamedTuple):
    """One run: the figures, and whether there is a picture of it."""

    figures: Figures
    pictured: bool


def measure_scenario(name: str, duration: float, folder: Path) -> Measured:
    """Run a scenario and put a picture NAME.png of its end into a folder.

    Without EGL there is no picture.
    """
    scenario = LoadScenario(name)
    with threadpool_limits(limits=1):
        skill, demonstrations, _ = scenario_skill(scenario)
        run = WipingRun(scenario, skill, demonstrations=demonstrations)
        run.simulator.AdvanceTo(duration)
        figures = run_figures(run)
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
            return Measured(figures, False)
    return Measured(figures, True)


def scenario_page(measured: Mapping[str, Measured], *, duration: float) -> str:
    """Return the page, in Markdown."""
    lines = [
        "# Scenarios",
        "",
        (
            "Written by `fmp-drake scenarios --page README.md`: "
            f"{duration:g} s of each, headless, with its own seed."
        ),
        "",
        (
            "| | demonstrated area cleaned | 50 / 90 / 99 % after | press, 90 % within "
            "| in 5 to 15 N | followed to | largest joint torque / speed | nearest joint "
            "limit |"
        ),
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [_row(name, each.figures) for name, each in measured.items()]
    lines += [
        "",
        (
            "Press and its share within 5 to 15 N are of the time in contact after the first; "
            "torque and speed are shares of the joints' limits. No run had a hold or a "
            "joint at a wall unless it is said here."
        ),
    ]
    for name, each in measured.items():
        lines += ["", f"## {name}", "", LoadScenario(name).description]
        faults = each.figures["fault_fraction"] or 0.0
        if faults > 0:
            lines += ["", f"Held or at a wall {100 * faults:.1f} % of the time."]
        if each.pictured:
            lines += ["", f"![{name} after {duration:g} s]({name}.png)"]
    return "\n".join(lines) + "\n"


def _row(name: str, figures: Figures) -> str:
    f = {key: 0.0 if value is None else value for key, value in figures.items()}
    reached = " / ".join(
        "-" if figures[key] is None else f"{figures[key]:.0f}"
        for key in (f"seconds_to_{share}_percent" for share in (50, 90, 99))
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
