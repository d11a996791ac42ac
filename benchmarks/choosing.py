"""Training of the choice: generated light fields through the plan of the preset surest, and steps of an optimiser.

Maps depend on the weights of the network and on the sweeps, so a choice is trained after them, for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812 - its usual name
from numpy.typing import NDArray
from torch import Tensor

from lfgpu._backends import DEFAULT, open_device
from lfgpu.contract import CLOSE, COMPARED, Device, Float32Array
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods import method_of
from lfgpu.methods.base import Method
from lfgpu.methods.matching.config import PRESETS, MatchingConfig
from lfgpu.methods.matching.learned import WeightsFile
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.methods.matching.unet import Weights
from lfgpu.training.compared import Windows
from lfgpu.training.generator import Generator
from lfgpu.training.network import FOLD, Choice, follow, learning_rate
from lfgpu.training.scenes import SPANS
from lfgpu.training.weights import unfold

_DISTURBED = 0.2  # standard deviation of factors of weights
_TOGETHER = 8  # light fields of one array of cameras
_REFRESH = 40  # arrays after which the textures are drawn anew
_SPANS = SPANS[0], Windows.spans[1]  # pixels in the farthest view: in wide ranges the network is another one
_MATT = 0.4  # share of the scenes in which all is matt, textured and in good light
_MASKED = 0.25  # share of the arrays whose lenses are round
_LENS = 0.55, 0.7  # radius of what these show, in diameters of the largest circle in a view
_SLACK = 1.0, 6.0  # pixels in the farthest view by which ranges are wider than the truth at either end
_LEAST_UNIT = 1 / 12  # of the distance to the farthest view: no view step is shorter
_FINE, _MOST = 0.03, 16.0  # pixels in the farthest view: errors from which the loss grows slower, and no more
_RIGHT = 0.07  # pixels per view step, as for the confidence of the network
_BATCH, _CROP = 16, 192
_RATE, _WARM_UP = 2e-3, 200
_RATE_AGAIN = 1e-3  # of training that begins with given weights
_SHOWN = 64  # light fields that a choice with given weights is shown


@dataclass(frozen=True)
class Compared:
    """Light fields as the choice sees them, and the truth; disparities are in pixels of the farthest view."""

    features: Tensor
    """float16 [n, COMPARED, y, x]."""
    image: Tensor
    """float16 [n, 3, y, x]."""
    maps: Tensor
    """float32 [n, 2, y, x]."""
    truth: Tensor
    """float32 [n, y, x], NaN where the reference view is masked."""
    limits: Tensor
    """The error up to which a pixel is right, [n]."""

    def of(self, which: Tensor, change: Callable[[Tensor], Tensor]) -> Compared:
        """Return some of the light fields, their images changed."""
        features, image, maps, truth = (
            change(part[which]) for part in (self.features, self.image, self.maps, self.truth)
        )
        return Compared(features, image, maps, truth, self.limits[which])


Sight = tuple[Float32Array, Float32Array, Float32Array]
"""The features, the image and both maps [c, y, x] of a light field."""


def compare(lf: LightField, bounds: tuple[float, float], method: Method[MatchingConfig], place: Device) -> Sight:
    """Run the preset surest up to its choice, and return what this sees."""
    plan = method.plan(lf.layout, method.measured(lf, bounds, place), place)
    assert isinstance(plan, MatchingPlan)
    assert plan.second is not None
    for work in plan.stages(place.image(lf.views)).values():
        work(None)
    numpy, choice, (height, width) = place.kernels.numpy, plan.second.choice, lf.size

    def unfolded(folded: Float32Array, channels: int) -> Float32Array:
        rows, columns, _ = folded[0].shape
        parts = folded[0].reshape(rows, columns, -1, FOLD, FOLD).transpose(2, 0, 3, 1, 4)
        return parts.reshape(-1, FOLD * rows, FOLD * columns)[:channels, :height, :width]

    features, image = unfolded(numpy(choice.features), COMPARED), unfolded(numpy(choice.image), 3)
    maps = np.stack([numpy(plan.second.first), numpy(plan.second.map)])
    return features, image, maps


def draw(
    number: int, *, seed: int, device: str, side: int, weights: WeightsFile, on_light_field: Callable[[int], None]
) -> Compared:
    """Generate light fields, and look at them as the choice does.

    Every second array of cameras is matched by a disturbed network. On light fields of others a network fails more
    often, and is surer of it, than on those it was trained with; a choice that never sees it fail trusts it too much.

    Parameters
    ----------
    number
        The number of light fields.
    seed
        Of all that is drawn.
    device
        "cpu" or "cuda:0".
    side
        Pixels of the light fields, each way.
    weights
        The weights of the network.
    on_light_field
        Called with the number of light fields so far, after each.
    """
    rng, place = np.random.default_rng((seed, 8)), open_device(DEFAULT, device)
    methods = [method_of(replace(PRESETS["surest"], weights=file)) for file in (weights, disturbed(weights, rng))]
    found = list[tuple[NDArray[Any], ...]]()
    for drawn in count():
        if drawn % _REFRESH == 0:
            generator = Generator((seed, 9, drawn), device, side=side, spans=_SPANS, matt=_MATT)
        batch = generator.draw(drawn, _TOGETHER)
        offsets = np.concatenate([batch.offsets, np.zeros((1, 2))])
        apart = np.abs(offsets[:, None] - offsets).max(2)
        offsets /= max(float(np.quantile(apart[apart > 0], 0.02)), _LEAST_UNIT)  # now in view steps
        inside = slice(batch.margin, batch.margin + side)
        views = torch.cat([batch.views[:, :, inside, inside], batch.reference[:, None]], 1).clamp(0, 1)
        white, valid = rng.choice([255, 65535]), _lens(side, rng)
        stored = (white * views.cpu().numpy() + 0.5).astype(np.uint8 if white == 255 else np.uint16)
        for these, truth in zip(stored, batch.truth.cpu().numpy(), strict=True):
            masks = None if valid is None else np.broadcast_to(valid, these.shape[:3])
            lf = LightField(these, offsets, reference=len(offsets) - 1, valid=masks)
            farthest, slack = lf.layout.farthest, rng.uniform(*_SLACK, 2)
            bounds = (truth.min() - slack[0]) / farthest, (truth.max() + slack[1]) / farthest
            try:
                features, image, maps = compare(lf, bounds, methods[drawn % 2], place)
            except LightFieldError:
                continue  # nothing to be seen
            halves = features.astype(np.float16), image.astype(np.float16)
            known = truth if valid is None else np.where(valid, truth, np.float32(np.nan))
            found.append((*halves, farthest * maps, known, np.array(_RIGHT * farthest, np.float32)))
            on_light_field(len(found))
            if len(found) == number:
                parts = (torch.from_numpy(np.stack(part)) for part in zip(*found, strict=True))
                return Compared(*(part.to(device) for part in parts))
    raise AssertionError


def _lens(side: int, rng: np.random.Generator) -> NDArray[np.bool_] | None:
    """Draw what a round lens shows, bool [y, x], or None: most views are whole."""
    if rng.random() >= _MASKED:
        return None
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    return np.hypot(y, x) < rng.uniform(*_LENS) * side


def disturbed(weights: WeightsFile, rng: np.random.Generator) -> WeightsFile:
    """Return weights of convolutions that are multiplied by random factors."""
    found = WeightsFile(f"{weights}, disturbed")
    found.weights = {
        name: (values * rng.normal(1, _DISTURBED, values.shape)).astype(np.float32)
        if name.endswith(".weight")
        else values
        for name, values in weights.weights.items()
    }
    return found


def chosen(maps: Tensor, decisions: Tensor) -> Tensor:
    """Make one map [n, y, x] of two [n, 2, y, x], as `KernelSet.choose` does."""
    apart, share = maps[:, 1] - maps[:, 0], decisions[:, 0].sigmoid()
    return maps[:, 0] + torch.where(apart.abs() < CLOSE, share, (share > 0.5).float()) * apart


def _cost(error: Tensor) -> Tensor:
    return torch.log1p(error / _FINE) + error.clamp(max=_MOST)


def loss_of(decisions: Tensor, seen: Compared) -> Tensor:
    """Give the loss of decisions [n, DECISIONS, y, x]: of the map, of its confidence and of its deviation."""
    choice, right, size = decisions.unbind(1)
    known = seen.truth.isfinite()
    share, maps, truth = choice.sigmoid(), seen.maps, torch.where(known, seen.truth, seen.maps[:, 0])
    apart = maps[:, 1] - maps[:, 0]
    first, second = (_cost((map_ - truth).abs()) for map_ in maps.unbind(1))
    mean = _cost((maps[:, 0] + share * apart - truth).abs())
    of_map = torch.where(apart.abs() < CLOSE, mean, share * second + (1 - share) * first)[known].mean()
    error = (chosen(maps, decisions.detach()) - truth).abs()
    is_right = (error < seen.limits[:, None, None]).float()
    of_confidence = F.binary_cross_entropy_with_logits(right[known], is_right[known])
    size = size.clamp(-7, 4)
    of_deviation = (size + 1.5 * torch.log1p((error * torch.exp(-size)) ** 2 / 2))[known].mean()
    return of_map + 0.3 * of_confidence + 0.1 * of_deviation


def train_choice(
    seen: Compared,
    *,
    steps: int,
    seed: int,
    start: Weights | None = None,
    on_step: Callable[[int, Tensor], None] = lambda *_: None,
) -> Choice:
    """Train a choice on light fields, from the weights `start` on if they are given.

    `on_step` is called with the number of each step and its loss.
    """
    torch.manual_seed(seed)
    device, rng = seen.truth.device, np.random.default_rng((seed, 10))
    network, mean = Choice().to(device), Choice().to(device)
    rate = _RATE if start is None else _RATE_AGAIN
    if start is not None:
        some = seen.of(torch.arange(min(_SHOWN, len(seen.truth)), device=device), lambda part: part)
        unfold(start, network, lambda shown: shown(some.features.float(), some.image.float()))
        network.train()
    mean.load_state_dict(network.state_dict())
    optimiser = torch.optim.AdamW(network.parameters(), rate, weight_decay=1e-3)
    number, side = len(seen.truth), seen.truth.shape[-1]
    crop = min(_CROP, side)
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = learning_rate(rate, step, steps, _WARM_UP)
        y, x = rng.integers(0, side - crop + 1, 2)
        turns, is_mirrored = int(rng.integers(4)), bool(rng.integers(2))

        def change(part: Tensor, y: int = y, x: int = x, turns: int = turns, mirror: bool = is_mirrored) -> Tensor:
            part = torch.rot90(part[..., y : y + crop, x : x + crop], turns, (-2, -1))
            return part.flip(-1) if mirror else part

        some = seen.of(torch.from_numpy(rng.integers(0, number, _BATCH)).to(device), change)
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=device.type == "cuda"):
            decisions = network(some.features.float(), some.image.float())
        loss = loss_of(decisions, some)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        follow(mean, network, step + 1)
        on_step(step + 1, loss.detach())
    return mean.eval()
