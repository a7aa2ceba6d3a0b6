"""A bus in this process with a simulated arm, and the clock of both sides."""

from types import SimpleNamespace

from pydrake.lcm import DrakeLcm

from fmp_drake.runs.arm_bench import ArmBench
from fmp_drake.station import LoadScenario


class Bus:
    """A bus with an arm of `table_top`, and a clock that a look at it advances.

    Parameters
    ----------
    monkeypatch : pytest.MonkeyPatch
    speaks : bool
        Whether there is an arm.
    stride : int
        Steps of a millisecond that it makes for each look.
    scenario : str
        Name.
    bench
        As for `ArmBench`.

    Attributes
    ----------
    at : dict
        What happens after so many looks: functions.
    """

    def __init__(
        self, monkeypatch, *, speaks=True, stride=1, scenario="table_top", **bench
    ):
        self.lcm, self.scenario = DrakeLcm("memq://"), LoadScenario(scenario)
        self.bench = ArmBench(self.scenario, self.lcm, **bench) if speaks else None
        self.seconds, self.looks, self.at, self._stride = 1.7e9, 0, {}, stride
        clock = SimpleNamespace(time=self.now, sleep=lambda _: None)
        monkeypatch.setattr("fmp_drake.runs.real_time.time", clock)
        monkeypatch.setattr(
            "fmp_drake.station.robots.panda_lcm.DrakeLcm", lambda _: self.lcm
        )

    def now(self):
        """Return the time, s; without an arm it runs fast."""
        self.looks += 1
        if self.bench is None:
            self.seconds += 0.1
        else:
            for _ in range(self._stride):
                self.seconds += 0.001
                self.bench.step(self.seconds)
        self.at.pop(self.looks, lambda: None)()
        return self.seconds
