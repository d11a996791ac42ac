"""Worth of each ingredient of matching: the preset `accurate` without it, on scenes whose truth is known.

An ingredient is left out by parameters alone, one at a time. `fast` and `paper` stand beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Annotated

import typer

from benchmarks import clock, runs, scoring
from benchmarks.errors import BenchmarkError
from benchmarks.options import DATA, Data, Out, check_out, listed, say
from benchmarks.results import Record, Run
from benchmarks.runs import WHOLE
from lfgpu import LightField, estimate_depth, evaluate, read, scenes
from lfgpu.config import Config
from lfgpu.errors import LfgpuError
from lfgpu.methods import preset
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.metrics import Metrics

KIND = "ablation"
GRID = (9, 9)


@dataclass(frozen=True)
class Variant:
    """A preset with some parameters changed, named by the ingredient that is missing then."""

    name: str
    values: Mapping[str, float | str] = field(default_factory=dict)
    preset: str = WHOLE

    def config(self) -> Config:
        """Return all parameters: the one place where values are applied, be they of users or of tuning."""
        config = preset(self.preset)
        return config.with_tuning(self.values) if isinstance(config, MatchingConfig) else config


@dataclass(frozen=True)
class Scene:
    """A scene of the package, with noise (standard deviation, intensity), or a folder of real light fields."""

    name: str
    made: str = ""
    """Name of the package's scene; none for a folder."""
    noise: float = 0.0
    judging: bool = False
    """True if no parameter was ever chosen by the scene."""


SCENES = (
    *(Scene(name, name) for name in ("boxes", "planes", "bars", "textureless", "relief")),
    Scene("noisy_boxes", "boxes", noise=0.02),
    Scene("cotton"),
    Scene("kitchen", judging=True),
)

# What is not to matter is 2 and not more: differences of intensity are multiplied by up to 5 where there is noise, and
# must stay within the parameters' ranges.
VARIANTS = (
    Variant(WHOLE),
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


def command(
    scene_names: Annotated[
        str, typer.Option("--scenes", metavar="NAME,...", help=f"{', '.join(s.name for s in SCENES)}.")
    ] = "",
    size: Annotated[int, typer.Option(min=48, help="Pixels along each side of the ray-cast scenes.")] = 256,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of each ray-cast scene; errors are means.")] = 1,
    data: Data = DATA,
    out: Out = None,
) -> None:
    """Leave out each ingredient of the preset `accurate`, one at a time, and print what that does to the errors."""
    chosen = tuple(find(name) for name in listed(scene_names)) or SCENES
    check_out(out)
    runs.finish(run(chosen, VARIANTS, size=size, seeds=seeds, data=data), out)


def find(name: str) -> Scene:
    """Return the scene of that name; BenchmarkError if there is none."""
    for scene in SCENES:
        if scene.name == name:
            return scene
    raise BenchmarkError(f"unknown scene {name!r}; there are {', '.join(scene.name for scene in SCENES)}.")


def run(chosen: Sequence[Scene], variants: Sequence[Variant], *, size: int, seeds: int, data: Path) -> Run:
    """Estimate every scene with every variant.

    Scenes of the package have `size` pixels along each side; their errors are means over the seeds 0 to `seeds` - 1.
    `data` is the folder of the real ones. The disparity range is the true one and a little more, so that finding it is
    no part of it. The commit is not recorded: the parameters are.
    """
    records: list[Record] = []
    begun = Run.begun("ablation")
    for scene in chosen:
        try:
            light_fields = _light_fields(scene, size, seeds, data)
        except LfgpuError as error:
            records.append(Record(KIND, "", "", scene.name, "all variants", failed=str(error)))
            continue
        for variant in variants:
            say(f"{scene.name}: {variant.name}")
            records.append(_measured(scene, variant, light_fields))
    return replace(begun, commit=None, records=records)


def _light_fields(scene: Scene, size: int, seeds: int, data: Path) -> list[LightField]:
    if scene.made:
        options = {"grid": GRID, "size": (size, size), "noise": scene.noise}
        return [scenes.make(scene.made, seed=seed, **options) for seed in range(seeds)]  # type: ignore[arg-type]
    folder = data / scene.name
    if not folder.is_dir():
        raise BenchmarkError(f"{folder} is not there; --data names the folder of the real light fields")
    return [read(folder)]


def _measured(scene: Scene, variant: Variant, light_fields: Sequence[LightField]) -> Record:
    config = variant.config()
    scoring.load_kernels(config)
    seconds: list[float] = []
    found: list[Metrics] = []
    place = "", ""
    case = f"{scene.name} {'x'.join(map(str, light_fields[0].views.shape[:3]))}"
    if scene.made:
        case += f", seeds 0 to {len(light_fields) - 1}" if len(light_fields) > 1 else ", seed 0"
    for lf in light_fields:
        try:
            truth = scoring.truth_of(lf)
            result = estimate_depth(lf, config=config, disparity_range=scoring.true_range(lf))
        except LfgpuError as error:
            return Record(KIND, *place, case, variant.name, failed=str(error))
        place = result.backend, result.device
        seconds.append(result.timings["total"])
        found.append(evaluate(result.disparity, truth.disparity, mask=truth.mask))
    count = sum(metrics.count for metrics in found)
    each = [scoring.errors(metrics) for metrics in found]
    return Record(
        KIND,
        *place,
        case,
        variant.name,
        clock.spread(seconds),
        errors={name: mean(one[name] for one in each) for name in scoring.METRICS},
        compared=f"{'exact truth' if scene.made else 'truth of the data set'}, {count} pixels",
        details={
            "preset": variant.preset,
            "values": dict(variant.values),
            **({} if variant.values else {"config": asdict(config)}),
            "judging": scene.judging,
            "each": each,
        },
    )
