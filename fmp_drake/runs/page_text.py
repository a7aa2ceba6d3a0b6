"""What the panel of a page says all the time, and how its colours are called."""

from fmp_drake.runs.metrics import NEAR_FORCE
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.ink.colours import ink_colours
from fmp_drake.systems.page.force_arrow import FORCE_COLOR
from fmp_drake.systems.page.plan_visualizer import PLAN_COLOR, TUBE_COLOR
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.viewer.panel_fields import Kind, PanelFields
from fmp_drake.systems.viewer.path_drawing import DEMONSTRATION_COLOR, css_color

VIEW_HELP = "Drag beside it to turn the view; right button: move, wheel: zoom."
"""How the camera is moved."""

_PULL_HELP = "Ctrl + left button drags the arm; let go, and it returns."
_INK_COLOR = "rgb({:.0f} {:.0f} {:.0f})".format(*(255 * ink_colours(1.0, srgb=True)))


def describe_page(scenario: Scenario, *, replay: bool = False) -> PanelFields:
    """Return what the panel of a wiping station says all the time.

    Parameters
    ----------
    scenario : Scenario
    replay : bool
        Whether the page only replays a run: there is nothing to pull then, and no plan.

    Examples
    --------
    >>> from fmp_drake.station import LoadScenario
    >>> describe_page(LoadScenario("table_top"))["force_band"]
    (5.0, 15.0)
    """
    show, force = scenario.show, scenario.press.force
    plans = not replay
    legend: list[tuple[bool, str, str, Kind]] = [
        (show.ink, "ink", _INK_COLOR, "area"),
        (
            show.demonstrations,
            "demonstrated paths",
            css_color(DEMONSTRATION_COLOR),
            "line",
        ),
        (show.trail, "path of the eraser", css_color(TRAIL_COLOR), "line"),
        (
            show.plan and plans,
            "plan of the next seconds",
            css_color(PLAN_COLOR),
            "line",
        ),
        (show.tube and plans, "its variation (2σ)", css_color(TUBE_COLOR), "area"),
        (show.component and plans, "mean of the component", "", "line"),
        (show.force, "force on the eraser", css_color(FORCE_COLOR), "arrow"),
    ]
    return {
        "subtitle": scenario.description,
        "force_band": (max(0.0, force - NEAR_FORCE), force + NEAR_FORCE),
        "legend": [
            {"name": name, "color": color, "kind": kind}
            for is_shown, name, color, kind in legend
            if is_shown
        ],
        "help": [*([_PULL_HELP] if show.mouse and plans else []), VIEW_HELP],
    }
