"""Facts about tasks in many processes."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from trials_stub import AtOnce, square

from fmp_drake.errors import ExperimentError
from fmp_drake.processes import ATTEMPTS, ClusterWorkers, LocalWorkers, run_tasks

DRIVER = """
import sys
from trials_stub import AtOnce, square
from fmp_drake.processes import LocalWorkers, run_tasks
if __name__ == "__main__":
    for _ in run_tasks(square, [(sys.argv[1], i, 60, "") for i in range(4)], LocalWorkers(2)):
        pass
"""


def begun(folder):
    """Return the numbers of the tasks that were begun, and by which processes."""
    path = folder / "begun"
    lines = path.read_text().splitlines() if path.exists() else []
    return [int(line.split()[0]) for line in lines], {
        int(line.split()[1]) for line in lines
    }


def alive(pid):
    """Return whether a process still runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


def wait_until(true, seconds=30):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_every_task_is_done_once(tmp_path):
    tasks = [(tmp_path, i, 0, "") for i in range(9)]
    done = list(run_tasks(square, tasks, LocalWorkers(2)))
    assert sorted(d.result for d in done) == [i**2 for i in range(9)]
    assert {d.attempts for d in done} == {1}
    assert sorted(begun(tmp_path)[0]) == list(range(9))


def test_processes_have_one_thread_and_long_lists_of_free_blocks(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
    done = run_tasks(os.getenv, ["OMP_NUM_THREADS", "GLIBC_TUNABLES"], LocalWorkers(1))
    values = {task: value for task, _, value in done}
    assert values["OMP_NUM_THREADS"] == "1"
    assert values["GLIBC_TUNABLES"] == "glibc.malloc.tcache_count=100"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "GLIBC_TUNABLES" not in os.environ


def test_processes_keep_the_settings_of_an_allocator(monkeypatch):
    monkeypatch.setenv("GLIBC_TUNABLES", "glibc.malloc.mxfast=0")
    (done,) = run_tasks(os.getenv, ["GLIBC_TUNABLES"], LocalWorkers(1))
    assert done.result == os.environ["GLIBC_TUNABLES"] == "glibc.malloc.mxfast=0"


def test_task_of_a_killed_process_is_repeated(tmp_path):
    tasks = [(tmp_path, i, 0.1, "kill once" if i == 1 else "") for i in range(5)]
    done = {d.task[1]: d for d in run_tasks(square, tasks, LocalWorkers(2))}
    assert [done[i].result for i in range(5)] == [0, 1, 4, 9, 16]
    assert done[1].attempts == 2
    assert not any(alive(pid) for pid in begun(tmp_path)[1])


def test_task_that_ends_its_process_is_given_up_and_no_other(tmp_path):
    tasks = [(tmp_path, i, 0.1, "kill" if i == 1 else "") for i in range(4)]
    done = {d.task[1]: d for d in run_tasks(square, tasks, LocalWorkers(2))}
    assert isinstance(done[1].result, Exception)
    assert [done[i].result for i in (0, 2, 3)] == [0, 4, 9]
    assert begun(tmp_path)[0].count(1) == ATTEMPTS


def test_processes_are_replaced_after_some_tasks(tmp_path):
    workers = LocalWorkers(1)
    workers.renewed_after = 2
    tasks = [(tmp_path, i, 0, "") for i in range(4)]
    assert len(list(run_tasks(square, tasks, workers))) == 4
    assert len(begun(tmp_path)[1]) == 2


class Breaking:
    """Workers whose first executor takes one task and no other."""

    renewed_after, attempts = None, 2

    def __init__(self):
        self.executors = 0

    @contextmanager
    def executor(self):
        self.executors += 1
        first, taken = self.executors == 1, []

        class Executor(AtOnce):
            def submit(self, *call):
                if first and taken:
                    raise BrokenExecutor("a process has ended")
                taken.append(call)
                return super().submit(*call)

        with Executor() as executor:
            yield executor

    def places(self):
        return 2


def test_task_that_a_broken_executor_does_not_take_is_done_by_the_next(tmp_path):
    workers = Breaking()
    tasks = [(tmp_path, i, 0, "") for i in range(3)]
    done = {d.task[1]: d for d in run_tasks(square, tasks, workers)}
    assert [done[i].result for i in range(3)] == [0, 1, 4]
    assert {d.attempts for d in done.values()} == {1}
    assert workers.executors == 2


def test_closing_the_iterator_ends_all_tasks(tmp_path):
    tasks = [(tmp_path, i, 0 if i == 0 else 60, "") for i in range(3)]
    running = run_tasks(square, tasks, LocalWorkers(2))
    assert next(running).result == 0
    running.close()
    assert not any(alive(pid) for pid in begun(tmp_path)[1])


def test_processes_end_when_their_driver_is_killed(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    script = tmp_path / "driver.py"
    script.write_text(DRIVER)
    driver = subprocess.Popen([sys.executable, script, tmp_path], env=environment)
    wait_until(lambda: len(begun(tmp_path)[1]) == 2)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    wait_until(lambda: not any(alive(pid) for pid in begun(tmp_path)[1]), 10)


@pytest.mark.parametrize("address", ["", "foo", "18786", "http://x:1"])
def test_address_that_is_none_is_refused(address):
    pytest.importorskip("distributed", reason="needs the extra cluster")
    with pytest.raises(
        ExperimentError, match="is not the address of a cluster; give HOST:PORT"
    ):
        ClusterWorkers(address)


def test_cluster_that_is_not_there_is_named():
    pytest.importorskip("distributed", reason="needs the extra cluster")
    workers = ClusterWorkers("tcp://127.0.0.1:1", patience=1.0)
    with pytest.raises(ExperimentError, match=r"no cluster at tcp://127.0.0.1:1 "):
        list(run_tasks(square, [()], workers))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExperimentError, match=r"pip install 'fmp-drake\[cluster\]'"):
        ClusterWorkers("tcp://127.0.0.1:8786")
