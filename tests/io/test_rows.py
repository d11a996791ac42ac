"""Folders of plenopticam, rows of numbered pictures, videos."""

from pathlib import Path
from typing import Any

import numpy as np
from fields import SAMPLES
from samples import picture, refusal, save

from lfgpu.data.lightfield import LightField
from lfgpu.io import read


def test_plenopticam_that_lost_a_row(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["plenopticam"].write(true, tmp_path)
    assert read(path / "viewpoints_5px").grid_shape == (5, 5)
    for file in path.glob("*/4_*.png"):
        file.unlink()
    assert "should have 5 x 5 views, found a grid of 4 x 5" in refusal(lambda: read(path))
    (path / "viewpoints_3px").mkdir()
    assert "several exports (viewpoints_3px, viewpoints_5px)" in refusal(lambda: read(path))


def save_row(folder: Path, numbers: Any, pattern: str = "mansion_image_{0:04d}.png") -> Path:
    for number in numbers:
        save(folder / pattern.format(number), picture(number))
    return folder


def test_numbered_images_are_a_row(tmp_path: Path) -> None:
    found = read(save_row(tmp_path / "a", range(25, 60, 5)))
    assert (found.grid_shape, found.reference) == ((1, 7), 3)
    np.testing.assert_array_equal(found.view(0, 2), picture(35))
    found = read(tmp_path / "a", every=3)
    np.testing.assert_array_equal(found.views[1], picture(40))
    assert found.grid_shape == (1, 3)
    assert read(tmp_path / "a", grid=(7, 1)).grid_shape == (7, 1)
    save(tmp_path / "a" / "cover.png")
    assert "not named as the others: cover.png" in read(tmp_path / "a").notes[0]


def test_numbered_images_that_leave_it_open(tmp_path: Path) -> None:
    save_row(tmp_path / "square", range(9))
    text = refusal(lambda: read(tmp_path / "square"))
    assert "--grid 1x9, --grid 3x3" in text
    np.testing.assert_array_equal(read(tmp_path / "square", grid=(3, 3)).view(2, 1), picture(7))
    save_row(tmp_path / "gaps", [1, 2, 3, 5])
    assert "lacks 1 of the 5 views" in refusal(lambda: read(tmp_path / "gaps"))
    assert len(read(tmp_path / "gaps", allow_missing=True).views) == 4
    save_row(tmp_path / "dates", [20250101, 20261231])
    assert '--pattern "mansion_image_{date}.png"' in refusal(lambda: read(tmp_path / "dates"))
    assert read(tmp_path / "dates", pattern="mansion_image_{date}.png").grid_shape == (1, 2)
    save_row(tmp_path / "far", [1, 2, 20261231])
    assert "that is no row of cameras" in refusal(lambda: read(tmp_path / "far"))
    assert "several folders with numbered images" in refusal(lambda: read(tmp_path))


def test_videos(tmp_path: Path, true: LightField) -> None:
    path = SAMPLES["video"].write(true, tmp_path)
    row = true.views[true.row()]
    found = read(path, every=2)
    np.testing.assert_array_equal(found.views, row[::2])
    assert read(path, grid=(5, 1)).grid_shape == (5, 1)
    assert "5 views, which is not a grid of 2 x 2" in refusal(lambda: read(path, grid=(2, 2)))
    assert "has 1 frames to take" in refusal(lambda: read(path, every=9))
    path.write_bytes(path.read_bytes()[:200])
    assert f"{path} cannot be read as a video" in refusal(lambda: read(path))
