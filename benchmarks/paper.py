"""The experiments of Sajjadi et al. 2016, and differences of every backend's kernels from the printed equations.

The experiments are raw captures of Lytro's, scenes of both HCI sets, and the time at 7 x 7 views of 375 x 375 pixels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import median_filter

from benchmarks import clock, results
from benchmarks.options import DATA, Data, Out, Presets, check_known, check_out, listed, say
from benchmarks.results import Record, Run, Skipped
from benchmarks.tables import NONE, Table
from lfgpu import LightField, estimate_depth, evaluate, read, scenes
from lfgpu._backends import list_backends, load
from lfgpu.config import Config
from lfgpu.errors import LfgpuError
from lfgpu.io.atomic import atomic_write
from lfgpu.methods import preset as named
from tests import printed

KIND, FORMS = "paper", "forms"
FIRST_PART = "first part"
_FIRST_PART: dict[str, float | str] = {
    "refinement.smooths": "map",
    "refinement.smoothness": 0.01,
    "refinement.tolerance": 2.25e-4,
    "refinement.max_iterations": 100,
}
"""Another reading of `paper-exact`: R(m) is the first part of equation 1 alone. A larger λ levels the map."""

_SPECKLE = 0.1  # pixels per view step from the median of 5 x 5: a speck
_COLOURS = 128  # of a picture
_WIDTH = 170  # pixels of a picture of a map
_OLD_HCI = ("buddha", "buddha2", "horses", "medieval", "monasRoom", "papillon", "stillLife")
_WHOLE = "-9x9x768x768"  # after the name of a whole scene of the old HCI set


@dataclass(frozen=True)
class Experiment:
    """A light field of the paper, or one like it."""

    name: str
    what: str
    load: Callable[[Path], LightField]
    unit: float = 1.0
    """View steps of the original light field in one of this: errors are divided by it."""


def _raw(number: int) -> Callable[[Path], LightField]:
    return lambda data: read(data / f"tao2013_IMG_{number}" / f"IMG_{number}.jpg")


def _folder(name: str, data: Path) -> LightField:
    return read(data / name)


EXPERIMENTS = (
    Experiment("IMG_1", "Lytro, first generation, raw", _raw(1)),
    Experiment("IMG_4", "Lytro, first generation, raw", _raw(4)),
    *(
        Experiment(name + _WHOLE, "old HCI set, whole; $LFGPU_DATA/NAME holds lf.h5", partial(_folder, name))
        for name in _OLD_HCI
    ),
    Experiment("cotton", "HCI 4D benchmark", partial(_folder, "cotton")),
    Experiment("kitchen", "HCI 4D benchmark, a star of views", partial(_folder, "kitchen")),
    Experiment("stillLife", "old HCI set, every fourth view", lambda data: read(data / "stillLife_3x3"), unit=4.0),
    Experiment(
        "boxes-7x7x375x375",
        "the size that the paper's 270 s on 8 cores are of",
        lambda _: scenes.make("boxes", grid=(7, 7), size=(375, 375)),
    ),
)


def command(
    names: Annotated[str, typer.Option("--experiments", metavar="NAME,...", help="Default: all.")] = "",
    presets: Presets = f"{FIRST_PART},paper-exact,paper,accurate",
    data: Data = DATA,
    pictures: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder of the pictures: docs/paper.")] = None,
    out: Out = None,
) -> None:
    """Repeat the paper's experiments, and compare the kernels with its printed equations."""
    known = tuple(sorted(experiment.name for experiment in EXPERIMENTS))
    check_known(listed(names), "experiment", known)
    check_out(out)
    found = run(data, listed(names) or known, pictures, listed(presets))
    if out is not None:
        results.save(found, out)
    for table in (forms(found), experiments(found)):
        table.show()


def run(data: Path, names: Sequence[str], pictures: Path | None, presets: Sequence[str]) -> Run:
    """Run the experiments whose light fields lie in `data`; the others are skipped, with the reason.

    `pictures` is the folder that gets a picture for each, or None.
    """
    begun, records, skipped = Run.begun("paper"), list[Record](), []
    for backend in list_backends():
        say(f"printed equations: {backend}")
        try:
            found = printed.errors(load(backend), "cpu")
        except LfgpuError as error:
            skipped.append(Skipped(backend, "cpu", str(error)))
            continue
        records += [Record(FORMS, backend, "cpu", "", name, errors={"relative": e}) for name, e in found.items()]
    for experiment in (experiment for experiment in EXPERIMENTS if experiment.name in names):
        try:
            lf = experiment.load(data)
        except LfgpuError as error:
            say(f"{experiment.name}: skipped: {error}")
            continue
        records += _measured(experiment, lf, presets, pictures)
    return replace(begun, records=records, skipped=skipped)


def _measured(experiment: Experiment, lf: LightField, presets: Sequence[str], pictures: Path | None) -> list[Record]:
    truth, records, maps = lf.reference_truth(), [], {}
    for preset in presets:
        say(f"{experiment.name}: {preset}")
        begin = time.perf_counter()
        try:
            result = estimate_depth(lf, config=_named(preset))
        except LfgpuError as error:
            records.append(Record(KIND, "", "", experiment.name, preset, failed=str(error)))
            continue
        seconds, errors = time.perf_counter() - begin, {}
        for stage, values in result.disparity_stages.items():
            errors[f"speckle {stage}"] = speckle(values)
            if truth is not None:
                found = evaluate(values, truth.disparity, mask=truth.mask)
                errors[f"rmse {stage}"] = found.rmse / experiment.unit
                errors[f"badpix {stage}"] = found.badpix_07
        maps[preset] = result.disparity
        if preset == "paper":
            maps = {"local": result.stages["local"], "propagated": result.stages["propagate"], **maps}
        record = Record(
            KIND,
            result.backend,
            result.device,
            experiment.name,
            preset,
            clock.spread([seconds]),
            errors=errors,
            details={"what": experiment.what, "range": list(result.disparity_range)},
        )
        records.append(record)
    if pictures is not None and maps:
        _draw(lf, maps, pictures / f"{experiment.name}.png")
    return records


def _named(preset: str) -> Config:
    return named("paper-exact").with_values(_FIRST_PART) if preset == FIRST_PART else named(preset)


def speckle(disparity: NDArray[np.floating]) -> float:
    """Compute the percentage of known pixels that are more than 0.1 px from the median of the 5 x 5 around them."""
    known = np.isfinite(disparity)
    filled = np.where(known, disparity, np.nanmedian(disparity) if known.any() else 0.0)
    apart = np.abs(filled - median_filter(filled, 5)) > _SPECKLE
    return float(100 * apart[known].mean()) if known.any() else float("nan")


def _draw(lf: LightField, maps: dict[str, NDArray[np.float32]], path: Path) -> None:
    """Draw the reference view and the maps side by side, on one scale."""
    low, high = np.nanquantile(maps["paper"], (0.01, 0.99))
    height, width = lf.size
    figure = Figure(figsize=((len(maps) + 1) * _WIDTH / 100, (_WIDTH * height / width + 18) / 100), dpi=100)
    axes = figure.subplots(1, len(maps) + 1)
    image = lf.image(lf.reference_index)
    axes[0].imshow(image if image.shape[2] == 3 else image[..., 0], cmap="gray")
    for place, (title, values) in zip(axes[1:], maps.items(), strict=True):
        place.imshow(values, cmap="viridis", vmin=low, vmax=high)
        place.set_title(title, fontsize=7, pad=2)
    axes[0].set_title("reference view", fontsize=7, pad=2)
    for place in axes:
        place.set_axis_off()
    figure.subplots_adjust(0, 0, 1, 0.88, 0.02, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = BytesIO()
    figure.savefig(drawn, format="png")
    with atomic_write(path) as temporary:
        Image.open(drawn).convert("RGB").quantize(_COLOURS).save(temporary, format="PNG", optimize=True)


def forms(run: Run) -> Table:
    """Make the table of exact forms: each equation, and the error of each backend."""
    found = [r for r in run.records if r.kind == FORMS]
    backends = list(dict.fromkeys(r.backend for r in found))
    errors = {(r.name, r.backend): f"{r.errors['relative']:.1g}" for r in found}
    names = dict.fromkeys(r.name for r in found)
    rows = [(name, *(errors.get((name, b), NONE) for b in backends)) for name in names]
    return Table("", ("printed", *backends), 1, rows)


def experiments(run: Run) -> Table:
    """Make the table of experiments: scene and preset, time, specks, RMSE and BadPix(0.07) of each stage.

    Where all scenes of the old HCI set were there, rows with the means of their RMSE follow: the paper has 0.063.
    """
    rows: list[tuple[str, ...]] = []
    found = [r for r in run.records if r.kind == KIND]
    for r in found:
        if r.failed:
            rows.append((r.case, r.name, NONE, r.failed.replace("|", "/"), NONE, NONE))
        elif r.seconds is not None:
            cells = [
                " → ".join(f"{e:.{digits}f}" for name, e in r.errors.items() if name.startswith(kind)) or NONE
                for kind, digits in (("speckle", 1), ("rmse", 3), ("badpix", 1))
            ]
            rows.append((f"`{r.case}`", f"`{r.name}`", f"{r.seconds.median:.0f} s", *cells))
    for preset in dict.fromkeys(r.name for r in found):
        whole = [r for r in found if r.name == preset and r.case.endswith(_WHOLE) and not r.failed]
        if len(whole) == len(_OLD_HCI):
            last = [[e for name, e in r.errors.items() if name.startswith("rmse")][-1] for r in whole]
            rows.append(("mean of the old HCI set", f"`{preset}`", NONE, NONE, f"{np.mean(last):.3f}", NONE))
    return Table(
        "",
        ("light field", "preset", "time", "specks, %: stages", "RMSE, px: stages", "BadPix(0.07), %: stages"),
        2,
        rows,
    )
