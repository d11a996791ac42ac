"""Steps that align the views, as `kernels/reference/alignment.py` defines them.

All that the alignment needs from a view at a place are six numbers for each channel, the mean and its first and second
differences, which six by six stored pixels give: nothing else is precomputed. `load` copies the views with a border, a
pixel with whether it is valid in one load, so that no tap needs to look where it is.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from lfgpu.contract import GRADIENT_REACH

from .edges import weigh_edges
from .memory import floats_of, made_within, pixel_type, scalar_of
from .native_code import kernel, names_of
from .splat import as_offsets
from .threads import launch_rows
from .vector import given

_AT_REFERENCE = 1e-3  # view steps: what is no farther from the reference is the reference
_BEFORE, _BORDER = 2, 5  # pixels that copies of views are longer at their left and top, and in all


def _kernels(channels: int, stored: Any, compact: Any, on_cpu: bool) -> SimpleNamespace:
    """Views come as `stored` and are kept as `compact` scalars."""
    pad = 4 if channels == 3 else 2
    kept = pixel_type(pad, compact)
    types = {"Stored": pixel_type(channels, stored), "Kept": kept}
    names, bytes_ = names_of(kept), wp.types.type_size_in_bytes(compact)
    is_integer = compact in (wp.uint8, wp.uint16)
    numbers: dict[str, int | float | str] = {
        "CHANNELS": channels,
        **names,
        "BITS": 8 * bytes_,
        "BORDER": _BORDER,
        "BEFORE": _BEFORE,
        "NEAR": _AT_REFERENCE,
    }
    if not on_cpu:
        numbers["IS_INTEGER"] = int(is_integer)
        numbers["PAIRS"] = "words.x, words.y" if pad * bytes_ == 8 else "words"
        align = kernel("alignment.cuh", "align", Pixel=pixel_type(channels), Kept=kept, **numbers)
        of_pixels = {"CHANNELS": channels, "PAD": pad, "BORDER": _BORDER, "BEFORE": _BEFORE}
        return SimpleNamespace(pack=kernel("alignment.cuh", "pack", **types, **of_pixels), align=align)
    # A CPU reads a pixel as one integer, and of floats each channel by itself.
    integers = {2: "unsigned short", 4: "unsigned", 8: "unsigned long long"}
    numbers["WORD"] = integers[pad * bytes_] if is_integer else f"struct {{ {names['KEPT']} c[{pad}]; }}"
    numbers["IS_FLOAT"] = int(compact is wp.float32)
    module = f"lfgpu_cpu_alignment_{channels}_{stored.__name__}_{compact.__name__}"
    align = kernel("alignment.h", "align", module=module, Pixel=pixel_type(channels), Kept=kept, **numbers)
    pack = kernel("alignment.h", "pack", module=module, **types, **numbers)
    return SimpleNamespace(pack=pack, align=align)


class alignment:
    def __init__(
        self,
        shape: Sequence[int],
        offsets: Any,
        *,
        scale: float,
        gradient_weight: float,
        contrast: Any,
        robust: Any,
        tolerance: float,
        shared: Any = None,
    ) -> None:
        self._shape, self._pairs = tuple(shape), as_offsets(offsets)
        others = int((np.hypot(*offsets.numpy().T) > _AT_REFERENCE).sum())
        share_of_all = 1 / (3 * shape[3] * max(others, 1))
        self._compared = [scale, *given(robust), tolerance, share_of_all]
        if shared is None:
            self._loaded = _Loaded(self._shape, (gradient_weight, contrast, GRADIENT_REACH), offsets.device)
        else:
            self._loaded = shared._loaded

    def room(self, stored: Any) -> int:
        return self._loaded.room(scalar_of(stored))

    def load(self, image: Any, recorded: Any, valid: Any, room: Any = None) -> None:
        self._loaded.take(image, recorded, valid, room)

    def __call__(self, disparity: Any, nearest: Any, curvature_out: Any, slope_out: Any) -> None:
        loaded = self._loaded
        views = [loaded.image, loaded.weights, loaded.packed, self._pairs]
        launch_rows(loaded.kernels.align, [*views, *self._compared, disparity, nearest], curvature_out, slope_out)


class _Loaded:
    """The views as the alignment reads them."""

    def __init__(self, shape: tuple[int, ...], weighing: tuple[float, Any, int], device: Any) -> None:
        n, height, width, self._channels = shape
        self._size, self._weighing, self._device = (n, height + _BORDER, width + _BORDER), weighing, device
        self._stored: Any = None
        self.weights = wp.empty(shape[1:3], dtype=float, device=device)

    def room(self, stored: Any) -> int:
        return floats_of(self._size, self._kept_type(stored)) if self._device.is_cpu else 0

    def _compact(self, stored: Any) -> Any:
        """Return the type of kept scalars: a CPU reads half precision slowly, and each pixel many times."""
        return wp.float32 if stored is wp.float16 and self._device.is_cpu else stored

    def _kept_type(self, stored: Any) -> Any:
        return pixel_type(4 if self._channels == 3 else 2, self._compact(stored))

    def take(self, image: Any, recorded: Any, valid: Any, room: Any) -> None:
        stored = recorded.dtype._wp_scalar_type_
        if stored is not self._stored:
            self._stored = stored
            self.kernels = _kernels(self._channels, stored, self._compact(stored), self._device.is_cpu)
            self.packed = made_within(room, self._size, self._kept_type(stored), self._device)
        self.image = image
        # What is near a step in brightness sees it in its gradients.
        weigh_edges(image, *self._weighing, self.weights)
        launch_rows(self.kernels.pack, [recorded, valid], self.packed)
