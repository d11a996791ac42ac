"""Pictures: scales, units, undefined pixels, and sizes that are exact."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lfgpu.errors import LightFieldError
from lfgpu.viz.colours import LOOKS, UNDEFINED, painted
from lfgpu.viz.pictures import save_picture
from lfgpu.viz.sheets import overview

SHAPE = (30, 40)


def ramp(low: float = -1.0, high: float = 2.0) -> np.ndarray:
    return np.linspace(low, high, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)


def greys(picture: Image.Image) -> int:
    return int((np.asarray(picture.convert("RGB")) == UNDEFINED).all(axis=2).sum())


def test_compared_maps_share_a_scale_and_errors_have_zero_in_the_middle() -> None:
    """An error of 0.05 everywhere is 0.05 of 0.07, at which all scales of errors end; the truth has no error."""
    sheet = np.asarray(overview(np.zeros((*SHAPE, 3)), ramp() + 0.05, ramp(), title="a title"))
    wanted = painted(np.full((1, 1), 0.05, np.float32), LOOKS["error"].colours, (-0.07, 0.07))[0, 0]
    size = math.ceil(900 / max(SHAPE))
    assert (sheet == wanted).all(axis=2).sum() >= SHAPE[0] * SHAPE[1] * size**2
    lowest = painted(np.full((1, 1), -1.0, np.float32), "viridis", (-1.0, 2.0))[0, 0]
    assert (sheet == lowest).all(axis=2).any()


def test_errors_outside_the_mask_and_in_the_border_are_grey() -> None:
    mask = np.ones(SHAPE, np.bool_)
    mask[:10] = False
    maps = (np.zeros((*SHAPE, 1)), ramp(), ramp())
    size = math.ceil(900 / max(SHAPE)) ** 2
    drawn = [greys(overview(*maps, title="", **options)) for options in ({}, {"mask": mask}, {"border": 5})]
    assert [n // size for n in drawn] == [0, 10 * SHAPE[1], SHAPE[0] * SHAPE[1] - 20 * 30]


def test_what_is_no_map_is_refused() -> None:
    with pytest.raises(LightFieldError, match=r"\[y, x\]"):
        overview(np.zeros((2, 3, 3)), np.zeros((2, 3, 4)), np.zeros((2, 3)), title="")
    with pytest.raises(LightFieldError, match="same size"):
        overview(np.zeros((*SHAPE, 3)), ramp(), ramp()[1:], title="")


def test_a_picture_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(LightFieldError, match="cannot be written"):
        save_picture(overview(np.zeros((*SHAPE, 3)), ramp(), ramp(), title=""), tmp_path / "file" / "x.png")
