"""Eigenvectors of covariances."""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numba.extending import get_cython_function_address
from numpy.typing import NDArray

from fmp_drake.numeric import Array

# Columns that LAPACK reflects at a time.
_BLOCK = 64


def symmetric_roots(covariances: Array) -> Array:
    """Return the symmetric square roots of covariances (n, D, D)."""
    variances, vectors = np.linalg.eigh(covariances)
    half = vectors * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
    return half @ np.swapaxes(vectors, 1, 2)


def leading_eigenvectors(matrix: Array, count: int) -> tuple[Array, Array]:
    """Return the greatest eigenvalues of a symmetric matrix and their vectors (n, count).

    The matrix, which has to be contiguous, is overwritten. The tridiagonal matrix is
    decomposed in full: finding only some of its eigenvectors takes longer. Only the
    requested ones are transformed back, which saves a third of the time of
    `numpy.linalg.eigh`. Threads can call it in parallel; SciPy's functions would wait for
    each other.
    """
    n = len(matrix)
    diagonal, off_diagonal, scales = np.empty((3, n))
    vectors, work = np.empty((n, n)), np.empty(1 + 4 * n + max(n, _BLOCK) * n)
    integers = np.empty(3 + 5 * n, dtype=np.intc)
    size, tridiagonal = len(work), (n, diagonal, off_diagonal)
    _lapack("dsytrd", b"L", n, matrix, *tridiagonal, scales, work, size)
    _lapack(
        "dstedc", b"I", *tridiagonal, vectors, n, work, size, integers, len(integers)
    )
    # LAPACK's columns are rows here.
    leading = vectors[n - count :]
    reflectors = (matrix, n, scales)
    _lapack("dormtr", b"L", b"L", b"N", n, count, *reflectors, leading, n, work, size)
    return diagonal[n - count :], leading.T


def _lapack(name: str, *arguments: NDArray[Any] | int | bytes) -> None:
    """Call a routine of LAPACK with arrays, integers and letters, without Python's lock."""
    info = ctypes.c_int()
    pointers: list[Any] = []
    for value in arguments:
        match value:
            case bytes():
                pointers.append(ctypes.byref(ctypes.c_char(value)))
            case int():
                pointers.append(ctypes.byref(ctypes.c_int(value)))
            case _:
                pointers.append(value.ctypes.data)
    _routine(name, len(arguments) + 1)(*pointers, ctypes.byref(info))
    if info.value:
        raise np.linalg.LinAlgError(f"{name} stopped with {info.value}")


@cache
def _routine(name: str, count: int) -> Any:
    address = get_cython_function_address("scipy.linalg.cython_lapack", name)
    return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * count)(address)
