"""Limit of one BLAS thread, which is fastest for small matrices."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in a block or, as a decorator, in a function.

    Products of some hundred numbers take ten times as long with two threads as with one,
    and a hundred times on a busy machine.
    """
    with _libraries().limit(limits=1, user_api="blas"):
        yield
