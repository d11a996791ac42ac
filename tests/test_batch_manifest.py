"""Batches: what the manifest remembers, what is read from damaged ones, and the page that shows them."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from batch_runs import FAST, SLOW, done, jobs
from command_line import lfgpu
from PIL import Image

from lfgpu import LightField, LightFieldError, scenes
from lfgpu.batch.cluster import BatchError
from lfgpu.batch.items import ERROR_FILE, MANIFEST_FILE, PREVIEW_FILE, VIEW_FILE, Item, find_items
from lfgpu.batch.manifest import DONE, FAILED, Manifest, damaged_lines, key_of, read_manifest, standing
from lfgpu.batch.report import facts, write_report
from lfgpu.batch.run import Batch, Summary, _jobs
from lfgpu.batch.work import Settings, work
from lfgpu.io import REPORT_FILE, load, write_hci
from lfgpu.methods import PRESETS
from lfgpu.viz.colours import UNDEFINED
from tests.made import masked


@pytest.fixture(scope="module")
def finished(scene_folders: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The outputs of a batch of them, without Dask."""
    out = tmp_path_factory.mktemp("finished")
    with Manifest(out) as manifest:
        manifest.add(work(job, "cpu") for job in jobs(scene_folders, out))
    return out


def test_the_last_line_of_an_item_holds_and_half_lines_are_skipped(tmp_path: Path) -> None:
    with Manifest(tmp_path) as manifest:
        manifest.add([{"item": "a", "status": FAILED}, {"item": "a", "status": DONE}, {"parameters_key": "x"}])
    with (tmp_path / MANIFEST_FILE).open("a") as file:
        file.write('{"item": "b", "sta')
    with Manifest(tmp_path) as manifest:
        manifest.add([{"item": "c", "status": DONE}])
    found = read_manifest(tmp_path)
    assert {name: entry["status"] for name, entry in found.items()} == {"a": DONE, "c": DONE}


def test_times_and_names_that_cannot_be(scene_folders: Path, tmp_path: Path) -> None:
    items = find_items([str(scene_folders / "scene_0")], sequence=False)[0]
    entry = {"item": "scene_0", "status": DONE}
    wrong = {"began": 1e15}, {"began": -1}, {"seconds": 1e12}, {"sizes": {"\ud800": 1}}
    lines = [{**entry, **one} for one in wrong]
    (tmp_path / MANIFEST_FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    entries = read_manifest(tmp_path)
    assert damaged_lines(tmp_path) == 3
    assert standing(entries, tmp_path) == {}
    last = {**entry, "began": 0.99e11, "seconds": 0.99e11}
    write_report(Summary(items, {"scene_0": last}), tmp_path, "page")


def test_text_from_files_does_not_become_part_of_the_page_of_a_batch(scene_folders: Path, tmp_path: Path) -> None:
    script = '"><script>x</script>'
    items = [Item(script, str(scene_folders / "scene_0"))]
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


def test_one_batch_at_a_time(tmp_path: Path, scene_folders: Path) -> None:
    with Manifest(tmp_path):
        outcome = lfgpu("batch", scene_folders, "-o", tmp_path)
        assert outcome.code == 1
        assert outcome.err.startswith("lfgpu: another batch is writing to")
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


def test_only_items_are_counted_that_the_disk_has_no_room_for(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Manifest, "_flush", lambda _: None)
    cluster = MagicMock(run=lambda sequences, done, _: done([{"item": sequences[0][0].item.name, "status": DONE}]))
    with pytest.raises(BatchError, match="lacks 1 of the items that are done"):
        Batch(find_items([str(scene_folders)], sequence=False)[0], tmp_path, FAST).run(cluster)


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
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert ended.returncode == 0, ended.stderr


def test_a_report_shows_all_items(scene_folders: Path, finished: Path) -> None:
    items = find_items([str(scene_folders)], sequence=False)[0]
    items.append(Item("never <reached>", "x"))
    entries = read_manifest(finished)
    summary = Summary(items, entries, computed=4, failed=[entries["scene_2"]])
    page = write_report(summary, finished, "a & b").read_text(encoding="utf-8")
    assert "4 done, 1 failed, 1 not reached" in page
    assert "a &amp; b" in page
    assert "66.67 % done" in page
    assert "preset" not in page, "nobody said which"
    assert page.index("scene_2") < page.index("scene_0"), "failed ones come first"
    assert page.count('loading="lazy"') == 3 * 4, "a view, a map and its error of each"
    for target in re.findall(r'(?:src|href)="([^"]+)"', page):
        assert (finished / target).exists(), target


def test_a_batch_is_scored_per_item_and_in_total(finished: Path, scene_folders: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    with Manifest(other) as manifest:
        manifest.add(work(job, "cpu") for job in jobs(scene_folders, other)[:2])
    outcome = lfgpu("eval", finished, other, "-o", tmp_path / "tables")
    assert outcome.code == 0, outcome.err
    assert "1 item failed or without ground truth" in outcome.out
    lines = (tmp_path / "tables" / "table.csv").read_text().splitlines()
    assert lines[0] == "scene,method,MSE x100,BadPix 0.07,BadPix 0.03,BadPix 0.01,Q25 x100"
    found = {tuple(line.split(",")[:2]): line.split(",")[2] for line in lines[1:]}
    scores = [read_manifest(finished)[f"scene_{index}"]["metrics"]["mse_100"] for index in (0, 1)]
    assert [float(found[f"scene_{index}", finished.name]) for index in (0, 1)] == scores
    assert float(found["average of 2", finished.name]) == pytest.approx(np.mean(scores))
    assert found["scene_3", "other"] == ""
    assert "\\toprule" in (tmp_path / "tables" / "table.tex").read_text()
    assert "different parameters" not in outcome.out
    with Manifest(other) as manifest:
        manifest.add([{**read_manifest(other)["scene_1"], "parameters_key": "another"}])
    (other / "scene_0" / "disparity.pfm").unlink()
    assert "1 items are left out" in lfgpu("eval", other).out
    shutil.copy(finished / "scene_0" / "disparity.pfm", other / "scene_0")
    assert "The items of other have different parameters" in lfgpu("eval", other).out
    assert lfgpu("eval", finished, "--border", "3").code == 1
    assert lfgpu("eval", finished).code == 0


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
def test_lines_of_a_manifest_that_were_damaged_are_skipped_and_said(
    scene_folders: Path, tmp_path: Path, line: str
) -> None:
    (tmp_path / MANIFEST_FILE).write_text(line + "\n")
    items = find_items([str(scene_folders / "scene_0")], sequence=False)[0]
    assert read_manifest(tmp_path) == {}
    assert standing(read_manifest(tmp_path), tmp_path) == {}
    batch = Batch(items, tmp_path, FAST)
    batch.summary.damaged = damaged_lines(tmp_path)
    assert len(batch._todo(read_manifest(tmp_path))) == 1
    assert "1 damaged lines were skipped" in write_report(batch.summary, tmp_path, "a").read_text()
    assert lfgpu("eval", tmp_path).code == 1


def test_a_name_that_is_no_text_is_written_out_in_the_report(scene_folders: Path, tmp_path: Path) -> None:
    items = find_items([str(scene_folders / "scene_0")], sequence=False)[0]
    batch = Batch(items, tmp_path, FAST)
    batch.summary.entries["scene_0"] = {"item": "scene_0", "status": FAILED, "error": "no \ud800 text"}
    batch.summary.entries["\ud800"] = {"item": "\ud800", "status": FAILED, "error": "damaged"}
    assert "no \\ud800 text" in write_report(batch.summary, tmp_path, "a").read_text(encoding="utf-8")


def test_a_pipe_in_place_of_a_manifest_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / MANIFEST_FILE)
    with pytest.raises(LightFieldError, match="neither a file nor a folder"):
        read_manifest(tmp_path)


SETTINGS = Settings(PRESETS["fast"], disparity_range=(-1.2, 1.2))
HOLE = np.s_[:16, -20:]


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("relief", grid=(3, 3), size=(72, 80))


@pytest.fixture(scope="module")
def folder(lf: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three light fields, one of which cannot be read."""
    place = tmp_path_factory.mktemp("many")
    other = scenes.make("relief", grid=(3, 3), size=(72, 80), seed=1)
    for name, scene in (("item_2", lf), ("item_10", other), ("bad", lf)):
        write_hci(scene, place / name)
    for path in (place / "bad").glob("input_Cam*.png"):
        path.write_bytes(path.read_bytes()[:200])
    return place


def items_in(folder: Path, out: Path) -> list[Item]:
    return find_items([str(folder)], sequence=False, leave_out=out)[0]


@pytest.fixture(scope="module")
def out(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("out")
    write_report(
        done(items_in(folder, place), place, replace(SETTINGS, report=True, command="lfgpu batch …")), place, "many"
    )
    return place


def test_pictures_are_a_view_and_its_map_with_grey_holes(out: Path, lf: LightField) -> None:
    entry = read_manifest(out)["item_10"]
    for name in (VIEW_FILE, PREVIEW_FILE):
        with Image.open(out / "item_10" / name) as image:
            assert image.size == lf.size[::-1], "not scaled down"
    error = load(out / "item_2" / "result.npz").disparity - lf.truth.disparity
    with Image.open(out / "item_2" / ERROR_FILE) as image:
        shown = np.asarray(image.convert("RGB")).astype(int)
    assert (shown[error > 0.07] == shown[error > 0.07][0]).all(), "one red beyond the scale"
    assert ((shown[..., 0] > shown[..., 2]) == (error > 0))[np.abs(error) > 0.005].all(), "red: too near"
    assert entry["scale"]["low"] < entry["scale"]["high"]
    assert entry["scale"]["undefined"] == 0


def test_undefined_pixels_of_thumbnails_are_grey_and_out_of_the_scale(
    lf: LightField, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.batch.work._read", lambda *_: masked(lf, (slice(None), *HOLE)))
    entry = work(_jobs([Item("a", str(tmp_path))], tmp_path / "out", SETTINGS)[0], "cpu")
    with Image.open(tmp_path / "out" / "a" / PREVIEW_FILE) as image:
        map_ = np.asarray(image.convert("RGB"))
    assert (map_[HOLE] == UNDEFINED).all()
    assert not (map_[20:, :50] == UNDEFINED).all(axis=2).any()
    assert entry["scale"]["undefined"] == 16 * 20
    assert -1.3 < entry["scale"]["low"] < entry["scale"]["high"] < 1.3


def test_the_page_says_how_much_is_done_by_which_preset(out: Path, folder: Path) -> None:
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "66.67 % done" in page
    assert "preset fast" in page
    again = Batch(items_in(folder, out), out, SETTINGS)
    again.summary.settings = replace(SETTINGS, config=PRESETS["fast"].with_values({"sweep.step": 0.5}))
    assert ("preset", "fast with 1 parameter changed") in facts(again.summary)


def test_items_have_reports_where_they_are_asked_for(out: Path, folder: Path, tmp_path: Path) -> None:
    page = (out / "report.html").read_text(encoding="utf-8")
    assert 'href="item_2/report.html"' in page
    report = (out / "item_2" / REPORT_FILE).read_text(encoding="utf-8")
    assert "lfgpu batch …" in report
    assert str(folder / "item_2") in report

    plain = tmp_path / "plain"
    write_report(done(items_in(folder, plain), plain, SETTINGS), plain, "plain")
    assert 'href="item_2/"' in (plain / "report.html").read_text(encoding="utf-8")
    assert not (plain / "item_2" / REPORT_FILE).exists()
    items = items_in(folder, plain)
    assert [job.item.name for job in Batch(items, plain, SETTINGS)._todo(read_manifest(plain))] == ["bad"]
    asked = Batch(items, plain, replace(SETTINGS, report=True))._todo(read_manifest(plain))
    assert len(asked) == 3, "reports that were not asked for before are written now"
    done(items, plain, replace(SETTINGS, report=True))
    assert (plain / "item_2" / REPORT_FILE).exists()
    other = replace(SETTINGS, config=PRESETS["fast"].with_values({"sweep.step": 0.5}))
    done(items, plain, other)
    assert not (plain / "item_2" / REPORT_FILE).exists(), "that of another result is gone"


@pytest.mark.parametrize("screen", [(1600, 1000), (390, 844)])
def test_items_are_sorted_and_enlarged(browser: Any, out: Path, screen: tuple[int, int]) -> None:
    width, height = screen
    page = browser.new_context(viewport={"width": width, "height": height}).new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((out / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    order = page.locator(".item h3")
    assert order.all_text_contents() == ["bad", "item_2", "item_10"]
    entries = read_manifest(out)
    for key, of in (
        ("item", lambda name: {"bad": 0, "item_2": 1, "item_10": 2}[name]),
        ("BadPix 0.07", lambda name: (entries[name].get("metrics") or {"badpix_07": 1e9})["badpix_07"]),
        ("seconds", lambda name: entries[name]["seconds"]),
    ):
        button = page.get_by_role("button", name=key)
        button.click()
        names = order.all_text_contents()
        assert names == sorted(names, key=of), key
        button.click()
        down = order.all_text_contents()
        scored = [name for name in names if of(name) < 1e9]
        assert down == [*reversed(scored), *(name for name in names if name not in scored)], "what has none is last"
    page.get_by_role("searchbox").fill("ITEM 10")
    assert [one.text_content() for one in order.all() if one.is_visible()] == ["item_10"]
    page.get_by_role("searchbox").fill("")
    item = page.locator(".item", has_text="item_10")
    before = item.locator("img").last.bounding_box()["width"]
    item.locator("img").last.click()
    pair = item.locator(".pair").bounding_box()
    assert pair == {"x": 0, "y": 0, "width": width, "height": height}
    assert item.locator("img").last.bounding_box()["width"] > 1.5 * before
    assert all(
        box["x"] >= 0 and box["y"] >= 0 and box["x"] + box["width"] <= width and box["y"] + box["height"] <= height
        for box in (part.bounding_box() for part in item.locator(".pair > span").all())
    ), "both pictures and the scale are on the screen"
    page.keyboard.press("Space")
    assert item.locator("img").last.bounding_box()["width"] == before
    assert not errors
    page.context.close()


def test_a_page_of_thousands_stays_small(out: Path) -> None:
    entry = read_manifest(out)["item_10"]
    entries = {f"item {n}": {**entry, "item": f"item {n}"} for n in range(3000)}
    summary = Summary([Item(name, "x") for name in entries], entries, computed=3000)
    page = write_report(summary, out, "thousands").read_text(encoding="utf-8")
    assert page.count("<article") == 3000
    assert len(page) < 3000 * 2500
    first = page[page.index('data-keys="') + 11 :].partition('"')[0].replace("&#34;", '"')
    assert json.loads(first)[0] == "item 0"
