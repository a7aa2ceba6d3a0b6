"""Facts about what Python code is told that uses the package wrongly."""

import copy
import functools
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from fmp_drake import (
    Demonstration,
    FourierMovementPrimitive,
    Player,
    load_skill,
    save_skill,
)
from fmp_drake.errors import FmpError
from fmp_drake.primitives import (
    LqrTracker,
    add_orientation,
    angular_velocity,
    find_rhythm,
    modulate_skill,
    read_demonstrations,
    scale_tempo,
    skill_rotations,
    skill_spectrum,
    transform_space,
)
from fmp_drake.primitives.data.windows import sliding_windows
from fmp_drake.primitives.discrete.discrete_movement_primitive import DiscreteMovement
from fmp_drake.skills import learn_skill

TIME = np.arange(0, 20, 0.05)
CIRCLES = 0.1 * np.column_stack([np.cos(3 * TIME), np.sin(3 * TIME), 0 * TIME])
NOT_FITTED = FourierMovementPrimitive()


@functools.cache
def player():
    return Player(FourierMovementPrimitive(rate=20.0).fit(CIRCLES))


def recording(**given):
    return Demonstration(**{"time": TIME, "values": CIRCLES} | given)


def fit(X, **given):
    return FourierMovementPrimitive(**given).fit(X)


WITH_NAN = np.where(np.arange(400)[:, None] == 7, np.nan, CIRCLES)
FRAME = SimpleNamespace(columns=["time", "x"])
WRONG = {
    "no rate": (lambda: fit(CIRCLES), r"no times.*time=time.* 20 Hz.*\(rate=50\)"),
    "no rate after clone": (lambda: clone(NOT_FITTED).fit(CIRCLES), r"\(rate=50\)"),
    "1 kHz": (
        lambda: fit(np.repeat(CIRCLES, 10, axis=0), rate=1000),
        r"4 s at 1000 Hz .* 4000 samples .*len\(array\)\) / 1000, values=array\)",
    ),
    "500 Hz": (
        lambda: fit(np.repeat(CIRCLES, 5, axis=0), rate=500),
        r"4 s at 500 Hz .* 2000 samples .*len\(array\)\) / 500, values=array\)",
    ),
    "transposed": (lambda: fit(CIRCLES.T, rate=20), r"\(array\.T\), of shape \(400, 3"),
    "transposed values": (lambda: recording(values=CIRCLES.T), r"Give values\.T"),
    "NaN": (lambda: fit(WITH_NAN, rate=20), r"3 NaN .* the first in sample 7; remove"),
    "too short": (lambda: fit(CIRCLES[:5], rate=20), r"no windows .* Record at least"),
    "no recording": (lambda: fit([]), r"no demonstration; give at least one"),
    "None": (lambda: fit(None), r"fit needs a Demonstration.* it is None\."),
    "a path": (lambda: fit(Path("a.csv")), r"'a\.csv'.* by Demonstration\.load\(path"),
    "a string": (lambda: fit("a.csv"), r"'a\.csv'.* by Demonstration\.load\(path"),
    "a data frame": (lambda: fit(FRAME), r"becomes one by Demonstration\(time=time"),
    "a dictionary": (lambda: fit({"time": TIME}), r"fit needs a Demonstration"),
    "two kinds": (lambda: fit([recording(), CIRCLES]), r"fit needs a Demonstration"),
    "other channels": (
        lambda: fit([recording(), recording(values=CIRCLES[:, :2])]),
        r"demonstration 2 has the channels x, y; the first has x, y, z",
    ),
    "words": (lambda: fit(np.array([["a"]] * 50), rate=20), "as real numbers"),
    "complex": (lambda: fit(1j * CIRCLES, rate=20), "as real numbers"),
    "no time": (
        lambda: recording(time=None),
        r"time has shape \(\) .* expected \(N,\)",
    ),
    "one string of names": (lambda: recording(channels="xyz"), "one name per channel"),
    "few units": (lambda: recording(units=["m"]), "give one of each per channel"),
    "rate of words": (lambda: fit(recording(), rate="50"), "rate is '50'"),
    "window of -1": (lambda: fit(recording(), window=-1), "window is -1 s; it must be"),
    "half a component": (lambda: fit(recording(), n_components=0.5), "a whole number"),
    "other model": (lambda: fit(recording(), model="best"), "it must be 'mixture'"),
    "played recording": (lambda: Player(recording()), r"Player\(skill\) needs a skill"),
    "played nothing": (lambda: Player(None), r"Player\(skill\) .* it is None"),
    "saved the wrong way": (
        lambda: save_skill("a", NOT_FITTED),
        r"save_skill\(skill, p",
    ),
    "transformed path": (
        lambda: transform_space("a"),
        r"transform_space\(skill\) needs",
    ),
    "masked": (
        lambda: recording(values=np.ma.masked_array(CIRCLES, CIRCLES > 0.09)),
        "some values are masked; leave them out",
    ),
    "backwards": (lambda: player().start([0.1, 0, 0], tempo=-1.0), "tempo is -1.0; it"),
    "advanced by NaN": (
        lambda: player().advance(player().start([0.1, 0, 0]), np.nan),
        "seconds is nan s; it must be",
    ),
    "advanced backwards": (
        lambda: player().advance(player().start([0.1, 0, 0]), -1.0),
        "seconds is -1.0 s; it must be at least 0 s",
    ),
    "advanced by a word": (
        lambda: player().advance(player().start([0.1, 0, 0]), "a"),
        "seconds: 'a' cannot be read as real numbers",
    ),
    "advanced by nothing": (
        lambda: player().advance(player().start([0.1, 0, 0]), None),
        "seconds is nan s; it must be at least 0 s",
    ),
    "target of two weights": (
        lambda: player().retarget(player().start([0.1, 0, 0]), [0.0, 1.0]),
        r"the target of shape \(2,\); expected \(\d+,\)",
    ),
    "sample of a word": (
        lambda: Player(player().skill, sample="yes"),
        "sample is 'yes'; it must be True or False",
    ),
    "sample of lists": (
        lambda: Player(player().skill, sample=[[1], [1, 2]]),
        "sample is .*; it must be True or False",
    ),
    "score of nothing": (
        lambda: player().skill.score_samples(None),
        "score_samples needs a Demonstration.* it is None",
    ),
    "one harmonic": (
        lambda: modulate_skill(player().skill, harmonics=2),
        "harmonics is 2; its type must be Iterable",
    ),
    "transformed without channels": (
        lambda: transform_space(player().skill, channels=None),
        "channels is None; its type must be Iterable",
    ),
    "orientation of an array": (
        lambda: add_orientation(CIRCLES, Rotation.identity(400)),
        "demonstration is array.* its type must be Demonstration",
    ),
    "two references": (
        lambda: add_orientation(
            recording(), Rotation.identity(400), reference=Rotation.identity(2)
        ),
        "there are 2 references; give one",
    ),
    "angular velocity in a plane": (
        lambda: angular_velocity([0.1, 0.2], [0.0, 0.0]),
        r"the rotation vectors of shape \(2,\); expected \(\.\.\., 3\)",
    ),
    "angular velocity of few rates": (
        lambda: angular_velocity(np.zeros((4, 3)), np.zeros((5, 3))),
        r"the rates of shape \(5, 3\); expected \(4, 3\)",
    ),
    "windows of a line": (
        lambda: sliding_windows(TIME, n_steps=3, stride=1),
        r"the samples have shape \(400,\); expected \(N, D\)",
    ),
    "one score of many samples": (
        lambda: player().track_sample(
            player().start([0.1, 0, 0]), count=9, score=lambda values: values.sum()
        ),
        r"cannot use the scores of shape \(1,\); expected \(9,\)",
    ),
    "class of a tracker": (
        lambda: Player(player().skill, tracker=LqrTracker),
        r"tracker is <class .*; give one such as LqrTracker\(\)",
    ),
    "motion at a word": (
        lambda: DiscreteMovement(
            coefficients=np.zeros((8, 1)), duration=1.0, component=0
        ).motion("end"),
        "the time: 'end' cannot be read as real numbers",
    ),
    "tempo of a path": (lambda: scale_tempo("a", 2.0), r"scale_tempo\(skill\) needs"),
    "motion at a time": (
        lambda: player().motion(0.5),
        r"a PlaybackState, which player.start\(position\) .* it is 0.5",
    ),
    "phase of a skill": (
        lambda: player().phase(player().skill),
        r"a PlaybackState, .* it is <FourierMovementPrimitive",
    ),
    "advanced nothing": (lambda: player().advance(None, 0.1), "it is None"),
    "remapped a position": (lambda: player().remap([0.1, 0, 0]), "a PlaybackState"),
    "plan from a time": (lambda: player().plan(0.5, 3), "a PlaybackState"),
    "list of skill files": (
        lambda: load_skill(["a.npz"]),
        r"the path is \['a.npz'\]; its type must be str or PathLike",
    ),
    "saved nowhere": (
        lambda: save_skill(player().skill, None),
        "the path is None; its",
    ),
    "recording saved nowhere": (
        lambda: recording().save(None),
        "the path is None; its",
    ),
    "list of recordings as one": (
        lambda: Demonstration.load(["a.npz"]),
        r"the path is \['a.npz'\]; its type must be str or PathLike",
    ),
    "read nothing": (
        lambda: read_demonstrations(None),
        "paths is None; its type must be str or PathLike or Iterable",
    ),
    "read numbers": (
        lambda: read_demonstrations([1]),
        r"paths\[0\] is 1; its type must",
    ),
    "rotations of a path": (
        lambda: skill_rotations("a.npz", [0, 0, 0]),
        "skill_rotations.* needs a fitted skill.* it is 'a.npz'",
    ),
    "spectrum of a path": (lambda: skill_spectrum("a"), r"skill_spectrum\(skill\) n"),
    "modulated path": (
        lambda: modulate_skill("a", harmonics=[1], gain=1),
        r"modulate_skill\(skill\)",
    ),
    "no skill file": (lambda: load_skill("/nowhere.npz"), "there is no skill file"),
    "rhythm of an array": (lambda: find_rhythm(CIRCLES), "find_rhythm needs a Demo"),
    "rhythm of nothing": (lambda: find_rhythm([]), "there is no demonstration"),
    "rhythm of other channels": (
        lambda: find_rhythm([recording(), recording(values=CIRCLES[:, :2])]),
        r"demonstration 2 has the channels x, y; the first has x, y, z",
    ),
    "learned arrays": (lambda: learn_skill([CIRCLES]), "learn_skill needs a Demo"),
    "learned nothing": (lambda: learn_skill([]), "there is no demonstration"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_use_is_refused_with_what_would_be_right(wrong):
    use, message = WRONG[wrong]
    with pytest.raises(FmpError, match=message):
        use()


@pytest.mark.parametrize("use", [Player, lambda skill: save_skill(skill, "a.npz")])
def test_a_skill_is_learned_before_it_is_used(use):
    with pytest.raises(NotFittedError, match="Call 'fit'"):
        use(NOT_FITTED)


# Windows of 6 s take three times as long to learn.
QUICK = {"window": 2.0}


@pytest.fixture(scope="module")
def period():
    return fit(CIRCLES, rate=20, **QUICK).period_


@pytest.mark.parametrize(
    "given",
    [
        CIRCLES.tolist(),
        CIRCLES.astype(np.float32),
        np.asfortranarray(CIRCLES),
        np.repeat(CIRCLES, 2, axis=0)[::2],
        np.frombuffer(CIRCLES.tobytes()).reshape(CIRCLES.shape),  # Read-only.
    ],
    ids=["lists", "float32", "Fortran", "strided", "read-only"],
)
def test_arrays_of_any_layout_give_the_same_skill(given, period):
    assert fit(given, rate=20, **QUICK).period_ == pytest.approx(period, abs=1e-5)


def test_dates_are_seconds_from_the_first():
    dates = np.datetime64("2024-03-31T23:59:58", "ns") + np.round(1e9 * TIME).astype(
        "timedelta64[ns]"
    )
    assert_allclose(recording(time=dates).time, TIME, atol=1e-9)


def test_one_path_is_read_like_a_list_of_it(tmp_path):
    recording().save(tmp_path / "d.npz")
    for paths in (str(tmp_path / "d.npz"), tmp_path / "d.npz", [tmp_path / "d.npz"]):
        (found,), _ = read_demonstrations(paths)
        assert_allclose(found.values, CIRCLES)


def test_objects_describe_their_content():
    skill = fit(recording(), **QUICK)
    assert repr(recording()) == (
        "<Demonstration: x (m), y (m), z (m); 400 samples in 19.95 s>"
    )
    assert repr(skill).startswith("<FourierMovementPrimitive: phase model of 9 cycles")
    assert repr(Player(skill)) == f"Player({skill!r})"


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))]
)
def test_copies_play_the_same_movement(copied):
    skill = learn_skill(recording(), **QUICK)
    start = CIRCLES[0]
    expected = Player(skill).rollout(start, 2.0)
    assert np.array_equal(Player(copied(skill)).rollout(start, 2.0), expected)
    assert np.array_equal(copied(recording()).values, CIRCLES)
    assert clone(skill).get_params() == skill.get_params()
