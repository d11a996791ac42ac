"""The page of a batch: pictures that can be judged, sorted by what one asks for, and reports of single items."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lfgpu import LightField, scenes
from lfgpu.batch.items import ERROR_FILE, PREVIEW_FILE, VIEW_FILE, Item, find_items
from lfgpu.batch.manifest import Manifest, read_manifest
from lfgpu.batch.report import facts, write_report
from lfgpu.batch.run import Batch, Summary, _jobs
from lfgpu.batch.work import Settings, work
from lfgpu.io import REPORT_FILE, load, write_hci
from lfgpu.methods import PRESETS
from lfgpu.viz.colours import UNDEFINED

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


def done(folder: Path, out: Path, settings: Settings = SETTINGS) -> Summary:
    """A batch, in this process."""
    items = find_items([str(folder)], sequence=False, leave_out=out)[0]
    batch = Batch(items, out, settings)
    with Manifest(out) as manifest:
        for job in batch._todo(read_manifest(out)):
            entry = work(job, "cpu")
            batch.summary.entries[job.item.name] = entry
            if entry["status"] == "done":
                batch.summary.computed += 1
            else:
                batch.summary.failed.append(entry)
            manifest.add([entry])
    return batch.summary


@pytest.fixture(scope="module")
def out(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("out")
    write_report(done(folder, place, replace(SETTINGS, report=True, command="lfgpu batch …")), place, "many")
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
    valid = np.ones(lf.views.shape[:3], bool)
    valid[(slice(None), *HOLE)] = False
    monkeypatch.setattr("lfgpu.batch.work._read", lambda *_: replace(lf, valid=valid))
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
    again = Batch(find_items([str(folder)], sequence=False, leave_out=out)[0], out, SETTINGS)
    again.summary.settings = replace(SETTINGS, config=PRESETS["fast"].with_values({"sweep.step": 0.5}))
    assert ("preset", "fast with 1 parameter changed") in facts(again.summary)


def test_items_have_reports_where_they_are_asked_for(out: Path, folder: Path, tmp_path: Path) -> None:
    page = (out / "report.html").read_text(encoding="utf-8")
    assert 'href="item_2/report.html"' in page
    report = (out / "item_2" / REPORT_FILE).read_text(encoding="utf-8")
    assert "lfgpu batch …" in report
    assert str(folder / "item_2") in report

    plain = tmp_path / "plain"
    write_report(done(folder, plain), plain, "plain")
    assert 'href="item_2/"' in (plain / "report.html").read_text(encoding="utf-8")
    assert not (plain / "item_2" / REPORT_FILE).exists()
    items = find_items([str(folder)], sequence=False, leave_out=plain)[0]
    assert [job.item.name for job in Batch(items, plain, SETTINGS)._todo(read_manifest(plain))] == ["bad"]
    asked = Batch(items, plain, replace(SETTINGS, report=True))._todo(read_manifest(plain))
    assert len(asked) == 3, "reports that were not asked for before are written now"
    done(folder, plain, replace(SETTINGS, report=True))
    assert (plain / "item_2" / REPORT_FILE).exists()
    other = replace(SETTINGS, config=PRESETS["fast"].with_values({"sweep.step": 0.5}))
    done(folder, plain, other)
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
    assert [one.inner_text() for one in order.all() if one.is_visible()] == ["item_10"]
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
