"""The views of one frame: loaded once, smoothed if they have grain, and chosen for each sweep."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract import WHITE, Array, Float32Array, PlaneSweep, ViewSets, bridged
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.arena import Arena, Scratch
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.disparities import compared_disparities, view_sets
from lfgpu.methods.matching.views import VIEWS, ChosenViews, offsets_of
from lfgpu.methods.prior import UNLIKE_ANY, NonLocalMeans
from lfgpu.methods.sections import PriorConfig

_ROOM = {"cpu": 1, "gpu": 8}  # disparities: volumes have room for a multiple, so that light fields share captured work


class KnownPixels:
    """The mask of the reference view on the device. Without masks all pixels are known, and nothing is done."""

    def __init__(self, arena: Arena, layout: ViewLayout) -> None:
        self._arena, self._kernels, self._size = arena, arena.kernels, layout.size
        self.mask: NDArray[np.bool_] | None = None if layout.masks is None else layout.masks[layout.reference]
        """The mask of the reference view, bool [y, x]; None if all pixels are known."""
        self.shown = None if self.mask is None else bridged(self.mask)
        """The same with the pixels that the image bridges, which are matched like all others."""
        self._known = None if self.mask is None else arena.constant("known", self.mask)

    def putting_nan(self) -> Callable[[Array], None]:
        """Plan to make maps [y, x] NaN at unknown pixels."""
        return self._putting(math.nan, self._known)

    def putting_far(self, value: float) -> Callable[[Array], None]:
        """Plan to give maps [y, x] a value at the pixels that the image does not show."""
        return self._putting(value, None if self.shown is None else self._arena.constant("shown", self.shown))

    def _putting(self, value: float, known: Array | None) -> Callable[[Array], None]:
        if known is None:
            return lambda map_: None
        other = self._arena.constant(f"all {value}", np.full(self._size, value))
        return lambda map_: self._kernels.select(known, map_, other, map_)

    def take_out(self, values: Array) -> None:
        """Make values [y, x] 0 at unknown pixels."""
        if self._known is not None:
            self._kernels.multiply(values, self._known, values)

    def on_host(self, values: Float32Array) -> Float32Array:
        """Put NaN at the unknown pixels of a map [y, x] on the host."""
        return values if self.mask is None else np.where(self.mask, values, np.float32(np.nan))


WIDEST = 1
"""Pixels by which a surface is widened at most before it hides anything."""

Load = Callable[[Array, Array, Array | None], None]
"""Takes a reference image [y, x, c], views [n, y, x, c] and their masks [n, y, x] or None."""

Loaded = tuple[Array, Array | None]
"""Views [n, y, x, c] and their masks [n, y, x]."""


def _clear(*attributes: dict[str, Any]) -> None:
    for each in attributes:
        each.clear()


class Frame:
    """The views of a frame on the device, with parameters in units of the noise.

    Smoothing averages pixels of a view that differ by `deviation`, intensity; None: no smoothing. `masked` says that
    masks may come that the layout does not have. Volumes have room for a `multiple` of so many disparities.
    """

    def __init__(
        self,
        arena: Arena,
        chosen: ChosenViews,
        bounds: tuple[float, float],
        config: MatchingConfig,
        *,
        deviation: float | None,
        masked: bool = False,
        multiple: int | None = None,
    ) -> None:
        layout, image = chosen.used, (*chosen.used.size, chosen.used.channels)
        self.arena, self.kernels, self.config, self.bounds = arena, arena.kernels, config, bounds
        self.layout, self.compared_layout, self.size = layout, chosen.compared, layout.size
        self.compared_offsets = offsets_of(layout, chosen.chosen)
        """(du, dv) of each used view [n, 2], NaN if it is not compared."""
        room = 1 if arena.changing is None else _ROOM["gpu" if arena.device.is_gpu else "cpu"]
        self._multiple = multiple or room
        self.reach = chosen.reach
        """The distance of the farthest views from which sweeps choose, view steps."""
        self.is_wide = chosen.is_wide
        """See `ChosenViews`."""
        self.disparities = compared_disparities(bounds, self.reach, config.sweep, multiple=self._multiple)
        """The disparities that sweeps compare."""
        self.moving: list[PlaneSweep] = []
        """The plane sweeps over these."""
        self.fits: list[Callable[[tuple[float, float]], bool]] = []
        """Tests of passes: can they go on with other bounds?"""
        self.low, self.high = (arena.number(partial(lambda end: self.bounds[end], end)) for end in (0, 1))
        self.labels: dict[str, Any] = {}
        """The number of the disparities, where volumes may have room for more; see `Changing`."""
        if arena.changing is not None:
            self.labels["labels"] = arena.number(lambda: self.disparities.count)
        self.known = KnownPixels(arena, layout)
        """The pixels that the reference view recorded."""
        self.is_masked = masked or layout.masks is not None
        self.valid = None if layout.masks is None else arena.constant("masks", np.stack(layout.masks))
        """The masks of the used views, a field [n, y, x]; None if all pixels are valid. Streams change it."""
        self.image = arena.image("image", image)
        """The reference image [y, x, c], `UNLIKE_ANY` where it is invalid."""
        self.scale, self.compared_image = layout.scale, self.image
        self._given = Selection(self, "used views", chosen.given, layout, layout.dtype)
        self._smoothing, self.stored = deviation, layout.dtype
        self._deviation = None if deviation is None else arena.number(lambda: self._smoothing or 0.0)
        if deviation is not None:
            self.compared_image, self.scale = arena.image("smoothed image", image), 1 / WHITE
            self.stored = np.dtype(np.uint16)
        self.hiding = arena.kernels.z_buffer(self.size, arena.device.name, reach=WIDEST)
        """Finds the nearest surface in each view, with surfaces widened by up to `WIDEST` pixels."""
        self.scratch: Scratch
        """Lends the memory in which sweeps keep views, while they are planned."""
        self._chosen = chosen
        self._priors: dict[int, NonLocalMeans] = {}
        self._swept: dict[tuple[int, ...], SweptViews] = {}
        self._loads: list[Load] = []
        self.used: Loaded
        """The used views, as stored."""

    def goes_with(self, plan: object) -> None:
        """Free all memory once `plan` is dropped; its parts refer to each other, so Python would find out late."""
        weakref.finalize(plan, _clear, vars(self), vars(self.arena)).atexit = False

    @contextmanager
    def planning(self) -> Iterator[Scratch]:
        """Lend scratch to the block, which plans all sweeps; then allocate what loading needs, in the same memory."""
        chosen, compared = self._chosen.chosen, self._chosen.compared
        with self.arena.scratch() as self.scratch:
            yield self.scratch
            del self.scratch  # a sweep that is planned later would lose its views to other passes
            with self.arena.scratch() as scratch:
                if self._deviation is None:
                    self._compared = Selection(self, "compared views", chosen, compared, self.stored, scratch)
                else:
                    self._smoothed = scratch.image(compared.shape, np.uint16)
                    self._smoothed_masks = ChosenMasks(self, "compared views", chosen, compared)

    def follow(self, bounds: tuple[float, float], config: MatchingConfig, *, deviation: float | None) -> bool:
        """Go on with other bounds, and parameters and smoothing for another noise; tell whether that is possible."""
        own, multiple = self.disparities, self._multiple
        disparities = compared_disparities(bounds, self.reach, config.sweep, multiple=multiple)
        fits = 0 <= own.slices - disparities.slices < 2 * multiple - 1  # at most one multiple is wasted
        if disparities.step != own.step or not fits or (deviation is None) != (self._smoothing is None):
            return False
        if not all(others_fit(bounds) for others_fit in self.fits):
            return False
        disparities = replace(disparities, room=own.slices)
        self.bounds, self.config, self.disparities, self._smoothing = bounds, config, disparities, deviation
        self.arena.follow()
        if (changing := self.arena.changing) is not None:
            for sweep in self.moving:
                changing.move(sweep, disparities)
        return True

    def load(self, views: Array) -> None:
        """Take all views [n, y, x, c] of a frame, as stored."""
        kernels, layout = self.kernels, self.layout
        self.used = self._given.of(views, None)[0], self.valid
        kernels.intensities(
            self.used[0], layout.reference, self.valid, scale=layout.scale, fill=UNLIKE_ANY, image_out=self.image
        )
        for prior in self._priors.values():
            prior.load(self.image)
        if self._deviation is None:
            views, valid = self._compared.of(*self.used)
        else:
            views, valid = self._smoothed, self._smoothed_masks.of(self.valid)
            kernels.smooth_views(
                *self.used,
                scale=layout.scale,
                deviation=self._deviation,
                chosen=self._chosen.chosen,
                views_out=views,
            )
            reference = self.compared_layout.reference
            kernels.intensities(
                views, reference, valid, scale=self.scale, fill=UNLIKE_ANY, image_out=self.compared_image
            )
        for load in self._loads:
            load(self.compared_image, views, valid)

    def on_load(self, load: Load) -> None:
        """Have `load` called for each frame, with the compared views, smoothed if they have grain.

        `scale` turns their values, which are of the type `stored`, into intensities.
        """
        self._loads.append(load)

    def like_pixels(self, window: int) -> NonLocalMeans:
        """Return the weights of like pixels in a window around each pixel of the reference image."""
        if window not in self._priors:
            tuning, shape = self.config.tuning.prior, (*self.size, self.layout.channels)
            prior = PriorConfig(window, tuning.patch, tuning.sigma_color, tuning.sigma_gradient, tuning.floor)
            sigma = self.arena.number(lambda: self.config.tuning.prior.sigma_color)
            self._priors[window] = NonLocalMeans(shape, prior, self.arena.device, sigma_color=sigma)
        return self._priors[window]

    @property
    def prior(self) -> NonLocalMeans:
        """The weights of like pixels for means over maps."""
        return self.like_pixels(self.config.prior.window)

    def swept(self, rule: str) -> SweptViews:
        """Return the compared views that a row of `VIEWS` chooses; rules that choose the same views share them."""
        chosen = tuple(VIEWS[rule](self.compared_layout, self.config.sweep.views))
        if chosen not in self._swept:
            self._swept[chosen] = SweptViews(self, chosen)
        return self._swept[chosen]


class ChosenMasks:
    """The masks of some views of a frame, copied on the device; those of all, if not `chosen`, are not copied."""

    def __init__(self, frame: Frame, name: str, chosen: list[int] | None, layout: ViewLayout) -> None:
        self._kernels, self._chosen = frame.kernels, chosen
        if chosen is not None and frame.is_masked:
            self._masks = frame.arena.field(f"{name}, masks", layout.shape[:3])

    def of(self, valid: Array | None) -> Array | None:
        """Copy the chosen ones of the masks [n, y, x] of all views."""
        if self._chosen is None or valid is None:
            return valid
        self._kernels.line_of_views(valid, self._chosen, vertical=False, epis_out=self._masks)
        return self._masks


class Selection:
    """Some views of a frame and their masks, copied on the device; all of them, if not `chosen`, are not copied.

    The views are lent if there is `scratch` for them.
    """

    def __init__(
        self,
        frame: Frame,
        name: str,
        chosen: list[int] | None,
        layout: ViewLayout,
        stored: np.dtype[np.generic],
        scratch: Scratch | None = None,
    ) -> None:
        self.layout, self._kernels, self._chosen = layout, frame.kernels, chosen
        self._masks = ChosenMasks(frame, name, chosen, layout)
        if chosen is not None:
            image = partial(frame.arena.image, name) if scratch is None else scratch.image
            self._views = image(layout.shape, stored)

    def of(self, views: Array, valid: Array | None) -> Loaded:
        """Copy the chosen ones of all views [n, y, x, c] and of their masks [n, y, x]."""
        if self._chosen is not None:
            self._kernels.line_of_views(views, self._chosen, vertical=False, epis_out=self._views)
            views = self._views
        return views, self._masks.of(valid)


class SweptViews:
    """The views of a sweep, some of the compared ones, and the operations that compare them."""

    def __init__(self, frame: Frame, chosen: tuple[int, ...]) -> None:
        self.frame, self.layout = frame, frame.compared_layout.subset(chosen)
        self.chosen = None if len(chosen) == frame.compared_layout.count else list(chosen)
        """The indices of the views among the compared ones; None if they are all of these."""
        self._costs: dict[str, Any] = {}
        self._offsets = offsets_of(frame.compared_layout, self.chosen)

    @cached_property
    def offsets(self) -> Array:
        """(du, dv) of each compared view, a field [n, 2] in view steps; NaN if the sweep leaves it out."""
        return self.frame.arena.device.field(self._offsets)

    @cached_property
    def sweep(self) -> PlaneSweep:
        """The plane sweep over these views, which costs share. All sweeps share the views that are loaded."""
        frame, tuning = self.frame, self.frame.config.tuning.sweep
        shared = None if self.chosen is None else frame.swept("all").sweep
        views = ViewSets(
            self.offsets,
            frame.arena.device.field(view_sets(self._offsets, tuning.view_set_angle)),
            preference=tuning.view_set_penalty,
            tolerance=tuning.tolerance / self.layout.farthest,
            least=max(1, math.ceil(tuning.min_share * (self.layout.count - 1))),
        )
        shape = frame.compared_layout.shape
        sweep = frame.kernels.plane_sweep(shape, views, frame.disparities, scale=frame.scale, shared=shared)
        frame.moving.append(sweep)
        if shared is None:
            room = frame.scratch.room(sweep, frame.stored)
            frame.on_load(lambda image, views, valid: sweep.load(image, views, valid, room))
        return sweep

    def cost(self, name: str, plan: Callable[[SweptViews], Any]) -> Any:
        """Return the cost of a name over these views; it is planned when it is first asked for."""
        if name not in self._costs:
            self._costs[name] = plan(self)
        return self._costs[name]
