"""Facts about the messages of the page, and about runs with a viewer."""

import json
import re

import pytest

from fmp_drake.apps import wipe as wipe_module
from fmp_drake.apps.page import ended_page, make_console, open_page, show_progress
from fmp_drake.errors import FmpError
from fmp_drake.runs import MakeRun


@pytest.fixture
def panel():
    panel = open_page(title="table_top")
    yield panel
    panel.close()


@pytest.fixture
def watched(monkeypatch):
    """The function that simulates a viewer, who then clicks or leaves."""

    def watch(looks, clicks=()):
        answers, choices = iter([True] * looks), iter(clicks)
        monkeypatch.setattr(wipe_module, "is_watched", lambda _: next(answers, False))
        monkeypatch.setattr(
            wipe_module, "wait_for_click", lambda *_: next(choices, None)
        )
        monkeypatch.setattr(wipe_module, "_DURATION", 0.2)

    return watch


def simulated(text):
    return [float(s) for s in re.findall(r"simulated +([\d.]+) s", text)]


def test_messages_are_kept_in_their_order(panel):
    panel.say("learning")
    panel.say("contact lost", level="busy")
    assert panel.shown["messages"] == [
        {"level": "idle", "text": "learning"},
        {"level": "busy", "text": "contact lost"},
    ]
    for i in range(200):
        panel.say(str(i))
    assert len(panel.shown["messages"]) == 100
    assert panel.shown["messages"][-1]["text"] == "199"


def test_page_reports_why_a_program_ends(panel):
    with pytest.raises(FmpError), ended_page(panel):
        raise FmpError("the start is out of reach")
    assert panel.shown["detail"] == "the start is out of reach"
    assert panel.shown["ended"]


def test_normal_end_is_not_an_error(panel):
    panel.show(mode="finished", level="idle")
    with ended_page(panel):
        pass
    assert (panel.shown["level"], panel.shown["ended"]) == ("idle", True)


def test_run_without_a_viewer_ends_by_itself(command, watched):
    watched(0)
    result = command("wipe", "--target-realtime-rate", 0)
    assert result.code == 0
    assert simulated(result.out) == [0.2]


def test_run_continues_while_a_page_is_open(command, watched):
    watched(3)
    assert simulated(command("wipe", "--target-realtime-rate", 0).out) == [0.5]


def test_given_duration_ends_a_run_that_is_watched(command, watched):
    watched(100)
    assert simulated(
        command("wipe", "--target-realtime-rate", 0, "--duration", 0.1).out
    ) == [0.1]


def test_run_continues_and_starts_again_by_buttons(command, watched):
    watched(2, clicks=["continue", "again"])
    # The first part uses two answers.
    assert simulated(command("wipe", "--target-realtime-rate", 0).out) == [
        0.4,
        0.4,
        0.2,
    ]


@pytest.fixture
def shown(monkeypatch):
    """The list of what a page shows, one call after another."""
    calls = []

    def open_and_watch(*arguments, **options):
        panel = open_page(*arguments, **options)
        show = panel.show
        monkeypatch.setattr(
            panel, "show", lambda **fields: (calls.append(fields), show(**fields))
        )
        return panel

    monkeypatch.setattr(wipe_module, "open_page", open_and_watch)
    return calls


def test_files_of_a_run_that_goes_on_are_said_to_hold_the_first(
    command, watched, shown, outputs
):
    report = outputs / "report.json"
    watched(0, clicks=["continue", "again"])
    result = command("wipe", "--target-realtime-rate", 0, "--report", report)
    note = "the files hold the first run, which ended at 0.2 s"
    assert result.out.count(note) == 2
    assert json.loads(report.read_text(encoding="utf-8"))["simulated_seconds"] == 0.2
    messages = next(f["messages"] for f in reversed(shown) if "messages" in f)
    texts = [message["text"] for message in messages]
    assert [text for text in texts if text in ("continue", "again", note)] == [
        "continue",
        note,
        "again",
        note,
    ]
    watched(0, clicks=["again"])
    assert "files hold" not in command("wipe", "--target-realtime-rate", 0).out


def test_finished_page_has_results_and_no_arm_to_drag(command, watched, shown):
    watched(2, clicks=["continue"])
    assert command("wipe", "--target-realtime-rate", 0).code == 0
    grabs = [fields["grab"] for fields in shown if "grab" in fields]
    ends = ["you are pulling", ""]
    assert grabs[-5:] == [*ends, *ends, ""]
    summary = dict(next(f["summary"] for f in reversed(shown) if f.get("summary")))
    assert "mm rms" in summary["tracking error"]
    assert "demonstrated path" in summary["path deviation"]
    assert "what went wrong" not in summary


def test_finished_page_shows_time_and_force_of_one_instant(
    command, watched, shown, monkeypatch
):
    runs = []

    def make_run(*arguments, **options):
        runs.append(MakeRun(*arguments, **options))
        return runs[0]

    monkeypatch.setattr(wipe_module, "MakeRun", make_run)
    watched(0)
    duration = 1.5  # The panel is updated each 0.128 s.
    command("wipe", "--target-realtime-rate", 0, "--duration", duration)
    last = {name: value for fields in shown for name, value in fields.items()}
    assert (last["mode"], last["time"]) == ("finished", pytest.approx(duration))
    assert last["force"] > 1.0
    assert last["force"] == runs[0].output("normal_force")[0]


def test_skill_that_is_too_fast_can_be_slowed_down_on_the_page(command, watched):
    watched(1, clicks=[None])
    result = command("wipe", "--target-realtime-rate", 0, "--tempo", 2.0)
    assert result.code == 2
    tempo = re.search(r"slow down to tempo (\d\.\d+)", result.err)[1]
    watched(1, clicks=[f"set tempo to {tempo}"])
    result = command("wipe", "--target-realtime-rate", 0, "--tempo", 2.0)
    assert result.code == 0
    before, after = result.out.split(f"\nset tempo to {tempo}\n")
    assert f"{tempo}. Choose on the page; Enter ends it." in before
    assert "The arm can follow this skill" in after
    assert "cannot follow" not in after


def test_the_terminal_tells_each_pause_once(capsys):
    times = [0.1, 0.2, 0.2, 0.2, 0.3, 0.4, 0.4]
    show_progress(make_console(), times, until=1.0, label="running")
    told = re.findall(r"paused at (.*) s: resume on the page", capsys.readouterr().out)
    assert told == ["0.2", "0.4"]
