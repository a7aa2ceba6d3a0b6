"""Facts about trials that are run, stored, continued and replayed."""

import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trials_stub
from PIL import Image
from trials_stub import GOOD, Here

from fmp_drake import ExperimentError
from fmp_drake.apps import worlds as worlds_command
from fmp_drake.experiments.trials import (
    TrialSpec,
    TrialStore,
    run_trials,
)
from fmp_drake.experiments.trials.running import code_version, replay_trial, run_trial
from fmp_drake.experiments.trials.store import Trial
from fmp_drake.experiments.trials.trials_report import (
    TrialsReport,
    draw_figures,
    draw_success,
    interval,
)
from fmp_drake.film import scene as film_scene
from fmp_drake.processes import ClusterWorkers
from fmp_drake.runs.judging import faults
from fmp_drake.station import models_dir

SPEC = """
fields: {press.force: {uniform: [5.0, 9.0]}, start: [0.0, 0.0, {uniform: [0.005, 0.02]}]}
disturbances: {count: {choice: [0, 1]}, each: {force: [0, {uniform: [-9.0, 9.0]}, 0]}}
"""


@pytest.fixture(scope="module")
def spec_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("spec") / "mine.yaml"
    path.write_text(SPEC)
    return path


@pytest.fixture(scope="module")
def out(tmp_path_factory, spec_file):
    """The folder of two real trials, run by the command line."""
    from click.testing import CliRunner

    from fmp_drake.apps.commands import app

    folder = tmp_path_factory.mktemp("worlds") / "out"
    call = ["worlds", spec_file, "--count", 2, "--duration", 0.3, "--jobs", 1]
    call = [str(each) for each in [*call, "--out", folder]]
    result = CliRunner().invoke(app, call, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert f"wrote {folder / 'report.html'}" in result.output
    return folder


@pytest.fixture
def make_store(tmp_path):
    """The function that runs trials with a substitute, in this process."""

    def make(run, count=4, *, force=False, spec=SPEC, name="made"):
        spec = TrialSpec(spec)
        store = TrialStore(tmp_path / name, spec.plan(seed=0, duration=9.0))
        list(run_trials(store, spec, count, Here(), force=force, run=run))
        return store

    return make


def passed(trial, **changes):
    metrics, events = GOOD | changes, "contact lost from 2.1 to 3.0 s"
    return replace(trial, metrics=metrics, events=events)


def refused_trial(trial):
    return replace(trial, is_feasible=False, verdict="out of reach")


def without_times(store):
    return [replace(t, cpu_seconds=0.0) for t in store.trials()]


# Real trials.


def test_trials_are_stored_with_all_metrics(out):
    store = TrialStore(out)
    trials = store.trials()
    assert [t.number for t in trials] == [0, 1]
    for trial in trials:
        assert trial.error == ""
        assert trial.code == code_version()
        assert trial.metrics["tracking_rms_m"] < 0.01
        assert 5 < trial.parameters["press.force"] < 9
        assert trial.cpu_seconds > 0


def test_replay_is_the_same_to_the_last_bit(out, command, outputs):
    page = outputs / "page.html"
    result = command("worlds", out, "--replay", 1, "--html", page)
    assert result.code == 0, result
    assert "identical to the last bit" in result.out
    assert page.stat().st_size > 1e5


@pytest.fixture(scope="module")
def egl():
    if not film_scene.renders():
        pytest.skip("films need EGL")


@pytest.mark.usefixtures("egl")
def test_replay_is_filmed(out, outputs):
    film = outputs / "world.gif"
    replay_trial(TrialStore(out).trial(0), 0.05, video=film)
    with Image.open(film) as opened:
        assert opened.n_frames == 2  # At 20 Hz, the first and the last.


def test_replay_that_differs_is_reported(out, command, monkeypatch):
    metrics = TrialStore(out).trial(0).metrics
    changed = {**metrics, "tracking_rms_m": metrics["tracking_rms_m"] * (1 + 1e-15)}
    monkeypatch.setattr(worlds_command, "replay_trial", lambda *_, **__: changed)
    assert "NOT identical" in command("worlds", out, "--replay", 0).out


def test_infeasible_trial_is_not_run(tmp_path):
    spec = TrialSpec("fields: {board.translation: [0.8, 0.0, 0.1]}")
    store = TrialStore(tmp_path, spec.plan(seed=0, duration=0.1))
    list(run_trials(store, spec, 1, Here()))
    (trial,) = store.trials()
    assert (trial.is_feasible, trial.was_run) == (False, False)
    assert trial.verdict.endswith(
        "at a joint-limit spring."
    )  # No change is looked for.
    assert trial.checked["reachable_fraction"] < 1


@pytest.mark.usefixtures("nothing_is_freed")
def test_cluster_gives_the_identical_store(out, spec_file, tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs the extra cluster")
    spec = TrialSpec.load(spec_file)
    store = TrialStore(tmp_path, spec.plan(seed=0, duration=0.3))
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        workers = ClusterWorkers(cluster.scheduler_address)
        list(run_trials(store, spec, 2, workers))
    assert without_times(store) == without_times(TrialStore(out))


# Stand-ins.


def test_killed_worker_and_driver_lose_and_repeat_no_trial(tmp_path):
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "TRIALS_STUB": str(tmp_path),
        "TRIALS_STUB_LAST": "3",
    }
    code = "import sys, trials_stub\nif __name__ == '__main__': trials_stub.drive(*sys.argv[1:])"
    (tmp_path / "driver.py").write_text(code)
    driver = subprocess.Popen(
        [sys.executable, tmp_path / "driver.py", tmp_path, "5"], env=environment
    )
    begun = tmp_path / "begun"
    end = time.monotonic() + 60
    while not begun.exists() or "\n3 " not in begun.read_text():
        assert time.monotonic() < end
        time.sleep(0.05)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    (plan,) = {TrialStore(tmp_path).plan["spec"]}
    spec = TrialSpec(plan)
    store = TrialStore(tmp_path, spec.plan(seed=0, duration=1.0))
    assert [t.number for t in store.trials()] == [0, 1, 2]
    os.environ["TRIALS_STUB"] = str(tmp_path)
    try:
        list(run_trials(store, spec, 5, Here(), run=trials_stub.trial))
    finally:
        del os.environ["TRIALS_STUB"]
    numbers = [int(line.split()[0]) for line in begun.read_text().splitlines()]
    assert numbers == [0, 1, 1, 2, 3, 3, 4]
    assert [t.attempts for t in store.trials()] == [1, 2, 1, 1, 1]
    assert store.trial(2).error == "ValueError: too much"


# Each store is made by a process that kills itself at its n-th statement, or is killed
# after a random time.
KILLED = """
import os, random, signal, sqlite3, sys, time
from pathlib import Path
from fmp_drake.experiments.trials import TrialStore

plan = {name: name for name in ("spec", "seed", "duration")}
connect = sqlite3.connect

def make(folder, last):
    statements = 0

    def count(_):
        nonlocal statements
        statements += 1
        if statements == last:
            os.kill(os.getpid(), signal.SIGKILL)

    def counted(*arguments, **options):
        base = connect(*arguments, **options)
        base.set_trace_callback(count)
        return base

    sqlite3.connect = counted
    TrialStore(folder, plan)

for i in range(40):
    child = os.fork()
    if child == 0:
        make(Path(sys.argv[1]) / str(i), i + 1 if i < 20 else None)
        os._exit(0)
    if i >= 20:
        time.sleep(random.Random(i).uniform(0, 0.01))
        os.kill(child, signal.SIGKILL)
    print(os.waitpid(child, 0)[1], flush=True)
"""


@pytest.mark.slow
def test_store_continues_after_a_kill_during_its_plan(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.split().count(str(signal.SIGKILL.value)) >= 10
    plan = {name: name for name in ("spec", "seed", "duration")}
    for i in range(40):
        store = TrialStore(tmp_path / str(i), plan)
        assert store.plan == plan
        assert store.trials() == []


@pytest.mark.parametrize("names", [["spec"], ["spec", "seed"]])
def test_incomplete_plan_of_an_earlier_version_is_replaced(tmp_path, names):
    plan = {name: name for name in ("spec", "seed", "duration")}
    TrialStore(tmp_path, {name: "old" for name in names})
    assert TrialStore(tmp_path, plan).plan == plan
    assert TrialStore(tmp_path).plan == plan


def test_a_store_of_an_earlier_version_has_a_duration(tmp_path):
    TrialStore(tmp_path, {"spec": "", "seed": "0", "seconds": "1.5"})
    assert TrialStore(tmp_path).plan == {"spec": "", "seed": "0", "duration": "1.5"}
    TrialStore(tmp_path, {"spec": "", "seed": "0", "duration": "1.5"})


def test_incomplete_plan_of_a_store_with_trials_is_refused(tmp_path):
    store = TrialStore(tmp_path, {"duration": "1.0"})
    store.add(Trial(number=0, scenario=""))
    with pytest.raises(ExperimentError, match="trials of another spec"):
        TrialStore(tmp_path, {"spec": "", "seed": "0", "duration": "1.0"})


def test_full_disk_is_reported_and_keeps_stored_trials(
    spec_file, refused, tmp_path, monkeypatch
):
    def run(trial):
        return replace(passed(trial), events="x" * (2**20 * (trial.number == 2)))

    def limited(folder, plan):
        store = TrialStore(folder, plan)
        store._base.execute("PRAGMA max_page_count = 40")  # A disk of 160 kB.
        return store

    out = tmp_path / "out"
    monkeypatch.setattr(worlds_command, "LocalWorkers", lambda _: Here())
    monkeypatch.setattr(worlds_command, "TrialStore", limited)
    monkeypatch.setattr(worlds_command, "run_trials", partial(run_trials, run=run))
    line = refused("worlds", spec_file, "--count", 5, "--out", out)
    assert f"cannot store trials in {out}: database or disk is full" in line
    assert "the same command continues" in line
    assert [t.number for t in TrialStore(out).trials()] == [0, 1]


def test_report_reads_no_text_as_html(make_store):
    store = make_store(passed, 1)
    store.add(replace(store.trial(0), code="<b>`<script>`"))
    TrialsReport(store).write()
    page = (store.folder / "report.html").read_text()
    assert "&lt;b&gt;<code>&lt;script&gt;</code>" in page
    assert "<script>" not in page


def test_ctrl_c_leaves_a_valid_store_and_prints_how_to_continue(
    command, spec_file, tmp_path, monkeypatch
):
    def run(trial):
        if trial.number == 2:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)
        return passed(trial)

    monkeypatch.setattr(worlds_command, "LocalWorkers", lambda _: Here())
    monkeypatch.setattr(worlds_command, "run_trials", partial(run_trials, run=run))
    result = command("worlds", spec_file, "--count", 5, "--out", tmp_path / "out")
    assert result.code == 130
    assert "2 trials are kept" in result.out
    assert "the same command continues" in result.out
    assert [t.number for t in TrialStore(tmp_path / "out").trials()] == [0, 1]


def test_progress_of_many_trials_is_printed_in_steps(
    command, spec_file, tmp_path, monkeypatch
):
    monkeypatch.setattr(worlds_command, "LocalWorkers", lambda _: Here())
    monkeypatch.setattr(worlds_command, "run_trials", partial(run_trials, run=passed))
    result = command("worlds", spec_file, "--count", 60, "--out", tmp_path / "out")
    lines = [line for line in result.out.splitlines() if line.endswith("of 60 trials")]
    assert lines == [f"{done} of 60 trials" for done in range(0, 61, 3)]


def test_replay_of_an_infeasible_trial_prints_the_verdict(
    make_store, command, monkeypatch
):
    store = make_store(refused_trial, 1)
    monkeypatch.setattr(worlds_command, "replay_trial", lambda *_, **__: GOOD)
    result = command("worlds", store.folder, "--replay", 0)
    assert result.out.splitlines() == [
        "infeasible: out of reach",
        "trial 0 passed",
    ]


def test_replay_of_a_trial_that_ended_by_an_exception_prints_it(make_store, command):
    far = "fields: {board.translation: [5.0, 0.0, 0.0]}"
    run = partial(run_trial, duration=0.1, force=True)
    store = make_store(run, 1, spec=far)
    lines = command("worlds", store.folder, "--replay", 0).out.splitlines()
    assert lines[1].startswith(
        "trial 0 stopped with StationError: the arm cannot bring"
    )
    assert lines[2:] == ["identical to the last bit"]


def test_process_that_ends_is_the_result_of_its_trial(make_store):
    def run(trial):
        if trial.number == 1:
            raise BrokenProcessPool("it was killed")
        return passed(trial)

    trials = make_store(run, 3).trials()
    assert [bool(trial.error) for trial in trials] == [False, True, False]
    (fault,) = faults(trials[1])
    assert "its process ended (BrokenProcessPool: it was killed)" in fault.text


def test_two_drivers_do_not_run_the_same_trials(make_store):
    store = make_store(passed)
    other, spec = TrialStore(store.folder), TrialSpec(SPEC)
    with store.writing(), pytest.raises(ExperimentError, match="another process runs"):
        list(run_trials(other, spec, 9, Here(), run=passed))


def test_repeated_call_runs_only_missing_trials(make_store):
    begun = []

    def run(trial):
        begun.append(trial.number)
        return passed(trial)

    for count in (3, 3, 5):
        store = make_store(run, count)
    assert begun == [0, 1, 2, 3, 4]
    assert [t.number for t in store.trials()] == begun


def test_equal_draws_are_trials_of_their_own(make_store):
    store = make_store(passed, 3, spec="base: {choice: [table_top]}")
    assert [t.number for t in store.trials()] == [0, 1, 2]


def test_changed_code_runs_trials_again(make_store, monkeypatch):
    make_store(passed)
    name = "fmp_drake.experiments.trials.running.code_version"
    monkeypatch.setattr(name, lambda: "newer")
    assert {t.code for t in make_store(passed).trials()} == {"newer"}


def test_trials_of_the_present_code_count_also_after_those_of_another(
    make_store, monkeypatch
):
    name = "fmp_drake.experiments.trials.running.code_version"
    for code in ("present", "other", "present"):
        monkeypatch.setattr(name, lambda code=code: code)
        trials = make_store(passed, 3).trials()
        assert [(t.number, t.code) for t in trials] == [(n, code) for n in range(3)]


def test_changed_files_of_a_scenario_run_trials_again(make_store, tmp_path):
    robot = tmp_path / "ur5e"
    shutil.copytree(models_dir() / "ur5e", robot)
    begun = []

    def run(trial):
        begun.append(trial.number)
        return passed(trial)

    spec = f"robot: {robot / 'ur5e.yaml'}"
    codes = [make_store(run, 1, spec=spec).trial(0).code for _ in range(2)]
    assert (begun, codes[0]) == ([0], codes[1])
    file = robot / "ur5e.yaml"
    file.write_text(file.read_text() + "# measured again\n")
    assert make_store(run, 1, spec=spec).trial(0).code != codes[0]
    assert begun == [0, 0]
    assert make_store(run, 1, name="bundled").trial(0).code == code_version()


def test_worker_with_other_code_is_refused(make_store):
    def run(trial):
        return run_trial(replace(trial, code="x"), duration=0.1, force=False)

    with pytest.raises(ExperimentError, match="its parent x: the code"):
        make_store(run)


def test_infeasible_trials_run_by_force_only(make_store):
    def run(trial):
        return passed(trial) if trial.number else refused_trial(trial)

    def results(store):
        return [(t.verdict, t.was_run) for t in store.trials()]

    assert results(make_store(run)) == [("out of reach", False), *[("", True)] * 3]
    assert results(make_store(passed, force=True)) == [("", True)] * 4


def test_exception_in_a_trial_is_a_result(tmp_path):
    spec = TrialSpec("fields: {board.translation: [5.0, 0.0, 0.0]}")
    store = TrialStore(tmp_path, spec.plan(seed=0, duration=0.1))
    list(run_trials(store, spec, 1, Here(), force=True))
    (trial,) = store.trials()
    (fault,) = faults(trial)
    assert fault.kind == "exception"
    assert "StationError: the arm cannot bring the eraser" in fault.text


def test_store_of_another_plan_is_refused(make_store):
    store = make_store(passed)
    plan = store.plan | {"seed": "7"}
    with pytest.raises(ExperimentError, match=r"another seed \(0, not 7\)"):
        TrialStore(store.folder, plan)
    with pytest.raises(ExperimentError, match="there are no trials in"):
        TrialStore(store.folder / "nowhere")
    with pytest.raises(ExperimentError, match="no trial 9; its trials are 0 to 3"):
        store.trial(9)


def test_a_broken_file_of_trials_is_named(tmp_path, refused):
    file = tmp_path / "worlds.sqlite"
    file.write_text("not a database")
    line = refused("worlds", tmp_path)
    assert line.endswith(
        "file is not a database. Delete its worlds.sqlite, or give another folder.\n"
    )
    assert file.read_text() == "not a database"


@pytest.mark.parametrize("blocked", ["out", "out/worlds.sqlite"])
def test_folder_that_cannot_store_trials_is_refused(
    spec_file, refused, tmp_path, blocked
):
    path = tmp_path / blocked
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"noise, and no folder or store of trials" * 9)
    out = tmp_path / "out"
    line = refused("worlds", spec_file, "--out", out)
    assert f"cannot store trials in {out}: " in line


def test_trials_of_an_older_version_are_still_reported(make_store):
    store = make_store(passed, 1)
    trial = store.trial(0)
    scenario = trial.scenario + "forgotten: {key: 1}\n"
    store.add(replace(trial, scenario=scenario, code="older"))
    TrialsReport(store).write()
    assert "Of 1 trial, drawn" in (store.folder / "report.html").read_text()


def test_path_is_judged_on_the_actual_board(make_store):
    spec = "fields: {board.error.translation: [0.0, 0.0, -0.008]}"
    rms = {"tracking_rms_m": 0.0101, "tracking_on_board_rms_m": 0.006}
    store = make_store(partial(passed, **rms), 1, spec=spec)
    assert faults(store.trial(0)) == []
    TrialsReport(store).write()
    text = (store.folder / "report.html").read_text()
    assert "it is too large in these trials: 0." in text


def test_path_is_judged_by_the_tolerance_of_the_scenario(make_store):
    spec = "fields: {tolerance: {choice: [0.004, 0.006]}}"
    rms = {"tracking_rms_m": 0.005, "tracking_on_board_rms_m": 0.005}
    store = make_store(partial(passed, **rms), 8, spec=spec)
    failed = [bool(faults(trial)) for trial in store.trials()]
    assert failed == [trial.fields["tolerance"] == 0.004 for trial in store.trials()]
    assert 0 < sum(failed) < 8
    TrialsReport(store).write()
    text = (store.folder / "report.html").read_text()
    assert "within their tolerance, 4 to 6 mm rms" in text


def test_older_trial_with_the_whole_distance_only_is_judged_by_it(make_store):
    spec = "fields: {board.error.translation: [0.0, 0.0, -0.008]}"
    store = make_store(partial(passed, tracking_rms_m=0.0101), 1, spec=spec)
    (fault,) = faults(store.trial(0))
    assert "10.1 mm rms, " in fault.text
    TrialsReport(store).write()
    assert "8.0 mm lower than assumed" in (store.folder / "report.html").read_text()


@pytest.mark.parametrize(("base", "is_told"), [("table_top", True), ("stir", False)])
def test_report_lists_metrics_not_measured_at_a_board(make_store, base, is_told):
    store = make_store(passed, 1, spec=f"base: {base}")
    assert ("was not measured" in TrialsReport(store).verdict()) == is_told


def test_report_and_page_list_faults_and_replay_commands(make_store, command, outputs):
    def run(trial):
        if trial.number == 3:
            verdict = "move it | 0.2 m nearer"
            return replace(trial, is_feasible=False, verdict=verdict)
        rms = 0.002 + 0.02 * (trial.number == 7)
        return passed(trial, tracking_rms_m=rms, penetration_max_m=0.0)

    store = make_store(run, 30)
    page = outputs / "README.md"
    assert command("worlds", store.folder, "--markdown", page).code == 0
    texts = page.read_text(), (store.folder / "report.html").read_text()
    for text in texts:
        assert "Of 30 trials" in text
        assert "not measured" not in text
        assert "28 passed (96.6 %), 1 with path missed, no body through" in text
        assert "22.0 mm rms" in text
        assert "The run reports: contact lost from 2.1 to 3.0 s." in text
        assert f"fmp-drake worlds {store.folder} --replay 7" in text
        assert "0.2 m nearer" in text
        assert "press.force" not in text  # It is in a picture.
    pictures = {"README_followed.png", "README_success.png"}
    assert {p.name for p in outputs.iterdir()} == pictures | {"README.md"}
    assert texts[1].count("data:image/png;base64") == 2


def test_report_counts_by_demonstration(make_store):
    spec = SPEC.replace(
        "fields: {", "fields: {skill.demonstration: {choice: [eight, wiping]}, "
    )
    store = make_store(passed, 12, spec=spec)
    drawn = [trial.parameters["skill.demonstration"] for trial in store.trials()]
    page = store.folder / "README.md"
    TrialsReport(store).write(page)
    for name in ("eight", "wiping"):
        assert f"| {name} | {drawn.count(name)} | 100.0 % |" in page.read_text()


@pytest.mark.parametrize("where", ["everywhere", "in one trial"])
def test_report_of_trials_in_free_space_omits_the_board(make_store, where):
    boards = {"cleaned_fraction_of_demonstrated_area", "normal_force_wanted_fraction"}

    def run(trial):
        trial = passed(trial)
        if where == "in one trial" and trial.number != 1:
            return trial
        metrics = {k: v for k, v in trial.metrics.items() if k not in boards}
        fields = trial.fields | {"board": trial.fields["board"] | {"shape": "none"}}
        return replace(trial, metrics=metrics, fields=fields)

    store = make_store(run)
    TrialsReport(store).write()
    html = (store.folder / "report.html").read_text()
    assert "4 trials" in html
    assert ("90 %" in html) == (where == "in one trial")


def test_report_of_infeasible_trials_only_is_written(make_store):
    store = make_store(refused_trial)
    TrialsReport(store).write()
    lines = "refuses 4. Of the 0 other trials 0 passed"
    report = (store.folder / "report.html").read_text()
    assert lines in report
    assert "None were run although infeasible." in report


def test_picture_of_errors_draws_groups_with_trials_from_zero():
    figure = draw_figures(
        {"without disturbances": [(0.2, 0.99), (0.4, 0.97)], "with": []}
    )
    path, press = figure.axes
    for ax in (path, press):
        assert ax.get_title(loc="left")
        assert ax.get_ylim()[0] == 0
        assert "with" not in [line.get_label() for line in ax.lines]


def test_trials_in_free_space_do_not_count_in_the_picture_of_the_force():
    pairs = [(0.2, 0.99), (0.4, np.nan), (0.6, 0.97), (0.8, np.nan)]
    path, press = draw_figures({"without": pairs, "with": []}).axes
    assert len(path.lines[0].get_xdata()) == 4
    np.testing.assert_allclose(press.lines[0].get_xdata(), [99, 97])
    np.testing.assert_allclose(press.lines[0].get_ydata(), [50, 100])


def test_parameter_over_decades_has_several_ticks():
    values = np.geomspace(0.02, 0.5, 40)
    figure = draw_success({"eraser.worn": values.tolist()}, [True] * 40)
    ax = figure.axes[0]
    figure.draw_without_rendering()
    low, high = ax.get_xlim()
    shown = [
        label.get_text()
        for at, label in zip(ax.get_xticks(), ax.get_xticklabels(), strict=True)
        if low <= at <= high
    ]
    assert shown == ["0.03", "0.1", "0.3"]


def test_picture_of_equal_trials_does_not_ask_for_more_of_them():
    figure = draw_success({"press.force": [5.0] * 40}, [True] * 40)
    (text,) = figure.texts
    assert text.get_text() == "No parameter differs between these trials."


def test_picture_of_the_force_ends_at_all_of_the_time():
    _, press = draw_figures({"without": [(0.2, 0.99)], "with": []}).axes
    assert press.get_xlim()[1] < 101


def test_interval_of_no_trials_is_everything():
    assert interval(0, 0) == (0.0, 1.0)
    low, high = interval(9, 9)
    assert 0.6 < low < high == 1.0


@pytest.mark.parametrize(("least", "scale"), [(0.1, "log"), (2.0, "linear")])
def test_parameter_over_a_decade_has_a_logarithmic_axis(least, scale):
    values = np.geomspace(least, 10.0, 20).tolist()
    figure = draw_success({"press.force": values}, [v > 1 for v in values])
    assert figure.axes[0].get_xscale() == scale
    figure.draw_without_rendering()


def test_report_of_no_trials_is_refused(make_store, refused):
    store = make_store(passed, 0)
    assert "no trials" in refused("worlds", store.folder)


def test_parquet_has_a_row_for_each_trial(make_store, command, outputs):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow")
    store = make_store(passed)
    path = outputs / "worlds.parquet"
    assert command("worlds", store.folder, "--parquet", path).code == 0
    table = parquet.read_table(path).to_pydict()
    assert table["number"] == [0, 1, 2, 3]
    assert table["metrics.tracking_rms_m"] == [0.003] * 4
    assert len(set(table["parameters.press.force"])) == 4


def test_parquet_without_pyarrow_is_refused(make_store, refused, outputs, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    store = make_store(passed)
    line = refused("worlds", store.folder, "--parquet", outputs / "w.parquet")
    assert "pip install 'fmp-drake[parquet]'" in line


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (("default",), "--out"),
        (("default", "--out", "x", "--count", 0), "count is 0"),
        (("default", "--out", "x", "--jobs", 0), "jobs is 0"),
        (("default", "--out", "x", "--seed", -1), "seed is -1"),
        (("default", "--out", "x", "--duration", 0), "duration is 0"),
        (("default", "--out", "x", "--html", "x.html"), "give its number by --replay"),
        (("default", "--replay", 1), "not a folder of trials"),
        ((".", "--replay", 1, "--parquet", "x.parquet"), "leave out --replay"),
        ((".", "--count", 3), "a folder of trials, to which --count does not apply"),
        (("default", "--out", "x", "--markdown", "x.html"), "end in .md"),
        (("moon", "--out", "x"), "there are no distributions moon"),
    ],
)
def test_inconsistent_options_are_refused(
    refused, call, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert message in refused("worlds", *call)
    assert list(tmp_path.iterdir()) == []


def test_rate_of_trials_counts_those_run_by_force(make_store):
    def run(trial):
        return replace(passed(refused_trial(trial)), cpu_seconds=9.0)

    verdict = TrialsReport(make_store(run, 4, force=True)).verdict()
    assert "at a rate of 400 per hour" in verdict


def test_report_states_the_trials_per_core_hour(make_store):
    def run(trial):
        done = passed(trial) if trial.number else refused_trial(trial)
        return replace(done, cpu_seconds=9.0)

    # In 36 s three are run and one is refused.
    verdict = TrialsReport(make_store(run, 4)).verdict()
    assert "0.01 hours of one core, at a rate of 300 per hour" in verdict
