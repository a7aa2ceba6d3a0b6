"""Facts about the estimator."""

import pickle
import re
from dataclasses import replace

import dense_paper
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score

from fmp_drake.errors import DemonstrationError, SkillError
from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.model.low_rank_gaussian import LowRankGaussian

PARAMETERS = {
    "model": "automatic",
    "n_steps": None,
    "stride": None,
    "rate": 20.0,
    "n_components": "automatic",
    "overlap": None,
    "window": None,
    "explained_variance": 0.9999,
    "regularization": 1e-8,
    "tolerance": 1e-8,
    "random_state": 0,
    "shrinkage": 5.0,
    "scales": "units",
}


def tiny(**changes):
    """Return an estimator of short windows."""
    options = {"n_steps": 8, "overlap": 2, "stride": 1, "n_components": 1}
    return FourierMovementPrimitive(**{**options, **changes})


def windows(count, t=8, d=2, seed=0):
    return np.random.default_rng(seed).standard_normal((count, t, d))


# Parameters -------------------------------------------------------------


def test_defaults_are_those_that_generalise():
    assert FourierMovementPrimitive().get_params() == PARAMETERS


@pytest.mark.parametrize(("n_steps", "stride"), [(120, 2), (1200, 20), (24, 1)])
def test_default_stride_is_a_sixtieth_of_a_window(n_steps, stride):
    assert FourierMovementPrimitive(n_steps=n_steps).window_stride == stride
    assert FourierMovementPrimitive(n_steps=n_steps, stride=7).window_stride == 7


@pytest.mark.parametrize(
    ("seconds", "count"), [(8.0, 5), (20.0, 20), (40.0, 48), (90.0, 80)]
)
def test_a_mixture_has_a_component_for_seven_windows(seconds, count):
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.standard_normal((round(20 * seconds), 2)), axis=0)
    skill = FourierMovementPrimitive(model="mixture", rate=20).fit(values)
    assert len(skill.components_) == count


def test_few_components_predict_a_short_recording_better(polishing_demonstration):
    values = polishing_demonstration.resample(20).values
    learned, unseen = values[:400], values[400:1600]
    likelihood = [
        FourierMovementPrimitive(model="mixture", rate=20, **settings)
        .fit(learned)
        .score(unseen)
        for settings in ({}, {"n_components": 80})
    ]
    assert likelihood[0] > likelihood[1] + 2


def test_parameters_are_set_read_and_cloned():
    skill = FourierMovementPrimitive().set_params(n_steps=60, overlap=5)
    copy = clone(skill)
    assert copy is not skill
    assert copy.get_params() == {**PARAMETERS, "n_steps": 60, "overlap": 5}
    assert copy.basis.n_steps == 60


def test_clone_is_not_fitted(small_skill):
    with pytest.raises(NotFittedError):
        clone(small_skill).check_fitted()


@pytest.mark.parametrize("model", ["mixture", "automatic"])
def test_a_failed_fit_changes_nothing(model):
    time = np.arange(800) / 20
    circle = 0.1 * np.column_stack([np.cos(2 * time), np.sin(2 * time)])
    skill = FourierMovementPrimitive(rate=20.0, model=model, n_components=5)
    skill.fit(circle)
    before = skill.predict(circle[:100], 5).values
    with pytest.raises(DemonstrationError):
        skill.fit(100 * circle[:20, :1])
    assert np.array_equal(skill.predict(circle[:100], 5).values, before)


def test_constructor_only_stores():
    assert FourierMovementPrimitive(n_steps=-3).n_steps == -3


def test_basis_follows_n_steps():
    skill = tiny()
    assert skill.basis is skill.basis
    assert skill.basis.n_steps == 8
    assert skill.set_params(n_steps=9).basis.n_steps == 9


def test_copies_by_pickle_play_the_same(small_skill):
    copy = pickle.loads(pickle.dumps(small_skill))
    assert np.array_equal(copy.sample(2, seed=1), small_skill.sample(2, seed=1))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("n_steps", 7),
        ("n_steps", 8.5),
        ("stride", 0),
        ("stride", 1.5),
        ("rate", 0.0),
        ("rate", 1e9),
        ("rate", np.inf),
        ("rate", np.nan),
        ("n_components", 0),
        ("n_components", 2.0),
        ("n_components", "aic"),
        ("overlap", 1),
        ("overlap", 5),
        ("overlap", "3"),
        ("explained_variance", 0.0),
        ("explained_variance", 1.01),
        ("explained_variance", None),
        ("regularization", 0.0),
        ("regularization", np.nan),
        ("shrinkage", -1.0),
        ("shrinkage", np.inf),
        ("tolerance", 0.0),
        ("tolerance", np.inf),
        ("random_state", -1),
        ("random_state", None),
    ],
)
def test_parameters_that_cannot_be_used_are_named(name, value):
    with pytest.raises(SkillError, match=rf"{name} is {value!r}.*; it must be"):
        tiny(**{name: value}).fit(windows(9))


@pytest.mark.parametrize(
    "use",
    [
        lambda s: s.sample(),
        lambda s: s.score(windows(2)),
        lambda s: s.score_samples(windows(2)),
        lambda s: s.map_partial(np.zeros((2, 2))),
        lambda s: s.observation_rows([0]),
    ],
)
def test_use_before_fit_is_refused(use):
    with pytest.raises(NotFittedError):
        use(tiny())


# Learning ---------------------------------------------------------------


def test_fit_describes_the_demonstrations(wiping_skill, wiping_demonstration):
    skill = wiping_skill
    assert skill.n_channels_ == 3
    assert skill.n_windows_ == (1800 - 120) // 2 + 1
    assert skill.channels_ == ("x", "y", "z")
    assert skill.units_ == ("m", "m", "m")
    assert skill.frame_ == "board"
    assert len(skill.components_) == 80
    assert np.all(np.diff(skill.proportions_) <= 0)
    assert skill.proportions_.sum() == pytest.approx(1)
    low = wiping_demonstration.values.min(axis=0)
    high = wiping_demonstration.values.max(axis=0)
    assert_allclose(skill.extent_, [low, high], atol=2e-3)


def test_fit_repeats(small_skill, polishing_demonstration):
    again = clone(small_skill).fit(polishing_demonstration)
    for one, two in zip(small_skill.components_, again.components_, strict=True):
        assert np.array_equal(one.mean, two.mean)
        assert np.array_equal(one.variances, two.variances)


def test_fit_leaves_the_windows_alone():
    x = windows(9)
    before = x.copy()
    tiny().fit(x)
    assert np.array_equal(x, before)
    assert x.flags.writeable


@pytest.mark.parametrize("count", [2, 3, 5])
def test_few_windows_are_enough(count):
    skill = tiny(n_components=10).fit(windows(count))
    assert len(skill.components_) == max(1, count // 2)
    assert np.all(np.isfinite(skill.sample(3)))


def test_one_window_is_too_few():
    with pytest.raises(DemonstrationError, match="1 windows; at least 2"):
        tiny().fit(windows(1))


def test_constant_channels_stay_constant():
    x = windows(20, d=3)
    x[..., 1] = 0.25
    skill = tiny(n_components=3).fit(x)
    assert_allclose(skill.sample(5, with_noise=False)[..., 1], 0.25, atol=1e-9)
    assert np.all(np.isfinite(skill.score_samples(x)))


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_a_robot_that_stands_still_is_a_skill(value):
    still = Demonstration(time=np.arange(60) / 20, values=np.full((60, 3), value))
    skill = tiny(n_components=4).fit(still)
    assert_allclose(skill.sample(3, with_noise=False), value, atol=1e-9)
    mapped = skill.map_partial(np.full((2, 3), value))
    assert_allclose(skill.basis.synthesize(mapped.weights), value, atol=1e-9)


def test_several_demonstrations_of_different_lengths(make_demonstration):
    demonstrations = [
        make_demonstration("eight", seconds=seconds, seed=i)
        for i, seconds in enumerate((13.0, 4.0, 8.5))
    ]
    skill = FourierMovementPrimitive(n_steps=60, overlap=6, stride=5, n_components=4)
    skill.fit(demonstrations)
    lengths = [len(d.resample(20).time) for d in demonstrations]
    assert skill.n_windows_ == sum((n - 60) // 5 + 1 for n in lengths)
    # One of them is the same as a list of one.
    one = clone(skill).fit(demonstrations[0])
    other = clone(skill).fit([demonstrations[0]])
    assert np.array_equal(one.components_[0].mean, other.components_[0].mean)


def test_windows_and_demonstrations_teach_the_same(polishing_demonstration):
    skill = tiny(rate=40.0, n_components=2, stride=8)
    y = polishing_demonstration.values
    cut = np.stack([y[i : i + 8] for i in range(0, len(y) - 7, 8)])
    one, two = clone(skill).fit(polishing_demonstration), clone(skill).fit(cut)
    assert np.array_equal(one.components_[1].mean, two.components_[1].mean)


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (np.zeros((2, 5, 8, 1)), r"shape \(2, 5, 8, 1\); expected \(windows, 8"),
        (np.zeros((5, 8)), r"no windows of 0\.4 s .* Record at least 0\.4 s"),
        (np.zeros((5, 9, 2)), "windows, 8, channels"),
        (np.zeros((5, 8, 0)), "expected .windows, 8, channels"),
        (np.full((5, 8, 2), np.nan), "NaN or infinite numbers in the windows"),
        ([], "at least one"),
        ("demonstration.npz", "needs a Demonstration, or a list of them"),
        ([1, "two"], "give a Demonstration, or a list of them"),
        (None, "needs a Demonstration, .* it is None"),
    ],
)
def test_unusable_training_data_are_refused(x, message):
    with pytest.raises(DemonstrationError, match=message):
        tiny(rate=20.0).fit(x)


@pytest.mark.parametrize("x", [np.zeros((90, 2)), [np.zeros(90)]])
def test_array_without_a_stated_rate_is_refused(x):
    for skill in (tiny(), clone(tiny())):
        with pytest.raises(
            DemonstrationError,
            match=r"no times.*time=time.* its sample rate.*\(rate=50\)",
        ):
            skill.fit(x)


@pytest.mark.parametrize(
    ("options", "samples", "overlap"),
    [
        ({}, 120, 10),
        ({"window": 6.0}, 120, 10),
        ({"rate": 50}, 300, 25),
        ({"rate": np.int64(50)}, 300, 25),
        ({"rate": 5}, 120, 10),
        ({"window": 6.0, "rate": 50}, 300, 25),
        ({"window": 6.0, "rate": 50, "overlap": 8}, 300, 8),
        ({"window": 1.0}, 20, 5),
    ],
)
def test_window_is_given_in_seconds(options, samples, overlap):
    skill = FourierMovementPrimitive(**options)
    assert (skill.n_steps, skill.overlap) == (samples, overlap)
    assert skill.window == samples / skill.rate
    assert clone(skill).get_params() == skill.get_params()


@pytest.mark.parametrize("options", [{}, {"window": 6.0}])
def test_another_rate_changes_the_samples_of_window_and_overlap(options):
    skill = FourierMovementPrimitive(**options).set_params(rate=50.0)
    assert (skill.n_steps, skill.overlap, skill.window) == (300, 25, 6.0)
    assert skill.set_params(overlap=8).overlap == 8


def test_a_fitted_skill_keeps_its_samples_until_it_is_learned_again():
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.standard_normal((400, 2)), axis=0)
    skill = FourierMovementPrimitive(model="mixture", window=2.0, rate=20.0).fit(values)
    skill.set_params(rate=10.0)
    assert (skill.n_steps, skill.overlap) == (40, 10)
    skill.fit(values)
    assert (skill.n_steps, skill.overlap) == (20, 5)


@pytest.mark.parametrize("model", ["phase", "mixture"])
def test_window_and_overlap_last_as_long_at_another_rate(
    polishing_demonstration, model
):
    slow, fast = (
        FourierMovementPrimitive(model=model, n_components=30, rate=rate).fit(
            polishing_demonstration.resample(rate).values
        )
        for rate in (20.0, 50.0)
    )
    assert fast.window == pytest.approx(slow.window, rel=0.05)
    assert fast.overlap / fast.rate == slow.overlap / slow.rate == 0.5


@pytest.mark.parametrize("window", [0.0, -1.0, np.nan, "long", 0.1])
def test_window_without_samples_is_refused(window):
    with pytest.raises(SkillError, match="window is"):
        FourierMovementPrimitive(window=window)


def test_fitted_skill_describes_itself(polishing_demonstration):
    assert repr(tiny()).startswith("FourierMovementPrimitive(")
    mixture = tiny(n_components=2).fit(polishing_demonstration)
    assert "mixture of 2 components; x (m), y (m)" in repr(mixture)
    phase = FourierMovementPrimitive(model="phase").fit(polishing_demonstration)
    assert re.search(r"phase model of \d+ cycles of \d\.\d\d s; x", repr(phase))
    assert "windows of 6 s at 20 Hz" in repr(phase)


def test_arrays_are_recordings_at_the_rate_of_the_skill(polishing_demonstration):
    y = polishing_demonstration.resample(20).values
    time = np.arange(len(y)) / 20
    whole = tiny().fit(Demonstration(time=time, values=y))
    halves = tiny().fit(
        [Demonstration(time=time[:300], values=part) for part in (y[:300], y[300:600])]
    )
    one = tiny().fit(Demonstration(time=time, values=y[:, 0]))
    for expected, x in (
        (whole, y),
        (whole, y.tolist()),
        (halves, [y[:300], y[300:600]]),
        (one, y[:, 0]),
    ):
        skill = tiny(rate=20).fit(x)
        assert np.array_equal(skill.components_[0].mean, expected.components_[0].mean)
        assert skill.paths_
    assert whole.score(y) == whole.score(Demonstration(time=time, values=y))


def test_a_demonstration_is_scored_by_its_channels_and_not_by_their_order(
    polishing_demonstration,
):
    skill = tiny().fit(polishing_demonstration)
    backwards = polishing_demonstration.select(polishing_demonstration.channels[::-1])
    expected = skill.score_samples(polishing_demonstration)
    assert np.array_equal(skill.score_samples(backwards), expected)
    assert np.array_equal(skill.score_samples([backwards]), expected)
    for wrong, match in (
        ({"units": ("mm",) * len(skill.channels_)}, "units mm, mm.*the skill has m, m"),
        ({"channels": tuple("abc"[: len(skill.channels_)])}, "channels a, b"),
    ):
        with pytest.raises(DemonstrationError, match=match):
            skill.score(replace(polishing_demonstration, **wrong))


def test_error_of_a_short_demonstration_states_the_least_length():
    short = Demonstration(time=np.arange(8) / 20, values=np.zeros((8, 3)))
    with pytest.raises(DemonstrationError, match=r"Record at least 0\.4 s"):
        tiny().fit(short)


def test_error_of_a_short_demonstration_suggests_a_shorter_window():
    time = np.arange(0, 3, 0.05)
    short = Demonstration(time=time, values=np.sin(3 * time))
    with pytest.raises(DemonstrationError, match="shorter windows, of") as refusal:
        FourierMovementPrimitive(n_components=1, window=6.0).fit(short)
    window = float(re.search(r"of ([\d.]+) s for", str(refusal.value))[1])
    assert window > 1.5
    FourierMovementPrimitive(n_components=1, window=window).fit(short)


def test_one_component_has_the_sample_covariance_of_the_samples():
    x = windows(40)
    skill = tiny(explained_variance=1.0, regularization=1e-4).fit(x)
    (g,) = skill.components_
    phi = skill.basis.synthesize(np.eye(16))  # (weight, T, D)
    phi = phi.reshape(16, 16).T
    flat = x.reshape(40, 16)
    assert_allclose(phi @ g.mean, flat.mean(axis=0), atol=1e-12)
    expected = np.cov(flat.T, bias=True) + 1e-4 * np.eye(16)
    assert_allclose(phi @ dense_paper.dense(g) @ phi.T, expected, atol=1e-8)


def test_log_likelihood_is_that_of_the_normal_distribution_of_the_samples():
    x, held_out = windows(40), windows(7, seed=1)
    skill = tiny(explained_variance=1.0, regularization=1e-2).fit(x)
    flat = x.reshape(40, 16)
    normal = multivariate_normal(
        flat.mean(axis=0), np.cov(flat.T, bias=True) + 1e-2 * np.eye(16)
    )
    expected = normal.logpdf(held_out.reshape(7, 16))
    assert_allclose(skill.score_samples(held_out), expected, rtol=1e-6)
    assert skill.score(held_out) == pytest.approx(expected.mean() / 8)
    assert_allclose(skill.score_samples(held_out[:1]), expected[:1], rtol=1e-6)


def test_log_likelihood_of_a_mixture_is_the_weighted_sum():
    x = np.concatenate([windows(30), windows(50, seed=1) + 4])
    skill = tiny(n_components=2, explained_variance=1.0, regularization=1e-2).fit(x)
    density = sum(
        p
        * multivariate_normal(c.mean, dense_paper.dense(c)).pdf(skill.basis.analyze(x))
        for p, c in zip(skill.proportions_, skill.components_, strict=True)
    )
    assert_allclose(skill.score_samples(x), np.log(density), rtol=1e-6)


def test_score_accepts_demonstrations(small_skill, make_demonstration):
    held_out = make_demonstration("polishing", seconds=20, seed=9).select(["x", "y"])
    other = make_demonstration("eight", seconds=20, seed=9).select(["x", "y"])
    assert small_skill.score(held_out) > small_skill.score(other)


# Sampling and observing ---------------------------------------------------


def test_samples_have_the_moments_of_the_mixture():
    x = windows(300) @ np.array([[1.0, 0.5], [0.0, 1.0]])
    skill = tiny(explained_variance=1.0).fit(x)
    y = skill.sample(20_000, seed=3)
    assert y.shape == (20_000, 8, 2)
    assert_allclose(y.mean(axis=0), x.mean(axis=0), atol=0.05)
    expected = np.cov(x.reshape(300, -1).T)
    assert_allclose(np.cov(y.reshape(20_000, -1).T), expected, atol=0.07)


def test_samples_come_from_components_by_proportion():
    x = np.concatenate([windows(30), windows(90, seed=1) + 40])
    y = tiny(n_components=2).fit(x).sample(4000, seed=0)
    assert np.mean(y.mean(axis=(1, 2)) > 20) == pytest.approx(0.75, abs=0.03)
    # And not one component after the other.
    far = y.mean(axis=(1, 2)) > 20
    assert np.mean(far[:2000]) == pytest.approx(0.75, abs=0.05)


def test_samples_repeat_with_the_seed(small_skill):
    assert np.array_equal(small_skill.sample(3, seed=1), small_skill.sample(3, seed=1))
    assert not np.array_equal(small_skill.sample(seed=1), small_skill.sample(seed=2))
    assert small_skill.sample(0).shape == (0, 24, 2)


def test_samples_without_noise_are_smooth(small_skill):
    rough = np.diff(small_skill.sample(50, seed=0), n=4, axis=1)
    smooth = np.diff(small_skill.sample(50, seed=0, with_noise=False), n=4, axis=1)
    assert np.std(smooth) < np.std(rough)


@pytest.mark.parametrize("fixture", ["small_skill", "odd_skill"])
def test_observation_rows_are_the_block_diagonal_20(fixture, request):
    skill = request.getfixturevalue(fixture)
    y = skill.sample(1, seed=0)[0]
    w = skill.basis.analyze(y)
    steps = [0, 5, skill.n_steps - 1]
    rows = skill.observation_rows(steps)
    assert_allclose((rows @ w).reshape(3, 2), y[steps], atol=1e-12)
    # The paper stacks channel by channel, these rows step by step.
    paper = dense_paper.phi_of(steps, skill.n_steps, 2) @ skill.basis.to_paper(w)
    assert_allclose((rows @ w).reshape(3, 2).T.ravel(), paper, atol=1e-12)


def test_derivatives_of_observation_rows_are_per_second(small_skill):
    w = small_skill.basis.analyze(small_skill.sample(1, with_noise=False)[0])
    h = 1e-4  # samples
    slope = (
        (small_skill.observation_rows(5 + h) - small_skill.observation_rows(5 - h))
        @ w
        / (2 * h / small_skill.rate)
    )
    assert_allclose(small_skill.observation_rows(5, derivative=1) @ w, slope, atol=1e-6)


def test_covariance_between_samples_is_that_of_the_rows(small_skill):
    for step in (0.0, 3.4, 23.0):
        rows = small_skill.observation_rows(step)
        for j, component in enumerate(small_skill.components_):
            expected = rows @ dense_paper.dense(component) @ rows.T
            assert_allclose(small_skill.covariance(j, step), expected, rtol=1e-9)


def test_map_partial_is_the_plan(small_skill):
    y = small_skill.sample(1, seed=5)[0][:4]
    plan = small_skill.mapping_plan(np.arange(4)).map(y.ravel())
    mapping = small_skill.map_partial(y)
    assert np.array_equal(mapping.weights, plan.weights)
    assert mapping.component == plan.component
    assert mapping.costs.shape == (3,)


def test_whole_window_maps_to_itself(small_skill):
    y = small_skill.sample(1, seed=5, with_noise=False)[0]
    mapped = small_skill.basis.synthesize(small_skill.map_partial(y).weights)
    assert_allclose(mapped, y, atol=1e-4)


@pytest.mark.parametrize(
    ("shape", "first"),
    [((0, 2), 0), ((25, 2), 0), ((4, 3), 0), ((4,), 0), ((5, 2), 20), ((1, 2), 24)],
)
def test_partial_trajectories_that_do_not_fit_are_refused(small_skill, shape, first):
    with pytest.raises(SkillError, match=r"trajectory|first_step is 24"):
        small_skill.map_partial(np.zeros(shape), first_step=first)


def test_partial_trajectories_before_the_window_are_refused(small_skill):
    with pytest.raises(SkillError, match="first_step is -1"):
        small_skill.map_partial(np.zeros((3, 2)), first_step=-1)


def test_partial_trajectories_that_are_not_finite_are_refused(small_skill):
    with pytest.raises(SkillError, match="NaN or infinite"):
        small_skill.map_partial([[0.0, np.nan]])


def test_components_are_low_rank(wiping_skill, wiping_mixture):
    for skill, most in ((wiping_mixture, 40), (wiping_skill, 160)):
        for component in skill.components_:
            assert isinstance(component, LowRankGaussian)
            assert component.dim == 360
            assert component.rank <= most


def test_skill_is_learned_from_real_demonstrations(real_demonstration_paths):
    wiping = [
        Demonstration.load(path)
        for name, path in real_demonstration_paths.items()
        if name.startswith("panda_wiping")
    ]
    assert len(wiping) >= 2
    skill = FourierMovementPrimitive(
        n_steps=40, overlap=5, stride=4, n_components=5
    ).fit(wiping)
    assert skill.n_channels_ == 3
    y = skill.sample(20, seed=0, with_noise=False)
    span = np.ptp(skill.extent_, axis=0)
    assert np.all(y > skill.extent_[0] - span)
    assert np.all(y < skill.extent_[1] + span)


# As an estimator of scikit-learn ------------------------------------------------


def arcs(count=60, t=16, seed=0):
    """Return windows of an arc whose size and phase vary: two channels."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 4, t)
    size, phase = rng.uniform(0.8, 1.2, count), rng.uniform(0, 2 * np.pi, count)
    angle = s + phase[:, None]
    path = np.stack([np.sin(angle), np.cos(angle)], axis=-1) * size[:, None, None]
    return path + 0.01 * rng.standard_normal(path.shape)


def arc_learner(**changes):
    options = {"n_steps": 16, "overlap": 2, "n_components": 3, "shrinkage": 0.0}
    return FourierMovementPrimitive(**{**options, **changes})


def test_score_is_the_held_out_log_likelihood_per_time_step():
    skill = arc_learner().fit(arcs())
    held_out = arcs(seed=1)
    expected = skill.score_samples(held_out).mean() / 16
    assert skill.score(held_out) == pytest.approx(expected, rel=1e-12)


def test_cross_validation_scores_windows_that_were_left_out():
    x, folds = arcs(), KFold(3)
    scores = cross_val_score(arc_learner(), x, cv=folds)
    expected = [
        arc_learner().fit(x[train]).score(x[test]) for train, test in folds.split(x)
    ]
    assert_allclose(scores, expected, rtol=1e-9)


def test_grid_search_chooses_the_greatest_held_out_score():
    grid = {"n_components": [1, 4, 10], "regularization": [1e-6, 1e-4, 1.0]}
    search = GridSearchCV(arc_learner(shrinkage=3.0), grid, cv=3).fit(arcs())
    scores = search.cv_results_["mean_test_score"]
    assert np.all(np.isfinite(scores))
    assert search.best_score_ == scores.max()
    # One Gaussian cannot follow a circle, and 1 m^2 of noise hides it.
    assert search.best_params_["n_components"] > 1
    assert search.best_params_["regularization"] < 1.0
    best = search.best_estimator_
    assert best.get_params()["n_components"] == search.best_params_["n_components"]
    assert search.score(arcs(seed=1)) == pytest.approx(best.score(arcs(seed=1)))


def test_clone_of_a_fitted_skill_learns_the_same():
    x = arcs()
    one = arc_learner(regularization=1e-5, shrinkage=2.0).fit(x)
    two = clone(one).fit(x)
    assert two.get_params() == one.get_params()
    assert two.score(x) == one.score(x)


def test_fit_ignores_targets_and_returns_itself():
    skill = arc_learner()
    assert skill.fit(arcs(), np.zeros(60)) is skill


# How much demonstrations count --------------------------------------------------


def test_demonstration_of_no_weight_is_left_out(make_demonstration):
    demonstrations = [
        make_demonstration(task, seconds=20, seed=i)
        for i, task in enumerate(("eight", "wiping", "eight"))
    ]
    skill = FourierMovementPrimitive(
        n_steps=40, overlap=4, stride=4, n_components=4, explained_variance=1.0
    )
    without = clone(skill).fit([demonstrations[0], demonstrations[2]])
    zero = clone(skill).fit(demonstrations, weights=[2.0, 0.0, 2.0])
    assert zero.n_windows_ == without.n_windows_
    assert np.array_equal(zero.extent_, without.extent_)
    held_out = make_demonstration("eight", seconds=20, seed=9)
    assert zero.score(held_out) == pytest.approx(without.score(held_out), rel=1e-6)


def test_window_of_no_weight_is_left_out():
    x = arcs()
    weights = np.ones(60)
    weights[40:] = 0.0
    x[40:] += 100.0
    zero = arc_learner().fit(x, weights=weights)
    without = arc_learner().fit(x[:40])
    held_out = arcs(seed=1)
    assert zero.score(held_out) == pytest.approx(without.score(held_out), rel=1e-6)
    assert np.array_equal(zero.extent_, without.extent_)


def test_weight_of_a_window_equals_its_repetition():
    x = arcs(20)
    times = np.random.default_rng(0).integers(1, 4, 20)
    one = arc_learner(n_components=1).fit(x, weights=times)
    two = arc_learner(n_components=1).fit(np.repeat(x, times, axis=0))
    held_out = arcs(seed=1)
    assert_allclose(one.score_samples(held_out), two.score_samples(held_out), rtol=1e-6)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ([1.0], "expected .60,"),
        (np.full(60, -1.0), "none may be negative"),
        (np.full(60, np.nan), "NaN or infinite"),
        (np.zeros(60), "leave 0 windows; at least 2"),
        (np.eye(60)[0], "leave 1 windows; at least 2"),
        ("heavy", "'heavy' cannot be read as real numbers"),
    ],
)
def test_weights_that_do_not_fit_are_refused(weights, message):
    with pytest.raises(DemonstrationError, match=message):
        arc_learner().fit(arcs(), weights=weights)


def test_progress_is_reported_in_sentences():
    said = []
    arc_learner().fit(arcs(), progress=said.append)
    assert said[0] == "principal directions of 60 windows of 32 weights"
    assert all("mean log-likelihood" in line for line in said[1:])
    assert len(said) > 2


@pytest.mark.parametrize("t", [15, 16])
@pytest.mark.parametrize("constant", [0, 1])
def test_constant_channel_beside_one_that_moves(t, constant):
    x = arcs(t=t)
    x[..., constant] = 0.7
    skill = arc_learner(n_steps=t).fit(x)
    y = skill.sample(20, with_noise=False)
    assert_allclose(y[..., constant], 0.7, atol=1e-9)
    mapped = skill.map_partial(x[0][:3])
    assert_allclose(skill.synthesize(mapped.weights)[:, constant], 0.7, atol=1e-4)


@pytest.mark.parametrize("n_components", [1, 10, "automatic"])
def test_two_windows_are_a_skill(n_components):
    x = arcs(2)
    skill = arc_learner(n_components=n_components).fit(x)
    assert len(skill.components_) == 1
    assert_allclose(skill.synthesize(skill.components_[0].mean), x.mean(axis=0))
    for window in x:
        w = skill.map_partial(window).weights
        assert_allclose(skill.synthesize(w), window, atol=1e-3)


@pytest.mark.parametrize("component", [-1, 3, 0.0, None])
def test_covariance_of_no_component_is_refused(small_skill, component):
    with pytest.raises(SkillError, match=r"component is .* at least 0 and at most 2"):
        small_skill.covariance(component, 3.0)


@pytest.mark.parametrize("step", [-0.1, 23.5, np.nan, "end"])
def test_covariance_outside_the_window_is_refused(small_skill, step):
    with pytest.raises(SkillError, match="at least 0 and at most 23"):
        small_skill.covariance(0, step)


def test_invalid_observations_are_refused(small_skill):
    with pytest.raises(SkillError, match="all channels are observed"):
        small_skill.infer(np.zeros((5, 2)), [0, 1])
    with pytest.raises(SkillError, match=r"3 samples were observed; .* the last 4"):
        small_skill.predict(np.zeros((3, 2)), 6)


def test_recordings_as_long_as_a_window_are_recordings():
    t = np.arange(600) / 20
    circles = np.column_stack([np.cos(3 * t), np.sin(3 * t)])
    recordings = [circles[i : i + 120] for i in (0, 150, 300)]
    assert len(FourierMovementPrimitive(rate=20).fit(recordings).paths_) == 3


def test_a_short_window_is_remarked():
    t = np.arange(600) / 20
    circles = np.column_stack([np.cos(3 * t), np.sin(3 * t)])
    reasons = [
        FourierMovementPrimitive(rate=20, window=w).fit(circles).model_reason_
        for w in (1.0, 2.5)
    ]
    assert "windows shorter than 1.2 s are played with high accelerations" in reasons[0]
    assert "shorter" not in reasons[1]
