"""What the user says of a light field, and what a user tries next when it cannot be read."""

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fields import SAMPLES
from samples import box, refusal, save, save_named

from lfgpu.data.lightfield import LightField
from lfgpu.io import read, recognise
from lfgpu.io.parallax import axes_agree

# --- what the user says ---


def test_flip_mirrors_the_cameras(tmp_path: Path) -> None:
    save_named(tmp_path, box(2, 3))
    plain, turned = read(tmp_path), read(tmp_path, flip="u")
    np.testing.assert_array_equal(turned.view(0, 0), plain.view(0, 2))
    np.testing.assert_array_equal(turned.view(1, 2), plain.view(1, 0))
    assert turned.reference == turned.index_of(1, 1)
    both = read(tmp_path, flip="uv")
    np.testing.assert_array_equal(both.view(0, 0), plain.view(1, 2))
    assert "flip must be u (columns)" in refusal(lambda: read(tmp_path, flip="x"))


def test_parallax_tells_a_flip(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["npy"].write(true, tmp_path)
    assert [axes_agree(read(path, flip=flip)) for flip in ("", "u", "v", "uv")] == [True, False, False, True]
    assert axes_agree(true.subset("row")) is None
    assert read(path).notes == ()
    assert "read it without --flip v" in read(path, flip="v").notes[-1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"grid": (2, 3)}, "has rows and columns in the names of its images; leave grid out"),
        ({"every": 2}, "for which every means nothing"),
        ({"grid": (0, 3)}, "grid must be (rows, columns)"),
        ({"every": 0}, "every must be a whole number of at least 1, not 0."),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    save_named(tmp_path, box(2, 3))
    assert words in refusal(lambda: read(tmp_path, **options))


# --- what a user tries next ---


def test_one_image_of_a_folder_names_the_folder(tmp_path: Path) -> None:
    folder = save_named(tmp_path / "my views", box(2, 2))
    text = refusal(lambda: read(folder / "view_00_01.png"))
    assert f"give the folder {folder}, which is named-views" in text
    save(tmp_path / "alone" / "a.png")
    assert "one image (give the folder that holds the views" in refusal(lambda: read(tmp_path / "alone" / "a.png"))


def test_archives_have_to_be_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "lego.zip", "w") as archive:
        archive.writestr("a.png", "x")
    assert "a zip archive (unpack it" in refusal(lambda: read(tmp_path / "lego.zip"))


@pytest.mark.parametrize("name", ["a.h5", "a.mat", "a.npz", "a.mp4"])
def test_files_that_are_not_what_their_name_says(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("<html>404 Not Found</html>")
    assert "does not begin as such files do" in refusal(lambda: read(tmp_path / name))
    (tmp_path / name).write_bytes(b"")
    assert "an empty file" in refusal(lambda: read(tmp_path / name))


def test_formats_are_known_by_their_beginning_not_their_name(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["npy"].write(true, tmp_path).rename(tmp_path / "views.dat")
    assert recognise(path)[0].name == "numpy"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in the file system here")
def test_pipes_and_links_in_circles(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "neither a file nor a folder" in refusal(lambda: read(tmp_path / "pipe"))
    (tmp_path / "circle").symlink_to("circle")
    assert "cannot be opened" in refusal(lambda: read(tmp_path / "circle"))
    folder = save_named(tmp_path / "views", box(1, 2))
    (folder / "view_00_02.png").symlink_to("gone.png")
    assert "view_00_02.png is a link that leads nowhere" in refusal(lambda: read(folder))
    (folder / "view_00_02.png").unlink()
    (folder / "around").symlink_to(folder)
    assert len(read(folder).views) == 2
