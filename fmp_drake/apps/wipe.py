"""`fmp-drake wipe`: the main job."""

import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import click

from fmp_drake.apps.arm_console import ARM_MODEL, arm_config, wipe_with_arm
from fmp_drake.apps.options import (
    PATH,
    arm_option,
    host_option,
    real_time_option,
    scene_options,
    skill_options,
)
from fmp_drake.apps.page import (
    get_ready,
    make_console,
    open_page,
    show_progress,
    track_frames,
)
from fmp_drake.apps.report import print_report
from fmp_drake.errors import FmpError, RunError, StationError
from fmp_drake.film import FILM_SIGNALS, FilmReel, check_film, film_run, film_size
from fmp_drake.numeric import check_number
from fmp_drake.plots import plot_run
from fmp_drake.plots.graphviz import check_graph, write_graph
from fmp_drake.plots.outputs import check_picture
from fmp_drake.plots.run_page import RUN_PAGE_SIGNALS
from fmp_drake.primitives.data.files import check_writable, write_text
from fmp_drake.runs.advancing import advance
from fmp_drake.runs.arm.real_time import take_precedence
from fmp_drake.runs.log import check_log
from fmp_drake.runs.signals import SIGNALS
from fmp_drake.runs.skill_words import model_in_words
from fmp_drake.runs.skills import scenario_skill
from fmp_drake.runs.wiping_run import WipingRun
from fmp_drake.station.feasibility import CheckFeasibility
from fmp_drake.station.models.panda import VISUALS
from fmp_drake.station.scenario import LoadScenario
from fmp_drake.station.scenario_parts import ShowConfig

_PARTS = list(vars(ShowConfig()))


@click.command()
@scene_options
@click.option(
    "--duration", type=float, default=60.0, show_default=True, help="Seconds."
)
@click.option(
    "--sample/--mean",
    default=None,
    help="Track samples of the components, or always their means "
    "[default: the scenario's, samples].",
)
@click.option("--seed", type=int, help="Of the samples [default: the scenario's, 0].")
@click.option(
    "--rate",
    type=float,
    help="Speed relative to real time, 0 for the fastest [default: 1; headless: 0].",
)
@click.option("--headless", is_flag=True, help="No page.")
@click.option("--force", is_flag=True, help="Run even where the arm cannot follow.")
@click.option(
    "--hide",
    type=click.Choice(_PARTS),
    multiple=True,
    help="Do not show this on the page (again).",
)
@click.option(
    "--visuals",
    type=click.Choice(VISUALS),
    default=VISUALS[0],
    show_default=True,
    help="The arm's meshes: ours, or the official ones, which Drake downloads.",
)
@click.option("--html", type=PATH, help="Write a page that replays the run.")
@click.option("--video", type=PATH, help="Render a film of the run (.mp4, .gif).")
@click.option(
    "--video-fps",
    type=float,
    default=20.0,
    show_default=True,
    help="Frames per second.",
)
@click.option(
    "--video-speed",
    type=float,
    default=1.0,
    show_default=True,
    help="Simulated seconds per second of the film.",
)
@click.option(
    "--video-width", type=int, default=640, show_default=True, help="Pixels; 4 to 3."
)
@click.option("--plot", type=PATH, help="Write a picture of the run.")
@click.option("--log", type=PATH, help="Write all signals of the run (.npz).")
@click.option("--report", type=PATH, help="Write the metrics of the run (.json).")
@click.option(
    "--graphviz", type=PATH, help="Write a picture of the diagram (.svg, .png, .dot)."
)
@arm_option("Move a real arm, or `fmp-drake arm`.")
@click.option("--no-torque", is_flag=True, help="With --arm: send zeros only.")
@click.option(
    "--go", is_flag=True, help="With --arm: begin without asking; never at a real arm."
)
@click.option(
    "--controls",
    is_flag=True,
    help="With --arm: let the page change tempo and normal force.",
)
@real_time_option
@host_option
@skill_options
def wipe(
    scenario: str,
    demos: tuple[Path, ...],
    skill_file: Path | None,
    duration: float,
    start: tuple[float, float, float] | None,
    sample: bool | None,
    seed: int | None,
    rate: float | None,
    headless: bool,
    force: bool,
    hide: tuple[str, ...],
    visuals: str,
    html: Path | None,
    video: Path | None,
    video_fps: float,
    video_speed: float,
    video_width: int,
    plot: Path | None,
    log: Path | None,
    report: Path | None,
    graphviz: Path | None,
    arm: str | None,
    no_torque: bool,
    go: bool,
    controls: bool,
    real_time: bool,
    host: str,
    **learning: Any,
) -> None:
    """Learn whiteboard wiping from a demonstration and wipe the board."""
    console = make_console()
    for target in (html, report):
        check_writable(target)
    check_picture(plot)
    check_film(video, fps=video_fps, speed=video_speed, size=film_size(video_width))
    check_log(log)
    check_graph(graphviz)
    check_number(duration, "duration", above=0, unit="s", error=FmpError)
    if rate is None:
        rate = 0.0 if headless else 1.0
    check_number(rate, "rate", least=0, error=FmpError)
    if seed is not None:
        check_number(seed, "seed", least=0, error=FmpError)
    if arm is None and any((no_torque, go, controls, real_time)):
        raise RunError(
            "--no-torque, --go, --controls and --real-time are for an arm; name it with "
            "--arm."
        )
    if arm is not None and any((html, video, plot, log, graphviz)):
        raise RunError(
            "of an arm there is only a --report; leave out --html, --video, --plot, "
            "--log and --graphviz."
        )
    scene = LoadScenario(scenario)
    for part in hide:
        setattr(scene.show, part, False)
    if start is not None:
        scene.start = list(start)

    config = None if arm is None else arm_config(arm, dry=no_torque)
    title = Path(scenario).stem
    panel = meshcat = None
    if html or not headless:
        panel = open_page(None if headless else console, title=title, host=host)
        meshcat = panel.meshcat
        if config is None and not headless:
            get_ready(panel, scene, visuals=visuals)

    learn_started = time.perf_counter()
    skill, demonstrations, remarks = scenario_skill(
        scene,
        demos=demos,
        skill_file=skill_file,
        model=None if arm is None else ARM_MODEL,
        **learning,
    )
    learn_seconds = time.perf_counter() - learn_started
    for remark in remarks:
        console.print(remark)
    console.print(
        f"skill of {len(skill.components_)} components from {skill.n_windows_} windows "
        f"of {skill.n_steps / skill.rate:g} s, ready after {learn_seconds:.2f} s"
    )
    console.print(model_in_words(skill))

    found = CheckFeasibility(scene, skill)
    if not (found.is_feasible or force):
        raise StationError(
            f"{found.verdict} --stretch slows a demonstration down; --force runs it all "
            "the same."
        )
    console.print(found.verdict)

    if config is not None:
        # A real arm's page shows, and touches only what it is told to.
        scene.show.ink = scene.show.force = scene.show.mouse = False
        scene.show.controls = controls
        for refused in take_precedence() if real_time else ():
            console.print(refused)
        wipe_with_arm(
            console,
            scene,
            skill,
            config,
            duration,
            go=go,
            panel=panel,
            demonstrations=demonstrations,
            report=report,
        )
        return

    run = WipingRun(
        scene,
        skill,
        demonstrations=demonstrations,
        sample=sample,
        seed=seed,
        visuals=visuals,
        meshcat=meshcat,
        panel=panel,
        recording=html is not None,
        keep={
            *(SIGNALS if log is not None else ()),
            *(RUN_PAGE_SIGNALS if plot is not None else ()),
            *(FILM_SIGNALS if video is not None else ()),
        },
    )
    if graphviz is not None:
        write_graph(run.station, graphviz)
        console.print(f"wrote {graphviz}")
    reel = None
    if video is not None:
        reel = FilmReel(run.station, fps=video_fps, speed=video_speed)
        reel.watch(run.simulator)
    run.simulator.set_target_realtime_rate(rate)
    started = time.perf_counter()
    times = advance(
        run.simulator,
        duration,
        meshcat=None if headless else meshcat,
        panel=panel,
        advance_to=run.advance_to,
        on_reset=run.begin_again,
    )
    show_progress(console, times, until=duration, label="wiping")
    wall_seconds = time.perf_counter() - started
    run.remove_controls()
    if panel is not None:
        panel.show(mode="finished", level="idle", detail=f"after {duration:g} s")

    metrics: dict[str, Any] = {
        "scenario": scenario,
        "simulated_seconds": duration,
        "wall_seconds": wall_seconds,
        "real_time_factor": duration / wall_seconds,
        "learn_seconds": learn_seconds,
        **run.metrics(),
        "events": [event._asdict() for event in run.events()],
    }
    print_report(console, metrics)
    if report is not None:
        write_text(report, json.dumps(metrics, indent=2) + "\n", RunError)
        console.print(f"wrote {report}")
    if log is not None:
        run.save_log(log, metrics)
        console.print(f"wrote {log}")
    if plot is not None:
        plot_run(run, plot)
        console.print(f"wrote {plot}")
    if html is not None:
        write_text(html, run.html(title=title), RunError)
        console.print(f"wrote {html}")
    if video is not None and reel is not None:
        track = partial(track_frames, console)
        film_run(run, reel, video, width=video_width, track=track)
        console.print(f"wrote {video}")
    if not headless and sys.stdin is not None and sys.stdin.isatty():
        console.input("the page stays open; press Enter to quit ")
