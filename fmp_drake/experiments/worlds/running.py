"""Running the worlds that are missing in a store."""

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import asdict

from fmp_drake.errors import FmpError
from fmp_drake.experiments.worlds.spec import WorldSpec
from fmp_drake.experiments.worlds.store import World, WorldStore
from fmp_drake.experiments.worlds.world import Outcome, Task, code_version, run_world
from fmp_drake.processes import Workers, run_tasks


def run_worlds(
    store: WorldStore,
    spec: WorldSpec,
    count: int,
    workers: Workers,
    *,
    force: bool = False,
    run: Callable[[Task], Outcome] = run_world,
) -> Generator[tuple[int, int]]:
    """Run those of the first `count` worlds that a store does not have yet.

    Each is written as soon as it is done. Whatever ends this process, the same call
    goes on with what is missing.

    Parameters
    ----------
    store : WorldStore
        Whose plan is that of the spec's `plan`.
    spec : WorldSpec
    count : int
    workers : Workers
    force : bool
        Run those, too, that the check in advance refuses.
    run : callable
        What runs one of them.

    Yields
    ------
    done, of : int
        How many of the missing worlds are done.
    """
    seed, seconds = int(store.plan["seed"]), float(store.plan["seconds"])
    code = code_version()
    with store.writing():
        finished = store.finished(force=force)
        drawn, tasks = {}, []
        for number in range(count):
            drawn[number] = spec.draw(seed=seed, number=number)
            task = Task(number, drawn[number].scenario, seconds, force, code)
            if task.key not in finished:
                tasks.append(task)
        yield 0, len(tasks)
        with closing(run_tasks(run, tasks, workers)) as running:
            for done, (task, attempts, result) in enumerate(running, 1):
                if isinstance(result, FmpError):
                    raise result
                if isinstance(result, Exception):
                    reason = f"{type(result).__name__}: {result}"
                    result = Outcome(checked={}, error=f"its process ended ({reason})")
                world = World(
                    number=task.number,
                    code=code,
                    scenario=task.scenario,
                    parameters=drawn[task.number].parameters,
                    attempts=attempts,
                    **asdict(result),
                )
                store.keep(task, world)
                yield done, len(tasks)
