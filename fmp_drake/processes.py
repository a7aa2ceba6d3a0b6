"""Parallel tasks in processes of this machine or of a Dask cluster."""

import os
import re
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any, NamedTuple, Protocol

from fmp_drake.errors import ExperimentError

ATTEMPTS = 3
"""Greatest number of attempts at a task whose process crashes."""

# Matrices are small: more threads would only spin, and round differently.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# A step of Drake's contact allocates and frees thousands of small blocks. With longer lists of
# free blocks than glibc's default of 7, a trial takes 3 % less time, and 2 MB more memory.
_ALLOCATOR, _FREE_LISTS = "GLIBC_TUNABLES", "glibc.malloc.tcache_count=100"
# Number of tasks after which a process is replaced. This frees diagrams whose
# references between Drake and Python form a cycle, 20 MB for each wiping station.
_TASKS_OF_A_PROCESS = 25


class Workers(Protocol):
    """Executor of tasks."""

    renewed_after: int | None
    """Tasks after which the executor is replaced."""
    attempts: int
    """Number of attempts at a task; 1 if the executor itself repeats it."""

    def executor(self) -> AbstractContextManager[Executor]:
        """Return an executor whose processes end with its context."""

    def places(self) -> int:
        """Return the greatest number of concurrent tasks."""


class TaskResult[T, R](NamedTuple):
    """A task, its number of attempts, and its result or the error of the last one."""

    task: T
    attempts: int
    result: R | Exception


def run_tasks[T, R](
    function: Callable[[T], R], tasks: Iterable[T], workers: Workers
) -> Generator[TaskResult[T, R]]:
    """Call a function with each task; yield finished tasks in any order.

    A task whose process crashes is repeated, up to the workers' number of attempts.
    Its last attempt runs alone, so that a crash can be attributed to it. Close the iterator
    to end the running tasks.

    Parameters
    ----------
    function : callable
        Defined at the top of a module, so that other processes can import it.
    tasks : iterable
        Arguments of the function. They are pickled, so each should be small.
    workers : Workers
    """
    waiting = deque((task, 1) for task in tasks)
    while waiting:
        with workers.executor() as executor:
            running: dict[Future[R], tuple[T, int]] = {}
            started, usable = 0, True
            while running or (waiting and usable):
                while waiting and usable:
                    concurrent = (waiting[0], *running.values())
                    most = max(attempts for _, attempts in concurrent)
                    runs_alone = most == workers.attempts > 1
                    if len(running) >= (1 if runs_alone else workers.places()):
                        break
                    try:
                        with uninterrupted_start():
                            future = executor.submit(function, waiting[0][0])
                    except BrokenExecutor:
                        usable = False
                        break
                    running[future] = waiting.popleft()
                    started += 1
                    usable = started != workers.renewed_after
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    task, attempts = running.pop(future)
                    try:
                        result: R | Exception = future.result()
                    except Exception as reason:  # noqa: BLE001
                        usable = usable and not isinstance(reason, BrokenExecutor)
                        if attempts < workers.attempts and not isinstance(
                            reason, ExperimentError
                        ):
                            waiting.appendleft((task, attempts + 1))
                            continue
                        result = reason
                    yield TaskResult(task, attempts, result)


@contextmanager
def uninterrupted_start() -> Iterator[None]:
    """Block Ctrl-C in processes that are started in a block, from their first instant.

    A terminal sends Ctrl-C to all processes; only the parent handles it.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class LocalWorkers:
    """Processes of this machine, each with one thread, that end with their parent.

    Parameters
    ----------
    jobs : int
        Number of processes.
    attempts : int
        Greatest number of attempts at a task.
    """

    def __init__(self, jobs: int, *, attempts: int = ATTEMPTS) -> None:
        self._jobs = jobs
        self.attempts = attempts
        self.renewed_after: int | None = jobs * _TASKS_OF_A_PROCESS

    @contextmanager
    def executor(self) -> Iterator[Executor]:
        """Return an executor of new processes, which end with its context."""
        settings = dict.fromkeys(_THREADS, "1")
        settings[_ALLOCATOR] = os.environ.get(_ALLOCATOR, _FREE_LISTS)
        environment = {name: os.environ.get(name) for name in settings}
        os.environ.update(settings)
        context = get_context("spawn")
        reader, writer = context.Pipe(duplex=False)
        executor = ProcessPoolExecutor(
            self._jobs, mp_context=context, initializer=_end_with, initargs=(reader,)
        )
        try:
            yield executor
        finally:
            writer.close()
            executor.shutdown(cancel_futures=True)
            reader.close()
            for name, value in environment.items():
                os.environ.pop(name)
                if value is not None:
                    os.environ[name] = value

    def places(self) -> int:
        """Return the number of processes."""
        return self._jobs


def _end_with(reader: Connection) -> None:
    """End this process when the other end of a pipe is closed.

    The operating system closes the parent's end of the pipe even if the parent is killed.
    Only the parent handles Ctrl-C.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        try:
            reader.recv()
        except (EOFError, OSError):
            os._exit(1)

    Thread(target=watch, daemon=True).start()


class ClusterWorkers:
    """Workers of a Dask cluster, which must have this version of the package.

    Start them with one thread each. Tasks are sent pickled and unencrypted, unless the
    cluster's address begins with tls://.

    Parameters
    ----------
    address : str
        Of the scheduler, such as tcp://127.0.0.1:8786.
    patience : float
        Longest time to connect, s.

    Raises
    ------
    ExperimentError
        Where Dask is not installed, or the address is not HOST:PORT.
    """

    renewed_after: int | None = None
    attempts = 1

    def __init__(self, address: str, *, patience: float = 10.0) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise ExperimentError(
                "a cluster needs the extra: pip install 'fmp-drake[cluster]'."
            ) from None
        if not re.fullmatch(r"((tcp|tls|ws|wss|ucx)://)?[^/]+:\d+", address):
            raise ExperimentError(
                f"{address!r} is not the address of a cluster; give HOST:PORT, such as "
                "tcp://127.0.0.1:8786."
            )
        self._connect: Any = Client
        self._address, self._patience = address, patience
        self._client: Any = None

    @contextmanager
    def executor(self) -> Iterator[Executor]:
        """Connect, and return an executor of the cluster's workers."""
        try:
            client = self._connect(
                self._address, timeout=self._patience, set_as_default=False
            )
        except (OSError, ValueError) as reason:
            raise ExperimentError(
                f"there is no cluster at {self._address} ({reason}); start one with "
                "dask scheduler, and dask worker ADDRESS --nthreads 1."
            ) from None
        with client as self._client:
            executor: Executor = client.get_executor(pure=False, retries=ATTEMPTS - 1)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)

    def places(self) -> int:
        """Return twice the current number of workers."""
        return 2 * max(1, len(self._client.scheduler_info(n_workers=-1)["workers"]))
