"""Contradictions between the pictures of a light field and the places of their cameras, in sentences."""

import math
from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField, summary
from lfgpu.data.mapping import check_unchanged, is_mapped
from lfgpu.data.windows import mean_of_channels
from lfgpu.io.flips import ORDERS, places_in
from lfgpu.io.parallax import AROUND, FITS, SMALLEST, Pair, alike, beside, fit, grey_of, moves, shrunk

_STEPS = 4  # of views that are looked at on either side of the reference
_BETTER = 0.3  # of the motion: how much more another way to count cameras must explain
_MISFIT = 0.15  # of the motion: how much less than one disparity map the places explain where they are wrong
_HALF, _STILL = 0.5, 0.15  # share of the motion that is explained; steps that are so much shorter than others are none
_OTHER = 0.5  # times as long as others are steps, at most, that are none if the common map does not explain them
_LOOKED_AT, _BLOCK = 32, 4  # pixels of the longer side; of blocks whose means are compared upside down
_UPRIGHT, _LESS = 0.7, 0.3  # correlation of what is upright, and how much less it is the other way
_BLOCKS, _ONE_SCENE = 12, 0.5  # pixels of the shorter side; correlation of pictures of one scene, at least
_UNMOVED = 0.2  # pixels, rms: motion that may be noise where no disparity map explains it
_NAMED = 4  # views that a sentence names
_WAYS = (
    (False, "", np.eye(2)),
    (False, "v", np.diag([1.0, -1.0])),
    (True, "", np.array([[0.0, 1.0], [1.0, 0.0]])),
    (True, "v", np.array([[0.0, 1.0], [-1.0, 0.0]])),
)


def contradictions(light_field: LightField) -> tuple[str, ...]:
    """Say in sentences how the pictures contradict the places of their cameras; empty if they do not."""
    check_unchanged(light_field.views)
    found = (look(light_field) for look in (no_parallax, copied, upside_down, contradiction, other_scenes, unmoved))
    return tuple(islice((sentence for sentence in found if sentence is not None), 1))


def no_parallax(light_field: LightField) -> str | None:
    """Return a sentence if all views are the same picture, which shows something; else None."""
    views, some = light_field.views, _looked_at(light_field)
    if not all(np.array_equal(views[0][some], view[some]) for view in views):  # which ends at the first difference
        return None
    if len(_copies(light_field)) < len(views) - 1:
        return None
    return (
        "All views are the same picture: there is no parallax, so there is no depth. Probably one camera took them, or "
        "one file was copied."
    )


def copied(light_field: LightField) -> str | None:
    """Return a sentence if some views are the same picture, which shows something; else None."""
    if not (found := _copies(light_field)):
        return None
    named = [summary.view_at(place) for place in light_field.positions[list(found[0])]]
    more = f", and {len(found) - 1} more are copies" if len(found) > 1 else ""
    return f"The views at {named[0]} and at {named[1]} are the same picture{more}: probably a file was copied."


def _copies(light_field: LightField) -> list[tuple[int, int]]:
    """List the views that are the same picture as an earlier one, that first, if it shows something."""
    views, some = light_field.views, _looked_at(light_field)
    seen: dict[bytes, list[int]] = {}  # the first of each picture, by some of its pixels
    found = []
    for index, view in enumerate(views):
        like = seen.setdefault(view[some].tobytes(), [])
        one = next((other for other in like if np.array_equal(views[other], view)), None)
        if one is None:
            like.append(index)
        elif view.min() < view.max():
            found.append((one, index))
    return found


def _looked_at(light_field: LightField) -> tuple[slice, slice]:
    """Return the rows and columns that are compared first."""
    step = max(1, max(light_field.size) // _LOOKED_AT)
    return np.s_[::step, ::step]


def upside_down(light_field: LightField) -> str | None:
    """Return a sentence that names the pictures that look like the others upside down; None if there are none."""
    if min(light_field.size) < SMALLEST or is_mapped(light_field.views):
        return None
    step = max(1, min(light_field.size) // (_BLOCKS * _BLOCK))
    few = mean_of_channels(light_field.views[:, ::step, ::step], np.float64)
    thumbs = shrunk(few, _BLOCK)
    middle = thumbs[light_field.reference_index]
    is_upright = _correlations(thumbs, middle) > _UPRIGHT
    turned = np.array(
        [not upright and _is_turned(thumb, middle) for upright, thumb in zip(is_upright, thumbs, strict=True)]
    )
    if turned.mean() > 0.5:  # then the reference is
        turned = ~turned
    found = np.flatnonzero(turned)
    if not len(found):
        return None
    named = "; ".join(map(summary.view_at, light_field.positions[found[:_NAMED]]))
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    one = len(found) == 1
    return (
        f"The {'picture' if one else 'pictures'} at {named}{more} {'is' if one else 'are'} upside down: turn "
        f"{'it' if one else 'them'} by 180 degrees."
    )


def _correlations(thumbs: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlate small pictures [n, y, x] with one of them, as `alike` does."""
    rest, own = (values - values.mean(axis=(-2, -1), keepdims=True) for values in (thumbs, middle))
    spread = np.sqrt((rest**2).sum(axis=(1, 2)) * (own**2).sum())
    return np.divide((rest * own).sum(axis=(1, 2)), spread, out=np.zeros(len(thumbs)), where=spread > 0)


def _is_turned(thumb: NDArray[np.float64], middle: NDArray[np.float64]) -> bool:
    """Tell whether a small picture looks more like another one upside down than as it is."""
    turned = _alike_moved(thumb[::-1, ::-1], middle)
    return turned > _ONE_SCENE and turned > _alike_moved(thumb, middle) + _LESS


def other_scenes(light_field: LightField) -> str | None:
    """Return a sentence if a view beside the reference looks unlike it, however far it is moved; else None."""
    if min(light_field.size) < SMALLEST:
        return None
    factor = max(1, min(light_field.size) // _BLOCKS)
    centre = grey_of(light_field, light_field.reference_index, factor)
    if centre.std() == 0:
        return None
    for index in _around(light_field):
        beside_it = grey_of(light_field, index, factor)
        if alike(beside_it, centre) < _ONE_SCENE and _alike_moved(beside_it, centre) < _ONE_SCENE:
            return (
                f"The picture at {summary.view_at(light_field.positions[index])} does not look like the reference "
                "beside it: perhaps the views are of several times or scenes, or are stored in another way."
            )
    return None


def _around(light_field: LightField) -> Iterator[int]:
    """Yield the views that stand beside the reference in its row and column, on either side."""
    for axis, line in enumerate((light_field.row(), light_field.column())):
        apart = light_field.offsets[line, axis]
        for side in (apart < 0, apart > 0):
            if side.any():
                yield int(line[side][np.argmin(np.abs(apart[side]))])


def _alike_moved(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Largest correlation of two small pictures where they overlap, one of them moved by up to a third."""
    (height, width), reach, found = a.shape, _BLOCKS // 3, -1.0
    for y, x in np.ndindex(2 * reach + 1, 2 * reach + 1):
        y, x = y - reach, x - reach
        one = a[max(0, y) : height + min(0, y), max(0, x) : width + min(0, x)]
        other = b[max(0, -y) : height + min(0, -y), max(0, -x) : width + min(0, -x)]
        found = max(found, alike(one, other))
    return found


def unmoved(light_field: LightField) -> str | None:
    """Return a sentence if no view in the row and column of the reference moves against it, or one far away does not;
    else None."""
    if min(light_field.size) < SMALLEST:
        return None
    top, left = (max(0, side - AROUND) // 2 for side in light_field.size)

    def middle(index: int) -> NDArray[np.float64]:
        part = light_field.views[index, top : top + AROUND, left : left + AROUND]
        return mean_of_channels(part, np.float64) * light_field.scale

    here, centre = light_field.reference_index, middle(light_field.reference_index)
    lines = {int(n) for line in (light_field.row(), light_field.column()) for n in line} - {here}
    far = {n: float(np.hypot(*light_field.offsets[n])) for n in lines}
    ends = [n for n in lines if far[n] == max(far.values())]
    pairs = {n: Pair(centre, middle(n)) for n in lines}
    found = moves([pairs[n] for n in ends])
    if found is None or np.ptp(centre) == 0:
        return None
    if not found.told and found.rms < _UNMOVED:
        return (
            "The views show no parallax, even those that are farthest apart: probably one camera took them from one "
            "place, or the whole scene is far away."
        )

    def motion(n: int) -> float:
        moved = moves([pairs[n]])
        assert moved is not None  # the pictures are large enough
        return moved.rms

    nearest = min(far.values())
    usual = min(motion(n) for n in lines if far[n] == nearest)
    if usual <= _UNMOVED:
        return None
    for n in sorted(lines):
        if far[n] >= 2 * nearest and motion(n) < _LESS * usual:
            return (
                f"The picture at {summary.view_at(light_field.positions[n])} shows the scene from the place of the "
                "reference: perhaps colours, times or exposures are taken for cameras."
            )
    return None


def contradiction(light_field: LightField) -> str | None:
    """Say in a sentence how parallax contradicts the places of the cameras; None if it does not."""
    factor = max(1, max(light_field.size) // AROUND)
    if min(light_field.size) < SMALLEST * factor:
        return None
    near = np.argsort(np.abs(light_field.offsets).sum(1), kind="stable")[1 : 2 * _STEPS + 1]
    chosen = sorted({int(n) for n in near} | {n for axis in (0, 1) if (n := beside(light_field, axis)) is not None})
    centre = grey_of(light_field, light_field.reference_index, factor)
    offsets = light_field.offsets[chosen]
    in_line = min(np.ptp(np.vstack([offsets, np.zeros((1, 2))]), axis=0)) == 0
    is_line = in_line or len(chosen) == 1  # views that are out of line may look like those of another line
    found = moves([Pair(centre, grey_of(light_field, n, factor), may_be_offset=is_line) for n in chosen])
    if found is None:
        return None
    once = np.hypot(*offsets.T)[:, None]  # views far away tell no more than those nearby
    vectors, offsets = found.vectors / once, offsets / once
    still = _still_line(vectors, offsets, found.shares) if found.explained > _HALF else None
    if still is not None and not _moves_as_said(light_field, ("row", "column").index(still), factor):
        return (
            f"By their parallax the camera stood still between the views of a {still}: perhaps they are times, "
            "exposures or colours of one camera."
        )
    if not found.told:
        return None
    scores = [fit(vectors, offsets @ matrix.T) for *_, matrix in _WAYS]
    best = int(np.argmax(scores[::2])) * 2 if in_line else int(np.argmax(scores))
    if scores[best] > FITS and scores[0] < scores[best] - _BETTER:
        return _counted_otherwise(light_field, *_WAYS[best][:2], in_line=in_line)
    if max(scores) > FITS:
        return None
    fitting = _fitting(light_field, chosen, vectors, once)
    if fitting is None and (
        max(scores) > found.explained - _MISFIT or any(_moves_as_said(light_field, axis, factor) for axis in (0, 1))
    ):
        return None
    told = f"; {fitting}" if fitting is not None and not light_field.missing else ""
    return f"By their parallax the views do not stand where they are said to stand{told}."


def _still_line(vectors: NDArray[np.float64], offsets: NDArray[np.float64], shares: NDArray[np.float64]) -> str | None:
    """Return "row" or "column" if views in such a line do not move as a whole, but others do; else None."""
    lines = [offsets[:, 1 - axis] == 0 for axis in (0, 1)]
    if not all(line.any() for line in lines):
        return None
    across, down = (float(np.hypot(*vectors[line].T).max()) for line in lines)
    for name, own, other, line in (("row", across, down, lines[0]), ("column", down, across, lines[1])):
        if own < (_STILL if shares[line].max() > _HALF else _OTHER) * other:
            return name
    return None


def _moves_as_said(light_field: LightField, axis: int, factor: int) -> bool:
    """Tell whether the views of a row (axis 0) or column, by themselves, move along it in proportion to their places.

    Where edges have one direction, all motion seems to be across them: then the views of a row may seem to stand still
    beside those of a column, or to move in a wrong direction.
    """
    line = light_field.row() if axis == 0 else light_field.column()
    near = line[np.argsort(np.abs(light_field.offsets[line, axis]), kind="stable")[1 : _STEPS + 1]]
    centre, offsets = grey_of(light_field, light_field.reference_index, factor), light_field.offsets[near]
    found = moves([Pair(centre, grey_of(light_field, int(n), factor)) for n in near])
    if found is None or not found.told:
        return False
    once = np.hypot(*offsets.T)[:, None]
    return fit(found.vectors / once, offsets / once) > FITS


def _counted_otherwise(light_field: LightField, transpose: bool, flip: str, *, in_line: bool) -> str:
    if in_line:
        what = "the views move at right angles to the line in which their cameras are said to stand"
    elif transpose:
        what = "rows of cameras are taken for columns" + ", and one of the two is counted the other way round" * bool(
            flip
        )
    else:
        what = "views in a column move against those in a row, so one of the two is counted the other way round"
    advice = light_field.reading.advice(transpose=transpose, flip=flip)
    return f"By their parallax {what}: {advice}{', or with the other axis flipped if near comes out far' * bool(flip)}."


def _fitting(
    light_field: LightField, chosen: list[int], vectors: NDArray[np.float64], once: NDArray[np.float64]
) -> str | None:
    """Name the order or the grid that fits distances of cameras from the reference, divided by `once`; else None.

    Rows and columns without any view, such as those before a first one that is numbered 1, are not counted.
    """
    (columns, column), (rows, row) = (np.unique(axis, return_inverse=True) for axis in light_field.positions.T)
    shape = len(rows), len(columns)
    if light_field.grid_shape is None or math.prod(shape) != len(light_field.views) or min(shape) < 2:
        return None
    index, count = row * len(columns) + column, len(row)
    places = {}
    for order in ORDERS[1:]:
        there = places_in(shape, order)[index]
        places[f"--order {order} fits (order= in Python)"] = np.stack([columns[there[:, 1]], rows[there[:, 0]]], axis=1)
    for other in (n for n in range(2, count // 2 + 1) if count % n == 0 and n != len(rows)):
        there = places_in((other, count // other), ORDERS[0])[index]
        places[f"--grid {other}x{count // other} fits (grid= in Python)"] = there[:, ::-1]
    here = light_field.reference_index
    scores = {told: fit(vectors, (found[chosen] - found[here]) / once) for told, found in places.items()}
    best = max(scores, key=lambda told: scores[told])
    return best if scores[best] > FITS else None
