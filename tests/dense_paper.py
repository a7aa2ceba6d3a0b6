"""Literal, dense and slow transcription of the paper's equations, as the oracle.

Kulak, Silverio and Calinon, "Fourier movement primitives: an approach for
learning rhythmic robot skills from demonstrations", RSS 2020. Every function
carries the number of its equation. A channel has 2T real weights (6), its real
parts first, and D channels are concatenated (19). Nothing here is shared with
the package under test.

Two readings. The paper writes Phi = A Phi~ above (8); only Phi~ A has the sizes.
And Phi is complex, whereas the weights of (6) are real by definition. So the
minimum over real weights in the first line of (14) keeps the real part of the
normal equations of its last line; `candidate_as_printed` leaves them complex.
"""

import numpy as np


def psi(t):
    """(2): Psi, T x T."""
    k, n = np.meshgrid(np.arange(t), np.arange(t), indexing="ij")
    return np.exp(-2j * np.pi / t * k * n)


def phi_tilde(t):
    """(4): Phi~ = Psi^H / T, T x T."""
    return psi(t).conj().T / t


def complex_weights(y):
    """(1): w~ of one channel (T,), coefficient by coefficient."""
    t = len(y)
    out = np.zeros(t, dtype=complex)
    for k in range(t):
        for n in range(t):
            out[k] += y[n] * np.exp(-2j * np.pi / t * k * n)
    return out


def signal(w_tilde):
    """(3): the samples of one channel, sample by sample."""
    t = len(w_tilde)
    out = np.zeros(t, dtype=complex)
    for n in range(t):
        for k in range(t):
            out[n] += w_tilde[k] * np.exp(2j * np.pi / t * k * n) / t
    return out


def expanded(w_tilde):
    """(6): w = [Re w~, Im w~], 2T real numbers."""
    return np.concatenate([w_tilde.real, w_tilde.imag])


def selector(t):
    """(7): A = [I, i I], T x 2T."""
    return np.hstack([np.eye(t), 1j * np.eye(t)])


def phi(t):
    """(8): Phi, T x 2T, so that y = Phi w."""
    return phi_tilde(t) @ selector(t)


def stacked(y):
    """(19): samples (T, D), one channel after the other."""
    return np.concatenate([y[:, d] for d in range(y.shape[1])])


def window_of(w, d):
    """(8): the window (T, D) of weights (2TD,), of which (8) keeps the real part."""
    t = len(w) // (2 * d)
    return (phi_of(range(t), t, d) @ w).real.reshape(d, t).T


def block_diagonal(block, d):
    """(20): D copies of a matrix on the diagonal."""
    rows, columns = block.shape
    out = np.zeros((d * rows, d * columns), dtype=block.dtype)
    for i in range(d):
        out[i * rows : (i + 1) * rows, i * columns : (i + 1) * columns] = block
    return out


def phi_of(steps, t, d):
    """Phi_{1:K} of (10), or any other rows of Phi, for D channels (20)."""
    return block_diagonal(phi(t)[steps], d)


def weights_of(y):
    """(2), (6), (19): the expanded weights of a window (T, D), 2TD numbers."""
    t = len(y)
    return np.concatenate([expanded(psi(t) @ y[:, d]) for d in range(y.shape[1])])


def gaussian_log_density(w, mu, sigma):
    """(9), second line, as a logarithm."""
    delta = w - mu
    _, log_det = np.linalg.slogdet(sigma)
    square = delta @ np.linalg.inv(sigma) @ delta
    return -0.5 * (len(w) * np.log(2 * np.pi) + log_det + square)


def mixture_log_density(w, pi, mu, sigma):
    """(9), first line, as a logarithm."""
    each = [
        np.log(pi[j]) + gaussian_log_density(w, mu[j], sigma[j]) for j in range(len(pi))
    ]
    top = max(each)
    return top + np.log(sum(np.exp(value - top) for value in each))


def candidate(y, rows, mu, sigma, lam):
    """(14): the minimum over real weights."""
    precision = np.linalg.inv(sigma)
    left = (rows.conj().T @ rows).real + lam * precision
    right = (rows.conj().T @ y).real + lam * precision @ mu
    return np.linalg.solve(left, right)


def candidate_as_printed(y, rows, mu, sigma, lam):
    """(14), last line, in complex numbers."""
    precision = np.linalg.inv(sigma)
    left = rows.conj().T @ rows + lam * precision
    right = rows.conj().T @ y + lam * precision @ mu
    return np.linalg.solve(left, right)


def cost(y, rows, w, pi, mu, sigma, lam):
    """(15): what is minimised over the components."""
    residual = np.linalg.norm(y - rows @ w) ** 2
    delta = w - mu
    square = (delta.conj() @ np.linalg.inv(sigma) @ delta).real
    return residual - lam * np.log(pi) + lam * square


def map_partial(y, rows, pi, mu, sigma, lam, solve=candidate):
    """Algorithm 1: (14), (15), (16). Returns w_K, j*, candidates and costs."""
    m = range(len(pi))
    w = [solve(y, rows, mu[j], sigma[j], lam) for j in m]
    costs = [cost(y, rows, w[j], pi[j], mu[j], sigma[j], lam) for j in m]
    best = int(np.argmin(costs))
    return w[best], best, w, costs


def track(w, mu, sigma, beta, dt):
    """(17): one step of the proportional controller."""
    precision = np.linalg.inv(sigma)
    return w + dt * beta * np.diag(np.diag(precision)) @ (mu - w)


def desired(step, w, sigma, t, d):
    """(18): the desired value and its covariance, complex as printed."""
    row = phi_of([step], t, d)
    return row @ w, row @ sigma @ row.conj().T


def algorithm_2(y, pi, mu, sigma, lam, beta, dt):
    """Algorithm 2 after observing y (K, D): desired values of steps K to T-1."""
    k, d = y.shape
    t = len(mu[0]) // (2 * d)
    w, j, _, _ = map_partial(stacked(y), phi_of(range(k), t, d), pi, mu, sigma, lam)
    values, covariances = [], []
    for step in range(k, t):
        w = track(w, mu[j], sigma[j], beta, dt)
        value, covariance = desired(step, w, sigma[j], t, d)
        values.append(value)
        covariances.append(covariance)
    return np.array(values), np.array(covariances)


def gaussian_of(mean, factors, variances, noise):
    """A Gaussian over 2TD weights, of windows.

    `mean` (T, D) is a window, `factors` (r, T, D) are the directions in which windows
    vary, with `variances` (r,), and `noise` is the white noise of the samples. Its
    2TD x 2TD covariance has the regulariser eps = T * noise that EM adds to all
    weights, among them the half that describes no real signal.
    """
    t = mean.shape[0]
    mu = weights_of(mean)
    sigma = t * noise * np.eye(len(mu))
    for factor, variance in zip(factors, variances, strict=True):
        direction = weights_of(factor)
        sigma += variance * np.outer(direction, direction)
    return mu, sigma


def dense(gaussian):
    """The covariance of a LowRankGaussian, U diag(v) U^T + noise I, (n, n)."""
    factors = gaussian.basis * gaussian.variances
    return factors @ gaussian.basis.T + gaussian.noise * np.eye(gaussian.dim)
