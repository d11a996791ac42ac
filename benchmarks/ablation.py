"""What each ingredient of matching is worth: the preset `accurate` without it, on scenes whose truth is known.

An ingredient is left out by parameters alone, one at a time. `fast` and `paper` stand beside it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from statistics import mean

import numpy as np

from benchmarks import clock, machine
from benchmarks.errors import BenchmarkError
from benchmarks.pipelines import METRICS
from benchmarks.results import Record, Run
from lfgpu import LightField, estimate_depth, evaluate, read, scenes
from lfgpu.config import Config
from lfgpu.errors import LfgpuError
from lfgpu.methods import preset
from lfgpu.metrics import Metrics
from lfgpu.threads import get_threads

KIND = "ablation"
ALL = "accurate"
DATA = Path(os.environ.get("LFGPU_DATA") or Path(__file__).parents[2] / "shared" / "data")
GRID = (9, 9)
_MARGIN = 0.1  # pixels per view step on either side of the true range
_WARM_UP = (48, 48)  # pixels
_WARM_UP_RANGE = (-1.5, 1.5)  # that of the package's scenes

Say = Callable[[str], None]


@dataclass(frozen=True)
class Variant:
    """A preset with some parameters changed, and what is missing then."""

    name: str
    values: Mapping[str, float | str] = field(default_factory=dict)
    preset: str = ALL

    def config(self) -> Config:
        """All parameters."""
        return preset(self.preset).with_values(self.values)


@dataclass(frozen=True)
class Scene:
    """A scene of the package, with noise (standard deviation, intensity), or a folder of real light fields."""

    name: str
    made: str = ""
    """Name of the package's scene; none for a folder."""
    noise: float = 0.0
    judging: bool = False
    """Whether no parameter was ever chosen by it."""


@dataclass(frozen=True)
class Plan:
    """What is asked for: scenes, pixels along each side of those that are made, how many of each, folder of the real.

    The seeds of those that are made are 0, 1, ...; their errors are means over them.
    """

    scenes: tuple[Scene, ...]
    size: int
    seeds: int
    data: Path
    variants: tuple[Variant, ...]


SCENES = (
    *(Scene(name, name) for name in ("boxes", "planes", "bars", "textureless", "relief")),
    Scene("noisy_boxes", "boxes", noise=0.02),
    Scene("cotton"),
    Scene("kitchen", judging=True),
)

# What is not to matter is 2 and not more: differences of intensity are multiplied by up to 5 where there is noise, and
# must stay within the parameters' ranges.
VARIANTS = (
    Variant(ALL),
    Variant("fast", preset="fast"),
    Variant("paper", preset="paper"),
    Variant("all views in all steps", {"sweep.views": "full"}),
    Variant("views of rows, columns, diagonals only", {"sweep.views": "star"}),
    Variant("views of row and column only", {"sweep.views": "cross"}),
    Variant("no apertures", {"sweep.view_set_penalty": 10}),
    Variant("apertures of a quarter of the views", {"sweep.view_set_angle": 90}),
    Variant("apertures not held back", {"sweep.view_set_penalty": 0}),
    Variant("first sweep over all views", {"sweep.first_views": "all"}),
    Variant("no further sweeps", {"sweep.first_views": "all", "sweep.resweeps": 0}),
    Variant(
        "no apertures, no further sweeps",
        {"sweep.view_set_penalty": 10, "sweep.first_views": "all", "sweep.resweeps": 0},
    ),
    Variant("one further sweep", {"sweep.resweeps": 1}),
    Variant("two further sweeps", {"sweep.resweeps": 2}),
    Variant("last sweep: gradients weigh as in the first", {"sweep.resweep_gradient_weight": 0.5}),
    Variant("last sweep: no gradients", {"sweep.resweep_gradient_weight": 0}),
    Variant("sweeps between truncated as the others", {"sweep.resweep_truncation": 0.1}),
    Variant("nothing hides anything", {"sweep.tolerance": 100}),
    Variant("guessed surfaces hide as all others", {"sweep.ambiguity": 1}),
    Variant("sweep: no gradients", {"sweep.gradient_weight": 0, "sweep.resweep_gradient_weight": 0}),
    Variant("sweep: next to no intensities", {"sweep.gradient_weight": 100, "sweep.resweep_gradient_weight": 100}),
    Variant("sweep: differences as they are, not their roots", {"sweep.softness": 0}),
    Variant("sweep: intensities not truncated", {"sweep.truncation": 2}),
    Variant("sweep: gradients not truncated", {"sweep.gradient_truncation": 2}),
    Variant("sweep: nothing truncated", {"sweep.truncation": 2, "sweep.gradient_truncation": 2}),
    Variant("sweep: half the step", {"sweep.step": 0.225}),
    Variant("sweep: twice the step", {"sweep.step": 0.9}),
    Variant("noise not measured", {"sweep.noise": 0.004}),
    Variant("no semi-global matching", {"semi_global.small_penalty": 0, "semi_global.large_penalty": 0}),
    Variant("steps twice as dear", {"semi_global.small_penalty": 0.0012, "semi_global.large_penalty": 0.0068}),
    Variant("first sweep: steps as dear at edges of the image", {"semi_global.contrast": 2}),
    Variant("further sweeps: steps cheaper at edges, too", {"semi_global.resweep_contrast": 0.03}),
    Variant("costs over 5 pixels", {"semi_global.window": 5}),
    Variant("costs over 9 pixels, as all else", {"semi_global.window": 9}),
    Variant("all else over 3 pixels, as costs", {"prior.window": 3}),
    Variant("all else over 5 pixels", {"prior.window": 5}),
    Variant("means over the window, like or not", {"prior.sigma_color": 2}),
    Variant("pixels compared, not patches", {"prior.patch": 1}),
    Variant("next to no alignment", {"alignment.longest_step": 0.001}),
    Variant("alignment: one step", {"alignment.iterations": 1}),
    Variant("alignment: four steps", {"alignment.iterations": 4}),
    Variant("alignment: no gradients", {"alignment.gradient_weight": 0}),
    Variant("alignment: gradients beside steps, too", {"alignment.contrast": 10}),
    # Stiffness is in units of the curvature over robust²: it stays what it is in absolute terms.
    Variant(
        "alignment: not robust",
        {"alignment.robust": 1.0, "alignment.stiffness": 0.1 / 100**2, "hole_filling.stiffness": 0.02 / 100**2},
    ),
    Variant("alignment: across surfaces", {"alignment.support": 100}),
    Variant("alignment: no stiffness", {"alignment.stiffness": 0}),
    Variant("alignment: nothing put back", {"alignment.reach": 1000}),
    Variant("outlines: only where surfaces hide each other", {"boundaries.step": 1.2}),
    Variant("outlines left as they are", {"boundaries.contrast": 2}),
    Variant("nothing filled", {"hole_filling.max_iterations": 0}),
    Variant("outlines left, nothing filled", {"boundaries.contrast": 2, "hole_filling.max_iterations": 0}),
)


def find(name: str) -> Scene:
    """The scene of that name; BenchmarkError if there is none."""
    for scene in SCENES:
        if scene.name == name:
            return scene
    raise BenchmarkError(f"unknown scene {name!r}; there are {', '.join(scene.name for scene in SCENES)}.")


def run(plan: Plan, say: Say) -> Run:
    """Estimate every scene with every variant; `say` is told what is being estimated.

    The disparity range is the true one and a little more, so that finding it is no part of it. The commit is not
    recorded: the parameters are.
    """
    load, date = machine.load_average(), datetime.now(UTC).isoformat(timespec="seconds")
    records: list[Record] = []
    for scene in plan.scenes:
        try:
            light_fields = _light_fields(scene, plan)
        except LfgpuError as error:
            records.append(Record(KIND, "", "", scene.name, "all variants", failed=str(error)))
            continue
        for variant in plan.variants:
            say(f"{scene.name}: {variant.name}")
            records.append(_measured(scene, variant, light_fields))
    return Run(date, machine.describe(), machine.versions(), None, get_threads(), load, records, [])


def _light_fields(scene: Scene, plan: Plan) -> list[LightField]:
    if scene.made:
        size = (plan.size, plan.size)
        return [scenes.make(scene.made, seed=s, grid=GRID, size=size, noise=scene.noise) for s in range(plan.seeds)]
    folder = plan.data / scene.name
    if not folder.is_dir():
        raise BenchmarkError(f"{folder} is not there; --data names the folder of the real light fields")
    lf = read(folder)
    if lf.reference_truth() is None:
        raise BenchmarkError(f"{folder} has no truth to score by")
    return [lf]


@cache
def _load_kernels(config: Config) -> None:
    """What a process does once, before anything is timed."""
    estimate_depth(scenes.make("boxes", grid=GRID, size=_WARM_UP), config=config, disparity_range=_WARM_UP_RANGE)


def _measured(scene: Scene, variant: Variant, light_fields: Sequence[LightField]) -> Record:
    _load_kernels(variant.config())
    seconds: list[float] = []
    found: list[Metrics] = []
    place = "", ""
    case = f"{scene.name} {'x'.join(map(str, light_fields[0].views.shape[:3]))}"
    if scene.made:
        case += f", seeds 0 to {len(light_fields) - 1}" if len(light_fields) > 1 else ", seed 0"
    for lf in light_fields:
        truth = lf.reference_truth()
        assert truth is not None
        low, high = float(np.nanmin(truth.disparity)), float(np.nanmax(truth.disparity))
        try:
            result = estimate_depth(lf, config=variant.config(), disparity_range=(low - _MARGIN, high + _MARGIN))
        except LfgpuError as error:
            return Record(KIND, *place, case, variant.name, failed=str(error))
        place = result.backend, result.device
        seconds.append(result.timings["total"])
        found.append(evaluate(result.disparity, truth.disparity, mask=truth.mask))
    count = sum(metrics.count for metrics in found)
    return Record(
        KIND,
        *place,
        case,
        variant.name,
        clock.spread(seconds),
        errors={name: mean(getattr(metrics, name) for metrics in found) for name in METRICS},
        compared=f"exact truth, {count} pixels" if scene.made else f"truth of the data set, {count} pixels",
        details={
            "preset": variant.preset,
            "values": dict(variant.values),
            **({} if variant.values else {"config": asdict(variant.config())}),
            "judging": scene.judging,
            "each": [{name: getattr(metrics, name) for name in METRICS} for metrics in found],
        },
    )
