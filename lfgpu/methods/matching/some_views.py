"""Some of the views of a light field, and their masks, copied on the device."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import DTypeLike

from lfgpu.contract import Array, Device
from lfgpu.data.layout import ViewLayout


class SomeViews:
    """Those views of light fields of a kind that are chosen.

    Parameters
    ----------
    layout
        The layout of the views.
    chosen
        Their indices, in order, the reference among them.
    device
        The device on which it runs.
    stored
        How the views' values are stored. Default None: as those of `layout`.
    masked
        Whether masks may come even if `layout` has none.
    """

    def __init__(
        self,
        layout: ViewLayout,
        chosen: Sequence[int],
        device: Device,
        *,
        stored: DTypeLike | None = None,
        masked: bool = False,
    ) -> None:
        kernels = device.kernels
        self._kernels, self._chosen = kernels, list(chosen)
        shape = (len(chosen), *layout.size, layout.channels)
        self._views = device.zeros_image(shape, layout.dtype if stored is None else stored)
        self._valid = device.zeros(shape[:3]) if masked or layout.masks is not None else None

    def of(self, views: Array, valid: Array | None) -> tuple[Array, Array | None]:
        """The chosen ones of all views [n, y, x, c] and of their masks [n, y, x]; the next call overwrites them."""
        self._kernels.line_of_views(views, self._chosen, vertical=False, epis_out=self._views)
        if valid is None:
            return self._views, None
        self._kernels.line_of_views(valid, self._chosen, vertical=False, epis_out=self._valid)
        return self._views, self._valid
