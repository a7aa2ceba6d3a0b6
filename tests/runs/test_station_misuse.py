"""Facts about what Python code is told that uses stations, skills and runs wrongly."""

import functools

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from fmp_drake.errors import FmpError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.runs import (
    MakeRun,
    RunLog,
    TeachingSession,
    load_context,
    save_context,
)
from fmp_drake.skills import (
    EraserPath,
    RobotJoints,
    default_demonstration,
    load_on_board,
    scenario_skill,
)
from fmp_drake.station import (
    AddBoardScene,
    AddInk,
    LoadRobot,
    LoadScenario,
    MakeStation,
    SimulatedHand,
    models_dir,
)
from fmp_drake.station.tasks.wiping import Wiping
from fmp_drake.systems import HandMotion

TIME = np.arange(0, 20, 0.05)
CIRCLES = 0.1 * np.column_stack([np.cos(3 * TIME), np.sin(3 * TIME), 0 * TIME])


@functools.cache
def skill():
    return FourierMovementPrimitive(rate=20.0, window=2.0).fit(CIRCLES)


def a_context():
    return MakeStation(LoadScenario("table_top"), skill()).CreateDefaultContext()


def a_hand():
    return SimulatedHand(HandMotion(np.zeros((5, 2))))


def ink_in_free_space():
    builder = DiagramBuilder()
    scene = AddBoardScene(builder, LoadScenario("stir"), start=[0.0, 0.0, 0.1])
    AddInk(builder, scene)


NO_SCENARIO = (
    r"needs a scenario, such as LoadScenario\('table_top'\); it is 'table_top'"
)
NO_PATH = "its type must be str or PathLike"
WRONG = {
    "scenario of a list": (lambda: LoadScenario(["vertical"]), NO_PATH),
    "robot of nothing": (lambda: LoadRobot(None), f"the robot is None; {NO_PATH}"),
    "robot of a model": (
        lambda: LoadRobot(models_dir() / "panda" / "panda.urdf"),
        "panda.urdf is not a YAML file; write one .* `model: panda.urdf`, `base` and",
    ),
    "placed on a name": (
        lambda: load_on_board("a.npz", scenario="table_top"),
        NO_SCENARIO,
    ),
    "placed arrays": (
        lambda: load_on_board([CIRCLES], scenario=LoadScenario("table_top")),
        rf"paths\[0\] is array.*{NO_PATH}",
    ),
    "skill of a name": (lambda: scenario_skill("table_top"), NO_SCENARIO),
    "bundled demonstration of nothing": (lambda: default_demonstration(None), NO_PATH),
    "taught on a name": (lambda: TeachingSession("table_top", a_hand()), NO_SCENARIO),
    "taught into nothing": (
        lambda: TeachingSession(LoadScenario("table_top"), a_hand(), out=None),
        f"out is None; {NO_PATH}",
    ),
    "run of an array": (
        lambda: MakeRun(LoadScenario("table_top"), skill(), demonstrations=CIRCLES),
        r"demonstrations=\) needs a Demonstration, or a list of them; it is array",
    ),
    "log of nothing": (lambda: RunLog.load(None), NO_PATH),
    "context from nothing": (lambda: load_context(a_context(), None), NO_PATH),
    "context into nothing": (lambda: save_context(a_context(), None), NO_PATH),
    "joints of a path": (
        lambda: RobotJoints("a.npz"),
        "'a.npz'; its type must be Demo",
    ),
    "eraser of a path": (lambda: EraserPath("a.npz"), "'a.npz'; its type must be Demo"),
    "hand in three channels of two": (
        lambda: HandMotion(np.zeros((5, 3))),
        r"the positions of shape \(5, 3\); expected \(N, 2\)",
    ),
    "task as a class": (
        lambda: MakeStation(LoadScenario("table_top"), skill(), task=Wiping),
        "task is <class '.*Wiping'>; its type must be Task or None",
    ),
    "ink without a board": (ink_in_free_space, "there is no board for the ink"),
    "hand at NaN": (lambda: HandMotion([[0.0, np.nan]]), "NaN or infinite numbers in"),
}


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_use_is_refused_with_what_would_be_right(wrong):
    use, message = WRONG[wrong]
    with pytest.raises(FmpError, match=message):
        use()


def test_one_demonstration_of_a_run_is_like_a_list_of_it():
    recording = Demonstration(time=TIME, values=CIRCLES)
    for given in (recording, [recording]):
        run = MakeRun(LoadScenario("table_top"), skill(), demonstrations=given)
        assert np.array_equal(run.demonstrated, [recording.values])


def test_files_are_named_by_a_string_a_path_or_any_iterable_of_them(tmp_path):
    Demonstration(time=TIME, values=CIRCLES).save(tmp_path / "d.npz")
    scenario = LoadScenario("table_top")
    for files in (str(tmp_path / "d.npz"), tmp_path / "d.npz", tmp_path.glob("*.npz")):
        (found,), _ = load_on_board(files, scenario=scenario)
        assert len(found.time) == len(TIME)
