"""The peak of the distribution of each pixel over disparities; `kernels/reference/peak.py` says what it is."""

from typing import Any

from lfgpu.contract import FOLD, PEAK_REACH

from .memory import pixel_type
from .native_code import c_type, kernel
from .threads import in_slices, launch, load, once, with_wide_vectors


@once
def _rows_kernel(stored: Any) -> Any:
    numbers = {"FOLD": FOLD, "REACH": PEAK_REACH, "STORED": c_type(stored, for_vectors=True)}
    types, module = {"Logits": pixel_type(FOLD**2, stored)}, f"lfgpu_peak_{stored.__name__}"
    return with_wide_vectors(kernel("peak.h", "find_peaks", module=module, **types, **numbers))


@once
def _pixel_kernel(stored: Any) -> Any:
    numbers = {"FOLD": FOLD, "REACH": PEAK_REACH, "STORED": c_type(stored)}
    types, module = {"Logits": pixel_type(FOLD**2, stored)}, f"lfgpu_gpu_peak_{stored.__name__}"
    return kernel("peak.cuh", "find_peak", module=module, **types, **numbers)


def peak(logits: Any, first: Any, *, step: float, disparity_out: Any, probability_out: Any, deviation_out: Any) -> None:
    outputs, stored = [disparity_out, probability_out, deviation_out], logits.dtype._wp_scalar_type_
    if not logits.device.is_cpu:
        launch(_pixel_kernel(stored), first.size, [logits, first, step], outputs, device=logits.device)
        return
    find = _rows_kernel(stored)
    load(logits.device, find)

    def some_rows(_: int, begin: int, end: int) -> None:
        launch(find, 1, [logits, first, step, begin, end], outputs, device="cpu")

    in_slices(logits.device, logits.shape[1], some_rows)
