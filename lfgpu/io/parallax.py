"""Parallax of views: the direction in which camera numbers count, told from the pictures themselves.

Between two cameras a picture moves by -d times their distance, at each point along the same line. So the motion fields
of all pairs of pictures are one disparity map times a vector each: a matrix of rank 1. Its factors are the distances of
the cameras, up to one common factor, and how much of the motion they explain says whether that can be believed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.data.windows import mean_of_channels
from lfgpu.errors import LightFieldError
from lfgpu.io.flips import ORDERS, places_in
from lfgpu.io.images import read_image

SMALLEST = 32  # pixels: smaller views tell nothing
_BLOCK = 8  # pixels of the shrunken views in which one disparity is taken for constant
AROUND = 160  # pixels to which the longer side of the views is shrunk
_COARSER = (1, 2, 4)  # times smaller, where views move too far
_SURE = 0.35  # correlation from which two sets of disparities agree, or are opposed
_EXPLAINED = 0.6  # share of the motion that one disparity map explains where it can be believed
FITS = 0.85  # share of the motion that the right order of cameras explains, at least
_CLEARER = 0.05  # of the motion: how much more the right order explains than any other
_AGAINST = 0.3  # of a step, against the direction in which it should be
_STILL = 0.01  # pixels of the shrunken views, rms: less is no motion
_BRIGHTEST = 1e6  # times white: squares of such values are still finite
_EXACT = 128  # times smaller, at most: sums of colours of 8 bits are exact in single precision
_ALIKE = 0.7  # correlation of pictures of one scene; those of other scenes are below it, as a rule


@dataclass(frozen=True, eq=False)
class Moves:
    """Distances of the cameras of pairs of pictures."""

    vectors: NDArray[np.float64]  # [pairs, 2], x and y, in units of the same unknown length; of unknown common sign
    explained: float  # share of the motion that they explain, 0 to 1
    rms: float  # motion of the pictures, pixels
    shares: NDArray[np.float64]  # [pairs], share of the motion of each pair that they explain

    @property
    def still(self) -> bool:
        """True if nothing moves in any pair."""
        return self.rms < _STILL

    @property
    def told(self) -> bool:
        """True if the pictures tell the distances."""
        return not self.still and self.explained > _EXPLAINED


@dataclass(frozen=True, eq=False)
class Pair:
    """Two grey pictures [y, x] of one size, and the motion between them, which is found once at each size."""

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    may_be_offset: bool = False
    """True if the pictures may be offset as a whole: then only what differs from place to place is motion."""
    _flows: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=dict)

    def flow(self, factor: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the `_flow` between the pictures, so many times smaller."""
        if factor not in self._flows:
            b = _laid_on(self.a, self.b) if self.may_be_offset else self.b
            self._flows[factor] = _flow(shrunk(self.a, factor), shrunk(b, factor), without_mean=self.may_be_offset)
        return self._flows[factor]


def moves(pairs: Sequence[Pair]) -> Moves | None:
    """Return the distances of the cameras of pairs of pictures of one size; None if they are too small."""
    if not pairs or min(pairs[0].a.shape) < SMALLEST:
        return None
    best: Moves | None = None
    for factor in _COARSER:
        if min(pairs[0].a.shape) // factor < SMALLEST:
            break
        found = _moves(pairs, factor)
        if best is None or found.explained > best.explained + 0.05:
            best = found
        if found.still or best.explained > 0.9:
            break
    return best


def _moves(pairs: Sequence[Pair], factor: int) -> Moves:
    flows, weights = zip(*(pair.flow(factor) for pair in pairs), strict=True)
    weight = np.minimum.reduce(weights).ravel()
    matrix = np.stack([flow[..., axis].ravel() for axis in (0, 1) for flow in flows]) * np.sqrt(weight)
    total = float((matrix**2).sum())
    rms = factor * np.sqrt(total / max(float(weight.sum()) * len(pairs), 1e-12))
    if rms < _STILL or total == 0:
        return Moves(np.zeros((len(pairs), 2)), 1.0, 0.0, np.ones(len(pairs)))
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    vectors = (left[:, 0] * values[0]).reshape(2, -1).T
    shares = (vectors**2).sum(1) / np.maximum((matrix**2).sum(1).reshape(2, -1).sum(0), 1e-12)
    return Moves(vectors, float(values[0] ** 2 / total), float(rms), shares)


def _laid_on(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move a picture as a whole, by the pixels with which it fits another one best; where it ends, that one is seen."""
    spectrum_a, spectrum_b = (np.fft.rfft2(picture - picture.mean()) for picture in (a, b))
    correlation = np.fft.irfft2(spectrum_a * spectrum_b.conj(), a.shape)
    place = np.unravel_index(np.argmax(correlation), a.shape)
    moved = np.roll(b, place, (0, 1))
    for axis, (by, side) in enumerate(zip(place, a.shape, strict=True)):
        beyond = slice(None, by) if by <= side // 2 else slice(by - side, None)
        np.moveaxis(moved, axis, 0)[beyond] = np.moveaxis(a, axis, 0)[beyond]
    return moved


def _flow(
    a: NDArray[np.float64], b: NDArray[np.float64], *, without_mean: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the motion (x, y) of blocks [y, x, 2] between pictures, pixels, and how well each of them shows it."""
    by_y, by_x = np.gradient(((a + b) / 2).astype(np.float32))
    change = b - a
    change = (change - change.mean()).astype(np.float32)
    products = np.empty((5, *a.shape), np.float32)
    for product, (one, other) in zip(
        products, ((by_x, by_x), (by_x, by_y), (by_y, by_y), (by_x, change), (by_y, change)), strict=True
    ):
        np.multiply(one, other, out=product)
    xx, xy, yy, xt, yt = shrunk(products, _BLOCK).astype(np.float64)
    floor = 1e-2 * (xx + yy).mean() + 1e-12
    if without_mean:
        normal = np.array([[xx.mean() + floor, xy.mean()], [xy.mean(), yy.mean() + floor]])
        mean_x, mean_y = -np.linalg.solve(normal, [xt.mean(), yt.mean()])
        xt, yt = xt + xx * mean_x + xy * mean_y, yt + xy * mean_x + yy * mean_y
    determinant = (xx + floor) * (yy + floor) - xy * xy
    x = -((yy + floor) * xt - xy * yt) / determinant
    y = -((xx + floor) * yt - xy * xt) / determinant
    return np.stack([x, y], axis=-1), determinant / (xx + yy + 2 * floor)


def measured(light_field: LightField, axis: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Measure rough disparities of blocks of the reference view along one axis of the cameras (0 is u, 1 is v).

    Returns disparity and contrast, [blocks y, blocks x]; None where no camera stands beside the reference on that axis,
    or the views are too small. A view at offset o is the reference moved by -d o, to first order; d follows from
    differences over gradients (Lucas and Kanade).
    """
    factor = max(1, max(light_field.size) // AROUND)
    if min(light_field.size) < max(SMALLEST, _BLOCK // 2 * factor):
        return None
    nearest = beside(light_field, axis)
    if nearest is None:
        return None
    offset = light_field.offsets[nearest, axis]
    centre, other = (grey_of(light_field, index, factor) for index in (light_field.reference_index, nearest))
    gradient = np.gradient((centre + other) / 2, axis=1 - axis)
    bottom = shrunk(gradient**2, _BLOCK // 2)
    top = shrunk(gradient * (other - centre) / offset, _BLOCK // 2)
    return factor * top / np.maximum(bottom, 1e-12), bottom


def beside(light_field: LightField, axis: int) -> int | None:
    line = light_field.row() if axis == 0 else light_field.column()
    apart = np.abs(light_field.offsets[line, axis])
    beside = np.flatnonzero(apart > 0)
    return int(line[beside[np.argmin(apart[beside])]]) if len(beside) else None


def agreement(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]], weight: NDArray[np.floating[Any]]) -> float:
    """Correlate two sets of disparities about zero, with weights: -1 to 1, negative if they have opposite signs."""
    scale = np.sqrt((weight * a * a).sum() * (weight * b * b).sum())
    return float((weight * a * b).sum() / scale) if scale > 0 else 0.0


def axes_agree(light_field: LightField) -> bool | None:
    """Tell whether parallax along rows and columns of cameras has one sign; None if the pictures do not tell."""
    across, down = measured(light_field, 0), measured(light_field, 1)
    if across is None or down is None:
        return None
    return _verdict(agreement(across[0], down[0], np.minimum(across[1], down[1])))


def runs_as_truth(light_field: LightField, axis: int) -> bool | None:
    """Tell whether parallax along an axis has the sign of the reference view's ground truth; None if unknown."""
    found, truth = measured(light_field, axis), light_field.reference_truth()
    if found is None or truth is None:
        return None
    factor = max(1, max(light_field.size) // AROUND)
    disparity = np.nan_to_num(truth.disparity.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    return _verdict(agreement(found[0], shrunk(shrunk(disparity, factor), _BLOCK // 2), found[1]))


def _verdict(correlation: float) -> bool | None:
    return None if abs(correlation) < _SURE else correlation > 0


# --- pictures in files ---


def one_scene(files: Sequence[Path]) -> bool:
    """Tell whether pictures show the same scene: folders of other scenes are often numbered, too."""
    try:
        pictures = [grey(read_image(file)[0]) for file in files]
    except LightFieldError:  # whoever reads them says what is wrong
        return True
    views = [shrunk(picture, max(1, min(picture.shape) // 20)) for picture in pictures]
    return all(a.shape == b.shape and alike(a, b) > _ALIKE for a, b in pairwise(views))


def alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the correlation of two pictures; 0 if one of them is plain, or has no pixels."""
    if a.size == 0 or b.size == 0:
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    spread = math.sqrt(float(np.vdot(a, a)) * float(np.vdot(b, b)))
    return float(np.vdot(a, b)) / spread if spread else 0.0


def line(found: Moves | None) -> str | None:
    """Tell whether pictures that follow each other come from a camera that moved along a "row" or a "column", each time
    to the same side; "" if they do not, None if they do not tell."""
    if found is None or not found.told:
        return None
    along = found.vectors @ np.linalg.svd(found.vectors, full_matrices=False)[2][0]
    if not (np.sign(along) == np.sign(along.sum())).all():
        return ""
    across, down = np.abs(found.vectors).sum(axis=0)
    share = down / max(float(across + down), 1e-12)
    return "row" if share < 0.25 else "column" if share > 0.75 else ""


def consecutive(files: Sequence[Path]) -> Moves | None:
    """Return the distances of the cameras of files that follow each other; None if they do not tell."""
    try:
        pictures = [grey(read_image(file)[0]) for file in files]
    except LightFieldError:  # whoever reads them says what is wrong
        return None
    if len({picture.shape for picture in pictures}) > 1:
        return None
    return in_sequence(pictures)


def in_sequence(pictures: Sequence[NDArray[np.float64]]) -> Moves | None:
    """Return the distances of the cameras of consecutive grey pictures; None if they are too small, or not finite."""
    return moves([Pair(a, b) for a, b in pairwise(pictures)]) if all(map(_in_bounds, pictures)) else None


def _in_bounds(picture: NDArray[np.float64]) -> bool:
    return bool(np.abs(picture).max() < _BRIGHTEST)  # False for NaN


def are_views(planes: Sequence[NDArray[np.float64]]) -> bool:
    """Tell whether pictures that may be colours of one view look like views of a line of cameras in equal steps."""
    if not all(_in_bounds(plane) and plane.std() > 0 for plane in planes):
        return False
    found = in_sequence(planes) if min(alike(a, b) for a, b in pairwise(planes)) > _ALIKE else None
    if not line(found):
        return False
    assert found is not None
    steps = np.hypot(*found.vectors.T)
    return found.explained > FITS and steps.min() > steps.max() / 2


def grey(picture: NDArray[Any]) -> NDArray[np.float64]:
    """Return a picture [y, x, c] as grey of about 160 pixels, on [0, 1]."""
    scale = 1.0 if picture.dtype.kind == "f" else 1 / float(np.iinfo(picture.dtype).max)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused later
        return _shrunk_grey(picture, scale, max(1, max(picture.shape) // AROUND))


def best_order(found: Moves, shapes: Sequence[tuple[int, int]]) -> str | None:
    """Return the options that say how consecutive cameras stood: "--grid 3x4 --order serpentine"; None if untold."""
    if not found.told:
        return None
    scores: dict[str, float] = {}
    for shape in shapes:
        for order in ORDERS if min(shape) > 1 else ORDERS[:1]:
            steps = np.diff(places_in(shape, order)[: len(found.vectors) + 1, ::-1], axis=0).astype(np.float64)
            long = np.hypot(*steps.T)[:, None]  # jumps tell no more than steps do
            seen, steps = found.vectors / long, steps / long
            along = (seen * steps).sum(0) / np.maximum((steps**2).sum(0), 1e-12)
            options = f"--grid {shape[0]}x{shape[1]}" + f" --order {order}" * (order != ORDERS[0])
            if (seen * steps * along < -_AGAINST * (along * steps) ** 2).any():  # against all others of its kind
                continue
            options += " --flip v" * bool(along[0] * along[1] < 0)
            scores[options] = 1 - float(((seen - along * steps) ** 2).sum() / (seen**2).sum())
    if not scores:
        return None
    first, *others = sorted(scores, key=lambda options: -scores[options])
    clear = not others or scores[others[0]] < scores[first] - _CLEARER
    return first if scores[first] > FITS and clear else None


def fit(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the share of vectors that others explain up to a common factor of any sign."""
    return float((a * b).sum() ** 2 / max(float((a**2).sum() * (b**2).sum()), 1e-12))


def grey_of(light_field: LightField, index: int, factor: int) -> NDArray[np.float64]:
    """Return a view [y, x], grey and `factor` times smaller, in [0, 1]."""
    return _shrunk_grey(light_field.views[index], light_field.scale, factor)


def _shrunk_grey(view: NDArray[Any], scale: float, factor: int) -> NDArray[np.float64]:
    """Return a picture [y, x, c] times `scale` [y, x], grey and `factor` times smaller."""
    height, width, channels = view.shape
    if 1 < factor <= _EXACT and view.dtype == np.uint8:  # exact sums of whole numbers take a third of the time
        few, wide = height // factor, width // factor * factor
        rows = view[: few * factor].reshape(few, factor, -1)
        sums = sum((rows[:, k] for k in range(factor)), np.zeros((few, width * channels), np.uint16))
        colours = np.moveaxis(sums.reshape(few, width, channels)[:, :wide], -1, 0)
        grey = sum(colours, np.zeros((few, wide), np.float32))
        total = sum(grey[:, k::factor] for k in range(factor))
        return np.asarray(total, np.float64) * (scale / (channels * factor**2))
    return shrunk(mean_of_channels(view, np.float64) * scale, factor)


def shrunk(image: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Return means of blocks of factor x factor pixels [..., y, x]; what is left at the right and below is cut off."""
    if factor == 1:
        return image
    *more, height, width = image.shape
    height, width = height // factor, width // factor
    cut = image[..., : height * factor, : width * factor]
    rows = cut.reshape(*more, height, factor, width * factor).sum(axis=-2)
    total = sum(rows[..., first::factor] for first in range(factor))  # NumPy is slow to add along short axes
    return np.asarray(total / factor**2)
