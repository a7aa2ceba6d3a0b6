"""The Cholesky factor of small matrices, without an exception where there is none."""

import math

import numpy as np
from numpy.typing import NDArray

from fmp_drake.compiled import compiled

Array = NDArray[np.float64]


@compiled
def cholesky(A: Array) -> tuple[Array, bool]:
    """Return L with ``A = L Lᵀ``, and whether A is positive definite.

    Parameters
    ----------
    A : array, shape (n, n)
        Symmetric; its lower triangle is read.

    Returns
    -------
    L : array, shape (n, n)
        Lower triangular; of no use where A is not positive definite.
    positive : bool
    """
    n = len(A)
    L = np.zeros((n, n))
    for j in range(n):
        pivot = A[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not pivot > 0:  # NaN ends here as well.
            return L, False
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            x = A[i, j]
            for k in range(j):
                x -= L[i, k] * L[j, k]
            L[i, j] = x / L[j, j]
    return L, True


@compiled
def solve_lower(L: Array, B: Array) -> Array:
    """Return ``L⁻¹ B`` for a lower triangular L, shape (n, n), and B, shape (n, m)."""
    X = B.copy()
    for i in range(len(L)):
        for k in range(i):
            for j in range(X.shape[1]):
                X[i, j] -= L[i, k] * X[k, j]
        for j in range(X.shape[1]):
            X[i, j] /= L[i, i]
    return X
