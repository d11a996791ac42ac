"""Batches: what is found, what the manifest remembers, and that nothing is lost, whatever dies on the way."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lfgpu import DepthPipeline, LightFieldError, estimate_depth, scenes
from lfgpu._backends import load
from lfgpu.batch.cluster import BatchError, Cluster, _Task
from lfgpu.batch.items import Item, find_items, fingerprint
from lfgpu.batch.manifest import DONE, FAILED, MANIFEST_FILE, Manifest, damaged_lines, key_of, read_manifest, standing
from lfgpu.batch.report import REPORT_FILE, write_report
from lfgpu.batch.run import Batch, Summary, _jobs
from lfgpu.batch.work import Settings, work
from lfgpu.cli import app
from lfgpu.io import read, read_result, write_hci
from lfgpu.methods import method_of, preset

pytest.importorskip("distributed", reason="a batch needs Dask: pip install -e '.[batch]'")

ROOT = Path(__file__).parents[1]
RANGE = (-1.2, 1.2)
QUICK = preset("fast").with_values({"prior.window": 3, "sweep.step": 1.0})
FAST = Settings(QUICK, RANGE)
SLOW = Settings(QUICK.with_values({"alignment.iterations": 100}), RANGE)
"""Settings with which an item takes long enough to be killed in the middle."""
COUNT = 5


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of light fields, one of which cannot be read."""
    folder = tmp_path_factory.mktemp("recorded") / "scenes"
    for index in range(COUNT):
        lf = scenes.make("relief", grid=(3, 3), size=(40, 48), disparity_range=(-1, 1), seed=index)
        write_hci(lf, folder / f"scene_{index}")
    damaged = folder / "scene_2" / "input_Cam004.png"
    damaged.write_bytes(damaged.read_bytes()[:200])
    return folder


@pytest.fixture(scope="module")
def undisturbed(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the slow settings make of it, without Dask and without anything going wrong but the damaged file."""
    out = tmp_path_factory.mktemp("undisturbed")
    with Manifest(out) as manifest:
        manifest.add(work(job, "cpu") for job in jobs(recorded, out, SLOW))
    return out


def jobs(inputs: Path, out: Path, settings: Settings = FAST, *, sequence: bool = False) -> list[Any]:
    return _jobs(find_items([str(inputs)], sequence=sequence)[0], out, settings)


def local(**options: Any) -> Cluster:
    return Cluster(workers=1, devices=("cpu",), threads=1, **options)


def lfgpu(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def pids(cluster: Cluster) -> set[int]:
    """Those of the workers that answer.

    Not of `os.getpid` itself: Dask asks for the signature of what it calls, Python parses that of a built-in function,
    and no thread may do so while another one imports Warp, which parses its kernels (a fault of Python 3.11).
    """
    with contextlib.suppress(Exception):
        return set(cluster.client.run(lambda: os.getpid(), on_error="ignore").values())
    return set()


def assert_same_maps(a: Path, b: Path) -> None:
    names = {entry["item"] for entry in read_manifest(a).values() if entry["status"] == DONE}
    assert names
    assert names == {entry["item"] for entry in read_manifest(b).values() if entry["status"] == DONE}
    for name in names:
        assert (a / name / "disparity.pfm").read_bytes() == (b / name / "disparity.pfm").read_bytes(), name
        ours, theirs = read_result(a / name / "result.npz"), read_result(b / name / "result.npz")
        assert np.array_equal(ours.confidence, theirs.confidence), name


def assert_nothing_left_over(out: Path) -> None:
    assert not list(out.rglob(".lfgpu-*"))


def wait_for(true: Callable[[], object], seconds: float = 600) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


# --- what there is to do ---


def test_light_fields_are_found_at_any_depth_and_named(recorded: Path, tmp_path: Path) -> None:
    shutil.copytree(recorded / "scene_0", tmp_path / "a" / "one")
    shutil.copytree(recorded / "scene_0", tmp_path / "a" / "b" / "two")
    shutil.copytree(recorded / "scene_0", tmp_path / "c" / "one")
    np.save(tmp_path / "a" / "third.npy", np.zeros((3, 3, 16, 16, 3), np.uint8))
    (tmp_path / "a" / "empty").mkdir()
    (tmp_path / "a" / "notes.txt").write_text("nothing")
    items, barren = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["two", "a/one", "third.npy", "c/one"]
    assert [path.name for path in barren] == ["empty"]
    assert {item.sequence for item in items} == {""}


@pytest.mark.parametrize("name", ["scan_2²", "scan_٣", "①"])
def test_digits_that_are_no_numbers_are_parts_of_names(name: str, recorded: Path, tmp_path: Path) -> None:
    shutil.copytree(recorded / "scene_0", tmp_path / "in" / name)
    items, _ = find_items([str(tmp_path / "in")], sequence=True)
    assert [item.name for item in items] == [name]


def test_patterns_order_and_outputs(recorded: Path, tmp_path: Path) -> None:
    for number in (2, 10, 1):
        shutil.copytree(recorded / "scene_0", tmp_path / f"frame_{number}")
    shutil.copytree(recorded / "scene_0", tmp_path / "out" / "frame_1")
    items, _ = find_items([str(tmp_path / "frame_*"), str(tmp_path / "frame_1")], sequence=True)
    assert [item.name for item in items] == ["frame_1", "frame_2", "frame_10"]
    assert {item.sequence for item in items} == {str(tmp_path)}
    items, _ = find_items([str(tmp_path)], sequence=False, leave_out=tmp_path / "out")
    assert len(items) == 3


def test_pictures_beside_light_fields_are_none(recorded: Path, tmp_path: Path) -> None:
    """A thumbnail or two do not hide the folders; images that are views are not hidden by a folder of fewer."""
    for name in ("one", "two"):
        shutil.copytree(recorded / "scene_0", tmp_path / "a" / name)
    for number in range(3):
        shutil.copy(recorded / "scene_0" / "input_Cam000.png", tmp_path / "a" / f"thumb{number}.png")
        items, barren = find_items([str(tmp_path / "a")], sequence=False)
        assert [item.name for item in items] == ["one", "two"]
        assert not barren
    for number in range(6):
        (tmp_path / "row" / "masks").mkdir(parents=True, exist_ok=True)
        shutil.copy(recorded / "scene_0" / "input_Cam000.png", tmp_path / "row" / f"v{number}.png")
        shutil.copy(recorded / "scene_0" / "input_Cam000.png", tmp_path / "row" / "masks" / f"m{number}.png")
    items, barren = find_items([str(tmp_path / "row")], sequence=False)
    assert [item.source for item in items] == [str(tmp_path / "row")]
    assert not barren


def test_outputs_and_other_arrays_are_no_inputs(recorded: Path, tmp_path: Path) -> None:
    shutil.copytree(recorded / "scene_0", tmp_path / "one")
    for name in ("earlier", "result"):
        shutil.copytree(recorded / "scene_0", tmp_path / name / "scene_0")
    (tmp_path / "earlier" / MANIFEST_FILE).write_text("")
    (tmp_path / "result" / "result.npz").write_bytes(b"")
    np.save(tmp_path / "weights.npy", np.zeros((9, 9)))
    np.savez(tmp_path / "calibration.npz", matrix=np.eye(3))
    items, _ = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["one"]
    (tmp_path / "one" / "result.npz").write_bytes(b"")  # which makes it no less of a light field
    items, _ = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["one"]
    items, _ = find_items([str(tmp_path / "weights.npy")], sequence=False)
    assert len(items) == 1  # who names it hears what is wrong with it


def test_a_file_whose_pages_go_in_a_circle_is_an_item(tmp_path: Path) -> None:
    header, page = struct.pack("<2sHI", b"II", 42, 8), struct.pack("<HHHIII", 1, 256, 3, 1, 16, 8)
    (tmp_path / "a.tif").write_bytes(header + page)
    assert [item.name for item in find_items([str(tmp_path)], sequence=False)[0]] == ["a.tif"]


def test_links_do_not_lead_in_circles(recorded: Path, tmp_path: Path) -> None:
    shutil.copytree(recorded / "scene_0", tmp_path / "a" / "one")
    (tmp_path / "a" / "loop").symlink_to(tmp_path / "a")
    (tmp_path / "again").symlink_to(tmp_path / "a" / "one")
    items, _ = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["one"]


def test_what_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LightFieldError, match=r"nowhere\* does not exist, and matches nothing as a pattern"):
        find_items([str(tmp_path / "nowhere*")], sequence=False)
    with pytest.raises(LightFieldError, match="no light field was found"):
        find_items([str(tmp_path)], sequence=False)


def test_fingerprints_tell_changed_files(recorded: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(recorded / "scene_0", copy)
    before = fingerprint(str(copy))
    assert fingerprint(str(copy)) == before
    (copy / "out" / "copy").mkdir(parents=True)
    (copy / "out" / "copy" / "disparity.pfm").write_bytes(b"")
    assert fingerprint(str(copy), leave_out=copy / "out") == before
    assert fingerprint(str(copy)) != before
    shutil.rmtree(copy / "out")
    os.utime(copy / "input_Cam003.png", ns=(1, 1))
    assert fingerprint(str(copy)) != before


# --- what becomes of an item ---


def test_an_item_comes_out_as_from_estimate_depth(recorded: Path, tmp_path: Path) -> None:
    job = jobs(recorded, tmp_path, Settings(preset("fast")))[0]
    entry = work(job, "cpu")
    lf = read(recorded / "scene_0")
    expected = estimate_depth(lf, config="fast", device="cpu")
    result = read_result(tmp_path / "scene_0" / "result.npz")
    assert np.array_equal(result.disparity, expected.disparity)
    assert np.array_equal(result.confidence, expected.confidence)
    assert entry["status"] == DONE
    assert entry["disparity_range"] == list(expected.disparity_range)
    assert entry["metrics"]["count"] == 10 * 18
    assert {path.name: path.stat().st_size for path in (tmp_path / "scene_0").iterdir()} == entry["sizes"]
    assert result.timings["total"] > 0


def test_a_pipeline_serves_the_next_item_and_changes_nothing(recorded: Path, tmp_path: Path) -> None:
    """With range and noise given, a worker keeps what it has allocated."""
    settings = replace(FAST, config=QUICK.with_values({"sweep.noise": 0.004}))
    for job in jobs(recorded, tmp_path, settings):
        if work(job, "cpu")["status"] == DONE:
            lf = read(job.item.source)
            expected = estimate_depth(lf, config=settings.config, disparity_range=RANGE, device="cpu")
            assert np.array_equal(read_result(tmp_path / job.item.name / "result.npz").disparity, expected.disparity)


def test_frames_have_range_and_noise_of_the_first_that_can_be_read(recorded: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    for number, scene in enumerate((2, 0, 1)):  # the first one is damaged
        shutil.copytree(recorded / f"scene_{scene}", frames / f"frame_{number}")
    settings = Settings(preset("fast"))
    todo = jobs(frames, tmp_path / "out", settings, sequence=True)
    first = read(frames / "frame_1")
    measured = method_of("fast").measure(first, load("warp"), "cpu")
    pipeline = DepthPipeline(first, config="fast", measured=measured, device="cpu")
    entries = [work(job, "cpu") for job in (todo[0], todo[2], todo[1])]  # in whatever order
    assert [entry["status"] for entry in entries] == [FAILED, DONE, DONE]
    for name in ("frame_1", "frame_2"):
        pipeline.upload(read(frames / name).views)
        pipeline.run()
        assert np.array_equal(read_result(tmp_path / "out" / name / "result.npz").disparity, pipeline.disparity()), name


def test_what_is_wrong_with_an_item_is_one_sentence(recorded: Path, tmp_path: Path) -> None:
    entry = work(jobs(recorded, tmp_path)[2], "cpu")
    assert entry["status"] == FAILED
    assert re.search(r"input_Cam004\.png cannot be read as an image", entry["error"])
    assert not (tmp_path / "scene_2").exists()
    assert_nothing_left_over(tmp_path)


# --- what the manifest remembers ---


def test_the_last_line_of_an_item_holds_and_half_lines_are_skipped(tmp_path: Path) -> None:
    with Manifest(tmp_path) as manifest:
        manifest.add([{"item": "a", "status": FAILED}, {"item": "a", "status": DONE}, {"parameters_key": "x"}])
    with (tmp_path / MANIFEST_FILE).open("a") as file:
        file.write('{"item": "b", "sta')
    with Manifest(tmp_path) as manifest:
        manifest.add([{"item": "c", "status": DONE}])
    found = read_manifest(tmp_path)
    assert {name: entry["status"] for name, entry in found.items()} == {"a": DONE, "c": DONE}


def test_times_and_names_that_cannot_be(recorded: Path, tmp_path: Path) -> None:
    items = find_items([str(recorded / "scene_0")], sequence=False)[0]
    done = {"item": "scene_0", "status": DONE}
    lines = [
        {**done, "began": 1e15},
        {**done, "began": -1},
        {**done, "seconds": 1e12},
        {**done, "sizes": {"\ud800": 1}},
    ]
    (tmp_path / MANIFEST_FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    entries = read_manifest(tmp_path)
    assert damaged_lines(tmp_path) == 3
    assert standing(entries, tmp_path) == {}
    last = {**done, "began": 0.99e11, "seconds": 0.99e11}
    write_report(Summary(items, {"scene_0": last}), tmp_path, "page")


def test_text_from_files_does_not_become_part_of_the_page_of_a_batch(recorded: Path, tmp_path: Path) -> None:
    script = '"><script>x</script>'
    items = [Item(script, str(recorded / "scene_0"))]
    entry = {"item": script, "status": FAILED, "error": script, "notes": [script]}
    page = write_report(Summary(items, {script: entry}), tmp_path, script).read_text(encoding="utf-8")
    assert "<script>x" not in page
    assert "&lt;script&gt;x" in page


def test_lines_that_do_not_end_take_no_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfgpu.batch.manifest._LONGEST_LINE", 1000)
    (tmp_path / MANIFEST_FILE).write_bytes(bytes(2500) + b'\n{"item": "a"}\n' + bytes(10))
    assert list(read_manifest(tmp_path)) == ["a"]
    assert damaged_lines(tmp_path) == 4


@pytest.mark.parametrize("clock", [1, -1], ids=["a clock that runs", "a clock that was set back"])
def test_what_is_gone_or_renamed_does_not_stand(tmp_path: Path, clock: int) -> None:
    def entry(name: str, source: str, number: int, status: str = DONE) -> dict[str, Any]:
        began = 10 + clock * number
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "disparity.pfm").write_bytes(b"1234")
        return {"item": name, "input": source, "began": began, "status": status, "sizes": {"disparity.pfm": 4}}

    entries = [entry("one", "/one", 1), entry("two", "/b/two", 2), entry("b/two", "/b/two", 3), entry("cut", "/cut", 4)]
    entries += [entry("deleted", "/deleted", 5), {**entry("bad", "/bad", 6, FAILED), "sizes": {}}]
    (tmp_path / "cut" / "disparity.pfm").write_bytes(b"")
    shutil.rmtree(tmp_path / "deleted")
    with Manifest(tmp_path) as manifest:
        manifest.add(entries)
    assert set(standing(read_manifest(tmp_path), tmp_path)) == {"one", "b/two", "bad"}


def test_one_batch_at_a_time(tmp_path: Path, recorded: Path) -> None:
    with Manifest(tmp_path):
        outcome = lfgpu("batch", recorded, "-o", tmp_path)
        assert outcome.exit_code == 1
        assert outcome.stderr.startswith("lfgpu: another batch is writing to")
    assert not (tmp_path / "scene_0").exists()


def test_keys_tell_parameters() -> None:
    keys = {
        key_of(settings.config, settings.options)
        for settings in (
            FAST,
            SLOW,
            replace(FAST, disparity_range=None),
            replace(FAST, pattern="cross"),
            replace(FAST, reading={"flip": "u"}),
        )
    }
    assert len(keys) == 5


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="files cannot be limited in size here")
def test_lines_that_the_disk_has_no_room_for_are_written_later(tmp_path: Path) -> None:
    """In a process of its own, where files may not grow beyond 100 bytes."""
    code = f"""
import resource, signal
from pathlib import Path
from types import SimpleNamespace
from lfgpu.batch.manifest import Manifest, read_manifest
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
out = Path({str(tmp_path)!r})
with Manifest(out) as manifest:
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY))
    manifest.add([{{"item": "a"}}, {{"item": "b", "long": "x" * 200}}])
    assert len(manifest.unwritten) == 1
    assert list(read_manifest(out)) == ["a"]
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    manifest.add([{{"item": "c"}}])
    assert not manifest.unwritten
assert list(read_manifest(out)) == ["a", "b", "c"]
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_a_report_shows_all_items(recorded: Path, undisturbed: Path) -> None:
    items = find_items([str(recorded)], sequence=False)[0]
    items.append(Item("never <reached>", "x"))
    entries = read_manifest(undisturbed)
    summary = Summary(items, entries, computed=4, failed=[entries["scene_2"]])
    page = write_report(summary, undisturbed, "a & b").read_text(encoding="utf-8")
    assert "4 done, 1 failed, 1 not reached" in page
    assert "a &amp; b" in page
    assert "66.67 % done" in page
    assert "preset" not in page, "nobody said which"
    assert page.index("scene_2") < page.index("scene_0"), "failed ones come first"
    assert page.count('loading="lazy"') == 2 * 4, "a view and a map of each"
    for target in re.findall(r'(?:src|href)="([^"]+)"', page):
        assert (undisturbed / target).exists(), target


def test_a_batch_is_scored_per_item_and_in_total(undisturbed: Path, recorded: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    with Manifest(other) as manifest:
        manifest.add(work(job, "cpu") for job in jobs(recorded, other)[:2])
    outcome = lfgpu("eval", undisturbed, other, "-o", tmp_path / "tables")
    assert outcome.exit_code == 0, outcome.output
    assert "1 item failed or without ground truth" in outcome.stdout
    lines = (tmp_path / "tables" / "table.csv").read_text().splitlines()
    assert lines[0] == "scene,method,MSE x100,BadPix 0.07,BadPix 0.03,BadPix 0.01,Q25 x100"
    found = {tuple(line.split(",")[:2]): line.split(",")[2] for line in lines[1:]}
    scores = [read_manifest(undisturbed)[f"scene_{index}"]["metrics"]["mse_100"] for index in (0, 1)]
    assert [float(found[f"scene_{index}", undisturbed.name]) for index in (0, 1)] == scores
    assert float(found["average of 2", undisturbed.name]) == pytest.approx(np.mean(scores))
    assert found["scene_3", "other"] == ""
    assert "\\toprule" in (tmp_path / "tables" / "table.tex").read_text()
    assert "different parameters" not in outcome.stdout
    with Manifest(other) as manifest:
        manifest.add([{**read_manifest(other)["scene_1"], "parameters_key": "another"}])
    (other / "scene_0" / "disparity.pfm").unlink()
    assert "1 items are left out" in lfgpu("eval", other).stdout
    shutil.copy(undisturbed / "scene_0" / "disparity.pfm", other / "scene_0")
    assert "The items of other have different parameters" in lfgpu("eval", other).stdout
    assert lfgpu("eval", undisturbed, "--border", "3").exit_code == 1
    assert lfgpu("eval", undisturbed).exit_code == 0


# --- real processes ---


def test_only_what_is_missing_failed_or_stale_is_done_again(recorded: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(recorded, folder)
    items = find_items([str(folder)], sequence=False)[0]
    first = Batch(items, out, FAST).run(local())
    assert (first.computed, first.kept, len(first.failed)) == (4, 0, 1)
    shutil.copy(recorded / "scene_1" / "input_Cam004.png", folder / "scene_2")  # repaired
    os.utime(folder / "scene_0" / "input_Cam000.png")  # changed
    (out / "scene_1" / "result.npz").unlink()  # missing
    (out / "scene_1" / ".lfgpu-half").mkdir()  # of a process that was killed
    second = Batch(items, out, FAST).run(local())
    assert (second.computed, second.kept, len(second.failed)) == (3, 2, 0)
    assert_nothing_left_over(out)
    third = Batch(items, out, FAST).run(local())
    assert (third.computed, third.kept) == (0, 5)


def test_a_worker_that_is_killed_in_the_middle_costs_nothing(recorded: Path, undisturbed: Path, tmp_path: Path) -> None:
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
    items = find_items([str(recorded)], sequence=False)[0]
    summary = Batch(items, tmp_path, SLOW).run(cluster)
    killer.join(60)
    assert len(set(killed)) == 2
    assert (summary.computed, summary.left, [e["item"] for e in summary.failed]) == (4, 0, ["scene_2"])
    assert_same_maps(tmp_path, undisturbed)


def test_kills_at_random_moments_cost_nothing(
    recorded: Path, undisturbed: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """All processes at once, wherever they are: the start of the cluster, an item, the manifest."""
    settings = ["--set", "prior.window=3", "--set", "sweep.step=1", "--set", "alignment.iterations=100"]
    command = ["batch", str(recorded), "-o", str(tmp_path), "--preset", "fast", "--disparity-range", "-1.2,1.2"]
    command += [*settings, "--device", "cpu", "--threads", "1"]
    for longest in (2.0, 5.0, 8.0):
        with started(["lfgpu", *command]) as process, contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(float(rng.uniform(0, longest)))
    outcome = lfgpu(*command)
    assert "lfgpu: 1 of 5 items failed: scene_2: " in outcome.stderr, outcome.output
    assert_same_maps(tmp_path, undisturbed)
    assert_nothing_left_over(tmp_path)


def test_a_clock_that_is_put_forward_costs_nothing(
    recorded: Path, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import dask

    real, day, ahead = time.time, 86400.0, [0.0]
    for place in ("time.time", "distributed.scheduler.time"):
        monkeypatch.setattr(place, lambda: real() + ahead[-1])
    seen: set[int] = set()
    cluster = local()

    def jump(_: object) -> None:
        ahead.append(day)  # from the first item on
        seen.update(pids(cluster))

    with dask.config.set({"distributed.scheduler.worker-ttl": "1 s"}):  # five minutes are too long for a test
        items = find_items([str(recorded)], sequence=False)[0]
        summary = Batch(items, tmp_path, SLOW).run(cluster, on_progress=jump)
    assert [entry["item"] for entry in summary.failed] == ["scene_2"], [entry["error"] for entry in summary.failed]
    assert summary.computed == 4
    assert len(seen) == 1  # no worker was taken for dead
    assert {entry["attempts"] for entry in summary.entries.values()} == {1}
    assert all(0 <= entry["seconds"] < day for entry in summary.entries.values())
    assert_same_maps(tmp_path, undisturbed)


def test_the_time_of_an_item_is_not_that_of_a_clock_that_is_set_back(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(10**6, 0, -1000))
    monkeypatch.setattr("lfgpu.batch.work.time.time", lambda: float(next(clock)))
    assert 0 <= work(jobs(recorded, tmp_path)[0], "cpu")["seconds"] < 1000


def test_an_item_that_kills_its_worker_is_given_up_and_the_rest_goes_on(recorded: Path, tmp_path: Path) -> None:
    """Its neighbours are not taken for the culprit; what found no memory is tried again."""
    tried = tmp_path / "tried"
    good = recorded / "scene_0"

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

    todo = jobs(recorded, tmp_path)
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


def test_a_result_that_is_lost_is_asked_for_alone_and_then_said_so(recorded: Path, tmp_path: Path) -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise TimeoutError

    class Future:
        def __init__(self, status: str) -> None:
            self.status = status

        def result(self, timeout: float) -> Any:
            return "tcp://there", {"status": DONE}

    finished, lost = [Future("finished"), Future("finished")], Future("pending")
    cluster, todo = Cluster(retries=0), jobs(recorded, tmp_path)
    cluster._client = SimpleNamespace(sync=fails, _gather=None, status="running")
    assert cluster._results(finished) == {}
    entry = cluster._outcome(finished[0], None, _Task(todo[0], deque()))
    assert entry == {"status": DONE, "attempts": 1}
    entry = cluster._outcome(lost, None, _Task(todo[0], deque()))
    assert entry is not None
    assert entry["error"] == "its result was lost with its worker, tried 1 times."
    cluster._client.status = "closed"
    entry = cluster._outcome(lost, None, _Task(todo[0], deque()))
    assert entry is not None
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


def test_interruption_is_clean_and_the_next_run_goes_on(recorded: Path, undisturbed: Path, tmp_path: Path) -> None:
    settings = ["--set", "prior.window=3", "--set", "sweep.step=1", "--set", "alignment.iterations=100"]
    command = ["batch", str(recorded), "-o", str(tmp_path), "--preset", "fast", "--disparity-range", "-1.2,1.2"]
    command += [*settings, "--device", "cpu", "--threads", "1"]
    with started(["lfgpu", *command]) as process:
        wait_for(lambda: "scene_0" in read_manifest(tmp_path))
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does it: all processes get it
        out, err = process.communicate(timeout=600)
    assert process.returncode == 130, err
    assert re.fullmatch(r"lfgpu: interrupted after \d of 5 items; run the same command again to continue\.\n", err), err
    assert out == ""
    before = sum(entry["status"] == DONE for entry in read_manifest(tmp_path).values())
    assert 1 <= before < 4
    outcome = lfgpu(*command)
    assert outcome.exit_code == 1, outcome.output
    assert re.match(r"lfgpu: 1 of 5 items failed: scene_2: .*input_Cam004\.png", outcome.stderr)
    assert f"{4 - before} computed, {before} kept from before" in outcome.stdout
    assert (tmp_path / REPORT_FILE).is_file()
    assert_same_maps(tmp_path, undisturbed)
    assert_nothing_left_over(tmp_path)


def test_a_full_disk_fails_items_and_room_brings_them_back(recorded: Path, undisturbed: Path, tmp_path: Path) -> None:
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=160k", "tmpfs", str(tmp_path)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("a small file system cannot be mounted here")
    try:
        items = find_items([str(recorded)], sequence=False)[0]
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


def test_a_scheduler_that_is_started_again_costs_nothing(recorded: Path, undisturbed: Path, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    items, problems = find_items([str(recorded)], sequence=False)[0], []
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


def test_a_scheduler_that_is_not_there_is_one_sentence(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.batch.cluster._CONNECTING", 0.5)
    outcome = lfgpu("batch", recorded, "-o", tmp_path, "--scheduler", "tcp://127.0.0.1:9")
    assert outcome.exit_code == 1
    assert re.fullmatch(
        r"lfgpu: the scheduler tcp://127\.0\.0\.1:9 does not answer \(.*\); check the address, and that it is "
        r"running\.\n",
        outcome.stderr,
    )


def test_frames_of_a_sequence_stay_in_order(recorded: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    for number in range(6):
        shutil.copytree(recorded / "scene_0", frames / f"frame_{number}")
    items = find_items([str(frames), str(recorded)], sequence=True)[0]
    with contextlib.suppress(BatchError):
        Batch(items, tmp_path / "out", FAST).run(Cluster(workers=2, devices=("cpu",), threads=1))
    entries = [e for e in read_manifest(tmp_path / "out").values() if e["item"].startswith("frame")]
    assert [entry["item"] for entry in entries] == [f"frame_{number}" for number in range(6)]
    assert len({entry["worker"] for entry in entries}) == 1


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


# --- what comes from outside ---


def test_items_that_cannot_be_looked_at_are_lines_with_a_sentence(recorded: Path, tmp_path: Path) -> None:
    """A link in a circle, a view that is a link to nowhere, a name that is not UTF-8; the rest goes on."""
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(recorded / "scene_0", folder / "good")
    shutil.copytree(recorded / "scene_0", os.fsdecode(os.fsencode(folder) + b"/bad\xff"))
    (folder / "circle").symlink_to("circle")
    shutil.copytree(recorded / "scene_0", folder / "broken")
    (folder / "broken" / "input_Cam004.png").unlink()
    (folder / "broken" / "input_Cam004.png").symlink_to("nowhere.png")
    items, barren = find_items([str(folder)], sequence=False, leave_out=out)
    assert [item.name for item in items] == ["bad\\udcff", "broken", "circle", "good"]
    assert not barren
    summary = Batch(items, out, FAST).run(local())
    assert {entry["item"]: entry["status"] for entry in summary.entries.values()} == {
        **{"good": DONE, "bad\\udcff": DONE},
        **{"circle": FAILED, "broken": FAILED},
    }
    assert "cannot be opened" in summary.entries["circle"]["error"]
    assert "link that leads nowhere" in summary.entries["broken"]["error"]
    (out / MANIFEST_FILE).read_text(encoding="utf-8")
    again = Batch(find_items([str(folder)], sequence=False, leave_out=out)[0], out, FAST)
    assert [job.item.name for job in again._todo(read_manifest(out))] == ["broken", "circle"]
    write_report(summary, out, "page")


@pytest.mark.usefixtures("_permissions_count")
def test_a_folder_without_permission_is_a_line_with_a_sentence(recorded: Path, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    shutil.copytree(recorded / "scene_0", folder / "good")
    (folder / "closed").mkdir(mode=0)
    items, _ = find_items([str(folder)], sequence=False)
    assert [item.name for item in items] == ["closed", "good"]
    assert "cannot be listed" in work(_jobs(items, tmp_path / "out", FAST)[0], "cpu")["error"]


def test_a_folder_that_cannot_be_listed_is_an_item(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the one before, for users whom permissions do not stop."""
    (tmp_path / "in" / "closed").mkdir(parents=True)
    shutil.copytree(recorded / "scene_0", tmp_path / "in" / "good")
    listing = Path.iterdir

    def iterdir(folder: Path) -> Iterator[Path]:
        if folder.name == "closed":
            raise PermissionError(13, "Permission denied")
        return listing(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    items, _ = find_items([str(tmp_path / "in")], sequence=False)
    assert [item.name for item in items] == ["closed", "good"]
    assert "cannot be listed" in work(_jobs(items, tmp_path / "out", FAST)[0], "cpu")["error"]


def test_names_do_not_lead_out_of_the_folder(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "scene" / "below"
    shutil.copytree(recorded / "scene_0", place.parent)
    place.mkdir()
    monkeypatch.chdir(place)
    for text in ("..", "../../scene/below/..", str(place / "..")):
        items, _ = find_items([text], sequence=False, format_name="hci")
        assert [item.name for item in items] == ["scene"]
    for name in ("manifest.jsonl", ".lfgpu-0123", "a\x1b[2J\nb"):
        shutil.copytree(recorded / "scene_0", tmp_path / name)
        items, _ = find_items([str(tmp_path / name)], sequence=False)
        assert items[0].name == {"a\x1b[2J\nb": r"a\x1b[2J\nb"}.get(name, f"_{name}")


def test_depth_of_a_name_that_is_not_utf_8_is_saved(recorded: Path, tmp_path: Path) -> None:
    folder = os.fsdecode(os.fsencode(tmp_path) + b"/bad\xff")
    shutil.copytree(recorded / "scene_0", folder)
    done = lfgpu("depth", folder, "-o", tmp_path / "out", "--report", "--preset=fast", "--disparity-range=-1.2,1.2")
    assert done.exit_code == 0, done.output
    assert read_result(tmp_path / "out" / "result.npz").name == "bad\\udcff"


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
    recorded: Path, tmp_path: Path, holds_lock: bool
) -> None:
    import cloudpickle

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    todo = jobs(recorded, tmp_path)
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
    from distributed import Client
    from distributed.security import Security

    with local() as cluster:
        address = cluster.client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        for tried, security in ((address.replace("tls", "tcp"), None), (address, Security.temporary())):
            with pytest.raises(OSError, match=r".") as refused:
                Client(tried, security=security, timeout=3)
            assert "TimeoutError" in repr(refused) or isinstance(refused.value, OSError)


def test_a_worker_that_is_killed_while_the_cluster_starts_is_no_traceback(
    recorded: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
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
    summary = Batch(find_items([str(recorded / "scene_0")], sequence=False)[0], tmp_path, FAST).run(local())
    killer.join(60)
    assert killed
    assert (summary.computed, summary.left) == (1, 0)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(
    "line",
    [
        '{"item": "scene_0", "status": "done", "sizes": [1]}',
        '{"item": "scene_0", "status": 3}',
        '{"item": "scene_0", "status": "done", "input": ["a"], "began": "x"}',
        '{"item": "scene_0", "status": "done", "metrics": {"mse_100": "0"}}',
        '{"item": "scene_0", "status": "done", "times": {"read": 1e999}, "seconds": 1}',
        '{"item": "scene_0", "status": "done", "disparity_range": [1]}',
        "[" * 100_000,
        "\\xff\x00",
        "9" * 10_000,
    ],
    ids=range(9),
)
def test_lines_of_a_manifest_that_were_damaged_are_skipped_and_said(recorded: Path, tmp_path: Path, line: str) -> None:
    (tmp_path / MANIFEST_FILE).write_text(line + "\n")
    items = find_items([str(recorded / "scene_0")], sequence=False)[0]
    assert read_manifest(tmp_path) == {}
    assert standing(read_manifest(tmp_path), tmp_path) == {}
    batch = Batch(items, tmp_path, FAST)
    batch.summary.damaged = damaged_lines(tmp_path)
    assert len(batch._todo(read_manifest(tmp_path))) == 1
    assert "1 damaged lines were skipped" in write_report(batch.summary, tmp_path, "a").read_text()
    assert lfgpu("eval", tmp_path).exit_code == 1


def test_a_name_that_is_no_text_is_written_out_in_the_report(recorded: Path, tmp_path: Path) -> None:
    items = find_items([str(recorded / "scene_0")], sequence=False)[0]
    batch = Batch(items, tmp_path, FAST)
    batch.summary.entries["scene_0"] = {"item": "scene_0", "status": FAILED, "error": "no \ud800 text"}
    batch.summary.entries["\ud800"] = {"item": "\ud800", "status": FAILED, "error": "damaged"}
    assert "no \\ud800 text" in write_report(batch.summary, tmp_path, "a").read_text(encoding="utf-8")


def test_a_pipe_in_place_of_a_manifest_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / MANIFEST_FILE)
    with pytest.raises(LightFieldError, match="neither a file nor a folder"):
        read_manifest(tmp_path)


def test_remnants_go_also_where_nothing_is_left_to_do(recorded: Path, tmp_path: Path) -> None:
    items = find_items([str(recorded / "scene_0")], sequence=False)[0]
    with Manifest(tmp_path) as manifest:
        manifest.add(work(job, "cpu") for job in _jobs(items, tmp_path, FAST))
    (tmp_path / ".lfgpu-0123").mkdir()
    assert Batch(items, tmp_path, FAST).run(local()).kept == 1
    assert_nothing_left_over(tmp_path)
