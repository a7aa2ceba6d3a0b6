"""A mixture of Gaussians over samples, given the first of them."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

Array = NDArray[np.float64]


class Conditioning:
    """Prediction of later samples of D channels from the first K, by Gaussians.

    Parameters
    ----------
    proportions : ndarray, shape (M,)
    means : ndarray, shape (M, n, D)
    covariances : ndarray, shape (M, n D, n D)
    seen : int
        K.
    noise : ndarray, shape (K D,)
        Variance of what is added to the first samples.

    Examples
    --------
    >>> import numpy as np
    >>> twice = np.array([[[1.0, 2.0], [2.0, 4.0]]])
    >>> model = Conditioning(
    ...     np.ones(1), np.zeros((1, 2, 1)), twice, seen=1, noise=np.zeros(1)
    ... )
    >>> model.predict(np.array([[3.0]]))[0]
    array([[6.]])
    """

    def __init__(
        self,
        proportions: Array,
        means: Array,
        covariances: Array,
        *,
        seen: int,
        noise: Array,
    ) -> None:
        m, n, d = means.shape
        known, ahead = seen * d, np.arange(n - seen)
        observed = covariances[:, :known, :known] + np.diag(noise)
        self._means = means
        self._whitening = np.linalg.inv(np.linalg.cholesky(observed))
        self._gains = covariances[:, known:, :known] @ np.swapaxes(
            self._whitening, 1, 2
        )
        # Of each sample ahead its own block.
        blocks = self._gains.reshape(m, n - seen, d, known)
        later = covariances[:, known:, known:].reshape(m, n - seen, d, n - seen, d)
        self._covariances = np.swapaxes(later[:, ahead, :, ahead], 0, 1)
        self._covariances = self._covariances - blocks @ np.swapaxes(blocks, 2, 3)
        roots = np.diagonal(self._whitening, axis1=1, axis2=2)
        self._offsets = np.log(proportions) + np.sum(np.log(roots), axis=1)
        self._seen = seen

    def predict(self, values: Array) -> tuple[Array, Array]:
        """Return mean (n - K, D) and covariances (n - K, D, D) after values (K, D).

        Of the mixture, its components weighted by their evidence.
        """
        m, _, d = self._means.shape
        off = (values - self._means[:, : self._seen]).reshape(m, -1, 1)
        whitened = self._whitening @ off
        evidence = self._offsets - 0.5 * np.sum(whitened**2, axis=(1, 2))
        probabilities = softmax(evidence)
        moves = (self._gains @ whitened).reshape(m, -1, d)
        means = self._means[:, self._seen :] + moves
        mean = np.tensordot(probabilities, means, axes=1)
        apart = np.sqrt(probabilities)[:, None, None] * (means - mean)
        covariances = np.tensordot(probabilities, self._covariances, axes=1)
        return mean, covariances + np.einsum("mha,mhb->hab", apart, apart)
