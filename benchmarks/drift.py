"""Hours of cameras whose gains drift, in simulated time: the tones must follow, and nothing else may happen.

A rig that is rectified by its calibration looks at one scene. The gain of each colour of each camera goes up and down,
each with a period of its own. Frames come only when the watch of the rig looks, one for each look, so hours take
minutes. The tones at the start are right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import rectify
from benchmarks.soak import grown, resident
from lfgpu import DepthStream, evaluate, scenes
from lfgpu.calibration import RigWatch
from lfgpu.contract import Float64Array

RANGE = (-1.0, 1.0)
_PERIODS = (1.0, 4.0)  # hours in which a gain goes up and down
_SETTLED = 10  # looks
_MOST_LEFT = 0.03  # of the brightness, by which views may be off, rms
_MOST_ERROR = 1.25  # times the MSE of the first maps
_NOISE = 0.004  # intensity


@dataclass(frozen=True)
class Plan:
    """What is simulated: hours, seconds from look to look, how far gains go, and the cameras."""

    hours: float
    every: float
    amplitude: float
    grid: tuple[int, int]
    size: tuple[int, int]
    preset: str
    seed: int
    device: str | None


@dataclass(frozen=True)
class Look:
    """After one look: hours, how far brightness is off, and how right the map is.

    `drifted` is what the gains alone do, `left` what remains when it is equalised: the rms difference of a view from
    what it should show, over the rms of that. Gain and offset may stand in for each other, so neither is told alone.
    """

    hours: float
    drifted: float
    left: float
    mse_100: float
    badpix_07: float


@dataclass
class Found:
    """All looks, bytes of the host after each, and what should not be."""

    looks: list[Look] = field(default_factory=list)
    host_bytes: list[int] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def summary(self) -> dict[str, Any]:
        """For a file: a look in a hundred and the last one."""
        kept = [*self.looks[:: max(1, len(self.looks) // 100)], *self.looks[-1:]]
        return {
            "count": len(self.looks),
            "left_rms_most": max((look.left for look in self.looks[_SETTLED:]), default=None),
            "looks": [asdict(look) for look in kept],
            "host_bytes": self.host_bytes[:: max(1, len(self.host_bytes) // 20)],
            "problems": self.problems,
        }


def run(plan: Plan, say: Callable[[str], None]) -> Iterator[Found]:
    """Look again and again; yields what was found so far, each simulated quarter of an hour and at the end."""
    lf = scenes.make("boxes", grid=plan.grid, size=plan.size, disparity_range=RANGE, seed=plan.seed)
    assert lf.truth is not None
    pictures, rectifier, _ = rectify.raw(lf)
    random = np.random.default_rng([plan.seed, 1])
    gains = _Gains(random, rectifier.tones[:, 0].shape, lf.reference_index, plan.amplitude)
    shown = pictures.views[lf.reference_index].reshape(-1, lf.channels) / 255.0
    found, count = Found(), max(1, round(plan.hours * 3600 / plan.every))
    options: dict[str, Any] = {"config": plan.preset, "disparity_range": RANGE, "device": plan.device}
    with (
        DepthStream(pictures, rectifier=rectifier, policy="block", **options) as stream,
        RigWatch(stream, every=None) as watch,
        ThreadPoolExecutor(1) as pool,
    ):
        for index in range(count):
            hours = (index + 1) * plan.every / 3600
            now = gains.at(hours)
            frame = _recorded(pictures.views, now, random)
            looking = pool.submit(watch.look, timeout=None)
            while not looking.done():  # the frame that is pushed before it looks is not the one that it sees
                disparity = stream.push(frame).numpy()
            if looking.result():
                found.problems.append(f"after {hours:.2f} h: {looking.result()[0]}")
            assert stream.rectifier is not None
            used = list(stream.used_views)
            right, tones = rectifier.tones[used], stream.rectifier.tones[used]
            left = _off(now[used], right, tones, shown)
            errors = evaluate(disparity, lf.truth.disparity)
            found.looks.append(
                Look(
                    hours,
                    _off(now[used], right, right, shown),
                    left,
                    errors.mse_100,
                    errors.badpix_07,
                )
            )
            found.host_bytes += [bytes_ for bytes_ in (resident(),) if bytes_ is not None]
            if index + 1 < count and (index + 1) % max(1, round(900 / plan.every)) == 0:
                say(f"{hours:.2f} h: {100 * left:.2f} % of brightness off, MSE x100 {errors.mse_100:.2f}")
                yield found
        found.problems += list(stream.warnings)
    _judge(found)
    yield found


class _Gains:
    """How bright each colour of each camera is, as a factor; the reference camera's is 1."""

    def __init__(self, random: np.random.Generator, shape: tuple[int, ...], reference: int, amplitude: float) -> None:
        self._period = random.uniform(*_PERIODS, shape)
        self._sign = random.choice((-1.0, 1.0), shape)
        self._amplitude = amplitude * np.ones(shape)
        self._amplitude[reference] = 0.0

    def at(self, hours: float) -> Float64Array:
        """[n, c]."""
        return np.asarray(1 + self._amplitude * self._sign * np.sin(2 * np.pi * hours / self._period))


def _off(gains: Float64Array, right: Float64Array, used: Float64Array, shown: Float64Array) -> float:
    """How far equalised views are from what they should show, `shown` [k, c], rms over cameras and relative to that.

    Cameras are those that maps are made from; the others are not looked at. Tones [n, 3, c] are those that were right
    with gains of 1, and those that are in use.
    """
    scale = gains * right[:, 0] / used[:, 0] - 1
    shift = (gains * right[:, 1] - used[:, 1]) / used[:, 0]
    off = scale[:, None] * shown + shift[:, None]
    return float(np.sqrt((off**2).mean() / (shown**2).mean()))


def _recorded(views: Any, gains: Float64Array, random: np.random.Generator) -> Any:
    noise = random.normal(0, 255 * _NOISE, views.shape)
    return np.clip(np.rint(views * gains[:, None, None, :] + noise), 0, 255).astype(np.uint8)


def _judge(found: Found) -> None:
    settled = found.looks[_SETTLED:]
    if not settled:
        return
    worst = max(settled, key=lambda look: look.left)
    if worst.left > _MOST_LEFT:
        found.problems.append(
            f"after {worst.hours:.2f} h, views are off by {100 * worst.left:.1f} % of their brightness."
        )
    first = float(np.mean([look.mse_100 for look in found.looks[:_SETTLED]]))
    wrong = max(settled, key=lambda look: look.mse_100)
    if wrong.mse_100 > _MOST_ERROR * first:
        found.problems.append(
            f"after {wrong.hours:.2f} h, the MSE is {wrong.mse_100 / first:.2f} times that of the first maps."
        )
    found.problems += grown("host", found.host_bytes)


def show(found: Found) -> None:
    """A table of a look in each twentieth of the time."""
    table = Table("hours", "drifted, %", "left, %", "MSE x100", "BadPix 0.07")
    for look in [*found.looks[:: max(1, len(found.looks) // 20)], found.looks[-1]]:
        table.add_row(
            f"{look.hours:.2f}",
            *(f"{100 * share:.2f}" for share in (look.drifted, look.left)),
            f"{look.mse_100:.2f}",
            f"{look.badpix_07:.2f}",
        )
    console = Console(highlight=False)
    console.print(table)
    console.print("\n".join(found.problems or ["The tones followed, and nothing else happened."]))
