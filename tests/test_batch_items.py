"""Batches: which light fields are found, how they are named, and what comes from names and folders."""

import os
import re
import shutil
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from batch_runs import COUNT, FAST, QUICK, RANGE, assert_nothing_left_over, done, jobs, local
from command_line import lfgpu, refused
from PIL import Image

from lfgpu import DepthPipeline, LightFieldError, estimate_depth, scenes
from lfgpu._backends import load
from lfgpu.batch import items
from lfgpu.batch.cluster import Cluster
from lfgpu.batch.items import MANIFEST_FILE, find_items, fingerprint
from lfgpu.batch.manifest import DONE, FAILED, Manifest, read_manifest
from lfgpu.batch.report import write_report
from lfgpu.batch.run import Batch, _jobs
from lfgpu.batch.work import Settings, work
from lfgpu.contract import Device
from lfgpu.io import RESULT_FILE, load as load_result, read, read_map
from lfgpu.methods import method_of, preset

# --- what there is to do ---


def names(place: Path | str, *, sequence: bool = False, **options: Any) -> list[str]:
    """Names of the light fields that are found there."""
    return [item.name for item in find_items([str(place)], sequence=sequence, **options)[0]]


def test_light_fields_are_found_at_any_depth_and_named(scene_folders: Path, tmp_path: Path) -> None:
    shutil.copytree(scene_folders / "scene_0", tmp_path / "a" / "one")
    shutil.copytree(scene_folders / "scene_0", tmp_path / "a" / "b" / "two")
    shutil.copytree(scene_folders / "scene_0", tmp_path / "c" / "one")
    np.save(tmp_path / "a" / "third.npy", np.zeros((3, 3, 16, 16, 3), np.uint8))
    (tmp_path / "a" / "empty").mkdir()
    (tmp_path / "a" / "notes.txt").write_text("nothing")
    items, barren = find_items([str(tmp_path)], sequence=False)
    assert [item.name for item in items] == ["two", "a/one", "third.npy", "c/one"]
    assert [path.name for path in barren] == ["empty"]
    assert {item.sequence for item in items} == {""}


@pytest.mark.parametrize("name", ["scan_2²", "scan_٣", "①"])
def test_digits_that_are_no_numbers_are_parts_of_names(name: str, scene_folders: Path, tmp_path: Path) -> None:
    shutil.copytree(scene_folders / "scene_0", tmp_path / "in" / name)
    assert names(tmp_path / "in", sequence=True) == [name]


def test_patterns_order_and_outputs(scene_folders: Path, tmp_path: Path) -> None:
    for number in (2, 10, 1):
        shutil.copytree(scene_folders / "scene_0", tmp_path / f"frame_{number}")
    shutil.copytree(scene_folders / "scene_0", tmp_path / "out" / "frame_1")
    items, _ = find_items([str(tmp_path / "frame_*"), str(tmp_path / "frame_1")], sequence=True)
    assert [item.name for item in items] == ["frame_1", "frame_2", "frame_10"]
    assert {item.sequence for item in items} == {str(tmp_path)}
    assert len(names(tmp_path, leave_out=tmp_path / "out")) == 3


def test_pictures_beside_light_fields_are_none(scene_folders: Path, tmp_path: Path) -> None:
    """A thumbnail or two do not hide the folders; images that are views are not hidden by a folder of fewer."""
    for name in ("one", "two"):
        shutil.copytree(scene_folders / "scene_0", tmp_path / "a" / name)
    for number in range(3):
        shutil.copy(scene_folders / "scene_0" / "input_Cam000.png", tmp_path / "a" / f"thumb{number}.png")
        items, barren = find_items([str(tmp_path / "a")], sequence=False)
        assert [item.name for item in items] == ["one", "two"]
        assert not barren
    for number in range(6):
        (tmp_path / "row" / "masks").mkdir(parents=True, exist_ok=True)
        shutil.copy(scene_folders / "scene_0" / "input_Cam000.png", tmp_path / "row" / f"v{number}.png")
        shutil.copy(scene_folders / "scene_0" / "input_Cam000.png", tmp_path / "row" / "masks" / f"m{number}.png")
    items, barren = find_items([str(tmp_path / "row")], sequence=False)
    assert [item.source for item in items] == [str(tmp_path / "row")]
    assert not barren


def test_outputs_and_other_arrays_are_no_inputs(scene_folders: Path, tmp_path: Path) -> None:
    shutil.copytree(scene_folders / "scene_0", tmp_path / "one")
    for name in ("earlier", "result"):
        shutil.copytree(scene_folders / "scene_0", tmp_path / name / "scene_0")
    (tmp_path / "earlier" / MANIFEST_FILE).write_text("")
    (tmp_path / "result" / "result.npz").write_bytes(b"")
    np.save(tmp_path / "weights.npy", np.zeros((9, 9)))
    np.savez(tmp_path / "calibration.npz", matrix=np.eye(3))
    (tmp_path / "live.json").write_text('{"frames": []}')
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "settings.toml").write_text("views = 9")
    assert names(tmp_path) == ["one"]
    (tmp_path / "one" / "result.npz").write_bytes(b"")  # which makes it no less of a light field
    assert names(tmp_path) == ["one"]
    assert len(names(tmp_path / "weights.npy")) == 1  # who names it hears what is wrong with it


@pytest.mark.parametrize(
    ("file", "found"),
    [
        ("cam{u}/frame_{t}.png", ["in/0000", "in/0001"]),
        ("view_{u}/time {t}.png", ["in/0000", "in/0001"]),
        ("cam{u}/{t}.png", ["in"]),  # it is asked what the numbers count
        ("{side}/{t}.png", ["in"]),
        ("cam{u}/picture.png", ["in"]),
        ("cam{u}/{kind}.png", ["in"]),
        ("time{t}/cam{u}.png", ["time0", "time1"]),
        ("lf{t}/view_{u}.png", ["lf0", "lf1"]),
        ("camera{u}/images/frame{t}.png", ["in/0000", "in/0001"]),
        ("{side}/images/{t}.png", ["in"]),
        ("{u}/frame_{t}.png", ["in"]),
        ("left{u}/{t}.png", ["in"]),
        ("scan{t}/images/{u}.png", ["scan0/images", "scan1/images"]),
    ],
)
def test_folders_that_are_cameras_are_no_light_fields(file: str, found: list[str], tmp_path: Path) -> None:
    for u, t in np.ndindex(2, 2):
        path = tmp_path / "in" / file.format(u=u, t=t, side=("left", "right")[u], kind=("a", "b")[t])
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((40, 48), 50 * u + 9 * t, np.uint8)).save(path)
    assert names(tmp_path / "in") == found


@pytest.mark.parametrize("names_of", ["{u}/{t:03d}.png", "{u}/images/{t:03d}.png"])
def test_pictures_tell_folders_that_are_cameras_from_light_fields(names_of: str, tmp_path: Path) -> None:
    options = {"grid": (1, 3), "size": (64, 72), "disparity_range": (-1, 1)}
    for k, lf in enumerate(scenes.sequence("moving", frames=3, **options)):
        for u, view in enumerate(lf.views):
            for folder, file in (("cameras", names_of.format(u=u, t=k)), ("fields", names_of.format(u=k, t=u))):
                (tmp_path / folder / file).parent.mkdir(parents=True, exist_ok=True)
                Image.fromarray(view).save(tmp_path / folder / file)
    assert names(tmp_path / "cameras") == ["cameras"]
    pattern = names_of.replace(":03d", "")
    with pytest.raises(LightFieldError, match=r"several folders with numbered images \(0, 1, 2\); give one"):
        read(tmp_path / "cameras")
    assert read(tmp_path / "cameras", pattern=pattern, frame=1).grid_shape == (1, 3)
    assert len(names(tmp_path / "fields")) == 3


def test_a_light_field_with_its_results_beside_the_views_is_an_input(tmp_path: Path) -> None:
    for folder, file in (("a", "view_0_0.png"), ("a", "view_0_1.png"), ("out", "disparity.png"), ("b", "0_0.png")):
        (tmp_path / folder).mkdir(exist_ok=True)
        Image.fromarray(np.full((40, 48), len(file), np.uint8)).save(tmp_path / folder / file)
    Image.fromarray(np.zeros((40, 48), np.uint8)).save(tmp_path / "b" / "0_1.png")
    for folder in ("a", "out"):
        (tmp_path / folder / RESULT_FILE).write_bytes(b"")
    assert names(tmp_path) == ["a", "b"]


def test_light_fields_beside_a_folder_of_the_archive_are_found(scene_folders: Path, tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    archive.mkdir()
    for n, file in enumerate(sorted((scene_folders / "scene_0").glob("*.png"))[:2]):
        shutil.copy(file, archive / f"out_00_{n:02d}_0.0_{n}.0_.png")
    assert names(tmp_path) == ["archive"]
    np.save(tmp_path / "a.npy", read(scene_folders / "scene_0").views)
    assert names(tmp_path) == ["a.npy", "archive"]
    shutil.copy(archive / "out_00_00_0.0_0.0_.png", tmp_path / "preview.png")
    assert names(tmp_path) == ["a.npy", "archive"]


def test_a_file_whose_pages_go_in_a_circle_is_an_item(tmp_path: Path) -> None:
    header, page = struct.pack("<2sHI", b"II", 42, 8), struct.pack("<HHHIII", 1, 256, 3, 1, 16, 8)
    (tmp_path / "a.tif").write_bytes(header + page)
    assert names(tmp_path) == ["a.tif"]


def test_links_do_not_lead_in_circles(scene_folders: Path, tmp_path: Path) -> None:
    shutil.copytree(scene_folders / "scene_0", tmp_path / "a" / "one")
    (tmp_path / "a" / "loop").symlink_to(tmp_path / "a")
    (tmp_path / "again").symlink_to(tmp_path / "a" / "one")
    assert names(tmp_path) == ["one"]


def test_what_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LightFieldError, match=r"nowhere\* does not exist, and matches nothing as a pattern"):
        find_items([str(tmp_path / "nowhere*")], sequence=False)
    with pytest.raises(LightFieldError, match="no light field was found"):
        find_items([str(tmp_path)], sequence=False)


def test_the_folder_of_inputs_takes_no_outputs(scene_folders: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(scene_folders)
    for out in (scene_folders, tmp_path / "link"):
        refused(lfgpu("batch", scene_folders, "-o", out), f"-o names {out}, which is the input; name another folder")


def test_fingerprints_tell_changed_files(scene_folders: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(scene_folders / "scene_0", copy)
    before = fingerprint(str(copy))
    assert fingerprint(str(copy)) == before
    (copy / "out" / "copy").mkdir(parents=True)
    (copy / "out" / "copy" / "disparity.pfm").write_bytes(b"")
    assert fingerprint(str(copy), leave_out=copy / "out") == before
    assert fingerprint(str(copy)) != before
    shutil.rmtree(copy / "out")
    os.utime(copy / "input_Cam003.png", ns=(1, 1))
    assert fingerprint(str(copy)) != before


@pytest.mark.parametrize("table", ["views.file", "views.valid", "truth.disparity", "truth.mask", "source.path"])
def test_fingerprints_tell_changed_files_that_a_description_names(table: str, tmp_path: Path) -> None:
    kind, key = table.split(".")
    files, source = tmp_path / "files", tmp_path / "described" / "one.toml"
    for folder in (files, source.parent):
        folder.mkdir()
    (files / "a.png").write_bytes(b"")
    named = "../files" if kind == "source" else "../files/a.png"
    source.write_text(f'[[views]]\nposition = [0, 0]\n{"" if kind == "views" else f"[{kind}]"}\n{key} = "{named}"\n')
    before = fingerprint(str(source))
    assert fingerprint(str(source)) == before
    os.utime(files / "a.png", ns=(1, 1))
    assert fingerprint(str(source)) != before
    (files / "a.png").unlink()  # it is missing, which is said by who reads it
    assert fingerprint(str(source)) != before
    for text in ("views = 3", 'views = [{file = "\\u0000"}]'):
        source.write_text(text)
        assert fingerprint(str(source)) != before
    (source.parent / "one.json").write_text('{"views": [{"file": "\\ud800"}]}')
    assert fingerprint(str(source.parent / "one.json")) != before


def test_fingerprints_tell_changed_files_in_linked_folders(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "in" / "one", tmp_path / "elsewhere"
    for place in (folder, elsewhere):
        place.mkdir(parents=True)
        (place / "a.png").write_bytes(b"")
    (folder / "views").symlink_to(elsewhere)
    for name, target in (("loop", elsewhere), ("back", folder), ("up", folder.parent)):
        (elsewhere / name).symlink_to(target)
    before = fingerprint(str(folder))
    (folder.parent / "another.png").write_bytes(b"")
    assert fingerprint(str(folder)) == before
    os.utime(elsewhere / "a.png", ns=(1, 1))
    assert fingerprint(str(folder)) != before


# --- what becomes of an item ---


def test_an_item_comes_out_as_from_estimate_depth(scene_folders: Path, tmp_path: Path) -> None:
    job = jobs(scene_folders, tmp_path, Settings(preset("fast")))[0]
    entry = work(job, "cpu")
    lf = read(scene_folders / "scene_0")
    expected = estimate_depth(lf, config="fast", device="cpu")
    result = load_result(tmp_path / "scene_0" / "result.npz")
    assert np.array_equal(result.disparity, expected.disparity)
    assert np.array_equal(result.confidence, expected.confidence)
    assert entry["status"] == DONE
    assert entry["disparity_range"] == list(expected.disparity_range)
    assert entry["metrics"]["count"] == 10 * 18
    assert {path.name: path.stat().st_size for path in (tmp_path / "scene_0").iterdir()} == entry["sizes"]
    assert result.timings["total"] > 0


def test_outputs_of_an_earlier_run_go_when_new_ones_come(scene_folders: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene_0"
    work(jobs(scene_folders, tmp_path)[0], "cpu")
    (out / "notes.txt").write_text("mine")
    before = {path.name for path in out.iterdir()}
    assert work(jobs(scene_folders, tmp_path, replace(FAST, place=(9, 9)))[0], "cpu")["status"] == FAILED
    assert {path.name for path in out.iterdir()} == before
    sizes = work(jobs(scene_folders, tmp_path, replace(FAST, place=(0, 0)))[0], "cpu")["sizes"]
    assert before - {*sizes} == {"error.png", "notes.txt"}  # there is no truth of that view
    assert {path.name for path in out.iterdir()} == {*sizes, "notes.txt"}


def test_a_pipeline_serves_the_next_item_and_changes_nothing(scene_folders: Path, tmp_path: Path) -> None:
    """With range and noise given, a worker keeps what it has allocated."""
    settings = replace(FAST, config=QUICK.with_values({"sweep.noise": 0.004}))
    worked = [job for job in jobs(scene_folders, tmp_path, settings) if work(job, "cpu")["status"] == DONE]
    assert len(worked) == COUNT - 1  # one is damaged
    for job in worked:
        lf = read(job.item.source)
        expected = estimate_depth(lf, config=settings.config, disparity_range=RANGE, device="cpu")
        assert np.array_equal(read_map(tmp_path / job.item.name / "result.npz"), expected.disparity)


def test_frames_have_range_and_noise_of_the_first_that_can_be_read(scene_folders: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    for number, scene in enumerate((2, 0, 1)):  # the first one is damaged
        shutil.copytree(scene_folders / f"scene_{scene}", frames / f"frame_{number}")
    settings = Settings(preset("fast"))
    todo = jobs(frames, tmp_path / "out", settings, sequence=True)
    first = read(frames / "frame_1")
    measured = method_of("fast").measure(first, Device(load("warp"), "cpu"))
    pipeline = DepthPipeline(first, config="fast", measured=measured, device="cpu")
    entries = [work(job, "cpu") for job in (todo[0], todo[2], todo[1])]  # in whatever order
    assert [entry["status"] for entry in entries] == [FAILED, DONE, DONE]
    for name in ("frame_1", "frame_2"):
        pipeline.upload(read(frames / name).views)
        pipeline.run()
        assert np.array_equal(read_map(tmp_path / "out" / name / "result.npz"), pipeline.disparity()), name


def test_what_is_wrong_with_an_item_is_one_sentence(scene_folders: Path, tmp_path: Path) -> None:
    entry = work(jobs(scene_folders, tmp_path)[2], "cpu")
    assert entry["status"] == FAILED
    assert re.search(r"input_Cam004\.png cannot be read as an image", entry["error"])
    assert not (tmp_path / "scene_2").exists()
    assert_nothing_left_over(tmp_path)


# --- what comes from outside ---


def test_items_that_cannot_be_looked_at_are_lines_with_a_sentence(scene_folders: Path, tmp_path: Path) -> None:
    """A link in a circle, a view that is a link to nowhere, a name that is not UTF-8; the rest goes on."""
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(scene_folders / "scene_0", folder / "good")
    shutil.copytree(scene_folders / "scene_0", os.fsdecode(os.fsencode(folder) + b"/bad\xff"))
    (folder / "circle").symlink_to("circle")
    shutil.copytree(scene_folders / "scene_0", folder / "broken")
    (folder / "broken" / "input_Cam004.png").unlink()
    (folder / "broken" / "input_Cam004.png").symlink_to("nowhere.png")
    items, barren = find_items([str(folder)], sequence=False, leave_out=out)
    assert [item.name for item in items] == ["bad\\udcff", "broken", "circle", "good"]
    assert not barren
    summary = done(items, out, FAST)
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


def test_a_folder_without_permission_is_a_line_with_a_sentence(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also for users whom permissions do not stop, as in containers."""
    (tmp_path / "in" / "closed").mkdir(parents=True)
    shutil.copytree(scene_folders / "scene_0", tmp_path / "in" / "good")
    listing = Path.iterdir

    def iterdir(folder: Path) -> Iterator[Path]:
        if folder.name == "closed":
            raise PermissionError(13, "Permission denied")
        return listing(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    items, _ = find_items([str(tmp_path / "in")], sequence=False)
    assert [item.name for item in items] == ["closed", "good"]
    assert "cannot be listed" in work(_jobs(items, tmp_path / "out", FAST)[0], "cpu")["error"]


def test_names_do_not_lead_out_of_the_folder(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "scene" / "below"
    shutil.copytree(scene_folders / "scene_0", place.parent)
    place.mkdir()
    monkeypatch.chdir(place)
    for text in ("..", "../../scene/below/..", str(place / "..")):
        assert names(text, format_name="hci") == ["scene"]
    for name in ("manifest.jsonl", ".lfgpu-0123", "a\x1b[2J\nb"):
        shutil.copytree(scene_folders / "scene_0", tmp_path / name)
        assert names(tmp_path / name) == [{"a\x1b[2J\nb": r"a\x1b[2J\nb"}.get(name, f"_{name}")]


def test_depth_of_a_name_that_is_not_utf_8_is_saved(scene_folders: Path, tmp_path: Path) -> None:
    folder = os.fsdecode(os.fsencode(tmp_path) + b"/bad\xff")
    shutil.copytree(scene_folders / "scene_0", folder)
    outcome = lfgpu("depth", folder, "-o", tmp_path / "out", "--report", "--preset=fast", "--disparity-range=-1.2,1.2")
    assert outcome.code == 0, outcome.err
    assert load_result(tmp_path / "out" / "result.npz").name == "bad\\udcff"


# --- batches on real processes ---


def test_only_what_is_missing_failed_or_stale_is_done_again(scene_folders: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(scene_folders, folder)
    items = find_items([str(folder)], sequence=False)[0]
    with Manifest(out) as manifest:
        manifest.add(work(job, "cpu") for job in jobs(folder, out))
    shutil.copy(scene_folders / "scene_1" / "input_Cam004.png", folder / "scene_2")  # repaired
    os.utime(folder / "scene_0" / "input_Cam000.png")  # changed
    (out / "scene_1" / "result.npz").unlink()  # missing
    (out / "scene_1" / ".lfgpu-half").mkdir()  # of a process that was killed
    second = Batch(items, out, FAST).run(local())
    assert (second.computed, second.kept, len(second.failed)) == (3, 2, 0)
    assert_nothing_left_over(out)
    assert not Batch(items, out, FAST)._todo(read_manifest(out))


def test_a_scheduler_that_is_not_there_is_one_sentence(
    scene_folders: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfgpu.batch.cluster._CONNECTING", 0.5)
    outcome = lfgpu("batch", scene_folders, "-o", tmp_path, "--scheduler", "tcp://127.0.0.1:9")
    assert outcome.code == 1
    assert re.fullmatch(
        r"lfgpu: the scheduler tcp://127\.0\.0\.1:9 does not answer \(.*\); check the address, and that it is "
        r"running\.\n",
        outcome.err,
    )


@pytest.mark.thorough
def test_frames_of_a_sequence_stay_in_order(scene_folders: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    for number in range(4):
        shutil.copytree(scene_folders / "scene_0", frames / f"frame_{number}")
    items = find_items([str(frames)], sequence=True)[0]
    Batch(items, tmp_path / "out", FAST).run(Cluster(workers=2, devices=("cpu",), threads=1))
    entries = read_manifest(tmp_path / "out").values()
    assert [entry["item"] for entry in entries] == [f"frame_{number}" for number in range(4)]
    assert len({entry["worker"] for entry in entries}) == 1


def test_remnants_go_also_where_nothing_is_left_to_do(scene_folders: Path, tmp_path: Path) -> None:
    items = find_items([str(scene_folders / "scene_0")], sequence=False)[0]
    with Manifest(tmp_path) as manifest:
        manifest.add(work(job, "cpu") for job in _jobs(items, tmp_path, FAST))
    (tmp_path / ".lfgpu-0123").mkdir()
    assert Batch(items, tmp_path, FAST).run(local()).kept == 1
    assert_nothing_left_over(tmp_path)


def test_a_disk_that_a_description_names_is_not_walked_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(items, "_MOST", 3)
    disk, source = tmp_path / "disk", tmp_path / "one.toml"
    disk.mkdir()
    source.write_text('[source]\npath = "disk"\nformat = "camera-row"\n')
    for n in range(4):
        before = fingerprint(str(source))
        assert fingerprint(str(source)) == before
        (disk / f"{n}.png").write_bytes(b"")
    assert fingerprint(str(source)) != fingerprint(str(source))  # what is not looked at may have changed
    looked_at = []
    monkeypatch.setattr(items.os, "walk", lambda *_, **__: (looked_at.append(n) or ("", [], ["a"]) for n in range(99)))
    fingerprint(str(source))
    assert len(looked_at) == 4
