"""Training: steps of an optimiser over generated batches, in pieces that go on where the last one ended."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor

from lfgpu.comparison import Scene
from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_write
from lfgpu.methods.matching.unet import Weights
from lfgpu.training.compared import SHOWN_FIRST, Comparison, WholeRanges, count_of
from lfgpu.training.generator import Batch, Generator
from lfgpu.training.network import MULTIPLE, Network, certainty, estimate, follow, learning_rate, peak
from lfgpu.training.rig import Rig
from lfgpu.training.trust import fit_trust
from lfgpu.training.weights import unfold

_WARM_UP = 200  # steps over which the learning rate rises
_SHOWN = 100  # steps from one line of the log to the next
_LARGE, _EVERY = 5 / 3, 3  # every so many batches light fields are larger by this, and as many fewer
_FINE = 0.03  # pixels in the farthest view from which the loss grows like the logarithm of the error
_UNSEEN = 1_000_000  # era of the light fields of validations
_PIXELS = 20_000  # of a batch, that the trust is fitted to
_PICTURED = 4  # light fields whose maps are drawn
_STEPS = 4.0  # view steps to the farthest view of a grid of 9 x 9, in which maps are drawn

RATE, RATE_LIKE = 2e-3, 5e-4
"""Largest learning rates, of random weights and of those that lfgpu comes with."""

STATE_FILE, LOG_FILE = "state.pt", "log.jsonl"


@dataclass(frozen=True)
class Settings:
    """The numbers that, with the count of processes, decide what a run sees."""

    steps: int  # length of the whole schedule, over all pieces
    scenes: int = 8  # light fields of a step and process
    side: int = 192  # pixels of these, each way: a multiple of 32
    rate: float = RATE  # largest learning rate
    seed: int = 0
    uses: int = 2  # steps for which a batch is used, mirrored, transposed and recoloured
    refresh: int = 1000  # steps after which the textures are drawn anew and the state is written
    unseen: int = 32  # batches of a validation


def losses(logits: Tensor, truth: Tensor, first: Tensor, steps: Tensor) -> dict[str, Tensor]:
    """Give the loss of logits [b, l, y, x] against the truth [b, y, x], its parts and errors, by name.

    Pixels whose truth lies more than half a step beyond the compared disparities have no loss. Errors are shares of
    pixels that are off by more than 0.28, 0.12 and 0.04 pixels in the farthest view (0.07, 0.03 and 0.01 per view step
    of a grid of 9 x 9), and the mean square of errors of at most 8 pixels.
    """
    count = logits.shape[1]
    place = (truth - first) / steps[:, None, None]
    inside = ((place > -0.5) & (place < count - 0.5)).float()
    weight = inside / inside.mean().clamp(min=1e-3)
    place = place.clamp(0, count - 1)[:, None]
    below = place.floor().clamp(max=count - 2)
    share, below = place - below, below.long()
    logs = logits.log_softmax(1)
    likelihood = -((1 - share) * logs.gather(1, below) + share * logs.gather(1, below + 1))[:, 0]
    error = (peak(logits, first, steps) - truth).abs()
    exact = torch.log1p(error.clamp(max=8) / _FINE)
    likelihood, exact = ((weight * part).mean() for part in (likelihood, exact))
    with torch.no_grad():
        found = {f"bad {limit}": (error > limit).float().mean() for limit in (0.28, 0.12, 0.04)}
        found["mse"] = error.clamp(max=8).square().mean()
    return {"loss": likelihood + 0.5 * exact, "likelihood": likelihood.detach(), "exact": exact.detach(), **found}


@dataclass(frozen=True)
class Validation:
    """The result of a network on light fields that it never saw."""

    errors: dict[str, float]  # losses and errors, as `losses` names them
    share: Float64Array
    spread: Float64Array  # the trust, as `fit_trust` gives it
    shown: list[Scene]  # some light fields with their maps


def read_log(folder: Path) -> list[dict[str, Any]]:
    """Read the lines of the log of a run."""
    path = folder / LOG_FILE
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [json.loads(line) for line in text.splitlines() if line.endswith("}")]


class Trainer:
    """A run, or one process of it; each process has one device and its own batches.

    Parameters
    ----------
    settings
        The numbers of the run.
    folder
        The state is read from it, if there is one, and written there, with a log.
    device
        "cpu" or "cuda:0".
    rank, world
        The number of this process, and how many there are; with several, `torch.distributed` is set up already.
    rig
        The cameras that are learned. Default None: cameras of any kind.
    start
        The weights that training begins with. Default None: random ones.
    compared
        The disparities that are compared. Default: whole ranges.

    Raises
    ------
    LightFieldError
        If the folder holds another run.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        device: str,
        *,
        rank: int = 0,
        world: int = 1,
        rig: Rig | None = None,
        start: Weights | None = None,
        compared: type[Comparison] = WholeRanges,
    ) -> None:
        self.settings, self.folder, self.device, self.rank, self.world = settings, folder, device, rank, world
        self.rig, self.stopped, self._spans = rig, False, compared.spans
        torch.manual_seed(settings.seed)
        self.network, self.mean = Network().to(device), Network().to(device)
        self.optimiser = torch.optim.AdamW(self.network.parameters(), settings.rate, weight_decay=1e-3)
        self.scaler = torch.amp.GradScaler(torch.device(device).type, enabled=device != "cpu")
        self.step = 0
        self._about = {**asdict(settings), "rig": None if rig is None else asdict(rig)}
        is_new = not (folder / STATE_FILE).exists()
        if not is_new:
            self._read()
        self._begin_era()
        self._compared = compared(self.generator, scenes=settings.scenes, seed=settings.seed)
        if is_new:
            if start is not None:
                unfold(start, self.network, self._show)
            if world > 1:
                for values in self.network.state_dict().values():
                    dist.broadcast(values, 0)
            self.mean.load_state_dict(self.network.state_dict())

    def _read(self) -> None:
        """Read the state and cut off the log behind it."""
        state = torch.load(self.folder / STATE_FILE, map_location=self.device)
        if state["about"] != self._about:
            name = next(name for name in self._about if state["about"].get(name) != self._about[name])
            was, now = (f"{about.get(name)}" if name != "rig" else "others" for about in (state["about"], self._about))
            raise LightFieldError(
                f"{self.folder} holds a run with other settings ({name}: {was}, now {now}); give the same options to "
                "continue it, or another file or folder to begin anew."
            )
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self.step = state["step"]
        if self.rank == 0:
            lines = [line for line in read_log(self.folder) if line["step"] <= self.step]
            with atomic_write(self.folder / LOG_FILE) as path:
                path.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")

    def _parts(self) -> dict[str, torch.nn.Module | torch.optim.Optimizer | torch.amp.GradScaler]:
        """Name what has a state."""
        return {"network": self.network, "mean": self.mean, "optimiser": self.optimiser, "scaler": self.scaler}

    def _show(self, network: Network) -> None:
        """Show a network some batches."""
        rng = np.random.default_rng((self.settings.seed, 5))
        for number in range(SHOWN_FIRST):
            batch = self.generator.draw(number, self.settings.scenes)
            estimate(network, batch, *self._compared(batch, rng, count_of(self.settings.seed, 5, number)))

    def run(self, seconds: float, on_step: Callable[[int, dict[str, Any]], None] | None = None) -> None:
        """Train for some time, or to the end of the schedule, or until `stopped` is set, and write the state.

        `on_step` is called after each step with its number and the last line of the log.
        """
        began = shown = time.monotonic()
        sums: dict[str, Tensor] = {}
        line: dict[str, Any] = {}
        began_at = since = self.step
        drawn: Batch | None = None
        while self.step < self.settings.steps and not self._is_over(self.stopped or time.monotonic() - began > seconds):
            rng = np.random.default_rng((self.settings.seed, 4, self.step, self.rank))
            if self.step % self.settings.refresh == 0 and self.step > began_at:
                self.write()
                self._begin_era()
            if drawn is None or self.step % self.settings.uses == 0:
                drawn = self._draw(self.step)
            for name, value in self.learn(drawn.turned(rng, keep=self.rig is not None), rng).items():
                sums[name] = sums.get(name, 0.0) + value.detach()
            if (self.step % _SHOWN == 0 or self.step == self.settings.steps) and self.rank == 0:
                means = {name: round(float(value) / (self.step - since), 4) for name, value in sums.items()}
                line = {"step": self.step, "ms": round(1e3 * (time.monotonic() - shown) / (self.step - since)), **means}
                self.note(line)
                sums, shown, since = {}, time.monotonic(), self.step
            if on_step is not None:
                on_step(self.step, line)
        self.write()

    def write(self) -> None:
        """Write the state, by the first process."""
        if self.rank == 0:
            states = {name: part.state_dict() for name, part in self._parts().items()}
            with atomic_write(self.folder / STATE_FILE) as path:
                torch.save({"step": self.step, "about": self._about, **states}, path)

    def note(self, line: dict[str, Any]) -> None:
        """Append a line to the log."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / LOG_FILE).open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(line)}\n")

    def learn(self, batch: Batch, rng: np.random.Generator) -> dict[str, Tensor]:
        """Take one step on a batch, and give its losses and errors."""
        self.network.train()
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.settings.rate, self.step, self.settings.steps, _WARM_UP)
        # All processes compare as many disparities: they wait for each other.
        first, steps, count = self._compared(batch, rng, count_of(self.settings.seed, 7, self.step))
        kind = torch.device(self.device).type
        # The kernels of a GPU compute in float16, too; bfloat16 loses faint texture. On a CPU both are slow.
        with torch.autocast(kind, dtype=torch.float16, enabled=kind == "cuda"):
            logits = estimate(self.network, batch, first, steps, count)
        found = losses(logits, batch.truth, first, steps)
        self.optimiser.zero_grad(set_to_none=True)
        self.scaler.scale(found["loss"]).backward()
        if self.world > 1:
            gradients = [parameter.grad for parameter in self.network.parameters()]
            flat = torch.cat([gradient.flatten() for gradient in gradients])
            dist.all_reduce(flat)
            parts = (flat / self.world).split([gradient.numel() for gradient in gradients])
            for gradient, mean in zip(gradients, parts, strict=True):
                gradient.copy_(mean.view_as(gradient))
        self.scaler.unscale_(self.optimiser)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.scaler.step(self.optimiser)
        self.scaler.update()
        self.step += 1
        follow(self.mean, self.network, self.step)
        return found

    def validate(self) -> Validation:
        """Judge the network on light fields that training never sees, of the first process's seeds."""
        network, generator = self.mean.eval(), self._generator(_UNSEEN, self.settings.side)
        rng = np.random.default_rng((self.settings.seed, 6))
        sums: dict[str, float] = {}
        samples: list[Float64Array] = []
        shown: list[Scene] = []
        for number in range(self.settings.unseen):
            batch = generator.draw(number, self.settings.scenes)
            first, steps, count = self._compared(batch, rng, count_of(self.settings.seed, 6, number))
            with torch.no_grad():
                logits = estimate(network, batch, first, steps, count)
            for name, value in losses(logits, batch.truth, first, steps).items():
                sums[name] = sums.get(name, 0.0) + float(value) / self.settings.unseen
            found = peak(logits, first, steps)
            step = steps[:, None, None].expand_as(found)
            values = torch.stack([*certainty(logits), step, (found - batch.truth).abs()]).flatten(1).cpu().numpy()
            samples.append(values[:, rng.permutation(values.shape[1])[:_PIXELS]].astype(np.float64))
            if len(shown) < _PICTURED:
                view, truth, map_ = (x[0].cpu().numpy() for x in (batch.reference, batch.truth, found))
                shown.append(
                    Scene(f"{len(batch.offsets) + 1} views", view, truth / _STEPS, {"network": map_ / _STEPS}, border=0)
                )
        share, spread = fit_trust(*np.concatenate(samples, 1))
        return Validation({name: round(value, 4) for name, value in sums.items()}, share, spread, shown)

    def _begin_era(self) -> None:
        """Draw the textures anew."""
        era, side = self.step // self.settings.refresh, self.settings.side
        self.generator = self._generator(era, side)
        large = int(side * _LARGE) // MULTIPLE * MULTIPLE
        self._large = self.generator if self.rig is not None else self._generator(era, large)

    def _draw(self, step: int) -> Batch:
        """Make the batch of a step."""
        of_large = step // self.settings.uses % _EVERY == _EVERY - 1
        generator = self._large if of_large else self.generator
        scenes = round(self.settings.scenes * (self.settings.side / generator.side) ** 2)
        return generator.draw(step, max(scenes, 1))

    def _generator(self, era: int, side: int) -> Generator:
        """Make a source of batches of this process."""
        seed = self.settings.seed, era, self.rank
        return Generator(seed, self.device, side=side, rig=self.rig, spans=self._spans)

    def _is_over(self, late: bool) -> bool:
        """Say whether time is over for any of the processes."""
        if self.world == 1 or self.step % 20:
            return late and self.world == 1
        found = torch.tensor(float(late), device=self.device)
        dist.all_reduce(found, op=dist.ReduceOp.MAX)
        return found.item() > 0
