"""Matching costs of the views at a row of disparities.

`PlaneSweep` in `lfgpu/contract` says what is computed. At one disparity all pixels of a view are shifted alike: rows
are interpolated as a whole, with the same weights everywhere. Views that belong to the same view_sets are added up
first, and then once to each of these. `cpu_plane_sweep.py` and `gpu_plane_sweep.py` have the kernels.
"""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import Disparities, SweepCost, ViewSets, sweep_shifts

from . import cpu_plane_sweep
from .gpu_plane_sweep import BLOCK, kept_type, mark_kernel, pack_kernel, sweep_kernel, threads_of
from .memory import floats_of, made_within, scalar_of
from .threads import flat, launch, launch_slices, room_for
from .vector import given
from .views import indices

wp.set_module_options({"enable_backward": False})

_LEAST_OFFSET = 1e-3  # view steps; what is nearer to the reference view is the reference view
_OUTSIDE = 2.0**24  # pixels: a shift with which no view shows anything
_PENALTY = 1e-4  # of all view_sets but the first, besides their preference


class _Loaded:
    """The views as the device reads them."""

    def __init__(self, shape: Sequence[int], device: Any, scale: float) -> None:
        self._shape, self._device, self._scale = tuple(shape), device, scale
        self.stored: Any = None
        self.image: Any = None

    def reach(self, farthest: int) -> None:
        """Prepare for shifts of at most so many pixels: a CPU keeps what lies beside the views."""
        self._farthest = farthest
        if self._device.is_cpu:
            self.stored = None

    def shape_of_views(self) -> tuple[int, ...]:
        n, height, width, channels = self._shape
        return n, channels, height, width + cpu_plane_sweep.margins(width, self._farthest)[1]

    def take(self, image: Any, recorded: Any, valid: Any, room: Any) -> None:
        stored = recorded.dtype._wp_scalar_type_
        if stored is not self.stored:
            self._prepare(stored, room)
        self.valid = valid
        if self._device.is_cpu:
            launch_slices(self._loading.views, len(recorded), [recorded, self.margin], self.views)
            launch(self._loading.image, image.shape, [image, self._scale], [self.image], device="cpu")
            return
        self.image = image
        inputs = [flat(recorded), None if valid is None else flat(valid)]
        launch(self._pack, recorded.size, inputs, [flat(self.views)], device=self._device)

    def _prepare(self, stored: Any, room: Any) -> None:
        """Allocate for views of scalar type `stored`, the first time and when that changes."""
        n, height, width, channels = self._shape
        self.stored = stored
        if not self._device.is_cpu:
            self.views = wp.empty((n, height, width), dtype=kept_type(channels, stored), device=self._device)
            self._pack = pack_kernel(channels, stored)
            self._mark = mark_kernel(channels, stored)
            self._marks: Any = None
            return
        self._loading = cpu_plane_sweep.loading_kernels(channels, stored)
        self.margin, _ = cpu_plane_sweep.margins(width, self._farthest)
        self.views = made_within(room, self.shape_of_views(), cpu_plane_sweep.kept_type(stored), self._device)
        self.image = wp.zeros((channels, height, width + cpu_plane_sweep.LANES), dtype=float, device="cpu")

    def mark(self, nearest: Any, order: Any, deepest: Any) -> Any:
        """Mark the pixels of the views in `order` with the first disparity past the surface, on a GPU."""
        if self._marks is None:
            self._marks = wp.empty(self._shape[:3], dtype=wp.uint16, device=self._device)
        plane = prod(self._shape[1:3])
        inputs = [flat(self.views), flat(nearest), order, plane, deepest]
        launch(self._mark, len(order) * plane, inputs, [flat(self._marks)], device=self._device)
        return self._marks


class plane_sweep:
    """The shifts of the views, in the order of their view sets."""

    def __init__(
        self,
        shape: Sequence[int],
        views: ViewSets,
        disparities: Disparities,
        *,
        scale: float,
        shared: Any = None,
    ) -> None:
        offsets: Any = views.offsets
        view_sets: Any = views.members
        self._shape, self._device, self._scale = tuple(shape), offsets.device, scale
        self._least, self._preference = float(views.least), views.preference
        places, belongs = offsets.numpy(), view_sets.numpy() != 0
        self._view_sets, self._count, self._tolerance = len(belongs), disparities.slices, views.tolerance
        bits = np.left_shift(np.uint32(1), np.arange(len(belongs), dtype=np.uint32))
        members = (belongs * bits[:, None]).sum(0, dtype=np.uint32)
        others = np.flatnonzero(np.hypot(*places.T) > _LEAST_OFFSET)
        others = others[np.argsort(members[others], kind="stable")]
        self._groups, self._places = max(1, len(np.unique(members[others]))), places[others]
        tables = others, members[others].view(np.int32), np.ones(len(others), np.int32)
        self._order, self._members, self._together = (indices(tuple(t.tolist()), self._device.alias) for t in tables)
        self._shifts = wp.empty((self._count, len(others)), dtype=wp.vec4f, device=self._device)
        self._deepest = wp.empty(self._count, dtype=float, device=self._device)
        self._shares = shared is not None
        self._loaded = _Loaded(shape, self._device, scale) if shared is None else shared._loaded
        self.move(disparities)
        if self._device.is_cpu:
            channels = self._shape[3]
            self._room = room_for(self._device, cpu_plane_sweep.room_of(channels, self._groups))

    def move(self, disparities: Disparities) -> None:
        shifts = sweep_shifts(self._places, disparities)
        whole = np.floor(shifts)
        if not self._shares:
            self._loaded.reach(int(np.abs(whole[..., 0]).max(initial=0)))
        rows = np.full((self._count, len(self._places), 4), _OUTSIDE, np.float32)
        rows[: disparities.count] = np.concatenate([whole, shifts - whole], axis=2)
        self._shifts.assign(rows)
        deepest = disparities.first + disparities.step * np.arange(self._count) + self._tolerance
        self._deepest.assign(deepest.astype(np.float32))

    def room(self, stored: Any) -> int:
        if not self._device.is_cpu:
            return 0
        kept = cpu_plane_sweep.kept_type(scalar_of(stored))
        return floats_of(self._loaded.shape_of_views(), kept)

    def load(self, image: Any, recorded: Any, valid: Any, room: Any = None) -> None:
        self._loaded.take(image, recorded, valid, room)

    def by_view_sets(self, cost: SweepCost, volume_out: Any) -> None:
        self._sweep(None, self._members, (self._groups, self._view_sets), 1.0, cost, volume_out)

    def by_visibility(self, nearest: Any, cost: SweepCost, volume_out: Any) -> None:
        self._sweep(nearest, self._together, (1, 1), self._least, cost, volume_out)

    def _sweep(
        self,
        nearest: Any,
        members: Any,
        counts: tuple[int, int],
        least: float,
        cost: SweepCost,
        volume_out: Any,
    ) -> None:
        """`members` says of each view in which view sets it is; `counts` are those of groups of views and of sets."""
        loaded, (_, height, width, channels) = self._loaded, self._shape
        groups, sets = counts
        gradients, rooted = cost.gradient_weight > 0, isinstance(cost.softness, wp.array) or cost.softness > 0
        numbers = [self._scale, cost.truncation, cost.gradient_weight, cost.gradient_truncation]
        numbers += [*given(cost.softness), self._preference]
        if not self._device.is_cpu:
            seen = nearest is not None
            marks = loaded.mark(nearest, self._order, self._deepest) if seen else None
            kernel = sweep_kernel(channels, loaded.stored, sets, seen, gradients, rooted, _PENALTY)
            dim = threads_of(self._count, height, width, seen=seen, gradients=gradients)
            inputs = [loaded.views, loaded.image, marks, self._order, members, self._shifts, *numbers, least]
            launch(kernel, dim, inputs, [volume_out], device=self._device, block_dim=BLOCK)
            return
        views = [loaded.views, loaded.margin, loaded.image, loaded.valid, nearest]
        planned = [self._order, members, groups, self._shifts, self._deepest, sets]
        kernel = cpu_plane_sweep.sweep_kernel(channels, loaded.views.dtype, gradients, rooted, _PENALTY)
        launch_slices(kernel, height, [*views, *planned, *numbers, least], volume_out, room=self._room)
