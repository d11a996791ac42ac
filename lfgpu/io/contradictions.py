"""Contradictions between the pictures of a light field and the places of their cameras, in sentences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.data.mapping import is_mapped
from lfgpu.io.flips import ORDERS, reordered
from lfgpu.io.parallax import AROUND, FITS, SMALLEST, beside, fit, grey_of, moves, shrunk

_STEPS = 4  # of views that are looked at on either side of the reference
_BETTER = 0.3  # of the motion: how much more another way to count cameras must explain
_MISFIT, _TOLD = 0.7, 0.85  # share that the places explain of a motion that one disparity map explains so well
_LOOKED_AT, _BLOCK = 128, 4  # pixels of the longer side, means of blocks of which are compared upside down
_UPSIDE_DOWN, _LESS = 0.7, 0.3  # correlation upside down, and how much less it is upright
_NAMED = 4  # views that a sentence names
_WAYS = (
    (False, "", np.eye(2)),
    (False, "v", np.diag([1.0, -1.0])),
    (True, "", np.array([[0.0, 1.0], [1.0, 0.0]])),
    (True, "v", np.array([[0.0, 1.0], [-1.0, 0.0]])),
)


def contradictions(light_field: LightField) -> tuple[str, ...]:
    """Say in sentences how the pictures contradict the places of their cameras; empty if they do not."""
    found = (no_parallax(light_field), upside_down(light_field), contradiction(light_field))
    return tuple(sentence for sentence in found if sentence is not None)[:1]


def no_parallax(light_field: LightField) -> str | None:
    """Return a sentence if all views are the same picture, which shows something; else None."""
    views = light_field.views
    if views[0].min() == views[0].max() or any(not np.array_equal(views[0], view) for view in views[1:]):
        return None
    return (
        "All views are the same picture: there is no parallax, so there is no depth. Probably one camera took them, or "
        "one file was copied."
    )


def upside_down(light_field: LightField) -> str | None:
    """Return a sentence that names the pictures that look like the others upside down; None if there are none."""
    if min(light_field.size) < SMALLEST or is_mapped(light_field.views):
        return None
    step = max(1, max(light_field.size) // _LOOKED_AT)
    few = light_field.views[:, ::step, ::step].mean(axis=3, dtype=np.float64)
    thumbs = np.stack([shrunk(view, _BLOCK) for view in few])
    middle = thumbs[light_field.reference_index]
    turned = np.array([_alike(thumb[::-1, ::-1], middle) - _alike(thumb, middle) > _LESS for thumb in thumbs])
    turned &= np.array([_alike(thumb[::-1, ::-1], middle) > _UPSIDE_DOWN for thumb in thumbs])
    if turned.mean() > 0.5:  # then the reference is
        turned = ~turned
    found = np.flatnonzero(turned)
    if not len(found):
        return None
    named = "; ".join(f"row {v:g}, column {u:g}" for u, v in light_field.positions[found[:_NAMED]])
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    one = len(found) == 1
    return (
        f"The {'picture' if one else 'pictures'} at {named}{more} {'is' if one else 'are'} upside down: turn "
        f"{'it' if one else 'them'} by 180 degrees."
    )


def contradiction(light_field: LightField) -> str | None:
    """Say in a sentence how parallax contradicts the places of the cameras; None if it does not."""
    factor = max(1, max(light_field.size) // AROUND)
    if min(light_field.size) < SMALLEST * factor:
        return None
    near = np.argsort(np.abs(light_field.offsets).sum(1), kind="stable")[1 : 2 * _STEPS + 1]
    chosen = sorted({int(n) for n in near} | {n for axis in (0, 1) if (n := beside(light_field, axis)) is not None})
    centre = grey_of(light_field, light_field.reference_index, factor)
    found = moves([(centre, grey_of(light_field, n, factor)) for n in chosen])
    if found is None or not found.told:
        return None
    offsets = light_field.offsets[chosen]
    scores = [fit(found.vectors, offsets @ matrix.T) for *_, matrix in _WAYS]
    in_line = min(np.ptp(np.vstack([offsets, np.zeros((1, 2))]), axis=0)) == 0
    best = int(np.argmax(scores[::2])) * 2 if in_line else int(np.argmax(scores))
    if scores[best] > FITS and scores[0] < scores[best] - _BETTER:
        return _counted_otherwise(light_field, *_WAYS[best][:2], in_line=in_line)
    if max(scores) < _MISFIT and found.explained > _TOLD:
        order = _order(light_field, chosen, found.vectors)
        told = "" if order is None else f"; --order {order} fits (order= in Python)"
        return f"By their parallax the views do not stand where they are said to stand{told}."
    return None


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


def _order(light_field: LightField, chosen: list[int], vectors: NDArray[np.float64]) -> str | None:
    """Find the order of a full grid that fits distances of cameras from the reference; None if there is none."""
    shape = light_field.grid_shape
    if shape is None or light_field.missing or min(shape) < 2:
        return None
    scores = {}
    for order in ORDERS[1:]:
        positions = reordered(light_field, order).positions
        scores[order] = fit(vectors, positions[chosen] - positions[light_field.reference_index])
    best = max(scores, key=lambda order: scores[order])
    return best if scores[best] > FITS else None


def _alike(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Correlation of two pictures; 0 if one of them is plain, or has no pixels."""
    plain = min(a.size, b.size) == 0 or min(a.std(), b.std()) == 0
    return 0.0 if plain else float(np.corrcoef(a.ravel(), b.ravel())[0, 1])
