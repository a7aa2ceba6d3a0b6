"""Facts about worlds that are run, kept, gone on with and shown again."""

import dataclasses
import os
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from functools import partial

import numpy as np
import pytest
import worlds_stub
from PIL import Image
from worlds_stub import Here

from fmp_drake import ExperimentError
from fmp_drake.apps import worlds as worlds_module
from fmp_drake.experiments.worlds import (
    Outcome,
    Task,
    WorldSpec,
    WorldsReport,
    WorldStore,
    faults,
    replay_world,
    run_worlds,
)
from fmp_drake.experiments.worlds.pictures import draw_success, interval
from fmp_drake.experiments.worlds.world import code_version
from fmp_drake.film import checks
from fmp_drake.processes import ClusterWorkers

SPEC = """
fields: {press.force: {uniform: [5.0, 9.0]}, start: [0.0, 0.0, {uniform: [0.005, 0.02]}]}
disturbances: {count: {choice: [0, 1]}, each: {force: [0, {uniform: [-9.0, 9.0]}, 0]}}
"""
GOOD = {
    "tracking_rms_m": 0.003,
    "tracking_max_m": 0.01,
    "normal_force_wanted_fraction": 0.99,
    "normal_force_p05_n": 8.0,
    "normal_force_p95_n": 11.0,
    "contact_fraction": 0.98,
    "torque_ratio_max": 0.5,
    "torque_rate_max_nm_per_s": 900.0,
    "joint_speed_ratio_max": 0.7,
    "joint_limit_margin_min_rad": 0.2,
    "cleaned_fraction_of_demonstrated_area": 0.9,
}


@pytest.fixture(scope="module")
def spec_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("spec") / "mine.yaml"
    path.write_text(SPEC)
    return path


@pytest.fixture(scope="module")
def out(tmp_path_factory, spec_file):
    """The folder of two real worlds, run by the command line."""
    from click.testing import CliRunner

    from fmp_drake.apps.main import app

    folder = tmp_path_factory.mktemp("worlds") / "out"
    call = ["worlds", spec_file, "--count", 2, "--seconds", 0.3, "--jobs", 1]
    call = [str(each) for each in [*call, "--out", folder]]
    result = CliRunner().invoke(app, call, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert f"wrote {folder / 'report.html'}" in result.output
    return folder


@pytest.fixture
def make_store(tmp_path):
    """The function that runs worlds with a stand-in, in this process."""

    def make(run, count=4, *, force=False, spec=SPEC, name="made"):
        spec = WorldSpec(spec)
        store = WorldStore(tmp_path / name, spec.plan(seed=0, seconds=9.0))
        list(run_worlds(store, spec, count, Here(), force=force, run=run))
        return store

    return make


def outcome(_, **changes):
    return Outcome(
        checked={}, metrics=GOOD | changes, events="contact lost from 2.1 to 3.0 s"
    )


def without_times(store):
    return [dataclasses.replace(w, cpu_seconds=0.0) for w in store.worlds()]


# Real worlds.


def test_worlds_are_kept_with_all_figures(out):
    store = WorldStore(out)
    worlds = store.worlds()
    assert [w.number for w in worlds] == [0, 1]
    for world in worlds:
        assert world.error == ""
        assert world.code == code_version()
        assert world.metrics["tracking_rms_m"] < 0.01
        assert 5 < world.parameters["press.force"] < 9
        assert world.cpu_seconds > 0


def test_replay_is_the_same_to_the_last_bit(out, command, outputs):
    page = outputs / "page.html"
    result = command("worlds", out, "--replay", 1, "--html", page)
    assert result.code == 0, result
    assert "the same to the last bit" in result.out
    assert page.stat().st_size > 1e5


@pytest.fixture(scope="module")
def egl():
    if not checks.renders():
        pytest.skip("films need EGL")


@pytest.mark.usefixtures("egl")
def test_replay_is_filmed(out, outputs):
    film = outputs / "world.gif"
    replay_world(WorldStore(out).world(0), 0.05, video=film)
    with Image.open(film) as opened:
        assert opened.n_frames == 2  # At 20 Hz, the first and the last.


def test_replay_that_differs_says_so(out, command, monkeypatch):
    metrics = WorldStore(out).world(0).metrics
    changed = {**metrics, "tracking_rms_m": metrics["tracking_rms_m"] * (1 + 1e-15)}
    monkeypatch.setattr(worlds_module, "replay_world", lambda *_, **__: changed)
    assert "NOT the same" in command("worlds", out, "--replay", 0).out


def test_world_out_of_reach_is_not_run(tmp_path):
    spec = WorldSpec("fields: {board.translation: [0.8, 0.0, 0.1]}")
    store = WorldStore(tmp_path, spec.plan(seed=0, seconds=0.1))
    list(run_worlds(store, spec, 1, Here()))
    (world,) = store.worlds()
    assert (world.is_feasible, world.was_run) == (False, False)
    assert "cm towards the arm" in world.verdict
    assert world.checked["reachable_fraction"] < 1


@pytest.mark.usefixtures("nothing_is_freed")
def test_cluster_gives_the_identical_store(out, spec_file, tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs the extra cluster")
    spec = WorldSpec.load(spec_file)
    store = WorldStore(tmp_path, spec.plan(seed=0, seconds=0.3))
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        workers = ClusterWorkers(cluster.scheduler_address)
        list(run_worlds(store, spec, 2, workers))
    assert without_times(store) == without_times(WorldStore(out))


# Stand-ins.


def test_killed_worker_and_killed_driver_lose_nothing_and_repeat_nothing(tmp_path):
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "WORLDS_STUB": str(tmp_path),
        "WORLDS_STUB_LAST": "3",
    }
    code = "import sys, worlds_stub\nif __name__ == '__main__': worlds_stub.drive(*sys.argv[1:])"
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
    (plan,) = {WorldStore(tmp_path).plan["spec"]}
    spec = WorldSpec(plan)
    store = WorldStore(tmp_path, spec.plan(seed=0, seconds=1.0))
    assert [w.number for w in store.worlds()] == [0, 1, 2]
    os.environ["WORLDS_STUB"] = str(tmp_path)
    try:
        list(run_worlds(store, spec, 5, Here(), run=worlds_stub.world))
    finally:
        del os.environ["WORLDS_STUB"]
    numbers = [int(line.split()[0]) for line in begun.read_text().splitlines()]
    assert numbers == [0, 1, 1, 2, 3, 3, 4]
    assert [w.attempts for w in store.worlds()] == [1, 2, 1, 1, 1]
    assert store.world(2).error == "ValueError: too much"


def test_ctrl_c_leaves_a_good_store_and_says_how_to_go_on(
    command, spec_file, tmp_path, monkeypatch
):
    def run(task):
        if task.number == 2:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)
        return outcome(task)

    monkeypatch.setattr(worlds_module, "LocalWorkers", lambda _: Here())
    monkeypatch.setattr(worlds_module, "run_worlds", partial(run_worlds, run=run))
    result = command("worlds", spec_file, "--count", 5, "--out", tmp_path / "out")
    assert result.code == 130
    assert "2 worlds are kept" in result.out
    assert "the same command goes on" in result.out
    assert [w.number for w in WorldStore(tmp_path / "out").worlds()] == [0, 1]


def test_progress_of_many_worlds_is_said_now_and_then(
    command, spec_file, tmp_path, monkeypatch
):
    monkeypatch.setattr(worlds_module, "LocalWorkers", lambda _: Here())
    monkeypatch.setattr(worlds_module, "run_worlds", partial(run_worlds, run=outcome))
    result = command("worlds", spec_file, "--count", 60, "--out", tmp_path / "out")
    said = [line for line in result.out.splitlines() if line.endswith("of 60 worlds")]
    assert said == [f"{done} of 60 worlds" for done in range(0, 61, 3)]


def test_refused_world_is_shown_with_what_was_said_of_it(
    make_store, command, monkeypatch
):
    def run(_):
        return Outcome(is_feasible=False, verdict="out of reach", checked={})

    store = make_store(run, 1)
    monkeypatch.setattr(worlds_module, "replay_world", lambda *_, **__: GOOD)
    result = command("worlds", store.folder, "--replay", 0)
    assert result.out.splitlines() == [
        "refused in advance: out of reach",
        "world 0 goes well",
    ]


def test_process_that_ends_is_the_result_of_its_world(make_store):
    def run(task):
        if task.number == 1:
            raise BrokenProcessPool("it was killed")
        return outcome(task)

    worlds = make_store(run, 3).worlds()
    assert [bool(world.error) for world in worlds] == [False, True, False]
    (fault,) = faults(worlds[1])
    assert "its process ended (BrokenProcessPool: it was killed)" in fault.words


def test_two_drivers_do_not_run_the_same_worlds(make_store):
    store = make_store(outcome)
    other, spec = WorldStore(store.folder), WorldSpec(SPEC)
    with store.writing(), pytest.raises(ExperimentError, match="by another process"):
        list(run_worlds(other, spec, 9, Here(), run=outcome))


def test_same_call_runs_nothing_again_and_a_larger_one_what_is_missing(make_store):
    begun = []

    def run(task):
        begun.append(task.number)
        return outcome(task)

    for count in (3, 3, 5):
        store = make_store(run, count)
    assert begun == [0, 1, 2, 3, 4]
    assert [w.number for w in store.worlds()] == begun


def test_changed_code_runs_worlds_again(make_store, monkeypatch):
    make_store(outcome)
    name = "fmp_drake.experiments.worlds.running.code_version"
    monkeypatch.setattr(name, lambda: "newer")
    assert {w.code for w in make_store(outcome).worlds()} == {"newer"}


def test_worker_with_other_code_is_refused(make_store, monkeypatch):
    from fmp_drake.experiments.worlds import run_world

    monkeypatch.setattr(
        "fmp_drake.experiments.worlds.running.code_version", lambda: "x"
    )
    with pytest.raises(ExperimentError, match="its driver x; the code"):
        make_store(run_world)


def test_refused_worlds_run_by_force_only(make_store):
    def run(task):
        if task.force or task.number:
            return outcome(task)
        return Outcome(is_feasible=False, verdict="out of reach", checked={})

    def seen(store):
        return [(w.verdict, w.was_run) for w in store.worlds()]

    assert seen(make_store(run)) == [("out of reach", False), *[("", True)] * 3]
    assert seen(make_store(run, force=True)) == [("", True)] * 4


def test_exception_in_a_world_is_a_result(tmp_path):
    spec = WorldSpec("fields: {board.translation: [5.0, 0.0, 0.0]}")
    store = WorldStore(tmp_path, spec.plan(seed=0, seconds=0.1))
    list(run_worlds(store, spec, 1, Here(), force=True))
    (world,) = store.worlds()
    (fault,) = faults(world)
    assert fault.kind == "exception"
    assert "StationError: the arm cannot bring the eraser" in fault.words


def test_store_of_another_plan_is_refused(make_store):
    store = make_store(outcome)
    plan = store.plan | {"seed": "7"}
    with pytest.raises(ExperimentError, match=r"another seed \(0, not 7\)"):
        WorldStore(store.folder, plan)
    with pytest.raises(ExperimentError, match="there are no worlds in"):
        WorldStore(store.folder / "nowhere")
    with pytest.raises(ExperimentError, match="no world 9; its worlds are 0 to 3"):
        store.world(9)


@pytest.mark.parametrize("blocked", ["out", "out/worlds.sqlite"])
def test_folder_that_cannot_keep_worlds_is_refused(
    spec_file, refused, tmp_path, blocked
):
    path = tmp_path / blocked
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"noise, and no folder or store of worlds" * 9)
    out = tmp_path / "out"
    line = refused("worlds", spec_file, "--out", out)
    assert f"cannot keep worlds in {out}: " in line


@pytest.mark.parametrize(
    ("changes", "kind", "words"),
    [
        ({"penetration_max_m": 0.02}, "through", "20.0 mm below the surface"),
        ({"contact_fraction": float("nan")}, "nan", "NaN in contact_fraction"),
        ({"torque_ratio_max": 1.2}, "limit", "torque reaches 1.2 of its limit"),
        ({"torque_rate_max_nm_per_s": 1500.0}, "limit", "reaches 1500 Nm/s"),
        ({"joint_speed_ratio_max": 1.1}, "limit", "speed reaches 1.1 of its limit"),
        ({"joint_limit_margin_min_rad": -0.1}, "limit", "0.100 rad beyond its limit"),
        (
            {"tracking_rms_m": 0.034},
            "path",
            "34.0 mm rms, 10 mm at most",
        ),
        ({"normal_force_wanted_fraction": 0.5}, "press", "50 % of the time in contact"),
        (
            {"contact_fraction": 0.0, "normal_force_wanted_fraction": 0.0},
            "press",
            "never",
        ),
        ({"arm_on_board_s": 0.06}, "touch", "touches the board for 0.06 s"),
    ],
)
def test_what_goes_wrong_is_said_in_words(make_store, changes, kind, words):
    spec = "fields: {press.force: 9.0}"
    (world,) = make_store(partial(outcome, **changes), 1, spec=spec).worlds()
    (fault,) = faults(world)
    assert fault.kind == kind
    assert words in fault.words
    (good,) = make_store(outcome, 1, spec=spec, name="good").worlds()
    assert faults(good) == []


def test_pushed_worlds_are_not_judged_by_their_press(make_store):
    spec = "disturbances: {count: 1}"
    run = partial(outcome, normal_force_wanted_fraction=0.5)
    assert faults(make_store(run, 1, spec=spec).world(0)) == []


def test_worlds_of_an_older_version_are_still_reported(make_store):
    store = make_store(outcome, 1)
    world = store.world(0)
    world.scenario += "forgotten: {key: 1}\n"
    store.keep(Task(0, world.scenario, 9.0, False, "older"), world)
    WorldsReport(store).write()
    assert "Of 1 worlds" in (store.folder / "report.html").read_text()


def test_path_is_judged_on_the_board_as_it_is(make_store):
    spec = "fields: {board.error.translation: [0.0, 0.0, -0.008]}"
    rms = {"tracking_rms_m": 0.0101, "tracking_on_board_rms_m": 0.006}
    store = make_store(partial(outcome, **rms), 1, spec=spec)
    assert faults(store.world(0)) == []
    WorldsReport(store).write()
    text = (store.folder / "report.html").read_text()
    assert "it is too large in these, too: 0." in text


def test_a_world_whose_store_knows_only_the_whole_distance_is_judged_by_it(make_store):
    spec = "fields: {board.error.translation: [0.0, 0.0, -0.008]}"
    store = make_store(partial(outcome, tracking_rms_m=0.0101), 1, spec=spec)
    (fault,) = faults(store.world(0))
    assert "10.1 mm rms, " in fault.words
    WorldsReport(store).write()
    assert "8.0 mm lower than assumed" in (store.folder / "report.html").read_text()


def test_report_does_not_promise_what_was_not_measured(make_store):
    assert "was not measured" in WorldsReport(make_store(outcome, 1)).verdict()


def test_report_and_page_say_what_went_wrong_and_how_to_see_it(
    make_store, command, outputs
):
    def run(task):
        if task.number == 3:
            return Outcome(
                is_feasible=False, verdict="move it | 0.2 m nearer", checked={}
            )
        rms = 0.002 + 0.02 * (task.number == 7)
        return outcome(task, tracking_rms_m=rms, penetration_max_m=0.0)

    store = make_store(run, 30)
    page = outputs / "README.md"
    assert command("worlds", store.folder, "--page", page).code == 0
    texts = page.read_text(), (store.folder / "report.html").read_text()
    for text in texts:
        assert "Of 30 worlds" in text
        assert "not measured" not in text
        assert "Of the 29 others 28 go well (96.6 %)" in text
        assert "22.0 mm rms" in text
        assert "The run says: contact lost from 2.1 to 3.0 s." in text
        assert f"fmp-drake worlds {store.folder} --replay 7" in text
        assert "0.2 m nearer" in text
        assert "press.force" not in text  # It is in a picture.
    pictures = {"followed.png", "success.png"}
    assert {p.name for p in outputs.iterdir()} == pictures | {"README.md"}
    assert texts[1].count("data:image/png;base64") == 2


def test_report_counts_by_demonstration(make_store):
    spec = SPEC.replace(
        "fields: {", "fields: {skill.demonstration: {choice: [eight, wiping]}, "
    )
    store = make_store(outcome, 12, spec=spec)
    drawn = [world.parameters["skill.demonstration"] for world in store.worlds()]
    page = store.folder / "README.md"
    WorldsReport(store).write(page)
    for name in ("eight", "wiping"):
        assert f"| {name} | {drawn.count(name)} | 100.0 % |" in page.read_text()


def test_report_of_refused_worlds_only_is_written(make_store):
    def run(_):
        return Outcome(is_feasible=False, verdict="out of reach", checked={})

    store = make_store(run)
    WorldsReport(store).write()
    said = "refuses 4. Of the 0 others 0 go well"
    assert said in (store.folder / "report.html").read_text()


def test_without_worlds_the_fraction_of_good_ones_may_be_anything():
    assert interval(0, 0) == (0.0, 1.0)
    low, high = interval(9, 9)
    assert 0.6 < low < high == 1.0


@pytest.mark.parametrize(("least", "scale"), [(0.1, "log"), (2.0, "linear")])
def test_parameter_over_a_decade_has_a_logarithmic_axis(least, scale):
    values = np.geomspace(least, 10.0, 20).tolist()
    figure = draw_success({"press.force": values}, [v > 1 for v in values])
    assert figure.axes[0].get_xscale() == scale
    figure.draw_without_rendering()


def test_report_of_no_world_says_so(make_store, refused):
    store = make_store(outcome, 0)
    assert "no worlds" in refused("worlds", store.folder)


def test_parquet_has_a_row_for_each_world(make_store, command, outputs):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow")
    store = make_store(outcome)
    path = outputs / "worlds.parquet"
    assert command("worlds", store.folder, "--parquet", path).code == 0
    table = parquet.read_table(path).to_pydict()
    assert table["number"] == [0, 1, 2, 3]
    assert table["metrics.tracking_rms_m"] == [0.003] * 4
    assert len(set(table["parameters.press.force"])) == 4


def test_parquet_without_pyarrow_is_refused(make_store, refused, outputs, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    store = make_store(outcome)
    line = refused("worlds", store.folder, "--parquet", outputs / "w.parquet")
    assert "fmp-drake[parquet]" in line


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (("default",), "--out"),
        (("default", "--out", "x", "--count", 0), "count is 0"),
        (("default", "--out", "x", "--jobs", 0), "jobs is 0"),
        (("default", "--out", "x", "--seed", -1), "seed is -1"),
        (("default", "--out", "x", "--seconds", 0), "seconds is 0"),
        (("default", "--out", "x", "--html", "x.html"), "say which with --replay"),
        (("default", "--replay", 1), "no folder of worlds"),
        (("default", "--out", "x", "--page", "x.html"), "end in .md"),
        (("moon", "--out", "x"), "there are no worlds moon"),
    ],
)
def test_calls_that_make_no_sense_are_refused(
    refused, call, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert message in refused("worlds", *call)
    assert list(tmp_path.iterdir()) == []
