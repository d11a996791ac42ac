"""Findings about cameras, in sentences: their places and directions, the brightness of their views, their signs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu.cameras import consensus
from lfgpu.cameras.signs import Signs
from lfgpu.contract import Float64Array
from lfgpu.data.lightfield import LightField

# A single view must stand out from the trend of its neighbours (`consensus.outliers`), all of them in their rms.
MOVED, OUT_OF_LINE = 0.1, 0.12
"""Shift of a single view, and of all views along each axis, that is worth a sentence; pixels."""
TURNED, OUT_OF_SHAPE = 0.15, 0.2
"""Rotation or scale of a single view, and of all views; pixels at the half diagonal."""
BRIGHTER, UNEQUAL = 0.03, 0.03
"""Difference in brightness of a single view, and of all views; share."""

_NAMED = 4  # views that a sentence names

_SIGNS: dict[Signs, tuple[str, bool, str, str]] = {
    "v": (
        "rows and columns of cameras are counted in opposite senses (one axis has the wrong sign)",
        False,
        "v",
        ", or with the other axis flipped if near comes out as far",
    ),
    "uv": (
        "surfaces that the map has as far hide those that it has as near (both axes have the wrong sign)",
        False,
        "uv",
        "",
    ),
    "transposed": ("rows of cameras are taken for columns", True, "", ""),
    "turned": (
        "rows of cameras are taken for columns, and one of the two is counted the other way round",
        True,
        "v",
        ", or with the other axis flipped if near comes out as far",
    ),
}
"""Sentence about each fault of the axes, how the light field has to be read, and what is left open."""


def axes(lf: LightField, fault: Signs) -> str:
    """Describe a fault of the axes, with the options that mend it; those that were given are counted in."""
    what, transpose, flip, more = _SIGNS[fault]
    return f"{what}: {lf.reading.advice(transpose=transpose, flip=flip)}{more}."


@dataclass(frozen=True, eq=False)
class Cameras:
    """Differences of the cameras from parallel, equal cameras at their positions.

    `Explanation` describes the fields. Gains and offsets are [n, 1] if colours are not told apart.
    """

    shift: Float64Array
    shift_error: Float64Array
    rotation: Float64Array
    rotation_error: Float64Array
    scale: Float64Array
    scale_error: Float64Array
    gain: Float64Array
    offset: Float64Array
    brightness: Float64Array
    misfit: Float64Array
    place: NDArray[np.intp]


def strangers(lf: LightField, cameras: Cameras) -> tuple[str, ...]:
    """Name the views that do not show what they should: those of other places, and those that fit nowhere."""
    place, said = cameras.place, []
    unlike = np.flatnonzero(consensus.unlike(cameras.misfit, lf.offsets))
    elsewhere = [n for n in unlike if place[n] != n]
    nowhere = [n for n in unlike if place[n] == n]
    if elsewhere:
        each = [f"the view at {_where(lf, n)} shows what belongs at {_where(lf, place[n])}" for n in elsewhere]
        said.append(f"{_named(each)}: correct the names of the files.")
    if nowhere:
        said.append(
            f"what is shown at {_named([_where(lf, n) for n in nowhere])} fits the other views at no camera's place, "
            "moved or not: replace pictures that are covered, turned, blurred, noisy, or of another time or scene; or "
            "take their files away and read the rest with --allow-missing (allow_missing=True in Python)."
        )
    return tuple(said)


def placement(lf: LightField, cameras: Cameras, *, single: bool = True) -> tuple[str, ...]:
    """Say what stands out about the places and directions of cameras, of single ones too unless `single` is False."""
    radius = float(np.hypot(*lf.size)) / 2
    turned, turned_error = (np.deg2rad(angle)[:, None] * radius for angle in (cameras.rotation, cameras.rotation_error))
    scaled, scaled_error = (share[:, None] * radius for share in (cameras.scale, cameras.scale_error))

    def degrees(pixels: float) -> str:
        return f"{np.rad2deg(abs(pixels) / radius):.2g} degrees"

    def share(pixels: float) -> str:
        return f"{100 * abs(pixels) / radius:.2g} %"

    kinds = (
        (
            *(cameras.shift, cameras.shift_error, (OUT_OF_LINE, MOVED)),
            lambda rms: f"are out of line by {rms:.2g} px (rms along each axis)",
            lambda rest: f"{_direction(*rest)} where it should be",
        ),
        (
            *(turned, turned_error, (OUT_OF_SHAPE, TURNED)),
            lambda rms: f"are turned against each other by {degrees(rms)} (rms)",
            lambda rest: f"{degrees(rest[0])} turned {'clockwise' if rest[0] > 0 else 'anticlockwise'}",
        ),
        (
            *(scaled, scaled_error, (OUT_OF_SHAPE, TURNED)),
            lambda rms: f"are scaled against each other by {share(rms)} (rms)",
            lambda rest: f"{share(rest[0])} {'larger' if rest[0] > 0 else 'smaller'}",
        ),
    )
    remedy = "line {} up with `lfgpu rectify --refine`."
    return tuple(said for kind in kinds for said in _found(lf, *kind, remedy, single=single))


def brightness(lf: LightField, cameras: Cameras, *, single: bool = True) -> tuple[str, ...]:
    """Say what stands out about the brightness of views; as `placement`."""
    bright = np.log(np.maximum(cameras.brightness, 1e-3))[:, None]
    found = _found(
        lf,
        bright,
        np.zeros_like(bright),
        (UNEQUAL, BRIGHTER),
        lambda rms: f"differ in brightness by {100 * rms:.2g} % (rms)",
        lambda rest: (
            f"{float(f'{100 * abs(np.expm1(rest[0])):.2g}'):g} % "
            f"{'brighter' if rest[0] > 0 else 'darker'} than its neighbours"
        ),
        "equalise {} with `lfgpu rectify --equalise`.",
        single=single,
    )
    return tuple(found)


def _found(
    lf: LightField,
    values: Float64Array,
    errors: Float64Array,
    limits: tuple[float, float],
    together: Callable[[float], str],
    alone: Callable[[Float64Array], str],
    remedy: str,
    *,
    single: bool,
) -> list[str]:
    """Make a sentence about values [n, k] of all views if they are off together, else about single views that are.

    Views whose values are not known are left out.
    """
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    values, offsets = values[known], lf.offsets[known]
    rest = consensus.smooth_rest(values, offsets)
    if consensus.usual_rest(rest) > limits[0]:
        return [f"the views {together(float(np.sqrt((rest**2).mean())))}; {remedy.format('them')}"]
    chosen = np.flatnonzero(consensus.outliers(values, offsets, errors[known], least=limits[1])) if single else ()
    if not len(chosen):
        return []
    each = [f"the view at {_where(lf, known[n])} is {alone(rest[n])}" for n in chosen]
    named = _named(each, "; and so are {} more")
    return [f"{named}: {remedy.format('it' if len(chosen) == 1 else 'them')}"]


def _where(lf: LightField, n: int | np.intp) -> str:
    return f"row {lf.positions[n, 1]:g}, column {lf.positions[n, 0]:g}"


def _named(each: list[str], more: str = "; and {} more") -> str:
    """List some of what is said of views, and the number of the others."""
    return "; ".join(each[:_NAMED]) + more.format(len(each) - _NAMED) * (len(each) > _NAMED)


def _direction(x: float, y: float) -> str:
    """Put a shift into words: "0.20 px to the right of and 0.11 px below"; small parts are left out."""
    parts = []
    if abs(x) >= 0.25 * abs(y):
        parts.append(f"{abs(x):.2f} px to the {'right' if x > 0 else 'left'} of")
    if abs(y) >= 0.25 * abs(x):
        parts.append(f"{abs(y):.2f} px {'below' if y > 0 else 'above'}")
    return " and ".join(parts)
