"""Batches on real processes: nothing is lost, whatever dies on the way."""

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import distributed
import imageio.v3 as iio
import numpy as np
import pytest
from batch_runs import FAST, QUICK, ROOT, SLOW, assert_nothing_left_over, assert_same_maps, jobs, local, pids, wait_for
from command_line import lfgpu
from distributed.security import Security

from lfgpu.batch.cluster import BatchError, Cluster, _Task
from lfgpu.batch.items import MANIFEST_FILE, Item, find_items
from lfgpu.batch.manifest import DONE, FAILED, Manifest, read_manifest
from lfgpu.batch.run import Batch, Summary
from lfgpu.batch.work import work
from lfgpu.io import REPORT_FILE

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def undisturbed(scene_folders: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The maps of the slow settings, without Dask and without any fault but the damaged file."""
    out = tmp_path_factory.mktemp("undisturbed")
    with Manifest(out) as manifest:
        manifest.add(work(job, "cpu") for job in jobs(scene_folders, out, SLOW))
    return out


def test_a_process_can_run_one_batch_after_another(tmp_path: Path) -> None:
    """The settings of the first, in a process that has not loaded Dask yet, take nothing away from the second."""
    runs = tmp_path / "runs.py"
    runs.write_text(
        "from lfgpu.batch.cluster import Cluster\n"
        "if __name__ == '__main__':\n"
        "    for _ in range(2):\n"
        "        with Cluster(devices=('cpu',)):\n"
        "            pass\n"
    )
    done = subprocess.run([sys.executable, str(runs)], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_a_worker_that_is_killed_in_the_middle_costs_nothing(
    scene_folders: Path, undisturbed: Path, tmp_path: Path
) -> None:
    cluster, killed = local(), []

    def kill() -> None:
        wait_for(lambda: list(tmp_path.glob("scene_*")))
        for _ in range(2):
            wait_for(lambda: pids(cluster) - set(killed))
            wait_for(lambda: any(cluster.client.processing().values()))
            (pid,) = pids(cluster)
            time.sleep(0.1)  # in the middle
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    items = find_items([str(scene_folders)], sequence=False)[0]
    summary = Batch(items, tmp_path, SLOW).run(cluster)
    killer.join(60)
    assert len(set(killed)) == 2
    assert (summary.computed, summary.left, [e["item"] for e in summary.failed]) == (4, 0, ["scene_2"])
    assert_same_maps(tmp_path, undisturbed)


def slow_batch(folder: Path, out: Path) -> list[str]:
    """The command that estimates with the slow settings."""
    settings = ["--set", "prior.window=3", "--set", "sweep.step=1", "--set", "alignment.iterations=100"]
    command = ["batch", str(folder), "-o", str(out), "--preset", "fast", "--disparity-range", "-1.2,1.2"]
    return [*command, *settings, "--device", "cpu", "--threads", "1"]


def test_kills_at_random_moments_cost_nothing(
    scene_folders: Path, undisturbed: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """All processes at once, wherever they are: the start of the cluster, an item, the manifest."""
    command = slow_batch(scene_folders, tmp_path)
    for longest in (2.0, 5.0, 8.0):
        with started(["lfgpu", *command]) as process, contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(float(rng.uniform(0, longest)))
    outcome = lfgpu(*command)
    assert "lfgpu: 1 of 5 items failed: scene_2: " in outcome.err, outcome.err
    assert_same_maps(tmp_path, undisturbed)
    assert_nothing_left_over(tmp_path)


def test_the_time_of_an_item_is_not_that_of_a_clock_that_is_set_back(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(10**6, 0, -1000))
    monkeypatch.setattr("lfgpu.batch.work.time.time", lambda: float(next(clock)))
    assert 0 <= work(jobs(scene_folders, tmp_path)[0], "cpu")["seconds"] < 1000


def test_an_item_that_kills_its_worker_is_given_up_and_the_rest_goes_on(scene_folders: Path, tmp_path: Path) -> None:
    """Its neighbours are not taken for the culprit; what found no memory is tried again."""
    tried = tmp_path / "tried"
    good = scene_folders / "scene_0"

    class Deadly:
        def __fspath__(self) -> str:
            os.kill(os.getpid(), signal.SIGKILL)
            return ""

    class Scarce:
        def __init__(self, times: int) -> None:
            self.times = times

        def __fspath__(self) -> str:
            with tried.open("a") as file:
                file.write(f"{self.times}\n")
            if tried.read_text().count(f"{self.times}\n") <= self.times:
                raise MemoryError
            return str(good)

        def __str__(self) -> str:
            return str(good)

    todo = jobs(scene_folders, tmp_path)
    sources = {"deadly": Deadly(), "scarce": Scarce(1), "too scarce": Scarce(99)}
    special = [replace(todo[0], item=Item(name, source)) for name, source in sources.items()]  # type: ignore[arg-type]
    entries: dict[str, dict[str, Any]] = {}
    with local(retries=1) as cluster:
        cluster.run(
            [[job] for job in (*special, *todo[:2])],
            lambda ended: entries.update({entry["item"]: entry for entry in ended}),
        )
    assert {name: entry["status"] for name, entry in entries.items()} == {
        **{"deadly": FAILED, "too scarce": FAILED},
        **{"scarce": DONE, "scene_0": DONE, "scene_1": DONE},
    }
    assert "its worker was killed" in entries["deadly"]["error"]
    assert re.match(r"out of memory; use fewer views.*, tried 2 times\.", entries["too scarce"]["error"])
    assert entries["scarce"]["attempts"] == 2


def test_a_result_that_is_lost_is_asked_for_alone_and_then_said_so(scene_folders: Path, tmp_path: Path) -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise TimeoutError

    class Future:
        def __init__(self, status: str) -> None:
            self.status = status

        def result(self, timeout: float) -> Any:
            return "tcp://there", {"status": DONE}

    finished, lost = [Future("finished"), Future("finished")], Future("pending")
    cluster, todo = Cluster(retries=0), jobs(scene_folders, tmp_path)
    cluster.client = SimpleNamespace(sync=fails, _gather=None, status="running")
    assert cluster._results(finished) == {}
    entry = cluster._outcome(finished[0], None, _Task(todo[0], deque()))
    assert entry == {"status": DONE, "attempts": 1}
    entry = cluster._outcome(lost, None, _Task(todo[0], deque()))
    assert entry["error"] == "its result was lost with its worker, tried 1 times."
    cluster.client.status = "closed"
    entry = cluster._outcome(lost, None, _Task(todo[0], deque()))
    assert entry["error"] == "the scheduler was lost, tried 1 times."


@contextlib.contextmanager
def started(arguments: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A process group of its own, which does not outlive the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_interruption_is_clean_and_the_next_run_goes_on(scene_folders: Path, undisturbed: Path, tmp_path: Path) -> None:
    """The fourth item takes very long at first, so that there is something to interrupt however late that comes."""
    folder, out_folder = tmp_path / "in", tmp_path / "out"
    shutil.copytree(scene_folders, folder)
    long, short = folder / "scene_3", tmp_path / "short"
    shutil.copytree(long, short)
    for truth in long.glob("*.pfm"):
        truth.unlink()
    for picture in long.glob("*.png"):
        iio.imwrite(picture, np.tile(iio.imread(picture), (40, 40, 1)))
    command = slow_batch(folder, out_folder)
    with started(["lfgpu", *command]) as process:
        wait_for(lambda: "scene_0" in read_manifest(out_folder))
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does it: all processes get it
        out, err = process.communicate(timeout=600)
    assert process.returncode == 130, err
    assert re.fullmatch(r"lfgpu: interrupted after \d of 5 items; run the same command again to continue\.\n", err), err
    assert out == ""
    before = sum(entry["status"] == DONE for entry in read_manifest(out_folder).values())
    assert 1 <= before < 4
    shutil.rmtree(long)
    short.rename(long)
    outcome = lfgpu(*command)
    assert outcome.code == 1, outcome.err
    assert re.match(r"lfgpu: 1 of 5 items failed: scene_2: .*input_Cam004\.png", outcome.err)
    assert f"{4 - before} computed, {before} kept from before" in outcome.out
    assert (out_folder / REPORT_FILE).is_file()
    assert_same_maps(out_folder, undisturbed)
    assert_nothing_left_over(out_folder)


def test_ctrl_c_while_workers_start_ends_the_batch_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was ignored."""
    closed, mask = [], signal.pthread_sigmask(signal.SIG_BLOCK, [])

    @contextlib.contextmanager
    def starting(self: Cluster) -> Iterator[None]:
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])  # which the workers inherit
        os.kill(os.getpid(), signal.SIGINT)
        yield
        closed.append(self)

    monkeypatch.setattr(Cluster, "_local", starting)
    with pytest.raises(KeyboardInterrupt), local():
        pytest.fail("the cluster was used")
    assert len(closed) == 1
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == mask


def test_processes_that_start_while_ctrl_c_waits_ignore_it() -> None:
    """The first process of a program starts another one, which tracks resources, and unblocked Ctrl-C after that."""
    code = (
        "import signal\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "from multiprocessing import resource_tracker\n"
        "from lfgpu.batch.cluster import _ctrl_c_waits\n"
        "def start():\n"
        "    resource_tracker.getfd()\n"
        "    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
        "with _ctrl_c_waits(), ThreadPoolExecutor() as pool:\n"
        "    print(pool.submit(start).result())\n"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout == "True\n"


def test_ctrl_c_among_results_ends_the_batch(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask sends a message from the destructor of each result, in which Python dropped it: all items were done."""
    release = distributed.Future.release

    def releasing(self: Any) -> None:
        if threading.current_thread() is threading.main_thread():
            monkeypatch.undo()
            signal.raise_signal(signal.SIGINT)
        release(self)

    monkeypatch.setattr(distributed.Future, "release", releasing)
    options = ["--preset", "fast", "--disparity-range", "-1.2,1.2", "--set", "alignment.iterations=100"]
    outcome = lfgpu("batch", scene_folders, "-o", tmp_path / "out", *options, "--device", "cpu")
    assert outcome.code == 130, outcome.err
    assert re.search(r"^lfgpu: interrupted after \d of 5 items; ", outcome.err), outcome.err


def test_a_full_disk_fails_items_and_room_brings_them_back(
    scene_folders: Path, undisturbed: Path, tmp_path: Path
) -> None:
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=160k", "tmpfs", str(tmp_path)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("a small file system cannot be mounted here")
    try:
        items = find_items([str(scene_folders)], sequence=False)[0]
        batch = Batch(items, tmp_path, SLOW)
        with contextlib.suppress(BatchError):  # where there was no room for the manifest either
            batch.run(local())
        assert batch.summary.computed < 4
        assert any("No space left" in entry["error"] for entry in batch.summary.failed)
        assert_nothing_left_over(tmp_path)
        subprocess.run(["mount", "-o", "remount,size=16m", str(tmp_path)], check=True)
        second = Batch(items, tmp_path, SLOW).run(local())
        assert [entry["item"] for entry in second.failed] == ["scene_2"]
        assert second.kept + second.computed == 4
        assert second.computed > 0
        assert_same_maps(tmp_path, undisturbed)
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def test_a_scheduler_that_is_started_again_costs_nothing(
    scene_folders: Path, undisturbed: Path, tmp_path: Path
) -> None:
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    items, problems = find_items([str(scene_folders)], sequence=False)[0], []
    summary: list[Summary] = []

    def run() -> None:
        try:
            summary.append(Batch(items, tmp_path, SLOW).run(Cluster(scheduler=address, devices=("cpu",), threads=1)))
        except Exception as error:
            problems.append(error)

    batch = threading.Thread(target=run, daemon=True)
    with started(scheduler), started(worker):
        batch.start()
        wait_for(lambda: "scene_0" in read_manifest(tmp_path) or problems)
    with started(scheduler), started(worker):
        batch.join(120)
        assert not problems, problems
        assert not batch.is_alive()
    assert (summary[0].computed, len(summary[0].failed)) == (4, 1)
    assert_same_maps(tmp_path, undisturbed)


def assert_nobody_is_answered(address: str) -> None:
    """Neither who has no certificate nor who has another one."""
    for tried, security in ((address.replace("tls", "tcp"), None), (address, Security.temporary())):
        with pytest.raises(OSError, match=r"."):
            distributed.Client(tried, security=security, timeout=3)


def test_a_cluster_with_certificates_of_ones_own(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `docs/batch.md` says of tls:// works, and nobody else is answered."""
    page = (ROOT / "docs" / "batch.md").read_text(encoding="utf-8")
    made = re.findall(r"^    (openssl .*)$", page, re.MULTILINE)
    for command in made:
        subprocess.run(shlex.split(command), cwd=tmp_path, check=True, capture_output=True)
    settings = re.search(r"```yaml\n(# ~/.config/dask/tls.yaml.*?)```", page, re.DOTALL)
    assert len(made) == 3
    (tmp_path / "tls.yaml").write_text(settings[1].replace("/secret", str(tmp_path)))
    monkeypatch.setenv("DASK_CONFIG", str(tmp_path / "tls.yaml"))
    port = free_port()
    address = f"tls://127.0.0.1:{port}"
    scheduler = ["distributed.cli.dask_scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port", str(port)]
    worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    batch = [sys.executable, "-m", "lfgpu", "batch", str(scene_folders), "-o", str(tmp_path / "out"), "--device=cpu"]
    batch += ["--preset=fast", "--disparity-range=-1.2,1.2", "--scheduler", address]
    with started([*scheduler, "--no-dashboard"]), started(worker):
        done = subprocess.run(batch, capture_output=True, text=True, timeout=300, check=False)
        assert_nobody_is_answered(address)
    entries = read_manifest(tmp_path / "out")
    assert sorted(entry["status"] for entry in entries.values()) == [DONE] * 4 + [FAILED], done.stderr


def test_five_hundred_light_fields_come_out(tmp_path: Path, rng: np.random.Generator) -> None:
    inputs, texture = tmp_path / "in", rng.random((64, 64, 3))
    inputs.mkdir()
    for index in range(500):
        at = 8 + index % 20
        views = [[texture[at + v : at + v + 24, at + u : at + u + 24] for u in range(3)] for v in range(3)]
        np.save(inputs / f"{index}.npy", (np.asarray(views) * 255).astype(np.uint8))
    settings = replace(FAST, config=QUICK.with_values({"sweep.noise": 0.004}))
    items = find_items([str(inputs)], sequence=False)[0]
    summary = Batch(items, tmp_path / "out", settings).run(Cluster(workers=2, devices=("cpu",), threads=1))
    assert (summary.computed, len(summary.failed)) == (500, 0)
    lines = (tmp_path / "out" / MANIFEST_FILE).read_text().splitlines()
    assert len([line for line in lines if "item" in json.loads(line)]) == 500
    assert len(list((tmp_path / "out").glob("*/disparity.pfm"))) == 500


class _Stuck:
    """A file on which a reader is stuck for ever, with the interpreter lock if it likes."""

    def __init__(self, at_work: Path, *, holds_lock: bool) -> None:
        self.at_work, self.holds_lock = at_work, holds_lock

    def __fspath__(self) -> str:
        self.at_work.touch()
        if self.holds_lock:
            re.match(r"(a|aa)+$", "a" * 100 + "b")
        threading.Event().wait()
        return ""


@pytest.mark.parametrize("holds_lock", [False, True])
def test_an_item_that_never_ends_is_given_up_and_the_rest_goes_on(
    scene_folders: Path, tmp_path: Path, holds_lock: bool
) -> None:
    import cloudpickle

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    todo = jobs(scene_folders, tmp_path)
    stuck = replace(todo[0], item=Item("stuck", _Stuck(tmp_path / "at_work", holds_lock=holds_lock)))  # type: ignore[arg-type]
    entries: dict[str, dict[str, Any]] = {}
    try:
        with local() as cluster:
            cluster.run([[todo[0]]], lambda ended: None)  # kernels are loaded before time counts
            cluster._item_timeout = 20
            cluster.run(
                [[stuck, todo[1]], [todo[3]]], lambda ended: entries.update({entry["item"]: entry for entry in ended})
            )
    finally:
        cloudpickle.unregister_pickle_by_value(sys.modules[__name__])
    assert (tmp_path / "at_work").exists()
    assert {name: entry["status"] for name, entry in entries.items()} == {
        **{"stuck": FAILED, "scene_1": DONE, "scene_3": DONE}
    }
    assert entries["stuck"]["error"] == "it took more than 20 s, the time for an item (--item-timeout)."


def test_others_on_the_machine_do_not_reach_a_local_cluster() -> None:
    with local() as cluster:
        address = cluster.client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        (worker,) = cluster.client.scheduler_info()["workers"].values()
        shared = Path(tempfile.gettempdir())
        folder = shared / Path(worker["local_directory"]).relative_to(shared).parts[0]
        assert folder.stat().st_mode & 0o077 == 0  # workers import from it
        assert_nobody_is_answered(address)
    assert not folder.exists()


def test_a_worker_that_is_killed_while_the_cluster_starts_is_no_traceback(
    scene_folders: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    import psutil

    killed: list[int] = []

    def kill() -> None:
        wait_for(
            lambda: [c for c in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(c.cmdline())]
        )
        for child in psutil.Process().children(recursive=True):
            if "spawn_main" in " ".join(child.cmdline()):
                child.kill()
                killed.append(child.pid)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    summary = Batch(find_items([str(scene_folders / "scene_0")], sequence=False)[0], tmp_path, FAST).run(local())
    killer.join(60)
    assert killed
    assert (summary.computed, summary.left) == (1, 0)
    assert "Traceback" not in capfd.readouterr().err
