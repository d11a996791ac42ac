"""Epipolar plane images (EPIs), enlarged around points where a map is easy to judge: on texture, and at an edge."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfgpu.contract import Float32Array
from lfgpu.data import LightField
from lfgpu.data.windows import differences
from lfgpu.viz.cards import Card, Mark, drawn_card, number
from lfgpu.viz.panels import rgb

_LEAST, _BESIDE = 24, 12  # pixels at each side of a point that an EPI shows: at least, and beyond the point's own line
_WIDE = 640  # pixels: about the width of an enlarged EPI
_LOW, _HIGH = 90, 260  # pixels: the least and the largest height of an enlarged EPI
_SMOOTH = 2.0  # pixels: the scale at which texture is measured
_NEAR = 9  # pixels: the surface around a textured point is smooth in a window of this size
_ASIDE = 2  # pixels from the middle of an edge to the point on its nearer side
_FLAT = 0.5  # pixels in the farthest view: surfaces that differ by less have no edge between them
_STEEP = 0.4  # pixels in the farthest view, from a pixel to the next: what is less is a slope and no edge


@dataclass(frozen=True)
class Point:
    """A point of the reference view."""

    letter: str  # its letter in the report
    what: str  # what is there
    x: int
    y: int


def find_points(lf: LightField, disparity: Float32Array) -> list[Point]:
    """Find the point with most texture on a smooth surface, and one on the nearer side of the largest edge of the map.

    What is not there is left out. Points are chosen so that all views in line with the reference show them.
    """
    inside = _seen_by_all(lf, disparity)
    known = np.isfinite(disparity)
    filled = np.where(known, disparity, np.float32(0))
    reach = float(np.abs(lf.offsets[_in_line(lf)]).max(initial=1.0))
    texture = _texture(lf)
    whole = ndimage.minimum_filter(known, _NEAR)  # an unknown pixel is neither smooth nor an edge
    varies = ndimage.maximum_filter(filled, _NEAR) - ndimage.minimum_filter(filled, _NEAR)
    smooth = whole & (varies * reach < _FLAT)
    found = [_largest(texture / (_FLAT + varies * reach), inside & smooth, "A", "texture")]
    across = lf.size[1] > 2 * _ASIDE + 1 and len(lf.row()) > 1
    jump = np.zeros(lf.size, np.float32)
    step = 2 * _ASIDE
    if across:
        jump[:, step:-step] = filled[:, step:-step] - np.minimum(filled[:, : -2 * step], filled[:, 2 * step :])
    else:
        jump[step:-step] = filled[step:-step] - np.minimum(filled[: -2 * step], filled[2 * step :])
    steep = ndimage.maximum_filter(np.abs(differences(filled, 1 if across else 0)), 2 * step + 1)
    edges = inside & whole & (jump * reach > _FLAT) & (steep * reach > _STEEP)
    if edges.any():
        jump = np.minimum(jump, np.quantile(jump[edges], 0.9))  # one outlier is no edge
    found.append(_largest(jump * (texture + 0.1 * texture.max()), edges, "B", "an edge of depth"))
    return [point for point in found if point is not None]


def epi_cards(lf: LightField, disparity: Float32Array, point: Point) -> Iterator[Card]:
    """Draw the EPIs of the image row and column of a point, enlarged, with the line that its disparity says."""
    slope = float(disparity[point.y, point.x])
    for name, indices, lines, at, of in (
        ("row", lf.row(), lf.epi_horizontal, point.x, point.y),
        ("column", lf.column(), lf.epi_vertical, point.y, point.x),
    ):
        if len(indices) > 1:
            offsets = lf.offsets[indices, 0 if name == "row" else 1]
            picture, mark = _enlarged(rgb(lines(of), lf.scale), offsets, at, slope)
            remark = f"at {'x' if name == 'row' else 'y'} {at}: {number(round(slope, 3))} px per view step"
            yield drawn_card(f"{point.letter}: {name} {of}", picture, remark=remark, marks=(mark,))


def _enlarged(
    epi: NDArray[np.uint8], offsets: NDArray[np.float64], at: int, slope: float
) -> tuple[NDArray[np.uint8], Mark]:
    """Cut out a part of an EPI [view, pixel, 3] in whole rectangles; returns it and the line through pixel `at`."""
    beside = max(_LEAST, int(np.ceil(np.abs(slope * offsets).max())) + _BESIDE)
    first, last = max(0, at - beside), min(epi.shape[1], at + beside + 1)
    across = max(1, _WIDE // (last - first))
    down = int(np.clip(across, np.ceil(_LOW / len(epi)), max(1, _HIGH // len(epi))))
    picture = epi[:, first:last].repeat(down, axis=0).repeat(across, axis=1)
    xs, ys = (at - first + 0.5 - slope * offsets) * across, (np.arange(len(epi)) + 0.5) * down
    points = [f"{x:.1f} {y:.1f}" for x, y in zip(xs, ys, strict=True) if 0 <= x <= picture.shape[1]]
    return picture, Mark("M" + "L".join(points))


def _in_line(lf: LightField) -> NDArray[np.intp]:
    """Return indices of the views in the row and the column of the reference."""
    return np.concatenate([lf.row(), lf.column()])


def _seen_by_all(lf: LightField, disparity: Float32Array) -> NDArray[np.bool_]:
    """Tell, bool [y, x], whether the point at a pixel of the reference is inside all views in line with it."""
    height, width = lf.size
    y, x = np.mgrid[:height, :width]
    inside = np.isfinite(disparity)
    if lf.valid is not None:
        inside = inside & lf.valid[lf.reference_index]
    shift = np.where(inside, disparity, np.float32(0))
    for du, dv in lf.offsets[_in_line(lf)]:
        moved_x, moved_y = x - shift * du, y - shift * dv
        inside = inside & (moved_x >= 0) & (moved_x <= width - 1) & (moved_y >= 0) & (moved_y <= height - 1)
    return inside


def _texture(lf: LightField) -> Float32Array:
    """Measure the texture around each pixel, [y, x]: in both directions where cameras lie in both."""
    grey = lf.image(lf.reference_index).mean(axis=2)
    lines = [axis for axis, line in ((1, lf.row()), (0, lf.column())) if len(line) > 1] or [0, 1]
    slopes = [ndimage.gaussian_filter(differences(grey, axis) ** 2, _SMOOTH) for axis in lines]
    return np.sqrt(np.minimum.reduce(slopes)).astype(np.float32)


def _largest(values: Float32Array, allowed: NDArray[np.bool_], letter: str, what: str) -> Point | None:
    if not allowed.any():
        return None
    y, x = np.unravel_index(int(np.where(allowed, values, -np.inf).argmax()), values.shape)
    return Point(letter, what, int(x), int(y))
