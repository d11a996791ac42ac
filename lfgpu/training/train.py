"""Training: steps of an optimiser over generated batches, in pieces that go on where the last one ended."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist
import torch.nn.functional as F  # noqa: N812 - its usual name
from torch import Tensor

from lfgpu.training.generator import Batch, Generator
from lfgpu.training.network import Network, estimate, peak

_WARM_UP = 200  # steps over which the learning rate rises
_SHOWN = 100  # steps from one line of the log to the next
_WINDOWS = 0.25  # share of the steps that compare windows around a coarse map


@dataclass(frozen=True)
class Settings:
    """The numbers that, with the count of processes, decide what a run sees."""

    steps: int
    """Length of the whole schedule, over all pieces."""
    scenes: int = 8
    """Light fields of a step and process."""
    side: int = 192
    """Pixels of these, each way: a multiple of 32."""
    rate: float = 2e-3
    """Largest learning rate."""
    seed: int = 0
    uses: int = 2
    """Steps for which a batch is used, mirrored, transposed and recoloured."""
    refresh: int = 1000
    """Steps after which the textures are drawn anew."""


def labels_for(batch: Batch, rng: np.random.Generator) -> tuple[Tensor, Tensor, int]:
    """Draw the disparities to compare: the first of each pixel [b, y, x], the steps [b], the count.

    They are a range that holds the truth, or windows around a coarse map, as the last pass over a wide range has them.
    """
    if rng.random() < _WINDOWS:
        return _windows_for(batch, rng)
    count = int(rng.choice([20, 28, 36, 48], p=[0.25, 0.3, 0.3, 0.15]))
    low, high = batch.truth.amin((1, 2)).cpu().numpy(), batch.truth.amax((1, 2)).cpu().numpy()
    step = np.maximum(rng.uniform(0.4, 0.9, len(low)), (high - low) / (count - 5))
    free = np.maximum(step * (count - 4) - (high - low), 0)
    first = low - step * 1.5 - rng.uniform(0, 1, len(low)) * free
    first, step = (torch.tensor(x, dtype=torch.float32, device=batch.truth.device) for x in (first, step))
    return first[:, None, None].expand_as(batch.truth).contiguous(), step, count


def _windows_for(batch: Batch, rng: np.random.Generator) -> tuple[Tensor, Tensor, int]:
    """Draw windows around a coarse map: the truth, sampled sparsely or spread from its edges, with smooth errors."""
    truth = batch.truth[:, None]
    count, factor = int(rng.choice([12, 16, 20])), int(rng.choice([2, 4, 8]))
    step = torch.tensor(rng.uniform(0.4, 0.9, len(truth)), dtype=torch.float32, device=truth.device)
    match rng.integers(3):
        case 0:
            coarse = truth[..., factor // 2 :: factor, factor // 2 :: factor]
        case 1:
            coarse = F.max_pool2d(truth, factor)
        case _:
            coarse = F.avg_pool2d(truth, factor)
    generator = torch.Generator(truth.device).manual_seed(int(rng.integers(1 << 30)))
    for size, error in (coarse.shape[-2:], 0.4), ((6, 6), 0.8):
        noise = torch.randn((len(truth), 1, *size), generator=generator, device=truth.device)
        coarse = coarse + F.interpolate(noise, coarse.shape[-2:], mode="bilinear") * error * step[:, None, None, None]
    first = F.interpolate(coarse, truth.shape[-2:], mode="bilinear")[:, 0] - step[:, None, None] * (count - 1) / 2
    return first.contiguous(), step, count


def losses(logits: Tensor, truth: Tensor, first: Tensor, steps: Tensor) -> dict[str, Tensor]:
    """Give the loss of logits [b, l, y, x] against the truth [b, y, x], its parts and errors, by name.

    Errors are shares of pixels that are off by more than 0.28, 0.12 and 0.04 pixels in the farthest view (0.07, 0.03
    and 0.01 per view step of a grid of 9 x 9), and the mean square of errors of at most 8 pixels.
    """
    count = logits.shape[1]
    place = ((truth - first) / steps[:, None, None]).clamp(0, count - 1)[:, None]
    below = place.floor().clamp(max=count - 2)
    share, below = place - below, below.long()
    logs = logits.log_softmax(1)
    likelihood = -((1 - share) * logs.gather(1, below) + share * logs.gather(1, below + 1)).mean()
    error = (peak(logits, first, steps) - truth).abs()
    exact = torch.log1p(error.clamp(max=8) / 0.1).mean()
    with torch.no_grad():
        found = {f"bad {limit}": (error > limit).float().mean() for limit in (0.28, 0.12, 0.04)}
        found["mse"] = error.clamp(max=8).square().mean()
    return {"loss": likelihood + 0.5 * exact, "likelihood": likelihood.detach(), "exact": exact.detach(), **found}


class Trainer:
    """A run, or one process of it; each process has one device and its own batches.

    Parameters
    ----------
    settings
        The numbers of the run.
    folder
        The state is read from it, if there is one, and written there.
    device
        "cpu" or "cuda:0".
    rank, world
        The number of this process, and how many there are; with several, `torch.distributed` is set up already.
    """

    def __init__(self, settings: Settings, folder: Path, device: str, *, rank: int = 0, world: int = 1) -> None:
        self.settings, self.folder, self.device, self.rank, self.world = settings, folder, device, rank, world
        torch.manual_seed(settings.seed)
        self.network, self.mean = Network().to(device), Network().to(device)
        self.mean.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(self.network.parameters(), settings.rate, weight_decay=1e-3)
        self.step, self.log = 0, []
        if (folder / "state.pt").exists():
            state = torch.load(folder / "state.pt", map_location=device)
            for name, part in self._parts().items():
                part.load_state_dict(state[name])
            self.step, self.log = state["step"], json.loads((folder / "log.json").read_text())
        self.generator = self._generator()

    def _parts(self) -> dict[str, torch.nn.Module | torch.optim.Optimizer]:
        """Name what has a state."""
        return {"network": self.network, "mean": self.mean, "optimiser": self.optimiser}

    def run(self, seconds: float) -> None:
        """Train for some time, or to the end of the schedule, and write the state."""
        began = shown = time.monotonic()
        sums: dict[str, Tensor] = {}
        began_at = since = self.step
        drawn: Batch | None = None
        while self.step < self.settings.steps and not self._is_over(time.monotonic() - began > seconds):
            rng = np.random.default_rng((self.settings.seed, 4, self.step, self.rank))
            if self.step % self.settings.refresh == 0 and self.step > began_at:
                self.generator = self._generator()
            if drawn is None or self.step % self.settings.uses == 0:
                drawn = self.generator.draw(self.step, self.settings.scenes)
            for name, value in self.learn(drawn.turned(rng), rng).items():
                sums[name] = sums.get(name, 0.0) + value.detach()
            if self.step % _SHOWN == 0 and self.rank == 0:
                means = {name: round(float(value) / (self.step - since), 4) for name, value in sums.items()}
                self.log.append(
                    {"step": self.step, "ms": round(1e3 * (time.monotonic() - shown) / (self.step - since)), **means}
                )
                print(*(f"{name} {value}" for name, value in self.log[-1].items()), flush=True)
                sums, shown, since = {}, time.monotonic(), self.step
        if self.rank == 0:
            self.write()

    def learn(self, batch: Batch, rng: np.random.Generator) -> dict[str, Tensor]:
        """Take one step on a batch, and give its losses and errors."""
        self.network.train()
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate()
        first, steps, count = labels_for(batch, rng)
        with torch.autocast(torch.device(self.device).type, dtype=torch.bfloat16):
            logits = estimate(
                self.network, batch.views, batch.reference, batch.offsets, batch.starts,
                margin=batch.margin, first=first, steps=steps, count=count,
            )  # fmt: skip
        found = losses(logits, batch.truth, first, steps)
        self.optimiser.zero_grad(set_to_none=True)
        found["loss"].backward()
        if self.world > 1:
            gradients = [parameter.grad for parameter in self.network.parameters()]
            flat = torch.cat([gradient.flatten() for gradient in gradients])
            dist.all_reduce(flat, op=dist.ReduceOp.AVG)
            for gradient, mean in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
                gradient.copy_(mean.view_as(gradient))
        if bool(torch.isfinite(torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0))):
            self.optimiser.step()
        self.step += 1
        # The weights that are kept are a mean over the last thousand steps.
        share = 1 - min(0.999, self.step / (self.step + 19))
        with torch.no_grad():
            for old, new in zip(self.mean.state_dict().values(), self.network.state_dict().values(), strict=True):
                if old.is_floating_point():
                    old.lerp_(new, share)
        return found

    def write(self) -> None:
        """Write the state and the log."""
        self.folder.mkdir(parents=True, exist_ok=True)
        states = {name: part.state_dict() for name, part in self._parts().items()}
        torch.save({"step": self.step, **states}, self.folder / "state.pt")
        (self.folder / "log.json").write_text(json.dumps(self.log))

    def _generator(self) -> Generator:
        """Make the source of the batches of this process until the textures are drawn anew."""
        era = self.step // self.settings.refresh
        return Generator((self.settings.seed, era, self.rank), self.device, side=self.settings.side)

    def _rate(self) -> float:
        """Give the learning rate of the next step: half a cosine, after a warm-up."""
        done = min(self.step / self.settings.steps, 1.0)
        rising = min((self.step + 1) / _WARM_UP, 1.0)
        return self.settings.rate * rising * max(0.5 + 0.5 * math.cos(math.pi * done), 0.01)

    def _is_over(self, late: bool) -> bool:
        """Say whether time is over for any of the processes."""
        if self.world == 1 or self.step % 20:
            return late and self.world == 1
        found = torch.tensor(float(late), device=self.device)
        dist.all_reduce(found, op=dist.ReduceOp.MAX)
        return found.item() > 0
