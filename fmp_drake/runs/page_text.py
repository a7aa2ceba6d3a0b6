"""What the panel of a page says all the time, and how its colours are called."""

from fmp_drake.runs.metrics import NEAR_FORCE
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.force_arrow import FORCE_COLOR
from fmp_drake.systems.ink.colours import ink_colours
from fmp_drake.systems.plan_visualizer import PLAN_COLOR, TUBE_COLOR
from fmp_drake.systems.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.viewer.page_panel import LegendEntry, PanelFields
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
    legend: list[tuple[bool, LegendEntry]] = [
        (show.ink, {"name": "ink", "color": _INK_COLOR, "kind": "area"}),
        (
            show.demonstrations,
            {
                "name": "demonstrated paths",
                "color": css_color(DEMONSTRATION_COLOR),
                "kind": "line",
            },
        ),
        (
            show.trail,
            {
                "name": "path of the eraser",
                "color": css_color(TRAIL_COLOR),
                "kind": "line",
            },
        ),
        (
            show.plan and not replay,
            {
                "name": "plan of the next seconds",
                "color": css_color(PLAN_COLOR),
                "kind": "line",
            },
        ),
        (
            show.tube and not replay,
            {
                "name": "its variation (2σ)",
                "color": css_color(TUBE_COLOR),
                "kind": "area",
            },
        ),
        (
            show.component and not replay,
            {"name": "mean of the component", "color": "", "kind": "line"},
        ),
        (
            show.force,
            {
                "name": "force on the eraser",
                "color": css_color(FORCE_COLOR),
                "kind": "arrow",
            },
        ),
    ]
    pull = [_PULL_HELP] if show.mouse and not replay else []
    return {
        "subtitle": scenario.description,
        "force_band": (max(0.0, force - NEAR_FORCE), force + NEAR_FORCE),
        "legend": [entry for is_shown, entry in legend if is_shown],
        "help": [*pull, VIEW_HELP],
    }
