"""Facts about channels of different units in one skill."""

import numpy as np
import pytest
from dense_paper import dense
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal
from sklearn.base import clone

from fmp_drake.errors import SkillError
from fmp_drake.primitives import (
    Demonstration,
    FourierMovementPrimitive,
    Keypoint,
    Player,
    load_skill,
    save_skill,
)
from fmp_drake.primitives.data.channels import channel_scales

CHANNELS = ("x", "y", "fz", "yaw")
UNITS = ("m", "m", "N", "rad")


def stroking(force_unit=1.0, seconds=40.0, seed=0):
    """Return 20 Hz of a stroke with a force and an angle; the force in units of N."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * 20)) / 20
    slow = np.arange(0, seconds + 2, 2.0)
    pace = np.interp(time, slow, rng.uniform(0.8, 1.2, len(slow)))
    size = np.interp(time, slow, rng.uniform(0.8, 1.2, len(slow)))
    phase = np.cumsum(pace) / 20 * 2 * np.pi / 1.5
    values = np.column_stack(
        [
            0.1 * size * np.sin(phase),
            0.03 * np.cos(phase),
            (15 + 4 * size * np.cos(phase)) / force_unit,
            0.4 * np.sin(phase + 0.5),
        ]
    )
    units = ("m", "m", "N" if force_unit == 1 else "kN", "rad")
    return Demonstration(time=time, values=values, channels=CHANNELS, units=units)


def learner(**changes):
    options = {
        "n_steps": 40,
        "overlap": 5,
        "stride": 4,
        "n_components": 4,
        "shrinkage": 0.0,
    }
    return FourierMovementPrimitive(**{**options, **changes})


@pytest.fixture(scope="module")
def newtons():
    return learner().fit(stroking())


@pytest.fixture(scope="module")
def kilonewtons():
    return learner().fit(stroking(force_unit=1000.0))


# The scales themselves --------------------------------------------------------


def test_channels_of_one_unit_keep_it():
    values = np.random.default_rng(0).standard_normal((50, 3)) * [1.0, 5.0, 0.0]
    assert_allclose(channel_scales("units", values, ("m", "m", "m")), 1.0)


def test_channels_of_a_unit_share_its_standard_deviation():
    values = np.random.default_rng(0).standard_normal((500, 6, 3)) * [1.0, 5.0, 40.0]
    scales = channel_scales("units", values, ("m", "m", "N"))
    flat = values.reshape(-1, 3)
    assert scales[0] == scales[1] == pytest.approx(np.sqrt(flat.var(axis=0)[:2].mean()))
    assert scales[2] == pytest.approx(flat[:, 2].std())


def test_channels_that_never_change_are_not_scaled():
    values = np.column_stack([np.arange(9.0), np.full(9, 3.0)])
    assert channel_scales("units", values, ("m", "N"))[1] == 1.0


def test_scales_may_be_given_and_are_copied():
    given = np.array([1.0, 2.0])
    scales = channel_scales(given, np.zeros((3, 2)), ("m", "m"))
    assert np.array_equal(scales, given)
    assert scales is not given


@pytest.mark.parametrize(
    "scales", [[1.0], [1.0, 0.0], [1.0, -1.0], [1.0, np.nan], [1.0, np.inf], 3.0]
)
def test_scales_that_do_not_fit_are_refused(scales):
    with pytest.raises(SkillError, match="scales"):
        learner(scales=scales).fit(np.random.default_rng(0).random((9, 40, 2)))


@pytest.mark.parametrize("scales", ["metres", ["a", "b"], None, [[1.0, 2.0], [3.0]]])
def test_scales_without_numbers_are_refused(scales):
    with pytest.raises(SkillError, match="scales"):
        learner(scales=scales).fit(np.random.default_rng(0).random((9, 40, 2)))


# Units do not matter ------------------------------------------------------------


def test_mixture_does_not_depend_on_the_unit_of_a_force(newtons, kilonewtons):
    assert_allclose(kilonewtons.proportions_, newtons.proportions_, rtol=1e-9)
    for one, two in zip(newtons.components_, kilonewtons.components_, strict=True):
        assert_allclose(two.mean, one.mean, rtol=1e-7, atol=1e-9)
        assert_allclose(two.variances, one.variances, rtol=1e-6)
        assert two.noise == pytest.approx(one.noise)
    assert_allclose(kilonewtons.scales_ * [1, 1, 1000, 1], newtons.scales_)


def test_log_likelihood_only_changes_by_the_unit(newtons, kilonewtons):
    held_out = stroking(seed=1), stroking(force_unit=1000.0, seed=1)
    one, two = newtons.score(held_out[0]), kilonewtons.score(held_out[1])
    # A density per kN is 1000 times that per N, at every time step.
    assert two == pytest.approx(one + np.log(1000.0), abs=1e-6)


@pytest.mark.parametrize("of", ["samples", "mapping", "play", "covariance"])
def test_everything_comes_back_in_the_channels_units(newtons, kilonewtons, of):
    def result(skill, k):
        start = np.array([0.05, 0.0, 17.0, 0.1]) * k
        if of == "samples":
            return skill.sample(3, seed=1)
        if of == "mapping":
            point = Keypoint(step=7.5, values=[17.0 * k[2]], channels=["fz"])
            return skill.synthesize(skill.map_keypoints([point]).weights)
        if of == "play":
            return Player(skill).rollout(start, 5.0)
        return skill.covariance(1, 12.3)

    one = result(newtons, np.ones(4))
    unit = np.array([1, 1, 1e-3, 1])
    two = result(kilonewtons, unit)
    if of == "covariance":
        unit = np.outer(unit, unit)
    assert_allclose(two / unit, one, rtol=1e-5, atol=1e-6)


def test_without_scales_the_rank_depends_on_the_unit():
    one = learner(scales=[1, 1, 1, 1]).fit(stroking())
    two = learner(scales=[1, 1, 1, 1]).fit(stroking(force_unit=1000.0))
    # In newtons hardly anything but the force counts.
    assert one.components_[0].rank < two.components_[0].rank


def test_given_scales_are_those_of_the_units_times_anything(newtons):
    # Also the regulariser is in scaled units: with it scaled along nothing changes.
    scaled = learner(
        scales=3 * newtons.scales_, regularization=1e-8 / 9, tolerance=1e-8 / 9
    ).fit(stroking())
    held_out = stroking(seed=1)
    assert scaled.score(held_out) == pytest.approx(newtons.score(held_out), rel=1e-6)
    y = held_out.values[:5]
    assert_allclose(
        scaled.synthesize(scaled.map_partial(y).weights),
        newtons.synthesize(newtons.map_partial(y).weights),
        rtol=1e-5,
        atol=1e-7,
    )


# Real units ------------------------------------------------------------------------


def test_analysis_and_synthesis_undo_each_other_in_real_units(newtons):
    y = stroking(seed=2).values[:80].reshape(2, 40, 4)
    assert_allclose(newtons.synthesize(newtons.analyze(y)), y, atol=1e-12)


def test_samples_have_the_spread_of_the_demonstration(newtons):
    demonstrated = stroking().values.std(axis=0)
    drawn = newtons.sample(400, seed=0).std(axis=(0, 1))
    assert_allclose(drawn, demonstrated, rtol=0.1)


def test_log_density_is_that_of_the_normal_distribution_of_the_real_values():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((60, 8, 2)) * [0.01, 20.0]
    skill = FourierMovementPrimitive(
        n_steps=8, overlap=2, n_components=1, explained_variance=1.0, scales=[0.01, 20.0],
        regularization=1e-3,
    ).fit(x)  # fmt: skip
    flat, unit = x.reshape(60, 16), np.tile([0.01, 20.0], 8)
    normal = multivariate_normal(
        flat.mean(axis=0), np.cov(flat.T, bias=True) + 1e-3 * np.diag(unit**2)
    )
    assert_allclose(skill.score_samples(x[:9]), normal.logpdf(flat[:9]), rtol=1e-6)


@pytest.mark.parametrize("step", [0.0, 12.3, 39.0])
def test_covariance_is_in_the_channels_units(newtons, step):
    rows = newtons.observation_rows(step)
    for j, component in enumerate(newtons.components_):
        expected = rows @ dense(component) @ rows.T
        assert_allclose(newtons.covariance(j, step), expected, rtol=1e-9)


def test_rows_observe_in_the_channels_units_per_second(newtons):
    y = newtons.sample(1, seed=3, with_noise=False)[0]
    w = newtons.analyze(y)
    assert_allclose((newtons.observation_rows([4, 9]) @ w).reshape(2, 4), y[[4, 9]])
    h = 1e-4
    before, after = (newtons.observation_rows(6 + s) @ w for s in (-h, h))
    velocity = newtons.observation_rows(6, derivative=1) @ w
    assert_allclose(velocity, (after - before) * 20 / (2 * h), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("given", [None, [1e-6, 1e-6, 0.25, 1e-4]])
def test_mapping_is_the_posterior_with_tolerances_in_squared_units(newtons, given):
    y = np.array([0.03, 0.02, 21.0, -0.2])
    keypoint = Keypoint(step=11, values=y, tolerance=given)
    mapping = newtons.map_keypoints([keypoint])
    noise = 1e-8 * newtons.scales_**2 if given is None else np.array(given)
    gaussian, rows = (
        newtons.components_[mapping.component],
        newtons.observation_rows(11),
    )
    cross = rows @ dense(gaussian)
    error = y - rows @ gaussian.mean
    step = np.linalg.solve(cross @ rows.T + np.diag(noise), error)
    expected = gaussian.mean + cross.T @ step
    assert_allclose(mapping.weights, expected, rtol=1e-6, atol=1e-8)


def test_start_and_velocity_are_in_the_channels_units(newtons):
    start = np.array([0.3, 0.1, 40.0, 1.5])
    motion = Player(newtons).rollout(start, 8.0)
    assert_allclose(motion[0, 0], start)
    assert_allclose(motion[0, 1], 0, atol=1e-9)
    fastest = np.abs(np.diff(stroking().values, axis=0)).max(axis=0) * 20
    late = np.abs(motion[80:, 1]).max(axis=0)
    assert np.all(late < 1.5 * fastest)
    assert np.all(late > 0.3 * fastest)


def test_skill_file_keeps_the_scales(newtons, tmp_path):
    save_skill(newtons, tmp_path / "s.npz")
    loaded = load_skill(tmp_path / "s.npz")
    assert np.array_equal(loaded.scales_, newtons.scales_)
    assert loaded.units_ == UNITS
    start = [0.05, 0.0, 17.0, 0.1]
    assert np.array_equal(
        Player(loaded).rollout(start, 3.0), Player(newtons).rollout(start, 3.0)
    )


def test_scales_are_a_parameter_that_is_cloned():
    copy = clone(learner(scales=[1.0, 1.0, 5.0, 1.0]))
    assert copy.get_params()["scales"] == [1.0, 1.0, 5.0, 1.0]
    assert np.array_equal(copy.fit(stroking()).scales_, [1.0, 1.0, 5.0, 1.0])
