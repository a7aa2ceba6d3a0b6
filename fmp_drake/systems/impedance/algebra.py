"""Algebra of poses and their motion, rotations and small matrices, for compiled functions.

``X_AB = (R_AB, p_AB)`` is the pose of frame B in frame A.
"""

import math
from typing import NamedTuple

import numpy as np

from fmp_drake.compiled import compiled
from fmp_drake.numeric import Array

# Sweeps of Jacobi's method; it converges quadratically, after five or six.
_MAX_SWEEPS = 30
# Ratio to the diagonal below which an element counts as zero.
_ROUNDING = 1e-16


class Pose(NamedTuple):
    """Pose of a frame: rotation matrix, shape (3, 3), and position, shape (3,), m."""

    R: Array
    p: Array


@compiled
def dot(x: Array, y: Array) -> float:
    """Return the scalar product of two vectors."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@compiled
def norm(x: Array) -> float:
    """Return the length of a vector."""
    return math.sqrt(dot(x, x))


@compiled
def has_finite_sum(x: Array) -> bool:
    """Return whether the sum of a vector's elements is finite."""
    total = 0.0
    for i in range(len(x)):
        total += x[i]
    return math.isfinite(total)


@compiled
def largest(A: Array) -> float:
    """Return the largest absolute value of a matrix's elements; NaN where one is NaN."""
    size = 0.0
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            x = abs(A[i, j])
            if not x <= size:
                size = x
            if math.isnan(x):
                return x
    return size


@compiled
def applied(A: Array, x: Array) -> Array:
    """Return ``A x`` for a matrix, shape (n, m), and a vector, shape (m,)."""
    y = np.empty(A.shape[0])
    for i in range(A.shape[0]):
        # Without `dot`: a slice for it is more code to compile.
        total = 0.0
        for k in range(A.shape[1]):
            total += A[i, k] * x[k]
        y[i] = total
    return y


@compiled
def product(A: Array, B: Array) -> Array:
    """Return ``A B`` for matrices, shapes (n, k) and (k, m)."""
    C = np.empty((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            # Without slices, as in `applied`.
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[k, j]
            C[i, j] = total
    return C


@compiled
def compose(X_AB: Pose, X_BC: Pose) -> Pose:
    """Return X_AC."""
    return Pose(product(X_AB.R, X_BC.R), applied(X_AB.R, X_BC.p) + X_AB.p)


@compiled
def relative(X_AB: Pose, X_AC: Pose) -> Pose:
    """Return X_BC."""
    R_BA = X_AB.R.T
    return Pose(product(R_BA, X_AC.R), applied(R_BA, X_AC.p - X_AB.p))


@compiled
def raised(X_AB: Pose, X_AC: Pose, distance: float) -> Pose:
    """Return X_AB translated along z of C by a distance."""
    p = np.empty(3)
    for i in range(3):
        p[i] = X_AB.p[i] + distance * X_AC.R[i, 2]
    return Pose(X_AB.R, p)


@compiled
def stacked(rotation: Array, translation: Array) -> Array:
    """Concatenate two vectors, shape (3,), to one, shape (6,)."""
    twist = np.empty(6)
    for i in range(3):
        twist[i] = rotation[i]
        twist[3 + i] = translation[i]
    return twist


@compiled
def twist_rotation(R: Array) -> Array:
    """Return the matrix, shape (6, 6), that rotates both halves of a twist."""
    blocks = np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            blocks[i, j] = blocks[3 + i, 3 + j] = R[i, j]
    return blocks


@compiled
def cross(a: Array, b: Array) -> Array:
    """Return ``a × b``, shape (3,)."""
    return np.array(
        (
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        )
    )


@compiled
def rotation_from_quaternion(wxyz: Array) -> Array:
    """Return the rotation matrix, shape (3, 3), of a quaternion of any length.

    Both signs give the same matrix. A quaternion of length 0 gives NaN.
    """
    w, x, y, z = wxyz[0], wxyz[1], wxyz[2], wxyz[3]
    squared = w * w + x * x + y * y + z * z
    s = 2 / squared if squared > 0 else math.nan
    R = np.empty((3, 3))
    R[0, 0] = 1 - s * (y * y + z * z)
    R[0, 1] = s * (x * y - w * z)
    R[0, 2] = s * (x * z + w * y)
    R[1, 0] = s * (x * y + w * z)
    R[1, 1] = 1 - s * (x * x + z * z)
    R[1, 2] = s * (y * z - w * x)
    R[2, 0] = s * (x * z - w * y)
    R[2, 1] = s * (y * z + w * x)
    R[2, 2] = 1 - s * (x * x + y * y)
    return R


@compiled
def rotation_from_vector(phi: Array) -> Array:
    """Return the rotation matrix, shape (3, 3), of a rotation vector in rad."""
    half = 0.5 * norm(phi)
    s = 0.5 * math.sin(half) / half if half > 1e-8 else 0.5
    return rotation_from_quaternion(
        np.array((math.cos(half), s * phi[0], s * phi[1], s * phi[2]))
    )


@compiled
def rotation_vector(R: Array) -> Array:
    """Compute the logarithm of a rotation, accurate at 0 and at 180 degrees.

    Parameters
    ----------
    R : array, shape (3, 3)
        A rotation matrix.

    Returns
    -------
    array, shape (3,)
        Axis times angle in rad, the angle in [0, π].

    Notes
    -----
    The quaternion is computed from its largest element (Shepperd, "Quaternion from
    rotation matrix", J. Guidance and Control 1(3), 1978), up to a factor that cancels in
    `atan2`. At 180 degrees the sign of the axis is arbitrary.
    """
    a, e, i = R[0, 0], R[1, 1], R[2, 2]
    largest = max(a + e + i, a, e, i)
    if largest == a + e + i:
        w, x = 1 + a + e + i, R[2, 1] - R[1, 2]
        y, z = R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif largest == a:
        w, x = R[2, 1] - R[1, 2], 1 + a - e - i
        y, z = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif largest == e:
        w, x = R[0, 2] - R[2, 0], R[0, 1] + R[1, 0]
        y, z = 1 - a + e - i, R[1, 2] + R[2, 1]
    else:
        w, x = R[1, 0] - R[0, 1], R[0, 2] + R[2, 0]
        y, z = R[1, 2] + R[2, 1], 1 - a - e + i
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2 * math.atan2(sine, abs(w)) / sine if sine > 0 else 0.0
    return (scale if w >= 0 else -scale) * np.array((x, y, z))


@compiled
def rotation_vectors(R: Array) -> Array:
    """Compute `rotation_vector` of rotations (N, 3, 3), shape (N, 3)."""
    vectors = np.empty((len(R), 3))
    for i in range(len(R)):
        vectors[i] = rotation_vector(R[i])
    return vectors


@compiled
def rotation_angle(R: Array, S: Array) -> float:
    """Return the angle between two orientations in rad."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += R[i, j] * S[i, j]
    cosine = 0.5 * (trace - 1)
    return math.acos(min(max(cosine, -1.0), 1.0))


@compiled
def inverse_left_jacobian(phi: Array, x: Array) -> Array:
    """Return x multiplied by the inverse left Jacobian of SO(3) at a rotation vector.

    ``x − ½ φ × x + c φ × (φ × x)`` with ``c = 1/θ² − cot(θ/2) / (2 θ)``: it maps
    a gradient with respect to the rotation vector to a torque.

    Parameters
    ----------
    phi : array, shape (3,)
        φ of length θ, rad.
    x : array, shape (3,)
    """
    squared = dot(phi, phi)
    if squared > 1e-4:
        theta = math.sqrt(squared)
        c = 1 / squared - 0.5 / (theta * math.tan(0.5 * theta))
    else:
        c = 1 / 12 + squared / 720
    once = cross(phi, x)
    return x - 0.5 * once + c * cross(phi, once)


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
        Lower triangular; incomplete where A is not positive definite.
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


@compiled
def eigen(A: Array) -> tuple[Array, Array]:
    """Compute the eigenvalues, ascending, and eigenvectors of a symmetric matrix.

    Parameters
    ----------
    A : array, shape (n, n)
        Symmetric and finite.

    Returns
    -------
    values : array, shape (n,)
    vectors : array, shape (n, n)
        In columns.

    Notes
    -----
    Jacobi's method with cyclic sweeps [1]_: for 6 rows it is as fast as LAPACK, and
    the result does not depend on the processor.

    References
    ----------
    .. [1] G. H. Golub, C. F. Van Loan, "Matrix Computations", 4th edition, 2013,
       section 8.5.
    """
    n, D, V = len(A), A.copy(), np.eye(len(A))
    for _ in range(_MAX_SWEEPS):
        is_diagonal = True
        for p in range(n):
            for q in range(p + 1, n):
                if abs(D[p, q]) > _ROUNDING * math.sqrt(abs(D[p, p] * D[q, q])):
                    is_diagonal = False
                    _rotate(D, V, p, q)
        if is_diagonal:
            break
    values, vectors = np.empty(n), np.empty((n, n))
    for i in range(n):
        rank = 0
        for j in range(n):
            rank += D[j, j] < D[i, i] or (D[j, j] == D[i, i] and j < i)
        values[rank] = D[i, i]
        for k in range(n):
            vectors[k, rank] = V[k, i]
    return values, vectors


@compiled
def _rotate(D: Array, V: Array, p: int, q: int) -> None:
    """Make the elements p, q of a symmetric D zero by a rotation, and rotate V."""
    tau = 0.5 * (D[q, q] - D[p, p]) / D[p, q]
    tangent = math.copysign(1.0, tau) / (abs(tau) + math.hypot(1.0, tau))
    c = 1 / math.hypot(1.0, tangent)
    s = tangent * c
    for k in range(len(D)):
        x, y = D[k, p], D[k, q]
        D[k, p], D[k, q] = c * x - s * y, s * x + c * y
    for k in range(len(D)):
        x, y = D[p, k], D[q, k]
        D[p, k], D[q, k] = c * x - s * y, s * x + c * y
        x, y = V[k, p], V[k, q]
        V[k, p], V[k, q] = c * x - s * y, s * x + c * y


class TaskTarget(NamedTuple):
    """Desired pose and motion of the end effector.

    Parameters
    ----------
    X : Pose
        X_TE.
    V, A : array, shape (6,)
        Twist and its derivative, rotation first, in T: rad/s, m/s, rad/s², m/s².
    """

    X: Pose
    V: Array
    A: Array


@compiled
def task_error(measured: Pose, desired: Pose) -> Array:
    """Compute the displacement from the measured to the desired pose.

    Parameters
    ----------
    measured, desired : Pose
        Measured and desired X_TE.

    Returns
    -------
    array, shape (6,)
        ``(log(R_TE_desired R_TEᵀ), p_TE_desired − p_TE)``: rad and m, in T.
    """
    return stacked(
        rotation_vector(product(desired.R, measured.R.T)), desired.p - measured.p
    )


@compiled
def unwrapped(error: Array, previous: Array) -> Array:
    """Unwrap a rotation error at 180 degrees.

    The axis of the shortest rotation changes its sign at 180 degrees, and the torque of
    a spring with it. Of the two rotation vectors of one rotation, the one nearer to the
    previous error is returned, if it is shorter than 270 degrees.

    Parameters
    ----------
    error : array, shape (6,)
        Result of `task_error`, rad and m; not changed.
    previous : array, shape (3,)
        Rotation of the previous error, as returned here, rad.

    Returns
    -------
    array, shape (6,)
    """
    phi = error[:3]
    angle = norm(phi)
    # Below 90 degrees the shortest rotation is the nearer one; NaN returns here, too.
    if not angle > 0.5 * math.pi or dot(phi, previous) >= 0:
        return error
    other = (1 - 2 * math.pi / angle) * phi
    this_way, other_way = phi - previous, other - previous
    if norm(other_way) < norm(this_way):
        return stacked(other, error[3:])
    return error


@compiled
def blended(target: TaskTarget, X_TE: Pose, fraction: float, rate: float) -> TaskTarget:
    """Mix a pose at rest and a target: the pose at fraction 0, the target at 1.

    Parameters
    ----------
    target : TaskTarget
    X_TE : Pose
        The pose at rest.
    fraction, rate : float
        Blend of pose and target, and its derivative in 1/s.
    """
    error = task_error(X_TE, target.X)
    R = product(rotation_from_vector(fraction * error[:3]), X_TE.R)
    X = Pose(R, X_TE.p + fraction * error[3:])
    return TaskTarget(X, fraction * target.V + rate * error, fraction * target.A)


@compiled
def motion_in_world(
    target: TaskTarget, frame_twist: Array, frame_acceleration: Array
) -> TaskTarget:
    """Turn a motion relative to T into the motion relative to W, in T's axes.

    Parameters
    ----------
    target : TaskTarget
        Relative to T.
    frame_twist : array, shape (6,)
        V_WT of T's origin, in T's axes, rad/s and m/s.
    frame_acceleration : array, shape (6,)
        A_WT, its derivative in W, in T's axes, rad/s² and m/s².
    """
    w, alpha, p = frame_twist[:3], frame_acceleration[:3], target.X.p
    velocity, relative_velocity = cross(w, p), target.V[3:]
    V, A, twice = np.empty(6), np.empty(6), np.empty(3)
    for i in range(3):
        twice[i] = velocity[i] + 2 * relative_velocity[i]
    angular, linear, coriolis = cross(w, target.V), cross(alpha, p), cross(w, twice)
    for i in range(3):
        V[i] = target.V[i] + frame_twist[i]
        V[3 + i] = target.V[3 + i] + frame_twist[3 + i] + velocity[i]
        A[i] = target.A[i] + frame_acceleration[i] + angular[i]
        A[3 + i] = target.A[3 + i] + frame_acceleration[3 + i]
        A[3 + i] += linear[i] + coriolis[i]
    return TaskTarget(target.X, V, A)
