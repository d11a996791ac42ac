"""A long stream of frames with drop-outs, cuts and errors, in which no memory may grow and no frame be lost."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks import cases, machine, rectify
from benchmarks.memory import allocated, gpu_used
from benchmarks.options import CaseName, DeviceName, Out, Preset, check_out, save, say
from lfgpu import DepthStream, LightField, LightFieldError, Rectifier, StreamResult, scenes

RANGE = (-1.0, 1.0)
_THREADS = 2  # that push
_LOOKS = 20  # at memory, evenly
_SETTLED = 0.3  # share of the looks until which memory may grow
_SLACK = 4 << 20  # bytes: what an allocator may keep
_DEVICE_SLACK = 64 << 20
_DROP_OUT, _CUT, _BAD = 0.2, 0.02, 0.05  # shares of the frames
_UNKNOWN = 0.05  # share of a map that rectification may leave without views, at the border


@dataclass(frozen=True)
class Plan:
    """Number and size of the frames, the preset, the seed and the device.

    If `rectified`, frames are raw pictures of a rig that are rectified; `burst` of them come at once in the mean.
    """

    frames: int
    grid: tuple[int, int]
    size: tuple[int, int]
    preset: str
    seed: int
    device: str | None
    rectified: bool = False
    burst: int = 4


@dataclass
class Found:
    """Statistics of the stream, bytes of the host and the GPUs at each look, and problems."""

    stats: dict[str, Any] = field(default_factory=dict)
    host_bytes: list[int] = field(default_factory=list)
    gpu_bytes: list[int] = field(default_factory=list)
    seconds: float = 0.0  # for all frames until the last look
    problems: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Say what happened, in lines."""
        s = self.stats
        lines = [
            f"{s['frames_pushed']} frames: {s['frames_done']} maps, {s['frames_dropped']} dropped, "
            f"{s['frames_failed']} failed; {s['scene_cuts']} cuts, {s['frames_with_missing_views']} maps without some "
            f"views; {s['frames_per_second']:.0f} maps/s at the end."
        ]
        for name, looks in (("host", self.host_bytes), ("device", self.gpu_bytes)):
            if looks:
                settled = looks[int(_SETTLED * len(looks))]
                lines.append(
                    f"Memory of the {name}: {settled / 2**20:.0f} MiB, {looks[-1] / 2**20:.0f} MiB at the end."
                )
        return lines + (self.problems or ["Nothing grew, nothing was lost."])


def command(
    frames: Annotated[int, typer.Option(min=1)] = 20_000,
    case_name: CaseName = "5x5x128x128",
    preset: Preset = "accurate",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    rectified: Annotated[
        bool, typer.Option("--rectify", help="Frames are raw pictures of a rig, rectified on the device.")
    ] = False,
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Push frames with random drop-outs, cuts and errors; exit with 1 if memory grows or a frame is lost."""
    check_out(out)
    case = cases.parse(case_name)
    plan = Plan(frames, case.grid, case.size, preset, seed, device, rectified)
    about = {**machine.about("soak"), "plan": asdict(plan)}
    for found in run(plan):
        save(out, {**about, **asdict(found)})  # as far as it is
    for line in found.lines():
        typer.echo(line)
    if found.problems:
        raise typer.Exit(1)


def run(plan: Plan) -> Iterator[Found]:
    """Push the frames from several threads, look at memory and counts, and at the end at a map.

    Yields what was found so far after each look; the last one is the whole.
    """
    films, rectifier = _films(plan)
    found, start = Found(), time.perf_counter()
    with DepthStream(
        films[0][0],
        config=plan.preset,
        disparity_range=RANGE,
        device=plan.device,
        policy="queue",
        rectifier=rectifier,
    ) as stream:
        first = stream.push(films[0][0].views).numpy()
        expected, done = 1, 0
        part = max(1, plan.frames // _LOOKS)
        with ThreadPoolExecutor(_THREADS) as pool:
            for look in range(0, plan.frames, part):
                count = min(part, plan.frames - look)
                shares = [count // _THREADS + (thread < count % _THREADS) for thread in range(_THREADS)]
                jobs = [
                    pool.submit(
                        _push, stream, films, np.random.default_rng([plan.seed, look, thread]), share, plan.burst
                    )
                    for thread, share in enumerate(shares)
                ]
                for job in jobs:
                    found.problems += job.result()
                expected, done = expected + count, look + count
                _look(found)
                found.seconds = time.perf_counter() - start
                say(f"{done} frames, {found.seconds:.0f} s")
                found.stats = stats = stream.stats()
                if stats["frames_pushed"] != expected or stats["frames_in_work"] != 0:
                    found.problems.append(f"after {done} frames counts are wrong: {stats}")
                yield found
        stream.restart()
        again = stream.push(films[0][0].views).numpy()
        if not np.array_equal(first, again, equal_nan=True):
            found.problems.append("the first frame has another map at the end than at the start.")
        found.stats = stream.stats()
    _judge(found)
    yield found


def _films(plan: Plan) -> tuple[list[list[LightField]], Rectifier | None]:
    """Make two scenes, each seen twice, and the rectifier of their pictures."""
    options: dict[str, Any] = {"grid": plan.grid, "size": plan.size, "disparity_range": RANGE}
    films = [[scenes.make(name, noise=noise, **options) for noise in (0.004, 0.005)] for name in ("boxes", "planes")]
    if not plan.rectified:
        return films, None
    taken = [[rectify.raw(lf) for lf in film] for film in films]
    return [[pictures for pictures, _, _ in film] for film in taken], taken[0][0][1]


def _push(
    stream: DepthStream, films: list[list[LightField]], random: np.random.Generator, count: int, burst: int
) -> list[str]:
    """Push some frames, in bursts, and wait for them; return the problems."""
    pending: list[tuple[StreamResult, bool]] = []
    film, problems = 0, list[str]()
    allowed = 0.0 if stream.rectifier is None else _UNKNOWN
    for _ in range(count):
        if random.random() < _CUT:
            film = 1 - film
        lf = films[film][random.integers(len(films[film]))]
        views, there, bad = lf.views, np.ones(len(lf.views), bool), random.random() < _BAD
        if random.random() < _DROP_OUT:
            there[random.integers(len(there), size=random.integers(1, 4))] = False
            there[lf.reference_index] = True
        if bad:
            views, there = _spoilt(views, there, lf.reference_index, random)
        pending.append((stream.push(views, valid=there), bad))
        if random.random() < 1 / burst:
            problems += [problem for item in pending for problem in _outcome(*item, allowed)]
            pending.clear()
    for item in pending:
        problems += _outcome(*item, allowed)
    return problems


def _spoilt(views: Any, there: Any, reference: int, random: np.random.Generator) -> tuple[Any, Any]:
    match random.integers(4):
        case 0:
            return views[:, 1:], there
        case 1:
            return views.astype(np.float32), there
        case 2:
            return None, there
    missing = there.copy()
    missing[reference] = False
    return views, missing


def _outcome(result: StreamResult, bad: bool, allowed: float) -> list[str]:
    if not result.wait(60):
        return [f"frame {result.index} hangs."]
    if result.dropped:
        return []
    if bad:
        return [] if isinstance(result.error, LightFieldError) else [f"bad frame {result.index} was taken."]
    if result.error is not None:
        return [f"frame {result.index} failed: {result.error}"]
    unknown = float(np.isnan(result.numpy()).mean())
    return [] if unknown <= allowed else [f"of the map of frame {result.index} {100 * unknown:.0f} % are unknown."]


def _look(found: Found) -> None:
    gc.collect()
    host = allocated()
    if host is not None:
        found.host_bytes.append(host)
    gpu = gpu_used()
    if gpu is not None:
        found.gpu_bytes.append(gpu)


def _judge(found: Found) -> None:
    found.problems += grown("host", found.host_bytes) + grown("device", found.gpu_bytes, _DEVICE_SLACK)


def grown(name: str, looks: list[int], slack: int = _SLACK) -> list[str]:
    """Return a sentence if memory went on growing after the first looks at it, by more than `slack`.

    A leak grows in each third of the looks, by the same; what is used for the first time late makes one step.
    """
    settled = looks[int(_SETTLED * len(looks)) :]
    if not settled:
        return []
    ends = [settled[third * (len(settled) - 1) // 3] for third in range(4)]
    if 3 * min(after - before for before, after in pairwise(ends)) <= slack:
        return []
    return [f"memory of the {name} grew by {(ends[-1] - ends[0]) / 2**20:.0f} MiB after it should have settled."]
