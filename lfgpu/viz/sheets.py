"""Sheets of several pictures: an overview of one result, and the errors of several methods on several scenes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from lfgpu.comparison import Scene, error_map
from lfgpu.errors import LightFieldError
from lfgpu.viz.colours import LOOKS, painted
from lfgpu.viz.panels import Picture, fitted, rgb
from lfgpu.viz.pictures import beside_scale, draw_map, draw_view, font, short
from lfgpu.viz.scales import ERRORS, scale_limits

_CELL, _LINE, _MARGIN = 330, 34, 12  # pixels: the width of a map in a comparison, the height of a line, space around
_LETTERS, _HEADING = 20, 30  # pixels
_PAPER, _INK = (255, 255, 255), (0, 0, 0)


def overview(
    view: ArrayLike,
    disparity: ArrayLike,
    truth: ArrayLike,
    *,
    title: str,
    mask: ArrayLike | None = None,
    border: int = 0,
) -> Image.Image:
    """Draw the reference view, the error map, and the estimate and the ground truth on one scale.

    NaN is grey, and so is the error in the border and where the mask is False.
    """
    estimated, true, picture = np.asarray(disparity), np.asarray(truth), np.asarray(view, np.float32)
    if true.ndim != 2 or not estimated.shape == true.shape == picture.shape[:2]:
        raise LightFieldError(
            f"view, disparity and truth must be [y, x] of the same size; found {picture.shape}, {estimated.shape}, "
            f"{true.shape}."
        )
    error = _inside(error_map(estimated, true), border)
    error = error if mask is None else np.where(np.asarray(mask), error, np.float32(np.nan))
    limits = scale_limits(np.asarray(true, np.float32))
    maps = [
        draw_map(values, title=name, label=LOOKS[kind].title, colours=LOOKS[kind].colours, limits=ends).convert("RGB")
        for values, name, kind, ends in (
            (error, "disparity minus truth", "error", ERRORS),
            (estimated, "disparity", "disparity", limits),
            (true, "truth", "disparity", limits),
        )
    ]
    drawn = [draw_view(rgb(picture, 1.0), title="reference view"), *maps]
    width, height = (max(image.size[axis] for image in drawn) for axis in (0, 1))
    sheet = Image.new("RGB", (2 * width, 2 * height + 2 * _HEADING), _PAPER)
    for n, image in enumerate(drawn):
        sheet.paste(image, (n % 2 * width, n // 2 * height + 2 * _HEADING))
    ImageDraw.Draw(sheet).text((width, _HEADING), title, _INK, font(_HEADING), "mm")
    return sheet


def comparison(scenes: Sequence[Scene]) -> Image.Image:
    """Draw error maps of several methods on one scale: a row for each scene, a column for each method.

    The first two columns show the view and the ground truth. Below each error map are BadPix(0.07) and the mean squared
    error times 100.
    """
    methods = list(dict.fromkeys(method for scene in scenes for method in scene.maps))
    if not methods:
        raise LightFieldError("there is nothing to compare; give at least one scene with the map of one method.")
    errors = {(s.name, m): error_map(values, s.truth) for s in scenes for m, values in s.maps.items()}
    known = np.concatenate([error[np.isfinite(error)] for error in errors.values()])
    heights = [round(_CELL * scene.truth.shape[0] / scene.truth.shape[1]) for scene in scenes]
    across = _MARGIN + (2 + len(methods)) * (_CELL + _MARGIN)
    sheet = Image.new("RGB", (across, _LINE + sum(height + _LINE for height in heights) + _MARGIN), _PAPER)
    draw, letters, top = ImageDraw.Draw(sheet), font(_LETTERS), _LINE
    for scene, height in zip(scenes, heights, strict=True):
        scores = scene.scores()
        truth = painted(scene.truth, LOOKS["disparity"].colours, scale_limits(scene.truth))
        cells: list[tuple[str, Picture, str]] = [("view", rgb(scene.view, 1.0), scene.name), ("truth", truth, "")]
        for method in methods:
            m = scores.get(method)
            error = errors.get((scene.name, method), np.full(scene.truth.shape, np.nan, np.float32))
            said = "no map" if m is None else f"{m.badpix_07:.2f} % bad, MSE×100 {m.mse_100:.2f}"
            cells.append((method, painted(_inside(error, scene.border), LOOKS["error"].colours, ERRORS), said))
        for column, (name, picture, said) in enumerate(cells):
            left = _MARGIN + column * (_CELL + _MARGIN)
            sheet.paste(fitted(picture, wide=_CELL, tall=height), (left, top))
            draw.text((left, top + height + _LINE / 2), short(said), _INK, letters, "lm")
            if scene is scenes[0]:
                draw.text((left, _LINE / 2), short(name), _INK, letters, "lm")
        top += height + _LINE
    return beside_scale(
        np.asarray(sheet),
        label=f"{LOOKS['error'].title}; grey: undefined or not scored",
        colours=LOOKS["error"].colours,
        limits=ERRORS,
        extent=(float(known.min(initial=0)), float(known.max(initial=0))),
    )


def _inside(error: NDArray[np.float32], border: int) -> NDArray[np.float32]:
    """Leave out the border of an error map, which is not scored: NaN there."""
    scored = np.zeros(error.shape, np.bool_)
    scored[border : error.shape[0] - border, border : error.shape[1] - border] = True
    return np.where(scored, error, np.float32(np.nan))
