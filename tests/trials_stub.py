"""Substitutes for trials and workers, in a module with few imports."""

import os
import time
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

# Metrics of a run in which all is well.
GOOD = {
    "tracking_rms_m": 0.003,
    "tracking_max_m": 0.01,
    "normal_force_wanted_fraction": 0.99,
    "normal_force_p05_n": 8.0,
    "normal_force_p95_n": 11.0,
    "contact_fraction": 0.98,
    "torque_ratio_max": 0.5,
    "torque_rate_max_nm_per_s": 900.0,
    "joint_speed_ratio_max": 0.7,
    "joint_limit_margin_min_rad": 0.2,
    "cleaned_fraction_of_demonstrated_area": 0.9,
}


class AtOnce(Executor):
    """Executor that runs a task at once, in the calling thread."""

    def submit(self, function, /, *arguments):
        """Call a function, and return its result as a finished future."""
        future = Future()
        try:
            future.set_result(function(*arguments))
        except Exception as reason:  # noqa: BLE001
            future.set_exception(reason)
        return future


class Here:
    """Workers in this process."""

    renewed_after = None
    attempts = 1

    @contextmanager
    def executor(self):
        yield AtOnce()

    def places(self):
        return 1


def note(folder, name):
    """Write the name of a task and the process that begins it."""
    with (Path(folder) / "begun").open("a") as stream:
        stream.write(f"{name} {os.getpid()}\n")


def square(task):
    """Wait and return a square; some tasks end their process."""
    folder, number, seconds, how = task
    note(folder, number)
    if how == "kill":
        os.kill(os.getpid(), 9)
    if how == "kill once":
        once = Path(folder) / f"killed_{number}"
        if not once.exists():
            once.touch()
            os.kill(os.getpid(), 9)
    if how == "raise":
        raise ValueError("no square")
    time.sleep(seconds)
    return number**2


def trial(drawn):
    """Note the beginning of a trial; the second one ends its process once."""
    folder = os.environ["TRIALS_STUB"]
    last = drawn.number == int(os.environ.get("TRIALS_STUB_LAST", "-1"))
    square((folder, drawn.number, 60 if last else 0, "kill once" * (drawn.number == 1)))
    if drawn.number == 2:
        return replace(drawn, error="ValueError: too much")
    return replace(drawn, checked={"margin": 0.1}, metrics={"rms": float("nan")})


def drive(folder, count):
    """Run trials with `trial` in one process."""
    from fmp_drake.experiments.trials import TrialSpec, TrialStore, run_trials
    from fmp_drake.processes import LocalWorkers

    spec = TrialSpec("fields: {press.force: {uniform: [5.0, 9.0]}}")
    store = TrialStore(Path(folder), spec.plan(seed=0, duration=1.0))
    list(run_trials(store, spec, int(count), LocalWorkers(1), run=trial))
