"""Facts about the threads of BLAS in products of small matrices."""

import numpy as np
from threadpoolctl import ThreadpoolController

from fmp_drake.numeric import one_blas_thread
from fmp_drake.primitives import FourierMovementPrimitive, Player
from fmp_drake.primitives.model import mapping

BLAS = ThreadpoolController().select(user_api="blas")


def threads():
    return {library["num_threads"] for library in BLAS.info()}


def test_there_is_one_thread_inside_and_as_many_as_before_outside():
    with BLAS.limit(limits=2):
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == {2}


def test_a_player_is_made_and_draws_its_samples_with_one_thread(monkeypatch):
    windows = np.random.default_rng(0).standard_normal((40, 24, 2))
    skill = FourierMovementPrimitive(n_steps=24, rate=10, overlap=4).fit(windows)
    seen = []

    def watch(owner, name):
        original = getattr(owner, name)

        def call(*arguments, **keywords):
            seen.append((name, threads()))
            return original(*arguments, **keywords)

        monkeypatch.setattr(owner, name, call)

    watch(mapping, "cholesky")
    watch(skill, "draw")
    with BLAS.limit(limits=2):
        Player(skill, sample=True).start([0.0, 0.0])
    assert {name for name, _ in seen} == {"cholesky", "draw"}
    assert all(count == {1} for _, count in seen)
