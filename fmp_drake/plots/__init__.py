"""Pictures of demonstrations, skills and runs.

A `draw_...` function draws into axes, or into a new figure, and returns the axes
(`ax.figure` is the figure). `plot_...` and `write_graph` write a file. None of them uses
pyplot; only `plot_run` and `write_graph` need Drake.

In the plane the first channel (x) points upwards and the second (y) to the left: the
board seen from above by a person behind the robot. `Demonstration.select` selects
other channels.

All pictures use the same colours: grey is demonstrated, blue sampled from the skill,
orange played, red infeasible. Each component has its own colour, and time runs from
violet to green.
"""

from fmp_drake.plots.demonstrations import (
    draw_demonstrations_in_plane,
    plot_demonstrations,
)
from fmp_drake.plots.learned import draw_rollout_in_plane, draw_samples_in_plane
from fmp_drake.plots.run_page import plot_run, write_graph
from fmp_drake.plots.skill_page import plot_reach, plot_skill

__all__ = [
    "draw_demonstrations_in_plane",
    "draw_rollout_in_plane",
    "draw_samples_in_plane",
    "plot_demonstrations",
    "plot_reach",
    "plot_run",
    "plot_skill",
    "write_graph",
]
