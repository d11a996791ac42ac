"""What stands out about cameras, in sentences: where they stand and look, how bright their views are, their signs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration import consensus
from lfgpu.data.lightfield import LightField

# A single view stands out does so against the trend of its neighbours, see `consensus.outliers`.
_MOVED = 0.1  # pixels
_TURNED = 0.15  # pixels at the half diagonal
_BRIGHTER = 0.03  # share
_OUT_OF_LINE = 0.12  # pixels, rms of all views along each axis
_OUT_OF_SHAPE = 0.2  # pixels at the half diagonal, rms
_UNEQUAL = 0.03  # share, rms
_NAMED = 4  # views that a sentence names

SIGNS = {
    "v": "rows and columns of cameras are counted in opposite senses (one axis has the wrong sign): read it with "
    "--flip v, or with --flip u if near comes out as far.",
    "uv": "what the map takes for far hides what it takes for near (both axes have the wrong sign): read it with "
    "--flip uv.",
    "transposed": "rows of cameras are taken for columns: swap u and v of the positions.",
}
"""What is said of the signs of axes, by the name of the fault."""


def placement(lf: LightField, cameras: dict[str, Any], *, single: bool = True) -> list[str]:
    """What stands out about where cameras stand and look, of single ones if wished."""
    offsets, radius = lf.offsets, float(np.hypot(*lf.size)) / 2
    said = []
    shift = cameras["shift"]
    rest = consensus.smooth_rest(shift, offsets)
    rms = float(np.sqrt((rest**2).mean()))
    usual = consensus.usual_rest(rest)
    if usual > _OUT_OF_LINE:
        said.append(
            f"the views are out of line by {rms:.2g} px (rms along each axis); line them up with `lfgpu rectify "
            "--refine`."
        )
    elif single:
        moved = consensus.outliers(shift, offsets, cameras["shift_error"], least=_MOVED)
        said += _single(lf, moved, lambda n: f"{_direction(*rest[n])} where it should be", "line up")
    shape = np.stack([np.deg2rad(cameras["rotation"]), cameras["scale"]], axis=1) * radius
    errors = np.stack([np.deg2rad(cameras["rotation_error"]), cameras["scale_error"]], axis=1) * radius
    rest_shape = consensus.smooth_rest(shape, offsets)
    words = (("turned", "clockwise", "anticlockwise"), ("scaled", "larger", "smaller"))
    for k, (word, more, less) in enumerate(words):
        one = slice(k, k + 1)
        if consensus.usual_rest(rest_shape[:, one]) > _OUT_OF_SHAPE:
            size = float(np.sqrt((rest_shape[:, k] ** 2).mean())) / radius
            amount = f"{np.rad2deg(size):.2g} degrees" if k == 0 else f"{100 * size:.2g} %"
            said.append(
                f"the views are {word} against each other by {amount} (rms); line them up with `lfgpu rectify "
                "--refine`."
            )
            continue
        if not single:
            continue
        out = consensus.outliers(shape[:, one], offsets, errors[:, one], least=_TURNED)

        def amount_of(n: int, k: int = k, more: str = more, less: str = less) -> str:
            value = float(rest_shape[n, k]) / radius
            size = f"{abs(np.rad2deg(value)):.2g} degrees turned" if k == 0 else f"{100 * abs(value):.2g} %"
            return f"{size} {more if value > 0 else less}"

        said += _single(lf, out, amount_of, "line up")
    return said


def brightness(lf: LightField, cameras: dict[str, Any], *, single: bool = True) -> list[str]:
    """What stands out about how bright views are, of single ones if wished."""
    offsets, said = lf.offsets, list[str]()
    bright = np.log(np.maximum(cameras["brightness"], 1e-3))[:, None]
    rest_bright = consensus.smooth_rest(bright, offsets)[:, 0]
    if consensus.usual_rest(rest_bright[:, None]) > _UNEQUAL:
        said.append(
            f"the views differ in brightness by {100 * float(np.sqrt((rest_bright**2).mean())):.2g} % (rms); equalise "
            "them with `lfgpu rectify --equalise`."
        )
    elif single:
        unequal = consensus.outliers(bright, offsets, np.zeros_like(bright), least=_BRIGHTER)
        said += _single(
            lf,
            unequal,
            lambda n: (
                f"{100 * abs(np.expm1(rest_bright[n])):.2g} % {'brighter' if rest_bright[n] > 0 else 'darker'} "
                "than its neighbours"
            ),
            "equalise",
        )
    return said


_REMEDY = {
    "line up": "line {it} up with `lfgpu rectify --refine`.",
    "equalise": "equalise {it} with `lfgpu rectify --equalise`.",
}


def _single(lf: LightField, chosen: NDArray[np.bool_], what: Any, remedy: str) -> list[str]:
    """A sentence that names the views that are chosen, the first few of them."""
    found = np.flatnonzero(chosen)
    if not len(found):
        return []
    named = "; ".join(
        f"the view at row {lf.positions[n, 1]:g}, column {lf.positions[n, 0]:g} is {what(int(n))}"
        for n in found[:_NAMED]
    )
    more = f"; and so are {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return [f"{named}{more}: {_REMEDY[remedy].format(it='it' if len(found) == 1 else 'them')}"]


def _direction(x: float, y: float) -> str:
    """A shift in words: "0.20 px to the right of and 0.11 px below"; small parts left out."""
    parts = []
    if abs(x) >= 0.25 * abs(y):
        parts.append(f"{abs(x):.2f} px to the {'right' if x > 0 else 'left'} of")
    if abs(y) >= 0.25 * abs(x):
        parts.append(f"{abs(y):.2f} px {'below' if y > 0 else 'above'}")
    return " and ".join(parts)


__all__ = ["SIGNS", "brightness", "placement"]
