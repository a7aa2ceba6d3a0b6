"""Learn from a large demonstration in a separate process; print the figures as JSON.

Arguments: T D N M, for N windows of T samples of D channels and M components.
"""

import json
import resource
import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from fmp_drake.primitives import Demonstration, FourierMovementPrimitive
from fmp_drake.primitives.model.movement_primitive import PAPER_SETTINGS

STRIDE = 10
WINDOW_SECONDS = 6.0


def wandering(time, every, spread, rng):
    """Return 1 and a bit, which changes every few seconds."""
    knots = np.arange(0, time[-1] + 2 * every, every)
    return 1 + spread * np.interp(time, knots, rng.standard_normal(len(knots)))


def demonstration(t, d, n):
    """Return d joint angles that swing in 2 s periods, 0.1 mrad of noise."""
    rng = np.random.default_rng(0)
    rate = t / WINDOW_SECONDS
    time = np.arange((n - 1) * STRIDE + t) / rate
    phase = np.cumsum(wandering(time, 2.0, 0.1, rng)) / rate * np.pi
    values = np.stack(
        [
            0.1 * np.sin(k * phase / 3 + k) * wandering(time, 3.0, 0.1, rng)
            for k in range(1, d + 1)
        ],
        axis=1,
    )
    values += 1e-4 * rng.standard_normal(values.shape)
    return Demonstration(time=time, values=values, units=("rad",) * d), rate


def resident(what):
    """Return MB in memory: VmRSS now, VmHWM at most.

    A new process inherits the peak of its parent in `ru_maxrss`, so that serves
    only where there is no /proc.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    for line in status.read_text().splitlines():
        if line.startswith(what):
            return int(line.split()[1]) / 1e3
    return float("nan")


def main():
    t, d, n, m = (int(argument) for argument in sys.argv[1:5])
    recorded, rate = demonstration(t, d, n)
    settings = {**PAPER_SETTINGS, "n_components": m, "stride": STRIDE}
    skill = FourierMovementPrimitive(n_steps=t, rate=rate, overlap=10, **settings)
    before = resident("VmRSS")
    begin = perf_counter()
    skill.fit(recorded)
    seconds = perf_counter() - begin
    peak = resident("VmHWM")
    plan = skill.mapping_plan(np.arange(10))
    y = recorded.values[:10].ravel()
    times = []
    for _ in range(200):
        begin = perf_counter()
        plan.map(y)
        times.append(perf_counter() - begin)
    figures = {
        "windows": skill.n_windows_,
        "rank": skill.components_[0].rank,
        "fit_s": seconds,
        "peak_mb": peak,
        "fit_mb": peak - before,
        "map_us": 1e6 * float(np.median(times)),
    }
    sys.stdout.write(json.dumps(figures))


if __name__ == "__main__":
    main()
