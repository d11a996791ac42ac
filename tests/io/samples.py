"""Small light fields in files, and what refusals look like."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.scenes import make

HEIGHT, WIDTH = 4, 5

CFG = """
[intrinsics]
focal_length_mm = 100.0
image_resolution_x_px = 5
image_resolution_y_px = 4
sensor_size_mm = 35.0

[extrinsics]
num_cams_x = {columns}
num_cams_y = {rows}
baseline_mm = 25.0
focus_distance_m = 4.25

[meta]
scene = 100 % cotton
disp_min = -1.6
disp_max = 1.5
"""


def picture(seed: int = 0, channels: int = 3, dtype: Any = np.uint8) -> NDArray[Any]:
    """[y, x, c] of random values, another one for each seed."""
    values = np.random.default_rng(seed).random((HEIGHT, WIDTH, channels))
    return values.astype(dtype) if dtype == np.float32 else (values * np.iinfo(dtype).max).astype(dtype)


def save(path: Path, image: NDArray[Any] | None = None) -> None:
    """Write an image with Pillow, in the format that the suffix names."""
    image = picture() if image is None else image
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image[..., 0] if image.shape[2] == 1 else image).save(path)


def save_named(folder: Path, places: Iterable[tuple[int, int]], pattern: str = "view_{0:02d}_{1:02d}.png") -> Path:
    """Views at places of a grid, each with its own content (seed 100 * row + column)."""
    for row, column in places:
        save(folder / pattern.format(row, column), picture(abs(100 * row + column)))
    return folder


def save_hci(folder: Path, indices: Iterable[int], *, rows: int = 3, columns: int = 3, cfg: str | None = CFG) -> Path:
    for index in indices:
        save(folder / f"input_Cam{index:03d}.png", picture(index))
    if cfg is not None:
        (folder / "parameters.cfg").write_text(cfg.format(rows=rows, columns=columns))
    return folder


def save_as(folder: Path, lf: LightField, name: Callable[[int, int], str]) -> Path:
    """The views of a light field, by the name that their (row, column) have."""
    for view, (u, v) in zip(lf.views, lf.positions.astype(int).tolist(), strict=True):
        save(folder / name(v, u), view)
    return folder


def planes(grid: tuple[int, int] = (3, 4)) -> LightField:
    """Views whose parallax shows how the cameras stand."""
    return make("planes", grid=grid, size=(96, 112), disparity_range=(-1.5, 1.5), seed=1)


def grid_of(lf: LightField) -> NDArray[Any]:
    """[v, u, y, x, c]."""
    assert lf.grid_shape is not None
    return lf.views.reshape(*lf.grid_shape, *lf.views.shape[1:])


def stored_as(order: str, views: NDArray[Any]) -> NDArray[Any]:
    """[v, u, y, x, c], or views one after the other [n, y, x, c], with the axes in an order such as "yxvuc"."""
    axes = "vuyxc" if views.ndim == 5 else "nyxc"
    return views.transpose([axes.index(axis) for axis in order])


def box(rows: int, columns: int, first: int = 0) -> list[tuple[int, int]]:
    return [(row + first, column + first) for row in range(rows) for column in range(columns)]


def cross(n: int) -> set[tuple[int, int]]:
    return {(row, column) for row, column in box(n, n) if row == n // 2 or column == n // 2}


def star(n: int) -> set[tuple[int, int]]:
    return {(row, column) for row, column in box(n, n) if abs(row - n // 2) == abs(column - n // 2)} | cross(n)


def changed(about: dict[str, Any], **values: Any) -> dict[str, Any]:
    """Nested dictionaries and lists with other values, `a__0__b` for the one at ["a"][0]["b"]; None takes one out."""
    for name, value in values.items():
        *parents, last = (int(key) if key.isdigit() else key for key in name.split("__"))
        place: Any = about
        for parent in parents:
            place = place[parent]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return about


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(LightFieldError) as error:
        call()
    text = str(error.value)
    assert text.endswith(".")
    assert "\n" not in text
    return text
