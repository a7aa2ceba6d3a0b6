"""A whole window of one component in closed form, for many playbacks at once."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fmp_drake.primitives.playback.tracking import Drift

if TYPE_CHECKING:
    from fmp_drake.primitives.model.movement_primitive import FourierMovementPrimitive


class WindowTable:
    """The motion at the ticks from sample K - 1 to T - 1, as a linear map.

    The deviation of the weights from their target decays mode by mode, so the motion
    is the target's plus a fixed matrix times the deviation's coordinates.

    Parameters
    ----------
    skill : FourierMovementPrimitive
        Fitted.
    drift : Drift
        Of one component.
    """

    def __init__(self, skill: "FourierMovementPrimitive", drift: Drift) -> None:
        d = skill.n_channels_
        steps = np.arange(skill.overlap - 1, skill.n_steps)
        self._rows = np.stack(
            [skill.basis.rows(steps, k) * skill.rate**k for k in range(3)]
        )
        self._scales = skill.scales_
        self._drift = drift
        seconds = (steps - steps[0]) / skill.rate
        decay = drift.decay(seconds)  # (3, ticks, r)
        if drift.modes is None:
            modes = np.broadcast_to(
                self._rows[:, :, None, :], (3, len(steps), d, skill.n_steps)
            )
            decay = decay.reshape(3, len(steps), d, skill.n_steps)
        else:
            by_channel = drift.modes.reshape(d, skill.n_steps, len(drift.rates))
            modes = np.einsum("klt,dtr->kldr", self._rows, by_channel, optimize=True)
            decay = decay[:, :, None, :]
        self._modes = _product_rule(modes, decay)  # (3, ticks, d, r)
        self._rest_decay = drift.rest_decay(seconds)[:, :, None]

    def motions(
        self, weights: NDArray[np.float64], target: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the motions of S playbacks, (S, ticks, 3, D).

        Parameters
        ----------
        weights, target : ndarray, shape (S, D*T)
            At sample K - 1.
        """
        d = len(self._scales)
        inside, rest = self._drift.split(weights - target)
        if self._drift.modes is None:
            inside = inside.reshape(len(weights), d, -1)
            out = np.einsum("kldt,sdt->slkd", self._modes, inside, optimize=True)
        else:
            out = np.einsum("kldr,sr->slkd", self._modes, inside, optimize=True)
        out = out + self._windows(target)
        if rest is not None and np.max(np.abs(rest)) > 1e-12 * np.max(np.abs(weights)):
            windows = np.transpose(self._windows(rest), (2, 1, 0, 3))
            left = _product_rule(windows, self._rest_decay[..., None])
            out += np.transpose(left, (2, 1, 0, 3))
        return out * self._scales

    def _windows(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        by_channel = weights.reshape(len(weights), len(self._scales), -1)
        return np.einsum("klt,sdt->slkd", self._rows, by_channel, optimize=True)


def _product_rule(
    a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a product and two derivatives, of arrays (3, ...) that hold the same."""
    return np.stack(
        [
            a[0] * b[0],
            a[1] * b[0] + a[0] * b[1],
            a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2],
        ]
    )
