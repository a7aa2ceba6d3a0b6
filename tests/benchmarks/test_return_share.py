"""Fraction of 1000 random starts that return, and their playback for 10 minutes."""

import numpy as np
import pytest
from tube import bundled, measure_return, peak_speed, remapping_jumps, starts_in_box

from fmp_drake.primitives import FourierMovementPrimitive
from fmp_drake.primitives.model.movement_primitive import PAPER_SETTINGS

SETTINGS = {
    "defaults": {},
    "mixture": {"model": "mixture"},
    "M = 10, stride 10": PAPER_SETTINGS,
}
PERIODS = {"polishing": 2.0, "eight": 3.0}
STARTS = 1000
SECONDS = 20.0
# Some of them play on for longer.
FEW = 10
LONG = 600.0


@pytest.mark.parametrize("task", list(PERIODS))
@pytest.mark.parametrize("settings", list(SETTINGS))
def test_return(benchmark, figures, task, settings):
    demonstration, period = bundled(task), PERIODS[task]
    skill = FourierMovementPrimitive(**SETTINGS[settings]).fit(demonstration)
    peak = peak_speed(demonstration, skill.rate)
    starts = starts_in_box(skill, STARTS)
    found = benchmark.pedantic(
        measure_return,
        args=(skill, demonstration),
        kwargs={"starts": starts, "seconds": SECONDS, "period": period},
        rounds=1,
    )
    later = measure_return(
        skill, demonstration, starts=starts[:FEW], seconds=LONG, period=period
    )
    jumps = np.array(
        [np.concatenate(remapping_jumps(skill, s, LONG)) for s in starts[:3]]
    ).max(axis=0)
    figures.section = (
        f"Return of {STARTS} starts in a box twice as wide as demonstrated: {task} "
        f"(period {period:g} s), {settings}"
    )
    figures.add("in the tube after two periods", 100 * found.at, "%", above=100)
    figures.add(
        f"at every tick from then to {SECONDS:g} s", 100 * found.after, "%", above=100
    )
    figures.add(
        f"{FEW} of them, at every tick to {LONG:g} s", 100 * later.after, "%", above=100
    )
    figures.add(
        "of the ticks from then on, as near as demonstrations are to themselves",
        100 * found.near,
        "%",
        above=99,
    )
    figures.add(
        "peak speed below twice the demonstrated", 100 * found.slow, "%", above=100
    )
    figures.add(
        "greatest speed / demonstrated peak speed", found.greatest_speed, below=2
    )
    figures.add("greatest position jump at a re-mapping", 1e3 * jumps[0], "mm", below=1)
    figures.add(
        "greatest velocity jump / demonstrated peak speed",
        100 * jumps[1] / peak,
        "%",
        below=10,
    )
    figures.add(
        "position that the offset takes up at a re-mapping", 1e3 * jumps[2], "mm"
    )
    figures.add(
        "velocity that the offset takes up / demonstrated peak speed",
        100 * jumps[3] / peak,
        "%",
    )
