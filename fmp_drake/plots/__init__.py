"""Pictures of demonstrations, skills and runs.

A `draw_...` function draws into the axes it is given, makes a figure of its own where
it is given none, and returns the axes (`ax.figure` is the picture). `plot_...` and
`write_graph` write a file. None of them touches pyplot; only `plot_run` and
`write_graph` need Drake.

In the plane the first channel (x) grows upwards and the second (y) to the left: a
board seen from above by a person behind the robot. `Demonstration.select` chooses
other channels.

Colours mean the same in all pictures: grey is demonstrated, blue sampled from the
skill, orange played, red infeasible; every component has a colour of its own, and time
runs from violet to green.
"""

from fmp_drake.plots.demonstrations import (
    draw_demonstrations_in_plane,
    plot_demonstrations,
)
from fmp_drake.plots.graphviz import write_graph
from fmp_drake.plots.learned import draw_samples_in_plane
from fmp_drake.plots.played import draw_way_back
from fmp_drake.plots.reach import plot_reach
from fmp_drake.plots.run_page import plot_run
from fmp_drake.plots.skill_page import plot_skill

__all__ = [
    "draw_demonstrations_in_plane",
    "draw_samples_in_plane",
    "draw_way_back",
    "plot_demonstrations",
    "plot_reach",
    "plot_run",
    "plot_skill",
    "write_graph",
]
