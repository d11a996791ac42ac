"""The weights of a trained network as files that need no PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from lfgpu.contract import FOLD, Float32Array, Float64Array

_EPSILON = 1e-5  # of PyTorch's normalisation


def fold(state: Mapping[str, Tensor]) -> dict[str, Float32Array]:
    """Fold the normalisations of a network's state into its convolutions.

    Parameters
    ----------
    state
        The state_dict of a `Network`.

    Returns
    -------
    dict
        "NAME.weight" [l, y, x, c_in, c_out] and "NAME.bias" [c_out] for each convolution. A normalisation's factors go
        to all convolutions whose sum it normalises, its shift to the last one.
    """
    values = {name: np.asarray(tensor.detach().cpu(), np.float64) for name, tensor in state.items()}
    norms = {name.removesuffix(".running_var") for name in values if name.endswith(".running_var")}
    folded: dict[str, Float32Array] = {}
    for key in values:
        name = key.removesuffix(".weight")
        if name == key or name in norms:
            continue
        weights = values[key]
        bias = values.get(f"{name}.bias", np.zeros(len(weights)))
        weights = weights[:, :, None] if weights.ndim == 4 else weights  # an image is one slice
        block, _, part = name.rpartition(".")
        norm = f"{block}.norm" if part in ("coarse", "fine") else f"{block}.1"
        if norm in norms:
            scale = values[f"{norm}.weight"] / np.sqrt(values[f"{norm}.running_var"] + _EPSILON)
            weights = weights * scale[:, None, None, None, None]
            if part != "coarse":
                bias = values[f"{norm}.bias"] + scale * (bias - values[f"{norm}.running_mean"])
            name = block if part == "0" else name
        weights = weights.transpose(2, 3, 4, 1, 0)
        if name == "image.0":  # the folded image has a channel beside its colours
            weights = np.pad(weights, [(0, 0)] * 3 + [(0, FOLD**2), (0, 0)])
        folded[f"{name}.weight"], folded[f"{name}.bias"] = weights.astype(np.float32), bias.astype(np.float32)
    return folded


def write_weights(path: str | Path, state: Mapping[str, Tensor], share: Float64Array, spread: Float64Array) -> None:
    """Write the folded weights of a network's state, in half precision, and its trust (`fit_trust`) to an .npz."""
    halves: dict[str, Any] = {name: values.astype(np.float16) for name, values in fold(state).items()}
    np.savez(path, **halves, share=share.astype(np.float32), spread=spread.astype(np.float32))
