"""Facts about distributions over scenarios."""

import numpy as np
import pytest

from fmp_drake import FmpError
from fmp_drake.experiments.trials import TrialSpec
from fmp_drake.experiments.trials.spec import Distribution, own_files, read_value
from fmp_drake.station import ParseScenario, models_dir

SPEC = """
base: {choice: [table_top, vertical]}
offsets: {board: {rpy: [0, {uniform: [-0.1, 0.1]}, 0]}}
fields:
  "board.translation[2]": {uniform: [0.1, 0.2]}
  press: {force: {log_uniform: [5, 20]}}
  skill.demonstration: {choice: [eight, wiping]}
  skill.seed: {uniform: [0, 9]}
  sensors: {rate: 1000.0, delay: {normal: [0.001, 0.001, 0, 0.002]}}
disturbances:
  count: {choice: [0, 2]}
  each: {start: 1.0, force: [0, {uniform: [-9.0, 9.0]}, 0]}
"""


def drawn(count=20, seed=3, spec=SPEC):
    spec = TrialSpec(spec)
    return [spec.draw(seed=seed, number=i) for i in range(count)]


def test_trial_depends_on_text_seed_and_number_only():
    trials = drawn()
    spec = TrialSpec(SPEC)
    alone = [spec.draw(seed=3, number=i) for i in reversed(range(20))]
    assert alone[::-1] == trials
    assert len({t.scenario for t in trials}) == 20
    assert all(a != b for a, b in zip(trials, drawn(seed=4), strict=True))
    assert drawn(1) == trials[:1]


def test_empty_text_is_no_specification():
    with pytest.raises(FmpError, match="distributions have the keys"):
        TrialSpec("# nothing\n")
    TrialSpec("{}")


def test_scenario_has_the_drawn_values_and_those_of_its_base():
    values = set()
    for trial in drawn():
        p, s = trial.parameters, ParseScenario(trial.scenario)
        assert s.board.translation[2] == p["board.translation[2]"]
        assert s.press.force == p["press.force"]
        assert s.skill.demonstration == p["skill.demonstration"]
        assert s.skill.seed == p["skill.seed"]
        assert 0 <= s.sensors.delay == p["sensors.delay"] <= 0.002
        assert s.sensors.rate == 1000
        upright = p["base"] == "vertical"
        pitch = -1.5707963 * upright + p["board.rpy[1], offset"]
        assert s.board.rpy == [0, pitch, 0]
        assert s.board.translation[0] == (0.366 if upright else 0.55)
        assert s.skill.tempo == (0.9 if upright else 1.0)
        assert len(s.disturbances) == p["disturbances.count"]
        for i, push in enumerate(s.disturbances):
            assert push.start == 1
            assert push.force == [0, p[f"disturbances[{i}].force[1]"], 0]
        values.add((p["base"], p["skill.demonstration"], p["disturbances.count"]))
    assert [len(set(each)) for each in zip(*values, strict=True)] == [2, 2, 2]


@pytest.mark.parametrize(
    ("kind", "values", "mean", "deviation"),
    [
        ("uniform", (1.0, 4.0), 2.5, 3 / 12**0.5),
        ("uniform", (1, 4), 2.5, 1.25**0.5),
        ("log_uniform", (1.0, np.e), np.e - 1, 0.492),
        ("normal", (2.0, 0.5, 0.0, 9.0), 2.0, 0.5),
        ("choice", (2, 4, 4, 4), 3.5, 0.75**0.5),
    ],
)
def test_distribution_has_its_mean_and_deviation(kind, values, mean, deviation):
    rng = np.random.default_rng(0)
    drawn = [Distribution(kind, values).draw(rng) for _ in range(4000)]
    assert np.mean(drawn) == pytest.approx(mean, abs=0.05)
    assert np.std(drawn) == pytest.approx(deviation, rel=0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "fields: {board.frction: 1}",
            "no board.frction: board has shape, radius, axis, translation, rpy",
        ),
        ('fields: {"board.rpy[3]": 1}', r"no board.rpy\[3\]: board.rpy has 0, 1, 2"),
        ("fields: {press.force: {unifrm: [1, 2]}}", r"one distribution \(.*got unifrm"),
        ("fields: 3", "fields is 3; expected names with values or distributions"),
        ("fields: [press.force, 5]", r"fields is \['press.force', 5\]; expected names"),
        (
            "fields: {choice: [1, 2]}",
            r"fields is \{'choice': \[1, 2\]\}; expected names",
        ),
        ("disturbances: {each: [1]}", r"each is \[1\]; expected names"),
        (
            "base: {choise: [tilted]}",
            r"base is .*expected a name, or choice: \[one, an",
        ),
        ("robot: [panda]", r"robot is \['panda'\]; expected a name, or choice: \[one"),
        ("fields: {press.force: 5, press: {force: 6}}", "fields has press.force twice"),
        (
            "offsets: {board: {rpy: [0, 1]}, 'board.rpy[1]': 0}",
            r"offsets has board.rpy\[1\] twice; keep one",
        ),
        ("fields: {board.friction: -1}", "board.friction is -1.0; it must be at least"),
        ("fields: {press.force: {uniform: [-1, 2]}}", "press.force is -1.0; it must"),
        ("fields: {press.force: {choice: [1, much]}}", "press.force is 'much'; expect"),
        (
            "fields: {press.force: {uniform: [2, 1]}}",
            r"expected uniform: \[least, most",
        ),
        ("fields: {press.force: {log_uniform: [0, 1]}}", "both positive"),
        ("fields: {press.force: {normal: [1, 2]}}", r"expected normal: \[mean, stand"),
        ("fields: {press.force: {choice: []}}", "equally likely"),
        ("fields: {press.force: {choice: [" + "9," * 201 + "]}}", "at most 200"),
        ("base: {choice: [" + "tilted," * 15_000 + "]}", "at most 200"),
        ('fields: {"board.rpy[²]": 1}', r"there is no board.rpy\[²\]"),
        (
            "offsets: {press.force: {uniform: [0, 1000000.0]}}",
            r"press.force is 1.00001e\+06",
        ),
        ("offsets: {skill.demonstration: 1}", "offset 1 of skill.demonstration, which"),
        (
            "stuff: 1",
            "have the keys description, base, robot, offsets, fields, disturbances",
        ),
        ("- 1", "have the keys description"),
        ("fields: {", "cannot be read as YAML"),
        ("base: moon", "no scenario moon; give a YAML file or one of: cenic"),
        ("disturbances: 2", "expected a mapping with count and each"),
        ("disturbances: {count: 1.5}", "must be a whole number"),
        ("disturbances: {count: 1000000000000}", "at least 0 and at most 1000"),
        ("disturbances: {count: {uniform: [0, 1001]}}", "count is 1001; it must"),
        ("fields: {skill.seed: {uniform: [0, 1000000000000000000000]}}", "within 1e"),
        ("fields: {a: " + "[" * 1000 + "]" * 1000 + "}", "deeper than 50 levels"),
        ("fields: {skill.tempo: " + "1" * 400 + "}", "an integer of 400 digits"),
        ("fields: {skill.seed: {uniform: [0, 2026-99-99]}}", "cannot be read as YAML"),
        ("disturbances: {each: {forc: 1}}", "no forc: it has kind, start"),
        ("disturbances: {each: {kind: kick}}", "choose one of: push, grasp"),
        (
            "disturbances: {count: {choice: [0, 1]}, each: {start: {uniform: [-1.0, 3.0]}}}",
            r"disturbances\[0\].start is -1",
        ),
        (
            "fields: {skill.demonstration: {choice: [wiping, nowhere.csv]}}",
            r"skill.demonstration is 'nowhere.csv'; there is no such file in /",
        ),
        ("fields: {skill.demonstration: sweeping}", "no demonstration sweeping; give"),
        (
            "fields: {posture: [0.1, 0.2]}",
            r"no posture\[0\]: posture has no values; give",
        ),
    ],
)
def test_invalid_names_and_values_are_named(text, message):
    with pytest.raises(FmpError, match=message):
        TrialSpec(text)


def test_trials_have_robots_with_postures_and_friction_of_their_own(tmp_path):
    text = """
base: {choice: [table_top, vertical]}
robot: {choice: [panda, iiwa14, ur5e]}
fields: {friction.enabled: true, impedance.friction_compensation.enabled: true}
"""
    values = set()
    for trial in drawn(40, spec=text):
        scenario = ParseScenario(trial.scenario)
        scenario.check()
        robot, base = (trial.parameters[key] for key in ("robot", "base"))
        values.add((robot, base))
        assert scenario.robot == robot
        is_panda = robot == "panda"
        assert scenario.friction.enabled == is_panda
        assert scenario.impedance.friction_compensation.enabled == is_panda
        assert bool(scenario.posture) == (is_panda and base == "vertical")
    assert len(values) == 6
    (tmp_path / "spec.yaml").write_text(text)
    spec = TrialSpec.load(tmp_path / "spec.yaml", robot="ur5e")
    trials = [spec.draw(seed=3, number=i) for i in range(5)]
    assert {ParseScenario(trial.scenario).robot for trial in trials} == {"ur5e"}
    assert all("robot" not in trial.parameters for trial in trials)
    with pytest.raises(FmpError, match="there is no robot billiards"):
        TrialSpec.load(tmp_path / "spec.yaml", robot="billiards")


@pytest.mark.parametrize(
    ("least", "most"), [(0.9, 1.0), (1.0, 1.1), (1.0, 1.0), (0.0, 2.0)]
)
def test_normal_distribution_of_narrow_bounds_is_drawn_between_them(least, most):
    values = [1.0, 1e12, least, most]
    distribution = read_value("it", {"normal": values})
    rng = np.random.default_rng(0)
    drawn = [distribution.draw(rng) for _ in range(50)]
    assert least <= min(drawn) <= max(drawn) <= most
    assert np.ptp(drawn) > 0.8 * (most - least) or least == most


def test_paths_are_relative_to_the_specification(tmp_path, make_npz):
    make_npz("mine.npz")
    path = tmp_path / "mine.yaml"
    path.write_text("fields: {skill.demonstration: {choice: [mine.npz]}}")
    scenario = ParseScenario(TrialSpec.load(path).draw(seed=0, number=0).scenario)
    assert scenario.skill.demonstration == str(tmp_path / "mine.npz")


def test_task_of_free_space_that_the_fields_make_is_drawn(tmp_path):
    (tmp_path / "stick.sdf").write_text("<sdf/>")
    path = tmp_path / "mine.yaml"
    path.write_text(
        "fields: {board: {shape: none}, tool: stick.sdf, skill.demonstration: stirring}"
    )
    trial = TrialSpec.load(path).draw(seed=0, number=0)
    assert trial.fields["skill"]["demonstration"] == "stirring"
    assert trial.fields["tool"] == str(tmp_path / "stick.sdf")
    assert own_files(trial.fields) == [tmp_path / "stick.sdf"]


def test_the_files_of_a_trial_include_the_model_of_its_robot(tmp_path):
    (tmp_path / "models").mkdir()
    model = tmp_path / "models" / "mine.urdf"
    model.write_bytes((models_dir() / "ur5e" / "ur5e.urdf").read_bytes())
    robot = tmp_path / "mine.yaml"
    text = (models_dir() / "ur5e" / "ur5e.yaml").read_text()
    robot.write_text(text.replace("ur5e.urdf", "models/mine.urdf"))
    trial = TrialSpec("robot: mine.yaml", folder=tmp_path).draw(seed=0, number=0)
    assert own_files(trial.fields) == [robot, model]


def test_missing_specification_lists_the_bundled_ones():
    with pytest.raises(
        FmpError, match="no distributions nowhere; give a YAML file or one of: default"
    ):
        TrialSpec.load("nowhere")


def test_numbers_with_exponents_are_numbers():
    trial = TrialSpec(
        "fields: {eraser.modulus: 1e5, press.force: {uniform: [5e0, 1.1e+1]}}"
    ).draw(seed=0, number=0)
    assert trial.fields["eraser"]["modulus"] == 1e5
    assert 5 < trial.parameters["press.force"] < 11


@pytest.mark.parametrize("name", ["default", "surfaces"])
def test_bundled_trials_can_be_drawn(name):
    spec = TrialSpec.load(name)
    for number in range(10):
        ParseScenario(spec.draw(seed=0, number=number).scenario)


def test_surfaces_robots_and_tasks_are_drawn():
    spec = TrialSpec.load("surfaces")
    trials = [spec.draw(seed=0, number=n) for n in range(60)]
    drawn = [ParseScenario(trial.scenario) for trial in trials]
    stirred = [s for s in drawn if s.board.shape == "none"]
    assert {s.skill.demonstration for s in stirred} == {"stirring"}
    # What is drawn for a board is no parameter of a trial without one.
    for trial in trials:
        has = "skill.demonstration" in trial.parameters
        assert has == trial.has_board
    drawn = [s for s in drawn if s not in stirred]
    assert {s.skill.demonstration for s in drawn} == {
        *("eight", "polishing", "pulsing", "wiping")
    }
    assert {s.board.shape for s in drawn} == {"plane", "cylinder", "dome", "bowl"}
    assert {s.robot for s in drawn} == {"panda", "iiwa14", "ur5e"}
    curved = [s.board.radius for s in drawn if s.board.shape != "plane"]
    assert min(curved) < 0.3
    assert max(curved) > 0.4


def test_empty_list_is_a_value():
    unchanged, emptied = (
        TrialSpec(f"base: tilted\n{t}") for t in ("", "fields: {posture: []}")
    )
    assert len(unchanged.draw(seed=0, number=0).fields["posture"]) == 7
    assert emptied.draw(seed=0, number=0).fields["posture"] == []
    with pytest.raises(FmpError, match=r"board\.translation"):
        TrialSpec("fields: {board.translation: []}")
