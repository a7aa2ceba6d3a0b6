"""The readable report of a run."""

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table


def print_report(console: Console, metrics: Mapping[str, Any]) -> None:
    """Print the metrics of a wiping run as a table."""
    m = metrics
    reached = [
        f"{percent} % after {m[f'seconds_to_{percent}_percent']:.0f} s"
        for percent in (50, 90, 99)
        if m[f"seconds_to_{percent}_percent"] is not None
    ]
    spots = f"{m['missed_spots']} spots of {m['missed_area_cm2']:.0f} cm2 left"
    pushed = m["reactive_remap_count"]
    after_pushes = f", {pushed} of them after pushes" if pushed else ""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    rows = {
        "simulated": f"{m['simulated_seconds']:.1f} s in {m['wall_seconds']:.1f} s "
        f"({m['real_time_factor']:.2f} times real time)",
        "cleaned": f"{100 * m['cleaned_fraction']:.1f} % of the board, "
        f"{100 * m['cleaned_fraction_of_demonstrated_area']:.1f} % of the "
        "demonstrated area",
        "it took": ", ".join([*reached, spots]),
        "normal force": f"{m['normal_force_mean_n']:.1f} N (90 % between "
        f"{m['normal_force_p05_n']:.1f} and {m['normal_force_p95_n']:.1f} N), "
        f"{100 * m['normal_force_wanted_fraction']:.1f} % within 5 N of "
        "the wanted, "
        f"in contact {100 * m['contact_fraction']:.1f} % of the time",
        "followed": f"to {1e3 * m['tracking_rms_m']:.1f} mm rms",
        "stayed": _stayed(m),
        "re-mapped": f"{m['remap_count']} times{after_pushes}, jumps up to "
        f"{1e3 * m['desired_position_jump_max_m']:.4f} mm",
        "limits": f"torque {100 * m['torque_ratio_max']:.0f} %, torque rate "
        f"{m['torque_rate_max_nm_per_s']:.0f} Nm/s, joint speed "
        f"{100 * m['joint_speed_ratio_max']:.0f} %, nearest joint limit "
        f"{m['joint_limit_margin_min_rad']:.2f} rad",
        "surface": f"up to {1e3 * m['penetration_max_m']:.1f} mm of core, handle or "
        "arm below it"
        if m["penetration_max_m"] > 0
        else "nothing hard below it",
    }
    events = [event["text"] for event in m["events"]]
    rows["what went wrong"] = "\n".join(events) or "nothing"
    for name, text in rows.items():
        table.add_row(f"[bold]{name}[/bold]", text)
    console.print(table)


def _stayed(m: Mapping[str, Any]) -> str:
    """Say how near the eraser and its target stayed to what was demonstrated."""
    ways = m["measured_off_paths_max_m"], m["desired_off_paths_max_m"]
    if None in ways:
        return "never near the demonstrated paths, or they are not known"
    measured, desired = (f"{1e3 * way:.0f} mm" for way in ways)
    return f"within {measured} of the demonstrated paths; wanted within {desired}"
