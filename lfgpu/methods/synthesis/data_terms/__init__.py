"""Data terms: the difference between the views that a disparity map predicts and the recorded views.

A data term is one file of this folder with a function `plan`, and one row of `_HOMES`.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfgpu.contract import Array, KernelSet, SplatDataTerm

_HOMES = {
    "additive": "additive",
    "z-buffer": "z_buffer",
}

NAMES = tuple(_HOMES)
"""Names of all data terms, the default first."""


def planned(name: str, shape: Sequence[int], offsets: Array, *, softness: float, kernels: KernelSet) -> SplatDataTerm:
    """Plan a data term for views of one shape.

    Parameters
    ----------
    name
        One of `NAMES`.
    shape, offsets
        The shape [n, y, x, c] of the views, and their offsets [n, 2] in view steps, a field on the device.
    softness
        Width of the rounded kinks of the triangle kernel, pixels.
    kernels
        The backend's kernels.
    """
    module = importlib.import_module(f"{__name__}.{_HOMES[name]}")
    plan: SplatDataTerm = module.plan(shape, offsets, softness=softness, kernels=kernels)
    return plan
