"""Rendering of new views: each pixel is the weighted mean of the recorded views that see the same surface.

The maps of the nearest recorded views are warped into the new view and joined to one map (`all_views.Join`). With this
map every pixel is sampled in these views by cubic splines. The weight of a view is larger if it is near, and if its own
map agrees with the disparity there; otherwise another surface hides the point. Sampling gives sharper images than
splatting, and the mean lowers the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import LightField, ViewsResult, check_light_field
from lfgpu.data.filling import fill_unknown
from lfgpu.data.layout import farthest
from lfgpu.data.light_field_checks import check_number, check_whole
from lfgpu.errors import LightFieldError
from lfgpu.pipelines.all_views import Join
from lfgpu.threads import in_threads
from lfgpu.viz.splines import colours, sampled, spline, valid_at

_SOURCES = 8
_SAME = 0.6  # pixels in the farthest view: difference in disparity at which a weight falls to one half
_AGREE = 0.4  # pixels in the farthest view: maps that differ by less are averaged
_NEAR = 0.1  # view steps: keeps the weight of a view in the very place finite
_SOMETHING = 0.02  # least sum of weights: what gets less is seen by nobody
_HIDDEN = 0.2  # the same for views that may show what nobody's map does: below it, all see what hides it
_FARTHEST = 3.0  # of the grid's extent: nothing is left to show beyond


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A rendered view.

    Parameters
    ----------
    image
        float32 [y, x, c] in [0, 1], with the channels of the light field.
    disparity
        float32 [y, x], the map of this view, pixels per view step; larger is nearer.
    known
        bool [y, x], False where no recorded view shows what is there: filled from beside, from the farther side, or a
        guess from views whose maps disagree.
    position
        (u, v) of the view, as in `LightField.positions`.
    """

    image: Float32Array
    disparity: Float32Array
    known: NDArray[np.bool_]
    position: tuple[float, float]


class Renderer:
    """Renders views of one light field; keeps intermediate results, so that many views are rendered quickly.

    Parameters
    ----------
    lf
        The light field. Its masks are used; its reference view does not matter.
    maps
        The maps of all its views, from `estimate_all_views`.
    sources
        Number of nearest recorded views that a new view is made from, >= 1; default 8.
    backend, device
        As for `estimate_depth`; they warp maps into new views. The rest runs on the host.

    Raises
    ------
    LightFieldError
        If the maps do not belong to the views, or `sources` is below 1.
    BackendError
        If the backend or the device is missing.

    Examples
    --------
    >>> render = lfgpu.Renderer(lf, lfgpu.estimate_all_views(lf, config="fast", keys=2))
    >>> film = [render(2.0, column).image for column in (1.0, 1.5, 2.0)]
    """

    def __init__(
        self,
        lf: LightField,
        maps: ViewsResult,
        *,
        sources: int = _SOURCES,
        backend: BackendName = DEFAULT,
        device: str | None = None,
    ) -> None:
        check_light_field(lf)
        if not isinstance(maps, ViewsResult):
            raise LightFieldError(
                f"maps must be those of all views, not {type(maps).__name__}; make them with "
                "lfgpu.estimate_all_views(lf)."
            )
        if maps.disparities.shape != lf.views.shape[:3] or not np.allclose(maps.positions, lf.positions, atol=1e-6):
            raise LightFieldError(
                f"the maps belong to {len(maps.disparities)} views of {maps.disparities.shape[1]} x "
                f"{maps.disparities.shape[2]} pixels, but {lf.name} has {len(lf.views)} views of {lf.size[0]} x "
                f"{lf.size[1]} pixels, or other camera positions; give the maps of these views."
            )
        check_whole("sources", sources, 1)
        self._lf, self._maps, self._sources = lf, maps, int(sources)
        self._device = open_device(backend, device)
        self._splines: dict[int, Float32Array] = {}

    def __call__(self, row: float, column: float) -> RenderedView:
        """Render the view at position v = `row`, u = `column`; they need not be whole, nor within the grid.

        LightFieldError if they are no finite numbers, or so far away that nothing of the scene is left.
        """
        place = self._checked(row, column)
        lf, reach = self._lf, farthest(self._lf.offsets)
        distance = np.hypot(*(lf.positions - place).T)
        chosen = [int(n) for n in np.argsort(distance, kind="stable")[: self._sources]]
        join = Join(
            [self._maps.map(n) for n in chosen],
            None if lf.valid is None else lf.valid[chosen],
            self._device,
            tolerance=_AGREE / reach,
        )
        disparity, _ = join(place)
        if np.isnan(disparity).all():
            raise LightFieldError(
                f"{lf.name}: nothing of the scene is visible from row {place[1]:g}, column {place[0]:g}; choose a "
                "nearer position."
            )
        disparity = fill_unknown(disparity)
        looks = in_threads(lambda n: self._look(n, place, disparity, _SAME / reach), chosen)
        image, known, hidden = _blended(looks, distance[chosen])
        image = filled_from_beside(image, disparity, hidden, tolerance=_SAME / reach)
        u, v = place
        return RenderedView(image, disparity, known, (float(u), float(v)))

    def _checked(self, row: float, column: float) -> Float64Array:
        """Check the position; returns it as (u, v)."""
        for name, value in (("row", row), ("column", column)):
            check_number(name, value)
        place = np.array([column, row], np.float64)
        low, high = self._lf.positions.min(0), self._lf.positions.max(0)
        if (np.abs(place - (low + high) / 2) > _FARTHEST * max(*(high - low), 1.0)).any():
            raise LightFieldError(
                f"the position row {place[1]:g}, column {place[0]:g} is too far away from the cameras, which are in "
                f"rows {low[1]:g} to {high[1]:g} and columns {low[0]:g} to {high[0]:g}; choose a nearer one."
            )
        return place

    def _look(
        self, index: int, place: Float64Array, disparity: Float32Array, tolerance: float
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Sample view `index` for the pixels of a new view.

        Returns
        -------
        Colour [y, x, c]; the weight [y, x] of the view where its map agrees; and a weight [y, x] for pixels at which no
        view agrees.
        """
        height, width = disparity.shape
        du, dv = self._lf.positions[index] - place
        y, x = np.mgrid[:height, :width].astype(np.float32)
        across, down = x - disparity * np.float32(du), y - disparity * np.float32(dv)
        inside = (across >= 0) & (across <= width - 1) & (down >= 0) & (down <= height - 1)
        at = np.stack([np.clip(down, 0, height - 1), np.clip(across, 0, width - 1)])
        if self._lf.valid is not None:
            inside &= valid_at(self._lf.valid[index], at)
        seen = [sampled(self._maps.disparities[index], at, order) for order in (0, 1)]
        if du != 0 or dv != 0:  # a view at the place itself shows every pixel, whatever its map says
            inside &= np.isfinite(seen[0])  # elsewhere a pixel of unknown disparity may belong anywhere
        seen = [np.where(np.isfinite(values), values, disparity) for values in seen]
        # At a depth edge bilinear values lie between both surfaces; the nearest pixel belongs to one of them.
        difference = np.min([np.abs(values - disparity) for values in seen], axis=0)
        before = np.maximum(seen[0] - disparity, 0)
        agreeing = inside / (1 + (difference / np.float32(tolerance)) ** 4)
        # Where no view agrees, farther surfaces get larger weights than nearer ones, and all weights are positive.
        otherwise = (inside + np.float32(1e-6)) / (1 + before / np.float32(tolerance)) ** 4
        return colours(self._spline(index), at), agreeing.astype(np.float32), otherwise.astype(np.float32)

    def _spline(self, index: int) -> Float32Array:
        """Compute the spline coefficients [c, y, x] of a view, once."""
        if index not in self._splines:
            self._splines[index] = spline(self._lf.image(index))
        return self._splines[index]


def render_view(
    lf: LightField,
    maps: ViewsResult,
    row: float | None = None,
    column: float | None = None,
    *,
    sources: int = _SOURCES,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> RenderedView:
    """Render one new view of a recorded scene. To render many, create one `Renderer`.

    Parameters
    ----------
    lf, maps, sources, backend, device
        As for `Renderer`.
    row, column
        Where the view is taken from: v and u of `LightField.positions`, in a grid its row and column; None (default)
        is that of the reference. Fractions are allowed, and places beyond the grid; there, what no view shows is
        filled.

    Raises
    ------
    LightFieldError, BackendError
        As `Renderer`.

    Examples
    --------
    >>> maps = lfgpu.estimate_all_views(lf, config="fast", keys=2)
    >>> lfgpu.render_view(lf, maps, 1.5, 2.25).image.shape
    (64, 80, 3)
    """
    render = Renderer(lf, maps, sources=sources, backend=backend, device=device)
    u, v = lf.positions[lf.reference_index]
    return render(float(v) if row is None else row, float(u) if column is None else column)


def _blended(
    looks: list[tuple[Float32Array, Float32Array, Float32Array]], distance: Float64Array
) -> tuple[Float32Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Blend views: the mean colour [y, x, c], where some view sees it, and where all see what hides it, [y, x]."""
    nearness = (1 / (distance + _NEAR) ** 2).astype(np.float32)
    nearness /= nearness.max()
    agreeing = sum(near * look[1] for near, look in zip(nearness, looks, strict=True))
    known = np.asarray(agreeing > _SOMETHING)
    hidden = ~known & (sum(near * look[2] for near, look in zip(nearness, looks, strict=True)) < _HIDDEN)
    colour, total = np.zeros_like(looks[0][0]), np.zeros_like(looks[0][1])
    for near, (seen, agrees, otherwise) in zip(nearness, looks, strict=True):
        weight = near * np.where(known, agrees, otherwise)
        colour += weight[..., None] * seen
        total += weight
    return np.clip(colour / total[..., None], 0, 1), known, np.asarray(hidden)


def filled_from_beside(
    image: Float32Array, disparity: Float32Array, hidden: NDArray[np.bool_], *, tolerance: float
) -> Float32Array:
    """Give hidden pixels of an image [y, x, c] the colour of what is beside them and no nearer.

    What hides them in all recorded views must not be seen there a second time. Colours spread from the rim of each
    hole, a pixel at a time; from what is nearer by more than `tolerance` (pixels per view step) only if there is
    nothing else.
    """
    if not hidden.any():
        return image
    image, holes = image.copy(), hidden.copy()
    for allowed in (tolerance, np.inf):
        while holes.any():
            y, x = np.nonzero(holes)
            total, weight = np.zeros((len(y), image.shape[2]), np.float32), np.zeros(len(y), np.float32)
            for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                at = np.clip(y + dy, 0, holes.shape[0] - 1), np.clip(x + dx, 0, holes.shape[1] - 1)
                from_there = ~holes[at] & (disparity[at] <= disparity[y, x] + np.float32(allowed))
                total += from_there[:, None] * image[at]
                weight += from_there
            reached = weight > 0
            if not reached.any():
                break
            image[y[reached], x[reached]] = total[reached] / weight[reached, None]
            holes[y[reached], x[reached]] = False
    return image
