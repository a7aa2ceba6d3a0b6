"""Results of a run: a table in the terminal, and files."""

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from fmp_drake.apps.options import option
from fmp_drake.apps.page import track_frames
from fmp_drake.errors import FmpError, RunError
from fmp_drake.film import FILM_SIGNALS, FilmReel, check_film, film_run, film_size
from fmp_drake.plots import plot_run
from fmp_drake.plots.run_page import RUN_PAGE_SIGNALS, check_graph, write_graph
from fmp_drake.plots.style import check_picture
from fmp_drake.primitives.data.files import check_writable, write_json, write_text
from fmp_drake.primitives.data.reading.table import count_text
from fmp_drake.runs import StationRun
from fmp_drake.runs.log import SIGNALS

# Smallest error of the board's height that is reported, m; the felt yields by less.
_MIN_HEIGHT_ERROR = 0.003


@dataclass(frozen=True, kw_only=True)
class RunFiles:
    """Files to write."""

    html: Path | None = option(None, "Page that replays the run.")
    video: Path | None = option(None, "Film of the run (.mp4, .gif).")
    video_fps: float = option(20.0, "Frames per second of the film.", basic=False)
    video_speed: float = option(
        1.0, "Simulated seconds per second of the film.", basic=False
    )
    video_width: int = option(640, "Width of the film, pixels (4 to 3).", basic=False)
    plot: Path | None = option(None, "Picture of the run (.png, .svg, .pdf).")
    log: Path | None = option(None, "All signals of the run (.npz).", basic=False)
    report: Path | None = option(None, "Metrics of the run (.json).")
    graphviz: Path | None = option(
        None, "Block diagram of the station (.svg, .png, .dot).", basic=False
    )

    def check(self, *, of_arm: bool, inputs: Iterable[Path | None]) -> None:
        """Check before a run that the files can be written, and that none of them is an input."""
        check_writable(self.html, "a page", [".html"])
        check_writable(self.report, "a report", [".json"])
        check_picture(self.plot)
        check_film(
            self.video,
            fps=self.video_fps,
            speed=self.video_speed,
            size=film_size(self.video_width),
        )
        check_writable(self.log, "a log", [".npz"], RunError)
        check_graph(self.graphviz)
        files = [self.html, self.video, self.plot, self.log, self.report, self.graphviz]
        paths = [os.path.realpath(path) for path in files if path is not None]
        for path in paths:
            if paths.count(path) > 1:
                raise RunError(f"{path} is named twice; give each output its own file.")
        for read in inputs:
            if read is not None and os.path.realpath(read) in paths:
                raise RunError(f"{read} is read; give the output a file of its own.")
        if of_arm and any((self.html, self.video, self.plot, self.log, self.graphviz)):
            raise RunError(
                "with --arm only --report can be written; leave out --html, --video, "
                "--plot, --log and --graphviz."
            )

    def are_results(self) -> bool:
        """Return whether a file is written at the end of the run."""
        return any((self.html, self.video, self.plot, self.log, self.report))

    def signals(self) -> set[str]:
        """Return the names of the signals that these files need."""
        return {
            *(SIGNALS if self.log is not None else ()),
            *(RUN_PAGE_SIGNALS if self.plot is not None else ()),
            *(FILM_SIGNALS if self.video is not None else ()),
        }

    def begin(self, console: Console, run: StationRun) -> FilmReel | None:
        """Write the picture of the diagram; return the collector of the film's frames."""
        if self.graphviz is not None:
            write_graph(run.station, self.graphviz)
            console.print(f"wrote {self.graphviz}")
        if self.video is None:
            return None
        reel = FilmReel(run.station, fps=self.video_fps, speed=self.video_speed)
        run.simulator.set_monitor(reel.observe)
        return reel

    def write(
        self,
        console: Console,
        run: StationRun,
        metrics: Mapping[str, Any],
        *,
        reel: FilmReel | None,
        title: str,
    ) -> None:
        """Write the files at the end of a run; an error comes after the others.

        Raises
        ------
        FmpError
            The first one.
        """

        def film(path: Path) -> None:
            track = partial(track_frames, console)
            if reel is not None:
                film_run(run, reel, path, width=self.video_width, track=track)

        steps: list[tuple[Path | None, Callable[[Path], None]]] = [
            (self.report, lambda path: write_json(path, metrics, RunError)),
            (self.log, lambda path: run.save_log(path, metrics)),
            (self.plot, lambda path: plot_run(run, path)),
            (self.html, lambda path: write_text(path, run.html(title=title), RunError)),
            (self.video, film),
        ]
        errors = []
        for path, write in steps:
            if path is not None:
                try:
                    write(path)
                    console.print(f"wrote {path}")
                except FmpError as error:
                    errors.append(error)
        if errors:
            raise errors[0]


def report_rows(metrics: Mapping[str, Any]) -> dict[str, str]:
    """Return the names and texts of a table about a run.

    It contains ink, normal force and surface if there is a board, and errors of orientation
    and force if the skill has such channels.
    """
    m = metrics
    rows = {
        "simulated": f"{m['simulated_seconds']:.1f} s in {m['wall_seconds']:.1f} s "
        f"({m['real_time_factor']:.2f} times real time)",
    }
    if "cleaned_fraction" in m:
        rows |= _board_rows(m)
    tracking = f"{1e3 * m['tracking_rms_m']:.1f} mm rms"
    if "orientation_rms_deg" in m:
        tracking += (
            f" and {m['orientation_rms_deg']:.2f} degrees rms, at most "
            f"{1e3 * m['tracking_max_m']:.1f} mm and {m['orientation_max_deg']:.2f} degrees"
        )
    if "normal_force_error_rms_n" in m:
        tracking += f"; force error {m['normal_force_error_rms_n']:.2f} N rms"
    margin = m["joint_limit_margin_min_rad"]
    nearest = f"{margin:.2f} rad" if margin < math.inf else "none"
    pushed = m["reactive_remap_count"]
    after_pushes = f", {pushed} of them after pushes" if pushed else ""
    rows |= {
        "tracking error": tracking,
        "path deviation": _path_deviation(m),
        "re-mapped": f"{count_text(m['remap_count'], 'time')}{after_pushes}; the "
        "desired position jumps by at most "
        f"{1e3 * m['desired_position_jump_max_m']:.4f} mm",
        "limits": f"torque {100 * m['torque_ratio_max']:.0f} %, torque rate "
        f"{m['torque_rate_max_nm_per_s']:.0f} Nm/s, joint speed "
        f"{100 * m['joint_speed_ratio_max']:.0f} %, nearest joint limit {nearest}",
    }
    if "penetration_max_m" in m:
        rows["surface"] = (
            f"core, handle or arm penetrate it by up to "
            f"{1e3 * m['penetration_max_m']:.1f} mm"
            if m["penetration_max_m"] > 0
            else "not penetrated"
        )
        height = m["board_height_error_m"] or 0.0
        if abs(height) >= _MIN_HEIGHT_ERROR:
            side = "higher" if height > 0 else "lower"
            rows["surface"] += f"; {1e3 * abs(height):.0f} mm {side} than assumed"
    events = [event["text"] for event in m["events"]]
    rows["what went wrong"] = "\n".join(events) or "nothing"
    return rows


def _board_rows(m: Mapping[str, Any]) -> dict[str, str]:
    """Return the rows about the ink and the normal force."""
    times = [
        f"{percent} % after {m[f'seconds_to_{percent}_percent']:.0f} s"
        for percent in (50, 90, 99)
        if m[f"seconds_to_{percent}_percent"] is not None
    ]
    spots = count_text(m["missed_spots"], "spot")
    remainder = f"{m['missed_area_cm2']:.0f} cm² left in {spots}"
    board = f"{100 * m['cleaned_fraction']:.1f} % of the board"
    if m["seconds_to_99_percent"] == 0:  # An area with ink takes some time.
        cleaned = {"cleaned": f"{board}; the demonstrated paths touch no ink"}
    else:
        area = f"{100 * m['cleaned_fraction_of_demonstrated_area']:.1f} %"
        cleaned = {
            "cleaned": f"{area} of the demonstrated area, {board}",
            "time to clean": ", ".join([*times, remainder]),
        }
    return cleaned | {
        "normal force": f"{m['normal_force_mean_n']:.1f} N (90 % between "
        f"{m['normal_force_p05_n']:.1f} and {m['normal_force_p95_n']:.1f} N), "
        f"{100 * m['normal_force_precise_fraction']:.1f} % within 10 % and "
        f"{100 * m['normal_force_wanted_fraction']:.1f} % within 5 N of "
        "the desired force, "
        f"in contact {100 * m['contact_fraction']:.1f} % of the time",
    }


def _path_deviation(m: Mapping[str, Any]) -> str:
    """Return a text about the distances to the demonstrated paths."""
    distances = m["measured_off_paths_rms_m"], m["desired_off_paths_rms_m"]
    if None in distances:
        return "never near the demonstrated paths, or they are unknown"
    measured, desired = (f"{1e3 * distance:.1f} mm" for distance in distances)
    return (
        f"{measured} rms from the demonstrated paths after reaching them; the planned "
        f"motion {desired}"
    )
