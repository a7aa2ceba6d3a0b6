"""The readable report of a run."""

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table


def print_report(console: Console, figures: Mapping[str, Any]) -> None:
    """Print the figures of a wiping run as a table."""
    f = figures
    reached = [
        f"{share} % after {f[f'seconds_to_{share}_percent']:.0f} s"
        for share in (50, 90, 99)
        if f[f"seconds_to_{share}_percent"] is not None
    ]
    spots = f"{f['missed_spots']} spots of {f['missed_area_cm2']:.0f} cm2 left"
    pushed = f["reactive_remap_count"]
    after_pushes = f", {pushed} of them after pushes" if pushed else ""
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    rows = {
        "simulated": f"{f['simulated_seconds']:.1f} s in {f['wall_seconds']:.1f} s "
        f"({f['real_time_factor']:.2f} times real time)",
        "cleaned": f"{100 * f['cleaned_fraction']:.1f} % of the board, "
        f"{100 * f['cleaned_fraction_of_demonstrated_area']:.1f} % of the "
        "demonstrated area",
        "it took": ", ".join([*reached, spots]),
        "pressed": f"{f['normal_force_mean_n']:.1f} N (90 % between "
        f"{f['normal_force_p05_n']:.1f} and {f['normal_force_p95_n']:.1f} N), "
        f"{100 * f['normal_force_wanted_fraction']:.1f} % in 5 to 15 N, "
        f"in contact {100 * f['contact_fraction']:.1f} % of the time",
        "followed": f"to {1e3 * f['tracking_rms_m']:.1f} mm rms",
        "re-mapped": f"{f['remap_count']} times{after_pushes}, jumps up to "
        f"{1e3 * f['desired_position_jump_max_m']:.4f} mm",
        "limits": f"torque {100 * f['torque_ratio_max']:.0f} %, torque rate "
        f"{f['torque_rate_max_nm_per_s']:.0f} Nm/s, joint speed "
        f"{100 * f['joint_speed_ratio_max']:.0f} %, nearest joint limit "
        f"{f['joint_limit_margin_min_rad']:.2f} rad",
    }
    for name, text in rows.items():
        table.add_row(f"[bold]{name}[/bold]", text)
    console.print(table)
