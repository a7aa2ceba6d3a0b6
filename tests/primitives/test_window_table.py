"""Facts about whole windows in closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tracking_rules import TRACKERS

from fmp_drake.primitives import FourierMovementPrimitive, Player
from fmp_drake.primitives.playback.window_table import WindowTable


@pytest.fixture(scope="module", params=["small", "odd", "units"])
def skill(request, small_skill, odd_skill, polishing_demonstration):
    if request.param == "units":
        return FourierMovementPrimitive(
            n_steps=24,
            rate=10.0,
            overlap=4,
            n_components=3,
            stride=3,
            scales=[0.05, 20.0],
            regularization=1e-6,
        ).fit(polishing_demonstration)
    return {"small": small_skill, "odd": odd_skill}[request.param]


@pytest.fixture(params=list(TRACKERS))
def drifts(request, skill):
    rule = TRACKERS[request.param](skill)
    return [
        rule.drift(c, n_steps=skill.n_steps, tick=1 / skill.rate)
        for c in skill.components_
    ]


def literal(skill, drift, weights, target):
    """Return one playback's motions, tick by tick and row by row."""
    out = []
    d, first = skill.n_channels_, skill.overlap - 1
    for step in range(first, skill.n_steps):
        phi = [skill.basis.rows(step, k) * skill.rate**k for k in range(3)]
        w, w_dot, w_ddot = (
            x.reshape(d, -1)
            for x in drift.advance(weights, target, (step - first) / skill.rate)
        )
        out.append(
            [
                w @ phi[0],
                w @ phi[1] + w_dot @ phi[0],
                w @ phi[2] + 2 * w_dot @ phi[1] + w_ddot @ phi[0],
            ]
        )
    return np.array(out) * skill.scales_


@pytest.mark.parametrize("spread", [0.0, 0.01])
def test_table_is_every_tick_by_itself(skill, drifts, spread):
    rng = np.random.default_rng(0)
    for gaussian, drift in zip(skill.components_, drifts, strict=True):
        weights = gaussian.sample(rng, 4, with_noise=False)
        # Outside the span of the component too.
        weights = weights + spread * rng.standard_normal(weights.shape)
        target = gaussian.sample(rng, 4, with_noise=False)
        got = WindowTable(skill, drift).motions(weights, target)
        assert got.shape == (4, skill.n_steps - skill.overlap + 1, 3, 2)
        for one, w, g in zip(got, weights, target, strict=True):
            expected = literal(skill, drift, w, g)
            scale = np.max(np.abs(expected), axis=0)
            assert_allclose(one / scale, expected / scale, atol=1e-9)


def test_one_playback_does_not_depend_on_the_others(skill, drifts):
    gaussian, drift = skill.components_[0], drifts[0]
    rng = np.random.default_rng(0)
    weights = gaussian.sample(rng, 3)
    target = np.tile(gaussian.mean, (3, 1))
    table = WindowTable(skill, drift)
    together = table.motions(weights, target)
    for i in range(3):
        alone = table.motions(weights[i : i + 1], target[i : i + 1])
        assert_allclose(together[i], alone[0], rtol=1e-9, atol=1e-10)


def test_rollout_is_the_ticks_one_by_one(skill):
    player = Player(skill)
    start = skill.extent_[1] + 0.05
    state = player.start(start)
    expected = [player.motion(state)]
    for _ in range(3 * player.ticks_between_remaps + 5):
        state = player.tick(state)
        if state.step == skill.n_steps - 1:
            state = player.remap(state)
        expected.append(player.motion(state))
    got = player.rollout(start, (len(expected) - 1) / skill.rate)
    scale = np.max(np.abs(expected), axis=0)
    assert_allclose(got / scale, expected / scale, atol=1e-8)
