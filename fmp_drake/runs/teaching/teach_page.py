"""What the page of a teaching session shows, and its buttons."""

from typing import Any

from fmp_drake.runs.page_text import VIEW_HELP, describe_page
from fmp_drake.runs.teaching.teaching_session import BUTTONS, TeachingSession
from fmp_drake.station.scenario import Scenario
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR
from fmp_drake.systems.viewer.page_panel import PagePanel
from fmp_drake.systems.viewer.path_drawing import DEMONSTRATION_COLOR, css_color

_HELP = {
    "teach": [
        (
            "Hold Ctrl and drag the eraser, or any part of the arm, with the left button: "
            "it stays on the board, and is held where you let it go."
        ),
        "Show the same movement again and again, for 20 s or longer; then press learn.",
        VIEW_HELP,
    ],
    "play": [
        "Ctrl + left button pulls the arm while it plays.",
        (
            "teach: show something new; more: show it again, or learn also from what you "
            "have just shown by pulling."
        ),
        VIEW_HELP,
    ],
}
_LEGEND = [
    {"name": "shown now", "color": css_color(TRAIL_COLOR), "kind": "line"},
    {"name": "shown before", "color": css_color(DEMONSTRATION_COLOR), "kind": "line"},
]


class TeachPage:
    """The buttons of a teaching session, and what its panel says.

    Parameters
    ----------
    panel : PagePanel
    scenario : Scenario

    Examples
    --------
    >>> from pydrake.geometry import Meshcat
    >>> panel = PagePanel(Meshcat())
    >>> page = TeachPage(panel, Scenario())
    >>> panel.close()
    """

    def __init__(self, panel: PagePanel, scenario: Scenario) -> None:
        self._panel, self._scenario = panel, scenario
        self._clicks: dict[str, int] = {}

    def show(self, session: TeachingSession, *, busy: str = "") -> None:
        """Show what a session does, and the buttons that may be pressed.

        Parameters
        ----------
        session : TeachingSession
        busy : str
            What it will be doing in a moment.
        """
        mode, meshcat = session.mode, self._panel.meshcat
        if [*self._clicks] != [*BUTTONS[mode]]:
            for name in self._clicks:
                meshcat.DeleteButton(name, strict=False)
            for name in BUTTONS[mode]:
                meshcat.AddButton(name)
            self._clicks = dict.fromkeys(BUTTONS[mode], 0)
        missing = session.missing
        looks: Any = {
            "learn": {
                "label": f"learn ({missing:.0f} s to show)" if missing else "learn"
            },
            "play": {"enabled": session.skill is not None},
        }
        fields: Any = {
            "buttons": looks,
            "help": _HELP[mode],
            "subtitle": session.remark or self._scenario.description,
        }
        if mode == "teach":
            nothing = dict.fromkeys(("time", "cleaned", "force", "component"))
            fields |= {
                "mode": busy or "teaching",
                "level": "good" if session.is_led else "idle",
                "detail": session.status,
                "legend": _LEGEND,
                **nothing,
            }
        else:
            fields["legend"] = describe_page(self._scenario)["legend"]
        if busy:
            fields |= {"mode": busy, "level": "busy"}
        self._panel.show(**fields)

    def attend(self, session: TeachingSession) -> str | None:
        """Press on a session what was clicked since the last time, and return it."""
        for name, before in self._clicks.items():
            now = self._panel.meshcat.GetButtonClicks(name)
            if now != before:
                self._clicks[name] = now
                self.show(session, busy=f"{name} ...")
                session.press(name)
                self.show(session)
                return name
        return None
