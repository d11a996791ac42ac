"""The pictures of `lfgpu depth`: colours, scale, undefined pixels, whole squares; they do without matplotlib."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from lfgpu.errors import LightFieldError
from lfgpu.viz.colours import UNDEFINED, indices, palette, shades
from lfgpu.viz.pictures import beside_scale, draw_map, ticks, write_confidence, write_disparity, write_picture


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.parametrize("name", ["viridis", "cividis"])
def test_colours_are_those_of_matplotlib(name: str) -> None:
    colours = palette(name)[:239].astype(float)
    wanted = 255 * colormaps[name](np.linspace(0, 1, 239))[:, :3]
    assert np.abs(colours - wanted).max() < 6  # each fifth step is in the tables
    assert palette(name)[239].tolist() == list(UNDEFINED)
    assert palette(name)[240].tolist() == [255] * 3
    assert palette(name)[255].tolist() == [0] * 3


@pytest.mark.parametrize("name", ["magma", "RdBu_r", "viridis_r"])
def test_other_colours_come_from_matplotlib(name: str) -> None:
    np.testing.assert_array_equal(shades(name, 17), (255 * colormaps[name](np.linspace(0, 1, 17))[:, :3] + 0.5) // 1)


def test_the_ink_is_what_is_read_on_the_paper() -> None:
    assert palette("magma", (20, 23, 28))[[240, 255]].tolist() == [[20, 23, 28], [255] * 3]
    assert palette("magma", (200, 200, 180))[255].tolist() == [0] * 3


def test_values_beyond_the_scale_have_the_colours_of_its_ends() -> None:
    values = np.array([[-9, -1, 0, 1, 9, np.nan, np.inf, -np.inf]], np.float32)
    assert indices(values, (-1, 1)).tolist() == [[0, 0, 119, 238, 238, 239, 239, 239]]


@pytest.mark.parametrize("shape", [(30, 40), (200, 10), (10, 200), (1, 1), (1000, 950)])
def test_each_pixel_of_a_map_is_a_whole_square(shape: tuple[int, int], tmp_path: Path) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    write_confidence(values, tmp_path / "a.png", name="noise")
    drawn, size = pixels(tmp_path / "a.png"), math.ceil(900 / max(shape))
    wanted = palette("cividis")[indices(values, (0.0, 1.0))].repeat(size, 0).repeat(size, 1)
    left, (height, width) = round(0.025 * size * max(shape)), wanted.shape[:2]
    tops = range(drawn.shape[0] - height + 1)
    assert any((drawn[top : top + height, left : left + width] == wanted).all() for top in tops)


@pytest.mark.parametrize("undefined", [np.nan, np.inf, -np.inf])
def test_undefined_pixels_are_grey(undefined: float, tmp_path: Path) -> None:
    values = np.linspace(-1, 2, 1200, dtype=np.float32).reshape(30, 40)
    write_disparity(values, tmp_path / "known.png", name="ramp")
    values[3, 4] = undefined
    write_disparity(values, tmp_path / "unknown.png", name="ramp")
    grey = [int((pixels(tmp_path / name) == UNDEFINED).all(2).sum()) for name in ("known.png", "unknown.png")]
    assert grey == [0, 23**2]


def test_an_end_of_the_bar_is_pointed_where_values_lie_beyond_it(tmp_path: Path) -> None:
    values = np.full((30, 40), 0.5, np.float32)
    heights = []
    for beyond in (0.5, 2.0, -2.0):
        values[0, 0] = beyond
        write_confidence(values, tmp_path / "a.png", name="flat")
        drawn = pixels(tmp_path / "a.png")
        bar = drawn.shape[1] - np.argmax((drawn[:, ::-1] == palette("cividis")[238]).all(2).any(0)) - 2
        ends = [(drawn[:, bar - 12] == palette("cividis")[index]).all(1).sum() for index in (238, 0)]
        heights.append(ends)
    assert heights[1][0] > heights[0][0] + 5
    assert heights[2][1] > heights[0][1] + 5


@pytest.mark.parametrize("value", [0.0, 2.5, 1e6, np.nan])
def test_a_map_of_one_value_can_be_drawn(value: float, tmp_path: Path) -> None:
    write_disparity(np.full((30, 40), value), tmp_path / "a.png", name="Ελλάδα $x$ \N{SNOWMAN} " + 50 * "long")
    assert min(pixels(tmp_path / "a.png").shape[:2]) > 500


@pytest.mark.parametrize(("low", "high", "wanted"), [(0, 1, 6), (-1.68, 1.48, 6), (-0.003, 0.002, 6), (3, 3.07, 8)])
def test_ticks_are_round_numbers_within_the_scale(low: float, high: float, wanted: int) -> None:
    found = ticks(low, high)
    assert len(found) == wanted
    assert low - 1e-9 <= found[0] < found[-1] <= high + 1e-9
    steps = np.diff(found)
    np.testing.assert_allclose(steps, steps[0])
    digits = steps[0] / 10 ** math.floor(math.log10(steps[0]) + 1e-9)
    assert min(abs(digits - round_one) for round_one in (1, 2, 2.5, 5)) < 1e-6


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LightFieldError, match=r"a map must be \[y, x\]"):
        write_picture(np.zeros((2, 3, 4)), tmp_path / "a.png", title="", label="")
    (tmp_path / "file").write_text("")
    with pytest.raises(LightFieldError, match="cannot be written"):
        write_picture(np.zeros((2, 3)), tmp_path / "file" / "a.png", title="", label="")
    assert {path.name for path in tmp_path.iterdir()} == {"file"}


def test_limits_that_are_given_are_those_of_the_scale() -> None:
    values = np.linspace(-1, 2, 1200, dtype=np.float32).reshape(30, 40)
    drawn = np.asarray(draw_map(values, title="", label="", colours="magma", limits=(-3, 3)))
    shown = drawn[drawn < 239]
    assert np.isin(indices(values, (-3, 3)), shown).all()


@pytest.mark.parametrize("size", [(29, 31), (480, 640)])
@pytest.mark.parametrize("paper", [(255, 255, 255), (20, 23, 28)])
def test_a_picture_beside_a_scale_keeps_its_pixels(
    size: tuple[int, int], paper: tuple[int, int, int], rng: np.random.Generator
) -> None:
    picture = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
    drawn = beside_scale(picture, label="depth (m)", colours="magma", limits=(1, 2), extent=(1, 3), paper=paper)
    found = np.asarray(drawn)
    assert found.shape[0] == size[0]
    np.testing.assert_array_equal(found[:, : size[1]], picture)
    assert tuple(found[0, -1]) == paper


def test_matplotlib_is_not_imported_for_them(tmp_path: Path) -> None:
    program = (
        "import sys, numpy; from lfgpu.viz.pictures import write_disparity; "
        f"write_disparity(numpy.eye(9), {str(tmp_path / 'a.png')!r}, name='eye'); print('matplotlib' in sys.modules)"
    )
    assert (
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "False\n"
    )
