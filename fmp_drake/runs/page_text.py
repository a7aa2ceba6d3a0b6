"""Constant texts of the panel of a page, and the legend of its colours."""

from pydrake.geometry import Rgba

from fmp_drake.runs.metrics import NEAR_FORCE
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.ink.mesh import ink_colours
from fmp_drake.systems.page.force_arrow import FORCE_COLOR
from fmp_drake.systems.page.page_panel import Kind, PanelFields
from fmp_drake.systems.page.paths import DEMONSTRATION_COLOR, css_color
from fmp_drake.systems.page.plan_visualizer import PLAN_COLOR, TUBE_COLOR
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR

VIEW_HELP = (
    "Drag beside it to turn the view; two fingers or right button: move, wheel: zoom."
)
"""Help about the camera."""

_PULL_HELP = "Drag the arm or the {} to pull it; let go, and it returns."
_INK_COLOR = "rgb({:.0f} {:.0f} {:.0f})".format(*(255 * ink_colours(1.0, srgb=True)))


def describe_page(scenario: Scenario, *, replay: bool = False) -> PanelFields:
    """Return the constant fields of the panel of a station.

    Parameters
    ----------
    scenario : Scenario
    replay : bool
        Whether the page only replays a run, without a plan and without an arm to pull.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario
    >>> describe_page(LoadScenario("table_top"))["force_band"]
    (5.0, 15.0)
    """
    show, force = scenario.show, scenario.press.force
    plans, has_board = not replay, scenario.has_board
    tool = "eraser" if has_board else "tool"
    legend: list[tuple[bool, str, Rgba | str, Kind]] = [
        (show.ink and has_board, "ink", _INK_COLOR, "area"),
        (show.demonstrations, "demonstrated paths", DEMONSTRATION_COLOR, "line"),
        (show.trail, f"path of the {tool}", TRAIL_COLOR, "line"),
        (show.plan and plans, "plan of the next seconds", PLAN_COLOR, "line"),
        (show.tube and plans, "its variation (2σ)", TUBE_COLOR, "area"),
        (show.component and plans, "mean of the component", "", "line"),
        (show.force and has_board, "force on the eraser", FORCE_COLOR, "arrow"),
    ]
    band: PanelFields = {}
    if has_board:
        band["force_band"] = (max(0.0, force - NEAR_FORCE), force + NEAR_FORCE)
    return {
        **band,
        "subtitle": scenario.description,
        "legend": [
            {
                "name": name,
                "color": color if isinstance(color, str) else css_color(color),
                "kind": kind,
            }
            for is_shown, name, color, kind in legend
            if is_shown
        ],
        "grab": "you are pulling" if show.mouse and plans else "",
        "help": [
            *([_PULL_HELP.format(tool)] if show.mouse and plans else []),
            VIEW_HELP,
        ],
    }
