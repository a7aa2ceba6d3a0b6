"""Pictures of demonstrations, skills and runs.

Every `draw_...` function draws into the axes it is given, makes a figure of its own
where it is given none, and returns the axes (`ax.figure` is the picture). Functions
that draw over time use one Axes for each channel, one below the other. `plot_skill`,
`plot_run` and `plot_reach` write a whole page to a file. None of them touches pyplot or needs Drake.

In the plane the first channel (x) grows upwards and the second (y) to the left: a
board as seen from above by somebody who stands behind the robot, not its mirror
image. `plane=("z", "y")` names other channels, again the upward one first.

Colours mean the same in all pictures: grey is demonstrated, blue sampled from the
skill, orange played, red what cannot be done; every component has a colour of its own, and time runs from
violet to green.
"""

from fmp_drake.plots.graphviz import write_graph
from fmp_drake.plots.heatmaps import draw_heatmap, draw_heatmaps
from fmp_drake.plots.learned import (
    draw_component_in_plane,
    draw_component_over_time,
    draw_samples_in_plane,
)
from fmp_drake.plots.phase import draw_phase
from fmp_drake.plots.played import draw_rollout_over_time, draw_way_back
from fmp_drake.plots.reach import draw_reach, plot_reach
from fmp_drake.plots.recorded import (
    draw_demonstrations_in_plane,
    draw_demonstrations_over_time,
)
from fmp_drake.plots.run_page import draw_run, plot_run
from fmp_drake.plots.skill_page import draw_skill, plot_skill
from fmp_drake.plots.spectra import draw_spectra
from fmp_drake.plots.windows import draw_windows_in_plane, draw_windows_over_time

__all__ = [
    "draw_component_in_plane",
    "draw_component_over_time",
    "draw_demonstrations_in_plane",
    "draw_demonstrations_over_time",
    "draw_heatmap",
    "draw_heatmaps",
    "draw_phase",
    "draw_reach",
    "draw_rollout_over_time",
    "draw_run",
    "draw_samples_in_plane",
    "draw_skill",
    "draw_spectra",
    "draw_way_back",
    "draw_windows_in_plane",
    "draw_windows_over_time",
    "plot_reach",
    "plot_run",
    "plot_skill",
    "write_graph",
]
