"""The weights of a trained network as files that need no PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from lfgpu.contract import FOLD, Float32Array, Float64Array
from lfgpu.io.atomic import atomic_write
from lfgpu.methods.matching.learned import VERSION
from lfgpu.methods.matching.unet import Weights

_EPSILON = 1e-5  # of PyTorch's normalisation


@dataclass(frozen=True)
class _Layer:
    """A convolution of a network: its name in the state and in files, and the normalisation of what it gives."""

    name: str
    stored: str
    norm: str | None
    has_shift: bool
    """True if its bias is the shift of the normalisation; of several convolutions of a sum, the last one has it."""


def _layers(state: Mapping[str, Tensor]) -> Iterator[_Layer]:
    """Yield the convolutions of a network's state."""
    norms = {name.removesuffix(".running_var") for name in state if name.endswith(".running_var")}
    for key in state:
        name = key.removesuffix(".weight")
        if name == key or name in norms:
            continue
        block, _, part = name.rpartition(".")
        norm = f"{block}.norm" if part in ("coarse", "fine") else f"{block}.1"
        is_normed = norm in norms
        stored = block if is_normed and part == "0" else name
        yield _Layer(name, stored, norm if is_normed else None, part != "coarse")


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
    folded: dict[str, Float32Array] = {}
    for layer in _layers(state):
        weights = values[f"{layer.name}.weight"]
        bias = values.get(f"{layer.name}.bias", np.zeros(len(weights)))
        weights = weights[:, :, None] if weights.ndim == 4 else weights  # an image is one slice
        if layer.norm is not None:
            scale = values[f"{layer.norm}.weight"] / np.sqrt(values[f"{layer.norm}.running_var"] + _EPSILON)
            weights = weights * scale[:, None, None, None, None]
            if layer.has_shift:
                bias = values[f"{layer.norm}.bias"] + scale * (bias - values[f"{layer.norm}.running_mean"])
        weights = weights.transpose(2, 3, 4, 1, 0)
        if layer.name == "image.0":  # the folded image has a channel beside its colours
            weights = np.pad(weights, [(0, 0)] * 3 + [(0, FOLD**2), (0, 0)])
        folded[f"{layer.stored}.weight"] = weights.astype(np.float32)
        folded[f"{layer.stored}.bias"] = bias.astype(np.float32)
    return folded


def unfold(weights: Weights, network: nn.Module, show: Callable[[nn.Module], object]) -> None:
    """Give a network the weights of a file, with normalisations that leave it the same function.

    Parameters
    ----------
    weights
        The weights.
    network
        A `Network` of the same widths.
    show
        Calls the network with light fields like those to be learned. Normalisations take over their means and
        variances, so that training begins where the weights are.
    """
    state = network.state_dict()
    for layer in _layers(state):
        values = np.asarray(weights[f"{layer.stored}.weight"]).transpose(4, 3, 0, 1, 2)
        own = state[f"{layer.name}.weight"]
        own.copy_(torch.tensor(values[:, : own.shape[1]].reshape(own.shape)))
        bias = torch.tensor(weights[f"{layer.stored}.bias"])
        if layer.norm is None:
            state[f"{layer.name}.bias"].copy_(bias)
        elif layer.has_shift:
            for part, value in ("running_mean", 0.0), ("running_var", 1 - _EPSILON), ("weight", 1.0), ("bias", bias):
                own = state[f"{layer.norm}.{part}"]
                own.copy_(torch.as_tensor(value).expand_as(own))
    network.load_state_dict(state)
    norms = [part for part in network.modules() if isinstance(part, nn.BatchNorm3d)]
    seen: dict[nn.Module, list[Tensor]] = {norm: [] for norm in norms}

    def look(norm: nn.Module, inputs: tuple[Tensor]) -> None:
        sums = [inputs[0].float().pow(power).mean((0, 2, 3, 4)) for power in (1, 2)]
        seen[norm].append(torch.stack(sums))

    hooks = [norm.register_forward_pre_hook(look) for norm in norms]
    with torch.no_grad():
        show(network.eval())
        for norm, hook in zip(norms, hooks, strict=True):
            hook.remove()
            mean, square = torch.stack(seen[norm]).mean(0)
            variance = (square - mean**2).clamp(min=0)
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance)
            norm.weight.copy_((variance + _EPSILON).sqrt())
            norm.bias.add_(mean)


def write_weights(path: str | Path, state: Mapping[str, Tensor], **trust: Float64Array) -> None:
    """Write the folded weights of a network's state, in half precision, to an .npz.

    `trust` is that of `fit_trust`, by name; a choice has none.
    """
    halves: dict[str, Any] = {name: values.astype(np.float16) for name, values in fold(state).items()}
    others: dict[str, Any] = {name: values.astype(np.float32) for name, values in trust.items()}
    with atomic_write(path) as temporary:
        np.savez(temporary, **halves, **others, version=VERSION)
