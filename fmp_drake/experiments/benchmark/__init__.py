"""Benchmark of methods that learn, predict and play rhythmic movements.

`run_benchmark` scores methods on a folder of recordings, and `write_benchmark` writes
the report. Another method is a subclass of `Method`, named by an entry point of the
group `fmp_drake.methods`.
"""

from fmp_drake.experiments.baselines.method import Forecast, Method
from fmp_drake.experiments.benchmark.findings import write_benchmark
from fmp_drake.experiments.benchmark.run import run_benchmark

__all__ = ["Forecast", "Method", "run_benchmark", "write_benchmark"]
