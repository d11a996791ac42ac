"""Pictures: scales, units, undefined pixels, and sizes that are exact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from lfgpu.errors import LightFieldError
from lfgpu.metrics import sparsification
from lfgpu.viz.figures import (
    disparity_figure,
    figure_with_scale,
    overview_figure,
    save_png,
    sparsification_figure,
)

SHAPE = (30, 40)


def ramp(low: float = -1.0, high: float = 2.0) -> np.ndarray:
    return np.linspace(low, high, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)


def pixels(figure: Figure, folder: Path) -> np.ndarray:
    save_png(figure, folder / "figure.png")
    with Image.open(folder / "figure.png") as image:
        return np.asarray(image.convert("RGB"))


def colour_of(figure: Figure, y: int, x: int) -> np.ndarray:
    image = figure.axes[0].images[0]
    return np.asarray(image.cmap(image.norm(image.get_array()))[y, x])


def test_disparity_has_a_scale_with_its_unit() -> None:
    figure = disparity_figure(ramp(), name="cones")
    axes, bar = figure.axes
    assert axes.get_title() == "cones: disparity"
    assert "px per view step" in bar.get_ylabel()
    assert "larger is nearer" in bar.get_ylabel()
    assert "undefined" not in bar.get_ylabel()
    assert axes.images[0].get_clim() == pytest.approx((-1, 2), abs=0.01)


def test_given_limits_are_kept() -> None:
    assert disparity_figure(ramp(), limits=(-3, 3)).axes[0].images[0].get_clim() == (-3, 3)


def test_outliers_do_not_stretch_the_scale() -> None:
    values = ramp()
    values[3, 4] = 1000
    assert disparity_figure(values).axes[0].images[0].get_clim()[1] < 3


@pytest.mark.parametrize("undefined", [np.nan, np.inf, -np.inf])
def test_undefined_pixels_are_grey_and_said_to_be(undefined: float) -> None:
    values = ramp()
    values[3, 4] = undefined
    figure = disparity_figure(values)
    red, green, blue, _ = colour_of(figure, 3, 4)
    assert red == green == blue
    assert "grey: undefined" in figure.axes[1].get_ylabel()


@pytest.mark.parametrize("value", [0.0, 2.5, np.nan])
def test_a_map_of_one_value_can_be_drawn(value: float, tmp_path: Path) -> None:
    assert pixels(disparity_figure(np.full(SHAPE, value)), tmp_path).size


@pytest.mark.parametrize("shape", [(30, 40), (200, 10), (10, 200), (1, 1), (1000, 950)])
def test_each_pixel_of_a_map_is_a_whole_square(shape: tuple[int, int], tmp_path: Path) -> None:
    values = np.random.default_rng(0).random(shape)
    figure = disparity_figure(values)
    drawn = pixels(figure, tmp_path)
    box = figure.axes[0].get_window_extent()
    magnification = box.width / shape[1]
    assert magnification == pytest.approx(round(magnification))
    assert box.height / shape[0] == pytest.approx(magnification)
    assert drawn.shape[0] >= box.height
    assert drawn.shape[1] >= box.width


def test_compared_maps_share_a_scale_and_errors_have_zero_in_the_middle() -> None:
    view = np.zeros((*SHAPE, 3))
    figure = overview_figure(view, ramp() + 0.17, ramp(), title="a title", border=5)
    by_title = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
    assert list(by_title) == ["reference view", "disparity minus truth", "disparity", "truth"]
    assert by_title["disparity"].images[0].get_clim() == by_title["truth"].images[0].get_clim()
    low, high = by_title["disparity minus truth"].images[0].get_clim()
    assert low == -high
    assert high == pytest.approx(0.2, abs=1e-9)  # an error of 0.17 everywhere, rounded up to one digit
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert sum("px per view step" in label for label in labels) == 2
    assert len(by_title["disparity minus truth"].patches) == 1  # the border


def test_errors_outside_the_mask_are_not_shown() -> None:
    mask = np.ones(SHAPE, np.bool_)
    mask[:10] = False
    figure = overview_figure(np.zeros((*SHAPE, 1)), ramp(), ramp(), title="", mask=mask)
    error = next(axes for axes in figure.axes if axes.get_title() == "disparity minus truth").images[0].get_array()
    assert np.ma.getmaskarray(error)[:10].all()
    assert not np.ma.getmaskarray(error)[10:].any()


@pytest.mark.parametrize("wrong", [True, False])
def test_the_curve_is_drawn_beside_that_of_the_oracle(wrong: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    error = rng.normal(0, 0.1 if wrong else 1e-3, SHAPE)
    curve = sparsification(error, rng.random(SHAPE), np.zeros(SHAPE), border=0)
    figure = sparsification_figure(curve, name="$a$")
    (axes,) = figure.axes
    drawn = [line.get_ydata() for line in axes.lines]
    np.testing.assert_array_equal(drawn, [curve.bad, curve.oracle])
    assert axes.get_title().startswith("$a$: sparsification")
    assert ("AUSE" in axes.get_title()) == wrong
    assert "0.07 px" in axes.get_ylabel()
    low, high = axes.get_ylim()
    assert low == 0 < high
    assert pixels(figure, tmp_path).size


@pytest.mark.parametrize("name", ["$x_$", "a" * 200, "深度", "two\nlines"])
def test_any_name_can_be_a_title(name: str, tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    assert pixels(disparity_figure(ramp(), name=name), tmp_path).size
    assert not recwarn.list


def test_what_is_no_map_is_refused() -> None:
    with pytest.raises(LightFieldError, match=r"\[y, x\]"):
        disparity_figure(np.zeros((2, 3, 4)))
    with pytest.raises(LightFieldError, match="same size"):
        overview_figure(np.zeros((*SHAPE, 3)), ramp(), ramp()[1:], title="")


def test_a_picture_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(LightFieldError, match="cannot be written"):
        save_png(disparity_figure(np.zeros(SHAPE)), tmp_path / "file" / "x.png")


@pytest.mark.parametrize("size", [(29, 31), (480, 640)])
@pytest.mark.parametrize("paper", [(255, 255, 255), (20, 23, 28)])
def test_a_picture_beside_a_scale_keeps_its_pixels(
    size: tuple[int, int], paper: tuple[int, int, int], rng: np.random.Generator, tmp_path: Path
) -> None:
    picture = rng.integers(0, 256, (*size, 3)).astype(np.uint8)
    figure = figure_with_scale(picture, label="depth (m)", colours="magma", limits=(1, 2), extent=(1, 3), paper=paper)
    found = pixels(figure, tmp_path)
    assert found.shape[0] == size[0]
    np.testing.assert_array_equal(found[:, : size[1]], picture)
    assert tuple(found[0, -1]) == paper
