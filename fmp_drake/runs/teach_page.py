"""Page of a teaching session: buttons and panel."""

from typing import Any

from fmp_drake.runs.teaching_session import TeachingSession
from fmp_drake.station import Scenario
from fmp_drake.station.page import VIEW_HELP, describe_page
from fmp_drake.systems import PagePanel
from fmp_drake.systems.mouse_hand import TURN_SWITCH
from fmp_drake.systems.page.page_controls import set_tempo
from fmp_drake.systems.page.page_panel import Level
from fmp_drake.systems.page.paths import DEMONSTRATION_COLOR, css_color
from fmp_drake.systems.page.trail_visualizer import TRAIL_COLOR

SLOWER = "slower"
"""Name of the button that sets a tempo which the arm can follow."""

_ON_BOARD = (
    "Drag the eraser, or any part of the arm: it stays on the board, and is held where you "
    "let it go."
)
_IN_SPACE = (
    "Drag the tool, or any part of the arm: it keeps its height, and is held where you let "
    "it go. With Shift, or with the switch, the drag turns the tool."
)
_HELP = {
    "teach": [
        "Show the same movement again and again for 12 s or more, then press learn.",
        VIEW_HELP,
    ],
    "play": [
        "Drag the arm to pull it while it plays.",
        (
            "teach: demonstrate a new movement; more: demonstrate it again, or also learn "
            "from how you have just pulled the arm."
        ),
        VIEW_HELP,
    ],
}
_LEGEND = [
    {"name": "this demonstration", "color": css_color(TRAIL_COLOR), "kind": "line"},
    {
        "name": "earlier demonstrations",
        "color": css_color(DEMONSTRATION_COLOR),
        "kind": "line",
    },
]


class TeachPage:
    """Buttons of a teaching session, and fields of its panel.

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
        """Show the state of a session, and the buttons that may be pressed.

        Parameters
        ----------
        session : TeachingSession
        busy : str
            Action that is about to start.
        """
        mode, meshcat, scenario = session.mode, self._panel.meshcat, self._scenario
        names = [*session.buttons]
        if mode == "play" and session.suggested_tempo is not None:
            names.insert(0, SLOWER)
        if [*self._clicks] != names:
            for name in self._clicks:
                meshcat.DeleteButton(name, strict=False)
            for name in names:
                meshcat.AddButton(name)
            self._clicks = dict.fromkeys(names, 0)
        requirement, has_skill = session.requirement, session.skill is not None
        has_demonstration = bool(session.shown)
        buttons: Any = {
            "learn": {
                "enabled": not requirement,
                "hint": requirement
                or "learn a skill from the demonstration, and play it",
            },
            "again": {
                "enabled": has_demonstration,
                "hint": "discard what was demonstrated since the last learning"
                if has_demonstration
                else "nothing was demonstrated yet",
            },
            "undo": {"hint": "restore what 'again' has discarded"},
            "play": {
                "enabled": has_skill,
                "hint": "play the last skill" if has_skill else "learn a skill first",
            },
            "save": {
                "enabled": has_skill or bool(session.demonstrations),
                "hint": f"write {session.file_names}; earlier files are renamed",
            },
            "teach": {"hint": "show a new movement"},
            "more": {"hint": "show more of the same movement, and learn all of it"},
            SLOWER: {
                "label": f"set tempo to {session.suggested_tempo or 1:.2f}",
                "hint": "the fastest tempo at which the arm can follow",
            },
        }
        fields: Any = {
            "buttons": buttons,
            "help": _HELP[mode],
            "subtitle": scenario.description,
            "turn": TURN_SWITCH,
            "grab": "you are guiding" if mode == "teach" else "you are pulling",
        }
        if mode == "teach":
            drag_help = _ON_BOARD if scenario.has_board else _IN_SPACE
            hidden_fields = dict.fromkeys(("time", "cleaned", "force", "component"))
            fields |= {
                "help": [drag_help, *_HELP[mode]],
                "mode": busy or "teaching",
                "level": "good" if session.is_guided else "idle",
                "detail": session.status,
                "legend": _LEGEND,
                "progress": session.progress,
                **hidden_fields,
            }
        else:
            fields["legend"] = describe_page(scenario)["legend"]
            fields["progress"] = None
        if busy:
            fields |= {"mode": busy, "level": "busy", "detail": "", "progress": None}
            fields["buttons"] = {n: {**buttons[n], "enabled": False} for n in names}
        self._panel.show(**fields)

    def press_clicked_button(self, session: TeachingSession) -> str | None:
        """Press the button that was clicked since the last call, and return its name."""
        for name, clicks_before in self._clicks.items():
            clicks = self._panel.meshcat.GetButtonClicks(name)
            if clicks != clicks_before:
                self._clicks[name] = clicks
                self.show(session, busy=f"{name} ...")
                if name == SLOWER:
                    set_tempo(self._panel.meshcat, session.suggested_tempo or 1.0)
                    session.suggested_tempo = None
                    session.remark = "the arm can follow at this tempo"
                else:
                    session.press(name)
                if session.remark:
                    level: Level = "good" if session.is_done else "busy"
                    self._panel.say(f"{name}: {session.remark}", level=level)
                else:
                    self._panel.say(name, level="idle")
                self.show(session)
                return name
        return None
