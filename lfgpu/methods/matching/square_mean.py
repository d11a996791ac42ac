"""Means over squares of pixels."""

from __future__ import annotations

from lfgpu.contract import Array, KernelSet


def square_mean(kernels: KernelSet, values: Array, *, reach: int, workspace: Array, means_out: Array) -> None:
    """Average each pixel of a map [y, x] and the pixels at most `reach` rows and columns from it.

    Only pixels in the image count. `values`, `workspace` [y, x] and `means_out` are different fields.
    """
    kernels.line_mean(values, axis=0, reach=reach, means_out=workspace)
    kernels.line_mean(workspace, axis=1, reach=reach, means_out=means_out)
