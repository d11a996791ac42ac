"""Data terms: how far the views that a disparity map predicts are from the recorded ones.

A data term is one file of this folder with a function `plan`, and one row of `_HOMES`.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfgpu.contract import Array, KernelSet, SplatDataTerm

_HOMES = {"additive": "additive", "z-buffer": "z_buffer"}

NAMES = tuple(_HOMES)
"""Names of all data terms, the default first."""


def planned(
    name: str, shape: Sequence[int], offsets: Array, *, softness: float, kernels: KernelSet, device: str
) -> SplatDataTerm:
    """A data term for views of `shape` [n, y, x, c] that are compared with scale 1.

    Parameters
    ----------
    name
        One of `NAMES`.
    shape, offsets
        [n, y, x, c] of the views, and their offsets [n, 2], a field.
    softness
        Width of the rounded kinks of the tent, pixels.
    kernels, device
        Where it is computed.
    """
    module = importlib.import_module(f"{__name__}.{_HOMES[name]}")
    plan: SplatDataTerm = module.plan(shape, offsets, softness=softness, kernels=kernels, device=device)
    return plan
