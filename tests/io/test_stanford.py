"""Folders of the Stanford archive: positions in the names of pictures, and what contradicts them."""

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from samples import picture, refusal, save

from lfgpu.data.lightfield import LightField
from lfgpu.io import read


def save_stanford(folder: Path, places: Any, pattern: str = "out_{0:02d}_{1:02d}_{2:.6f}_{3:.6f}_.png") -> Path:
    for index, (row, column, y, x) in enumerate(places):
        save(folder / pattern.format(row, column, y, x), picture(index))
    return folder


def test_stanford_positions_are_irregular_view_steps(tmp_path: Path) -> None:
    places = [(0, 0, -20.0, 100.0), (0, 1, -20.5, 110.0), (0, 2, -19.5, 121.0), (1, 0, -8.0, 101.0)]
    found = read(save_stanford(tmp_path, places))
    # The distances of neighbours in a row are 10 and 11: the step is their median.
    np.testing.assert_allclose(found.positions[:, 0] * 10.5, [0, 10, 21, 1], atol=1e-9)
    np.testing.assert_allclose(found.positions[:, 1] * 10.5, [0.5, 0, 1, 12.5], atol=1e-9)
    assert found.grid_shape is None
    assert "One view step is 10.5 in the unit" in found.notes[0]


def test_stanford_y_counts_downwards_whether_names_end_in_an_underscore_or_not(tmp_path: Path) -> None:
    places = [(0, 0, -3.0, 1.0), (1, 0, -5.0, 1.0)]
    for name, end in (("with", "_"), ("without", "")):
        pattern = "out_{0:02d}_{1:02d}_{2}_{3}" + end + ".png"
        found = read(save_stanford(tmp_path / name, places, pattern))
        np.testing.assert_allclose(found.positions, [[0, 1], [0, 0]])


def test_stanford_a_row_with_gaps(tmp_path: Path) -> None:
    columns = [0, 1, 2, 5, 6, 9]
    places = [(8, column, -451.0 + 0.3 * (column % 3), 1103.0 - 8.7 * column) for column in columns]
    found = read(save_stanford(tmp_path, places))
    np.testing.assert_allclose(found.positions[:, 0], 9 - np.array(columns), atol=1e-9)
    np.testing.assert_allclose(found.positions[:, 1] * 8.7, 0.3 * (np.array(columns) % 3), atol=1e-9)
    assert "One view step is 8.7 in the unit" in found.notes[0]


def test_stanford_pictures_are_believed_against_names(tmp_path: Path, true: LightField) -> None:
    for index, (u, v) in enumerate(true.positions):
        name = f"out_{round(v):02d}_{round(u):02d}_{-v:.3f}_{u:.3f}_.png"
        Image.fromarray(true.views[index]).save(tmp_path / name)
    found = read(tmp_path)
    assert any("rows were turned round" in note for note in found.notes)
    np.testing.assert_allclose(found.positions[found.index_of(0, 0)], [0, 0])
    np.testing.assert_array_equal(found.view(0, 0), true.view(0, 0))


def test_stanford_that_is_refused(tmp_path: Path) -> None:
    places = [(0, 0, 5.0, 1.0), (0, 1, 5.0, 1.0)]
    assert "stand in one place" in refusal(lambda: read(save_stanford(tmp_path / "a", places)))
    places = [(0, 0, 5.0, 1.0), (0, 1, 5.0, 2.0), (0, 2, 5.0, 2.0)]
    assert "two views have the position" in refusal(lambda: read(save_stanford(tmp_path / "b", places)))
    assert "one view only" in refusal(lambda: read(save_stanford(tmp_path / "c", places[:1])))
