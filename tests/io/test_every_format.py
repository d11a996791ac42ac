"""The table of formats; one scene in every format: the same views, moving the way they should."""

import inspect
import re
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fields import SAMPLES
from PIL import Image
from samples import box, refusal, save_hci, save_named
from typer.testing import CliRunner

from lfgpu.cli import app
from lfgpu.data import LightField
from lfgpu.io import FORMATS, read, recognise
from lfgpu.io.parallax import runs_as_truth

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]


def test_the_table_is_well_formed_and_a_format_can_be_asked_for(tmp_path: Path) -> None:
    names = [entry.name for entry in FORMATS]
    assert len(set(names)) == len(names)
    for entry in FORMATS:
        assert entry.name == entry.name.lower()
        assert " " not in entry.name
        assert "\n" not in entry.description
        assert not entry.description.endswith(".")
        assert set(entry.takes) <= set(inspect.signature(read).parameters)
        assert entry.extra is None or entry.extra in EXTRAS
    entry, reason = recognise(save_hci(tmp_path / "a", [0, 1], rows=1, columns=2))
    assert (entry.name, reason) == ("hci", "it is a folder with input_Cam000.png")
    entry, reason = recognise(save_named(tmp_path / "b", box(1, 2)))
    assert entry.name == "named-views"
    assert "view_00_00.png" in reason
    entry, reason = recognise(save_named(tmp_path / "c" / "lf", box(1, 2)).parent)
    assert entry.name == "named-views"
    assert "lf/view_00_00.png" in reason
    save_hci(tmp_path, range(9))
    save_named(tmp_path, box(2, 2))
    assert read(tmp_path).grid_shape == (3, 3)
    assert read(tmp_path, format="named-views").grid_shape == (2, 2)
    assert "unknown format 'hcl'; known are blender, lightfield-toml, hci, " in refusal(
        lambda: read(tmp_path, format="hcl")
    )


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_every_format_refuses_folders_and_files_that_are_none(entry: Any, tmp_path: Path) -> None:
    assert entry.recognise(tmp_path) is None
    assert str(tmp_path) in refusal(lambda: read(tmp_path, format=entry.name))
    file = tmp_path / "notes.txt"
    file.write_text("hello")
    assert entry.recognise(file) is None
    assert str(file) in refusal(lambda: read(file, format=entry.name))


def test_pictures_without_numbers_are_asked_for_some(tmp_path: Path) -> None:
    for name in ("top.png", "bottom.png"):
        Image.new("RGB", (40, 32)).save(tmp_path / name)
    said = refusal(lambda: read(tmp_path))
    assert "bottom.png, top.png, whose names do not say where the cameras stood: number them, such as view_00_" in said


def test_what_is_no_light_field(tmp_path: Path) -> None:
    missing = refusal(lambda: read(tmp_path / "nowhere"))
    assert "nowhere does not exist" in missing
    empty = refusal(lambda: read(tmp_path))
    assert "an empty folder" in empty
    assert all(entry.name in empty for entry in FORMATS)
    for name in ("d.txt", "c.txt", "b.txt", "a.txt"):
        (tmp_path / name).write_text("")
    assert "a folder with a.txt, b.txt, c.txt and 1 more" in refusal(lambda: read(tmp_path))
    assert "none of which is a picture that can be read: convert them" in refusal(lambda: read(tmp_path))
    for name in ("view_00.npy", "view_01.npy"):
        np.save(tmp_path / name, np.zeros((4, 5), np.uint8))
    assert "if each is one view, stack them as one file, such as numpy.save(" in refusal(lambda: read(tmp_path))
    text = refusal(lambda: read(tmp_path / "a.txt"))
    assert "a.txt" in text
    assert "give the folder" in text


@pytest.mark.usefixtures("_permissions_count")
def test_what_may_not_be_read(tmp_path: Path) -> None:
    folder = save_named(tmp_path / "views", box(1, 2))
    (folder / "view_00_01.png").chmod(0)
    text = refusal(lambda: read(folder))
    assert "view_00_01.png cannot be read as an image: Permission denied" in text
    try:
        for mode in (0, 0o400):  # not to be listed; to be listed, but not to be entered
            folder.chmod(mode)
            assert f"{folder} cannot be listed: Permission denied" in refusal(lambda: read(folder))
            assert "deeper cannot be opened: Permission denied" in refusal(lambda: read(folder / "deeper"))
    finally:
        folder.chmod(0o700)


DOCS = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def written(true: LightField, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: sample.write(true, tmp_path_factory.mktemp(name)) for name, sample in SAMPLES.items()}


def test_every_format_has_a_sample_and_stands_in_the_docs() -> None:
    raw = {"lenslet"}  # holds no views but what they are made of: lenslet_samples.py has its samples
    assert {sample.format for sample in SAMPLES.values()} == {entry.name for entry in FORMATS} - raw
    for entry in FORMATS:
        assert f"| `{entry.name}` |" in DOCS


@pytest.fixture(scope="module")
def lf_of(written: dict[str, Path]) -> Callable[[str], LightField]:
    return cache(lambda name: read(written[name], **SAMPLES[name].options))


@pytest.mark.parametrize("name", SAMPLES)
def test_the_same_light_field_comes_back(name: str, lf_of: Callable[[str], LightField], true: LightField) -> None:
    sample, found = SAMPLES[name], lf_of(name)
    expected = true.subset(sample.views)
    assert len(found.views) == len(expected.views) - (name == "lftoolbox-7.3")  # without its dark corner
    assert found.size == true.size
    np.testing.assert_allclose(found.offsets[found.reference_index], 0)
    for index, (du, dv) in enumerate(found.offsets):
        u, v = expected.positions[expected.reference_index] + (du, dv)
        wanted = expected.image(expected.index_of(round(v, 5), round(u, 5)))
        np.testing.assert_allclose(found.image(index), wanted, atol=1e-6 if sample.exact else 0.12)
        if not sample.exact:
            assert np.mean(np.abs(found.image(index) - wanted)) < 0.02


@pytest.mark.parametrize("name", [name for name, sample in SAMPLES.items() if sample.truth])
def test_truth_comes_back_and_views_move_as_it_says(name: str, written: dict[str, Path], true: LightField) -> None:
    found = read(written[name])
    truth = found.reference_truth()
    np.testing.assert_allclose(truth.disparity, true.truth.disparity, atol=1e-5)
    assert runs_as_truth(found, 0) is True
    assert runs_as_truth(found, 1) is True
    inside = found.geometry.depth(truth.disparity)
    np.testing.assert_allclose(found.geometry.disparity(inside), truth.disparity, atol=1e-4)


@pytest.mark.usefixtures("_no_look")
@pytest.mark.parametrize("name", SAMPLES)
def test_info_of_each_and_descriptions_that_read_back(
    name: str, written: dict[str, Path], lf_of: Callable[[str], LightField], tmp_path: Path
) -> None:
    told = [f"--{key}={'x'.join(map(str, value))}" for key, value in SAMPLES[name].options.items()]
    file = tmp_path / "deep" / "array.toml"
    shown = CliRunner().invoke(app, ["info", str(written[name]), "--write", str(file), *told])
    assert shown.exit_code == 0, shown.stderr
    assert re.search(rf"format +{SAMPLES[name].format}, because", shown.stdout)
    first, again = lf_of(name), read(file)
    for field in ("views", "positions"):
        np.testing.assert_array_equal(getattr(again, field), getattr(first, field))
    for field in ("reference", "grid_shape", "geometry", "name"):
        assert getattr(again, field) == getattr(first, field)
    if first.truth is not None:
        np.testing.assert_array_equal(again.truth.disparity, first.truth.disparity)
        assert again.truth.position == first.truth.position
    if first.valid is not None and not first.files:
        np.testing.assert_array_equal(again.valid, first.valid)


LIBRARIES = {
    "blender": "OpenEXR",
    "hci-hdf5": "h5py",
    "lftoolbox-7.3": "h5py",
    "tiff-stack": "tifffile",
    "video": "imageio_ffmpeg",
    "lytro": "imageio_ffmpeg",
}


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_missing_library_is_named_with_its_extra(
    name: str, written: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, LIBRARIES[name], None)
    extra = next(entry.extra for entry in FORMATS if entry.name == SAMPLES[name].format)
    text = refusal(lambda: read(written[name]))
    assert f"pip install 'lfgpu[{extra}]'" in text
    assert str(written[name]) in text
