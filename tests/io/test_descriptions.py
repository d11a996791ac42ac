"""`lightfield.toml` and `.json`: what they say of a light field, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from fields import SAMPLES
from samples import picture, refusal, save

from lfgpu.data.lightfield import LightField
from lfgpu.io import read


def describe(folder: Path, text: str) -> Path:
    save(folder / "a.png", picture(1))
    save(folder / "b.png", picture(2))
    save(folder / "mask.png", np.array(picture(3, 1) > 100, np.uint8) * np.uint8(255))
    (folder / "lightfield.toml").write_text(text, encoding="utf-8")
    return folder


TWO = '[[views]]\nfile = "a.png"\nposition = [0, 0]\n[[views]]\nfile = "b.png"\nposition = [1.5, -0.25]\n'


def test_a_description_by_hand(tmp_path: Path) -> None:
    text = (
        'name = "Bänke"\nreference = 0\n[geometry]\nfocal_length_px = 1200\nbaseline_m = 0.02\n'
        "principal_point = [1.0, 2.0]\n" + TWO + 'valid = "mask.png"\n'
    )
    found = read(describe(tmp_path, text))
    assert (found.name, found.reference, found.grid_shape) == ("Bänke", 0, None)
    np.testing.assert_array_equal(found.positions, [[0, 0], [1.5, -0.25]])
    assert found.geometry is not None
    assert (found.geometry.focus_distance_m, found.geometry.principal_point) == (float("inf"), (1, 2))
    assert found.valid is not None
    assert found.valid[0].all()
    np.testing.assert_array_equal(found.valid[1], picture(3, 1)[..., 0] > 100)


def test_a_description_of_another_format(tmp_path: Path, true: LightField) -> None:
    SAMPLES["npy"].write(true, tmp_path)
    description = tmp_path / "lightfield.toml"
    description.write_text(
        '[source]\npath = "views.npy"\nformat = "numpy"\nflip = "v"\n[geometry]\nfocal_length_px = 9\nbaseline_m = 1\n'
    )
    found = read(tmp_path)
    np.testing.assert_array_equal(found.view(0, 1), true.view(4, 1))
    assert found.geometry is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("views = 3", "views must be a list"),
        ("colour = 1\n" + TWO, "a description has an unknown entry 'colour'"),
        (TWO + "angle = 3\n", "views[1] has an unknown entry 'angle'"),
        (TWO.replace("b.png", "c.png"), "views[1].file names"),
        (TWO.replace("b.png", ""), "views[1] has no file"),
        (TWO.replace("[1.5, -0.25]", "[1.5]"), "views[1].position must be a pair of numbers"),
        (TWO.replace("[1.5, -0.25]", "[nan, 0]"), "must be a number, not nan"),
        (TWO.replace("[1.5, -0.25]", "[inf, 0]"), "finite pairs"),
        (TWO.replace("[1.5, -0.25]", "[true, 0]"), "must be a number, not True"),
        (TWO.replace("[1.5, -0.25]", "[0, 0]"), "two views have the position row 0, column 0"),
        (TWO.replace("position = [0, 0]\n", ""), "views[0] has no position"),
        (TWO[:42], "lists 1 views"),
        ("reference = 2\n" + TWO, "reference view 2 does not exist"),
        ("reference = 1.5\n" + TWO, "reference must be a whole number"),
        ("grid = [3, 3]\n" + TWO, "positions must be integers in the grid"),
        ("name = 3\n" + TWO, "name must be a text"),
        ("[geometry]\nfocal_length_px = 3\n" + TWO, "geometry has no baseline_m"),
        ("[geometry]\nfocal_length_px = 3\nbaseline_m = -1\n" + TWO, "baseline_m must be a positive number"),
        ('[truth]\ndisparity = "t.pfm"\n' + TWO, "truth must have a file of disparity and the position"),
        ('[source]\npath = "."\nformat = "lightfield-toml"\n', "source must name a path and its format"),
        ('[source]\npath = "."\n', "source must name a path and its format"),
        ('[source]\npath = "no.npy"\nformat = "numpy"\n', "no.npy does not exist"),
        ('[source]\npath = "a.png"\nformat = "numpy"\nflip = 3\n', "source: flip must be u"),
        ("= 3", "is not valid TOML"),
    ],
)
def test_descriptions_that_are_refused(tmp_path: Path, text: str, words: str) -> None:
    found = refusal(lambda: read(describe(tmp_path, text)))
    assert words in found
    assert "lightfield.toml" in found or "no.npy" in found


def test_json_that_is_refused(tmp_path: Path) -> None:
    for text in ("[1", "[" * 100_000, "[]", '{"views": [{"file": "a"}, 3]}', '"\\ud800"', "{" + '"a":{' * 5000):
        (tmp_path / "a.json").write_text(text)
        assert "a.json" in refusal(lambda: read(tmp_path / "a.json"))
