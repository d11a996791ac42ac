"""The way from a raw capture to a light field, on one page."""

import json
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_folder, check_no_others
from lfgpu.io.lenslet import bayer as mosaics
from lfgpu.io.lenslet.capture import Capture, read_capture
from lfgpu.io.lenslet.lattice import Microlenses
from lfgpu.io.lenslet.microlenses import find_microlenses, is_upright
from lfgpu.io.lenslet.resampling import sample_views, view_grid
from lfgpu.io.lenslet.vignetting import Float32Array, MeanMicrolens, field_gains, from_white_image
from lfgpu.io.png import write_png
from lfgpu.io.reporting import say

STEP = 1.0
"""Pixels of the sensor between neighbouring views."""
ABOUT_FILE = "lenslet.json"
"""The findings and steps of a decoded capture, beside its views."""

_DARKEST = 0.15  # share of the light below which values are not raised any further
_VALID = 0.25  # share of the light below which a pixel of a view is of no use
_WHITE_PERCENTILE = 99.9
_MOST_VIEWS = 31
_VIEW = re.compile(r"view_[0-9]+_[0-9]+\.png")
_LEAST_LEVEL = 1e-4  # of the white level: what is darker everywhere is black


@dataclass(frozen=True, eq=False)
class Decoded:
    """A light field from a raw capture, and how it was made."""

    light_field: LightField  # views uint16 [n, y, x, c], square roots of linear values
    about: dict[str, Any]  # findings and steps, for people and JSON


def decode(
    path: str | os.PathLike[str],
    *,
    bayer: str | None = None,
    white: str | os.PathLike[str] | None = None,
    views: int | None = None,
    progress: Callable[[str], None] = say,
) -> Decoded:
    """Make views of the raw capture of a lenslet camera: uint16, square roots of linear values.

    The microlens grid is found (in the white image, if there is one), values are divided by what light the pixels get
    under their microlenses, demosaiced among pixels of the same microlens, and resampled to square pixels, one row of
    them for each row of microlenses. Nothing is sharpened or filtered. 1 is the brightest thousandth of the middle
    view.

    `bayer` names the colours of the pixels (0, 0), (0, 1), (1, 0), (1, 1), or is "grey"; None takes what the container
    says; for pictures, green is found, and the pattern of Lytro cameras that has it is taken. `white` is a capture of
    an evenly white scene by the same camera, zoom and focus; None estimates the vignetting of the microlenses, but not
    of the main lens, from the capture. There are 2 to 31 `views` along each side, a pixel of the sensor apart; None
    takes the largest odd number for which those in the corners lie under the microlens. `progress` takes a few words
    for each step.
    """
    path = named(path)
    if views is not None and not 2 <= views <= _MOST_VIEWS:
        raise LightFieldError(f"the number of views must be 2 to {_MOST_VIEWS}, not {views}.")
    pattern = None if bayer is None else mosaics.check_pattern(bayer)
    capture = read_capture(path)
    pattern, notes = (pattern, ()) if pattern else _pattern(capture)
    even = None if white is None else _white_image(named(white), capture.mosaic.shape)
    progress("looking for the microlenses")
    sensor = _Sensor(
        capture.mosaic,
        even,
        pattern,
        name=str(path),
        white_name=None if white is None else str(white),
        expected=_expected(capture),
    )
    # The largest odd number of views of which the one in the corner lies under the round microlens.
    count = views or max(3, 2 * math.floor(sensor.lenses.pitch / 2 / math.sqrt(2) / STEP) + 1)
    positions = _positions(sensor.lenses.pitch, count)
    progress("making the views")
    linear, valid = sensor.views(positions - (count - 1) / 2)
    middle = int(np.argmin(np.abs(positions - count // 2).sum(1)))
    if even is None:
        progress("evening out their light")
        linear *= field_gains(linear, middle)[..., None]
    if linear.shape[-1] == 3:
        linear *= np.array(capture.balance, np.float32)

    level = max(float(np.percentile(linear[middle], _WHITE_PERCENTILE)), _LEAST_LEVEL)
    if len(positions) < count * count:
        notes = (*notes, f"{count * count - len(positions)} of {count * count} views lie beyond the microlenses.")
    light_field = LightField(
        _encoded(linear, level),
        positions,
        reference=middle,
        grid_shape=(count, count),
        valid=None if valid.all() else valid,
        name=path.resolve().stem,
        notes=(*capture.notes, *notes, sensor.summary()),
    )
    about = {
        "source": path.name,
        "found": capture.source,
        "camera": {} if capture.camera is None else dict(capture.camera.facts()),
        "bayer": pattern,
        "white_balance": list(capture.balance),
        **sensor.about(),
        "views": {
            "rows": count,
            "columns": count,
            "there": len(positions),
            "step_px": STEP,
            "size": list(light_field.size),
            "valid_share": float(valid.mean()),
        },
        "values": {"transfer": "square root", "white_level": level, "linear": "white_level * (value / 65535)^2"},
        "notes": list(light_field.notes),
    }
    return Decoded(light_field, about)


def write_decoded(decoded: Decoded, out: str | os.PathLike[str]) -> list[str]:
    """Write view_row_col.png (16 bits) and lenslet.json, all or nothing, not beside other views; returns names."""
    lf = decoded.light_field
    names = [f"view_{round(v):02d}_{round(u):02d}.png" for u, v in lf.positions]
    check_no_others(out, names, _VIEW)
    with atomic_folder(out) as folder:
        for name, view in zip(names, lf.views, strict=True):
            write_png(folder / name, view)
        (folder / ABOUT_FILE).write_text(json.dumps(decoded.about, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return [*names, ABOUT_FILE]


class _Sensor:
    """A sensor under its microlenses. Where their rows stand upright, all is done on the transposed sensor."""

    def __init__(
        self,
        mosaic: Float32Array,
        even: Float32Array | None,
        pattern: str,
        *,
        name: str,
        white_name: str | None,
        expected: Microlenses | None,
    ) -> None:
        self._name, self._white_name = name, white_name
        lenses = find_microlenses(mosaic if even is None else even, name=white_name or name, expected=expected)
        self._upright = is_upright(lenses)
        if self._upright:
            mosaic, even = np.ascontiguousarray(mosaic.T), None if even is None else np.ascontiguousarray(even.T)
            pattern = mosaics.transposed(pattern)
            lenses = find_microlenses(mosaic if even is None else even, name=white_name or name)
        self.lenses = lenses
        self._pattern = pattern
        places = mosaics.colours(pattern)
        self._mean: MeanMicrolens | None = None
        if even is None:
            self._mean = MeanMicrolens(mosaic, lenses, places)
            self._light = self._mean.over(lenses, mosaic.shape)
        else:
            self._light = from_white_image(even, places)
        # What is cut off at the white level stays so in all views, whatever light they get.
        self._mosaic = np.minimum(mosaic / np.maximum(self._light, np.float32(_DARKEST)), np.float32(1))
        self._grid = view_grid(lenses, mosaic.shape, lenses.pitch / 2 + 2, name=name)

    def views(self, offsets: NDArray[np.float64]) -> tuple[Float32Array, NDArray[np.bool_]]:
        """Sample linear views [n, y, x, c] at offsets (du, dv) from the middle; returns also where they are of use."""
        if self._upright:
            offsets = offsets[:, ::-1]
        if self._mean:  # the same under all microlenses
            of_views = self._mean.at((offsets.T * STEP).astype(np.float32))
            light = np.broadcast_to(of_views[:, None, None], (len(offsets), *self._grid.shape))
        else:
            light = sample_views(self._light[None], self._grid, offsets, STEP)[..., 0]
        valid = light >= _VALID
        image = mosaics.demosaic(self._mosaic, self._light, self.lenses, self._pattern)
        views = sample_views(image, self._grid, offsets, STEP)
        return (views.swapaxes(1, 2), valid.swapaxes(1, 2)) if self._upright else (views, valid)

    def summary(self) -> str:
        """Describe the grid in a sentence."""
        source = "the capture itself" if self._white_name is None else Path(self._white_name).name
        return (
            f"Microlenses {self.lenses.pitch:.3f} px apart{' in squares' if self.lenses.square else ''}, rows "
            f"{'upright' if self._upright else 'level'} and turned by {math.degrees(self.lenses.rotation):.3f} "
            f"degrees; grid and vignetting from {source}."
        )

    def about(self) -> dict[str, Any]:
        """Return the grid as numbers."""
        lenses = self.lenses.transposed() if self._upright else self.lenses
        return {
            "microlenses": {
                "pitch_px": self.lenses.pitch,
                "row_distance_px": self.lenses.row_distance,
                "origin_xy": lenses.origin.tolist(),
                "along_xy": lenses.along.tolist(),
                "down_xy": lenses.down.tolist(),
                "lattice": "square" if lenses.square else "hexagonal",
                "slant": lenses.slant.tolist(),
                "convention": "lens k of row l is at origin + (k * along + l * down) / (1 + k * slant[0] + l * "
                "slant[1]); pixel centres are whole numbers",
            },
            "white_image": None if self._white_name is None else Path(self._white_name).name,
            "view_pixel": {
                "side_px": self._grid.pixel,
                "first_xy": (self._grid.origin[::-1] if self._upright else self._grid.origin).tolist(),
            },
        }


def _pattern(capture: Capture) -> tuple[str, tuple[str, ...]]:
    if capture.bayer is not None:
        return capture.bayer, ()
    diagonal = mosaics.green_diagonal(capture.mosaic)
    if diagonal is None:
        return mosaics.GREY, ("No mosaic of colours was found: the views are grey.",)
    found, other = (("grbg", "gbrg"), ("bggr", "rggb"))[diagonal]
    return found, (
        f"The mosaic is taken for {found}, as in Lytro cameras; if red and blue are exchanged, it is {other}.",
    )


def _expected(capture: Capture) -> Microlenses | None:
    """Return the lattice that the camera says it has; None where it says nothing."""
    array = None if capture.camera is None else capture.camera.microlenses
    if array is None:
        return None
    c, s = math.cos(array.rotation), math.sin(array.rotation)
    row = math.sqrt(3) / 2 * array.stretch
    steps = array.pitch * np.array([[1.0, 0.0], [0.5, row]]) @ np.array([[c, s], [-s, c]])
    return Microlenses(np.zeros(2), steps[0], steps[1])


def _white_image(path: Path, shape: tuple[int, ...]) -> Float32Array:
    white = read_capture(path).mosaic
    if white.shape != shape:
        raise LightFieldError(
            f"{path} is no white image for this capture: it is {white.shape[1]} x {white.shape[0]} pixels, "
            f"the capture {shape[1]} x {shape[0]}."
        )
    return white


def _positions(pitch: float, count: int) -> NDArray[np.float64]:
    """Return (u, v), row by row, of the views of a grid that lie under the round microlens."""
    positions = np.array([(u, v) for v in range(count) for u in range(count)], np.float64)
    seen = np.hypot(*(positions - (count - 1) / 2).T) * STEP <= pitch / 2
    return positions[seen]


def _encoded(linear: Float32Array, level: float) -> NDArray[np.uint16]:
    """Take square roots of linear values, `level` being 1; `linear` is used up."""
    linear /= np.float32(level)
    np.clip(linear, 0.0, 1.0, out=linear)
    np.sqrt(linear, out=linear)
    linear *= np.float32(65535)
    return np.rint(linear, out=linear).astype(np.uint16)
