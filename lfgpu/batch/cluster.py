"""Jobs on a Dask cluster: their order, and their fate when a worker or the scheduler dies.

Dask repeats a job whose worker died, up to a limit. A job over the limit may be innocent, if another job on the same
worker was the cause; so it is tried once more at the end, alone. Jobs that are lost with a scheduler are submitted
again when the scheduler is back.
"""

import importlib.util
import logging
import math
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from tempfile import TemporaryDirectory
from typing import Any, Self

from lfgpu.batch.work import Job, OutOfMemory, work
from lfgpu.errors import LfgpuError
from lfgpu.io.damage import how_to_install
from lfgpu.threads import on_signal, set_threads

ITEM_TIMEOUT = 7200.0
"""Seconds that an item may take by default: ten times as long as large ones take on two cores."""

_CONNECTING = 30.0  # seconds to wait for an answer of the scheduler
_PATIENCE = 300.0  # seconds in which a lost scheduler may come back
_REPLACED = 60.0  # seconds after which a worker that died and does not come back is replaced
_STARTS = 3  # of a local cluster
_LOOK = 0.2  # seconds between two polls

Entry = dict[str, Any]


class BatchError(LfgpuError):
    """A batch cannot continue, or items of it failed."""


@dataclass
class _Task:
    """A job, the jobs after it in its sequence, and its history."""

    job: Job
    after: deque[Job]
    attempts: int = 0
    alone: bool = False
    worker: str | None = None
    errors: list[str] = field(default_factory=list)
    since: float = 0.0  # time when it was given to a worker, or last seen to wait for one


class Cluster:
    """A local cluster of `workers` processes, or the existing cluster of a `scheduler`. Use it in a `with` block.

    Workers take the `devices` in turn. An item whose worker dies is tried again `retries` times; after `item_timeout`
    seconds it is given up, and its worker started anew. BatchError if Dask is missing or the scheduler does not answer.
    """

    def __init__(
        self,
        *,
        scheduler: str | None = None,
        workers: int = 1,
        devices: Sequence[str] = (),
        threads: int | None = None,
        retries: int = 3,
        item_timeout: float = ITEM_TIMEOUT,
    ) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise BatchError(f"a batch needs Dask, which is not installed; {how_to_install('batch')}.")
        if scheduler is None and importlib.util.find_spec("cryptography") is None:
            raise BatchError(
                f"a local cluster needs cryptography, which is not installed, to keep others out; "
                f"{how_to_install('batch')}."
            )
        self._scheduler, self._workers, self._devices, self._threads = scheduler, workers, tuple(devices), threads
        self._retries, self._item_timeout = retries, item_timeout
        self._stack = ExitStack()
        self.client: Any = None
        """The client of Dask."""
        self._cluster: Any = None
        self._complete = time.monotonic()
        """The time when all workers were last alive."""
        self._running: dict[Any, _Task] = {}
        self._woken = threading.Event()

    def __enter__(self) -> Self:
        import dask
        import distributed  # noqa: F401  # its defaults come first: with the settings, those after them would go

        # The scheduler reads the number of retries when it starts.
        settings: dict[str, Any] = {
            "distributed.scheduler.allowed-failures": self._retries,
            "distributed.scheduler.worker-saturation": 1.0,  # no job is queued on a worker that another job may kill
            "distributed.worker.daemon": True,
            # It goes by the clock of the day, which may jump; processes that died are seen without it.
            "distributed.scheduler.worker-ttl": None,
            # Pages about a cluster can be read by everybody on the machine, and some of them give orders.
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
            "distributed.deploy.lost-worker-timeout": "1 hour",  # a busy machine needs long to start a new worker
        }
        if self._scheduler is None:
            # Dask's own folder has one name for all users of a machine, and Python imports from it.
            place = dask.config.get("temporary-directory", None)
            folder = TemporaryDirectory(prefix="lfgpu-", dir=place, ignore_cleanup_errors=True)
            settings["temporary-directory"] = self._stack.enter_context(folder)
        self._stack.enter_context(dask.config.set(settings))
        try:
            if self._scheduler is None:
                self._start()
            else:
                self._connect()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):  # lost jobs are not in the manifest, so the next run repeats them
            self.client.cancel(list(self._running), force=True)
        self._running.clear()
        self._cluster = None
        self._stack.close()

    @property
    def dashboard(self) -> str | None:
        """Address of the dashboard of an existing scheduler; a local cluster has none, as others could read it."""
        return None if self._scheduler is None else self.client.dashboard_link or None

    @property
    def size(self) -> int:
        """Number of jobs that can run at the same time: the threads of all workers."""
        with suppress(Exception):
            return sum(self.client.nthreads().values())
        return 0

    def run(
        self,
        sequences: Sequence[Sequence[Job]],
        done: Callable[[list[Entry]], None],
        tick: Callable[[int], None] = lambda _: None,
    ) -> None:
        """Run all jobs. Those of a sequence run in order, and on one worker while it lives.

        `done` takes the manifest entries of jobs that ended, before new jobs start; `tick` takes the number of jobs
        that can run at the same time, a few times a second. BatchError if the scheduler is lost and does not come back.
        """
        waiting = deque(_Task(jobs[0], deque(jobs[1:])) for jobs in map(list, sequences) if jobs)
        suspects: deque[_Task] = deque()
        size, looked = 0, -math.inf
        while waiting or suspects or self._running:
            if self._is_there():
                if (now := time.monotonic()) - looked >= _LOOK:
                    size, looked = self.size, now
                    self._replace_lost(size)
                    late = self._give_up_late()
                    if late:
                        done(late)
                    tick(size)
                while waiting and len(self._running) < size:
                    self._submit(waiting.popleft())
                if suspects and not waiting and not self._running and size:
                    self._submit(suspects.popleft())
            self._woken.wait(_LOOK)
            self._woken.clear()
            ended = [future for future in self._running if future.done()]
            results = self._results(ended)
            entries: list[Entry] = []
            try:
                for future in ended:
                    task = self._running.pop(future)
                    entry = self._outcome(future, results.get(future), task)
                    if entry is None:
                        (suspects if task.alone else waiting).appendleft(task)
                        continue
                    entries.append(entry)
                    if task.after:
                        waiting.appendleft(_Task(task.after.popleft(), task.after, worker=task.worker))
            finally:
                if entries:
                    done(entries)

    def _start(self) -> None:
        from distributed import Client

        for name in ("distributed", "asyncio", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        with _ctrl_c_waits():  # while the workers start
            self._cluster = self._stack.enter_context(self._local())
        self.client = self._stack.enter_context(Client(self._cluster))

    def _local(self) -> Any:
        """Start a local cluster; if a worker dies meanwhile, perhaps for want of memory, start it anew."""
        from distributed import LocalCluster
        from distributed.security import Security
        from distributed.system import MEMORY_LIMIT

        reason = ""
        for _ in range(_STARTS):
            try:
                return LocalCluster(
                    n_workers=self._workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    # Whoever reaches a scheduler runs what he likes as its user: nobody without the certificate does.
                    protocol="tls://",
                    security=Security.temporary(),
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=MEMORY_LIMIT // self._workers,
                    silence_logs=logging.CRITICAL,
                    preload=["lfgpu.batch.worker_process"],
                )
            except (OSError, RuntimeError, TimeoutError) as error:
                reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise BatchError(
            f"the local cluster did not start in {_STARTS} tries ({reason}); its workers may have been killed for want "
            "of memory: take fewer (--workers)."
        )

    def _connect(self) -> None:
        from distributed import Client

        for name in ("distributed", "distributed.client", "distributed.core"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self.client = Client(self._scheduler, timeout=_CONNECTING)
        except (OSError, TimeoutError, ValueError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BatchError(
                f"the scheduler {self._scheduler} does not answer ({reason[:200]}); check the address, and that it is "
                "running."
            ) from error
        self._stack.callback(lambda: self.client.close(timeout=5))

    def _is_there(self) -> bool:
        """Ask whether the scheduler answers. If it is lost, wait for it to come back."""
        if self.client.status == "running":
            return True
        if self._scheduler is None:
            raise BatchError("the local cluster has ended; run the same command again to continue.")
        if self.client.status == "connecting":
            return False
        since = time.monotonic()
        while time.monotonic() - since < _PATIENCE:
            with suppress(BatchError):
                self._connect()
                return True
            time.sleep(1)
        raise BatchError(
            f"the scheduler {self._scheduler} was lost and has not come back in {_PATIENCE:g} s; run the same command "
            "again to continue."
        )

    def _replace_lost(self, size: int) -> None:
        """Replace dead workers of a local cluster that have not come back for a while."""
        now = time.monotonic()
        if self._cluster is None or size >= self._workers:
            self._complete = now
        elif now - self._complete > _REPLACED:
            self._cluster.scale(self._workers)
            self._complete = now

    def _give_up_late(self) -> list[Entry]:
        """Give up items that took too long and restart their workers; returns their manifest entries."""
        now = time.monotonic()
        late = [future for future, task in self._running.items() if now - task.since > self._item_timeout]
        if not late:
            return []
        held: dict[str, list[str]] = {}
        with suppress(Exception):  # the scheduler is lost, which is seen elsewhere
            held = {worker: [str(key) for key in keys] for worker, keys in self.client.processing().items()}
        entries = []
        for future in late:
            workers = [worker for worker, keys in held.items() if str(future.key) in keys]
            if future.done():
                continue
            if not workers:  # it waits, on a scheduler that others use too
                self._running[future].since = now
                continue
            task = self._running.pop(future)
            with suppress(Exception):
                self.client.cancel([future], force=True)
            with suppress(Exception):
                self.client.restart_workers(workers, timeout=_REPLACED, raise_for_error=False)
            task.errors.append(f"it took more than {self._item_timeout:g} s, the time for an item (--item-timeout)")
            entries.append(self._entry(task, f"{task.errors[-1]}.", task.attempts + 1))
            if task.after:
                self._submit(_Task(task.after.popleft(), task.after))
        return entries

    def _submit(self, task: _Task) -> None:
        there = {} if task.worker is None else {"workers": [task.worker], "allow_other_workers": True}
        future = self.client.submit(_on_worker, task.job, self._devices, self._threads, pure=False, retries=0, **there)
        future.add_done_callback(lambda _: self._woken.set())
        task.since = time.monotonic()
        self._running[future] = task

    def _results(self, ended: Sequence[Any]) -> dict[Any, tuple[str, Entry]]:
        """Fetch the results of jobs together; missing ones have to be fetched one by one."""
        finished = [future for future in ended if future.status == "finished"]
        if len(finished) > 1:
            with suppress(Exception):  # some results were lost
                gathered = self.client.sync(self.client._gather, finished, callback_timeout=_CONNECTING)
                return dict(zip(finished, gathered, strict=True))
        return {}

    def _outcome(self, future: Any, result: tuple[str, Entry] | None, task: _Task) -> Entry | None:
        """Make the manifest entry of a task; None if it is to be tried again."""
        from distributed import KilledWorker

        if future.status == "finished":
            try:
                task.worker, entry = result or future.result(timeout=_CONNECTING)
                return {**entry, "attempts": task.attempts + 1}
            except Exception as error:  # the result was lost
                return self._again(task, f"{type(error).__name__}")
        if future.status != "error":
            there = self.client.status == "running"
            return self._again(task, "its result was lost with its worker" if there else "the scheduler was lost")
        try:
            raised = future.exception(timeout=_CONNECTING)
        except Exception as error:
            return self._again(task, f"{type(error).__name__}")
        if isinstance(raised, OutOfMemory):
            return self._again(task, str(raised).rstrip("."))
        if isinstance(raised, KilledWorker):
            task.errors.append("its worker was killed, by a signal or because it used too much memory")
            if task.alone:
                return self._failed(task)
            task.alone, task.attempts = True, 0
            return None
        task.errors.append(f"{type(raised).__name__}: {' '.join(str(raised).split())[:300]}")
        return self._failed(task)

    def _again(self, task: _Task, reason: str) -> Entry | None:
        task.errors.append(reason)
        task.attempts += 1
        task.worker = None
        return None if task.attempts <= self._retries else self._failed(task)

    def _failed(self, task: _Task) -> Entry:
        return self._entry(task, f"{task.errors[-1]}, tried {self._retries + 1} times.", self._retries + 1)

    def _entry(self, task: _Task, error: str, attempts: int) -> Entry:
        """Make the manifest entry of an item that failed."""
        return {**task.job.entry, "error": error, "began": time.time(), "seconds": 0.0, "attempts": attempts}


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Raise Ctrl-C at the end of this block; the processes that are started in it ignore it."""
    mask = getattr(signal, "pthread_sigmask", lambda *_: None)
    if hasattr(signal, "pthread_sigmask"):  # Windows has none
        resource_tracker.ensure_running()  # else the thread that starts the first process does, and unblocks it
    pressed: list[int] = []
    with on_signal(signal.SIGINT, lambda sign, _: pressed.append(sign)):
        mask(signal.SIG_BLOCK, {signal.SIGINT})  # of this thread; new threads and their processes inherit it
        try:
            yield
        finally:
            mask(signal.SIG_UNBLOCK, {signal.SIGINT})
    if pressed:
        raise KeyboardInterrupt


def _on_worker(job: Job, devices: tuple[str, ...], threads: int | None) -> tuple[str, Entry]:
    """Do a job on a worker; returns the address of the worker and the manifest entry."""
    from distributed import get_worker

    worker = get_worker()
    if threads is not None:
        set_threads(threads)
    device = devices[int(worker.name) % len(devices)] if devices and str(worker.name).isdigit() else None
    return worker.address, {**work(job, device), "worker": str(worker.name)}
