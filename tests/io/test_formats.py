"""The table of formats: what is recognised, and what is no light field."""

import inspect
import tomllib
from pathlib import Path
from typing import Any

import pytest
from samples import box, refusal, save_hci, save_named

from lfgpu.io import FORMATS, read, recognise

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]


def test_the_table_is_well_formed() -> None:
    names = [entry.name for entry in FORMATS]
    assert len(set(names)) == len(names)
    for entry in FORMATS:
        assert entry.name == entry.name.lower()
        assert " " not in entry.name
        assert "\n" not in entry.description
        assert not entry.description.endswith(".")
        assert set(entry.takes) <= set(inspect.signature(read).parameters)
        assert entry.extra is None or entry.extra in EXTRAS


def test_recognise_says_why(tmp_path: Path) -> None:
    entry, reason = recognise(save_hci(tmp_path / "a", [0, 1], rows=1, columns=2))
    assert (entry.name, reason) == ("hci", "it is a folder with input_Cam000.png")
    entry, reason = recognise(save_named(tmp_path / "b", box(1, 2)))
    assert entry.name == "named-views"
    assert "view_00_00.png" in reason
    entry, reason = recognise(save_named(tmp_path / "c" / "lf", box(1, 2)).parent)
    assert entry.name == "named-views"
    assert "lf/view_00_00.png" in reason


def test_a_format_can_be_asked_for(tmp_path: Path) -> None:
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


def test_what_is_no_light_field(tmp_path: Path) -> None:
    missing = refusal(lambda: read(tmp_path / "nowhere"))
    assert "nowhere does not exist" in missing
    empty = refusal(lambda: read(tmp_path))
    assert "an empty folder" in empty
    assert all(entry.name in empty for entry in FORMATS)
    for name in ("d.txt", "c.txt", "b.txt", "a.txt"):
        (tmp_path / name).write_text("")
    assert "a folder with a.txt, b.txt, c.txt and 1 more" in refusal(lambda: read(tmp_path))
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
