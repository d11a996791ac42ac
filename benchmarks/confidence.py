"""Calibration of the confidence: its weights, and shares of right pixels with weights fitted on other scenes.

The features of each pixel come from the method (`MatchingPlan.features`), the form from the reference's `judge`.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import typer
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize

from benchmarks import machine, scoring
from benchmarks.errors import BenchmarkError
from benchmarks.options import Out, Presets, check_out, listed, save, say
from benchmarks.tables import NONE, Table
from lfgpu import LightField, estimate_depth, read, scenes
from lfgpu._backends import DEFAULT, load, open_device
from lfgpu.data import GroundTruth
from lfgpu.io.atomic import atomic_write
from lfgpu.methods import method_of
from lfgpu.methods.matching import trust
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.judging import FEATURES, kind_of
from lfgpu.methods.matching.plan import MatchingPlan
from lfgpu.metrics import BORDER

RIGHT = 0.07  # pixels per view step: errors up to this are right
EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0)
"""Bounds of the confidences that are counted together."""
LEAST_SHARE = 0.005
"""Share of the pixels of a map: bins that hold fewer are not shown."""
_KINDS = (
    *((1, 0.02, 9, 256), (2, 0.0, 9, 256), (3, 0.0, 5, 128)),
    *((4, 0.005, 5, 128), (5, 0.0, 5, 128), (6, 0.005, 5, 128), (7, 0.0, 5, 128), (8, 0.0, 9, 256)),
)
OWN = tuple((name, *kind) for name in ("boxes", "planes", "bars", "textureless") for kind in _KINDS)
"""Scenes of the package that are always fitted on: name, seed, noise, rows and columns of views, and side in pixels."""
_MOST = 20_000  # pixels of a scene
_LEAST_ERROR = 0.003  # pixels per view step: smaller errors are the truth's own
_OWN_SHARE, _OWN_SPREAD = 0.2, 0.5  # of scenes of the package in the fits of both; errors there are smaller
_BLURS, _SEEDS = (0.0, 2.0, 4.0, 6.0), range(1, 7)  # of noise, pixels and random numbers
_NOISY, _NOISE_SIZE, _NOISE_RANGE = 5, (96, 96), (-4.0, 8.0)  # views in a row, pixels, pixels per view step
_RIDGE = 1e-3
_HEAD = '''"""Weights of the confidence and of the uncertainty of matching.

{written}
They belong to 1, conflict, evidence, bend, relief and bend times relief, see `Judging.run`.
"""

SHARE = {share}
"""Weights of the log odds that a pixel is within 0.07 pixels per view step of the truth, by `judging.kind_of`."""

SPREAD = {spread}
"""Weights of the logarithm of the variance of the disparity, (pixels per view step)², by `judging.kind_of`."""
'''

Vector = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Sample:
    """Some pixels of one map: the features of their confidence, and their error."""

    scene: str
    preset: str
    kind: str
    """The key of its weights: `judging.kind_of` of the preset."""
    features: Mapping[str, Vector]
    """By name, as `MatchingPlan.features`."""
    error: Vector
    """Pixels per view step."""
    span: float
    """Length of the searched range, pixels per view step."""
    own: bool = False
    """True if the sample is of a scene of the package."""

    def judged(self, weights: Weights) -> Judged:
        confidence, variance = (np.empty_like(self.error) for _ in range(2))
        share, spread = weights.share[self.kind], weights.spread[self.kind]
        load("reference").judge(
            [self.features[name] for name in FEATURES],
            span=self.span,
            share=share,
            spread=spread,
            confidence_out=confidence,
            variance_out=variance,
        )
        deviation = np.sqrt(np.minimum(variance, self.span**2 / 12))  # as `MatchingPlan` does
        return Judged(self.scene, self.preset, self.error, confidence, deviation)


@dataclass(frozen=True, eq=False)
class Judged:
    """Some pixels of one map: their error, and the confidence and deviation that are stated."""

    scene: str
    preset: str
    error: Vector
    """Pixels per view step."""
    confidence: Vector
    deviation: Vector
    """Standard deviations, pixels per view step."""


@dataclass(frozen=True)
class Bin:
    """Pixels whose confidence is from one of `EDGES` up to the next; shares are from 0 to 1."""

    low: float
    said: float
    """Mean confidence of the pixels."""
    right: float
    """Share of them that is right."""
    share: float
    """Number of the pixels over that of all."""


@dataclass(frozen=True)
class Row:
    """Confidence and errors of one map, or of all."""

    scene: str
    preset: str
    bins: tuple[Bin, ...]
    """Bins that hold pixels."""
    said_rms: float
    """Root mean square of the stated standard deviations, pixels per view step; `error_rms` is that of the errors."""
    error_rms: float
    within_1: float
    """Share of the errors that are at most one stated standard deviation; the next, two."""
    within_2: float


@dataclass(frozen=True)
class Weights:
    """The content of `lfgpu/methods/matching/trust.py`."""

    share: Mapping[str, tuple[float, ...]]
    spread: Mapping[str, tuple[float, ...]]


NOW = Weights(trust.SHARE, trust.SPREAD)


def command(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Light fields with truth, or folders.")],
    fitted: Annotated[
        bool,
        typer.Option("--fit", help="Fit the weights, also on the package's own scenes, and write them to the method."),
    ] = False,
    presets: Presets = "fast,accurate",
    diagram: Annotated[Path | None, typer.Option(metavar="FILE.png", help="File of the reliability diagram.")] = None,
    out: Out = None,
) -> None:
    """Compare the confidence with the truth; with `--fit`, weights for each scene are those of the others."""
    check_out(diagram, out)
    about = {**machine.about("confidence"), "presets": listed(presets), "fitted": fitted}
    groups: dict[str, list[Judged]]
    if fitted:
        found = _each(folders, listed(presets), _sample)
        all_ = [*found, *own_samples(listed(presets))]
        weights, judged = fit(all_), by_the_others(all_)
        groups = {"fitted on other scenes": judged, "fitted on all": [sample.judged(weights) for sample in found]}
        typer.echo(f"written: {write(weights, all_)}: {weights.share}, {weights.spread}")
    else:
        judged = _each(folders, listed(presets), _stated)
        groups = {"as stated": judged}
    save(out, {**about, "rows": [asdict(row) for row in rows(judged)]})
    for table in tables(rows(judged)):
        table.show()
    if diagram is not None:
        draw(groups, diagram)


def _each(folders: Sequence[Path], presets: Sequence[str], take: Callable[[LightField, str, str], T]) -> list[T]:
    """Take pixels of each light field in folders with each preset."""
    found = scoring.light_fields(folders)
    return [take(read(path), name, preset) for name, path in found.items() for preset in presets]


def own_samples(presets: Sequence[str]) -> list[Sample]:
    """Take pixels of `OWN`, and of noise."""
    found = []
    for name, seed, noise, views, side in OWN:
        lf = scenes.make(name, seed=seed, noise=noise, grid=(views, views), size=(side, side))
        found += [replace(_sample(lf, f"own {name}", preset), own=True) for preset in presets]
    return [*found, *(_of_nothing(blur, seed, preset) for blur in _BLURS for seed in _SEEDS for preset in presets)]


def by_the_others(fitted: Sequence[Sample]) -> list[Judged]:
    """Judge each sample that is not the package's own with weights that were fitted without its scene."""
    found = []
    for scene in dict.fromkeys(sample.scene for sample in fitted if not sample.own):
        say(f"without {scene}")
        weights = fit([sample for sample in fitted if sample.scene != scene])
        found += [sample.judged(weights) for sample in fitted if sample.scene == scene]
    return found


def fit(fitted: Sequence[Sample]) -> Weights:
    """Fit weights by maximum likelihood; kinds that are not among the samples keep theirs."""
    share, spread = dict(NOW.share), dict(NOW.spread)
    for kind in dict.fromkeys(sample.kind for sample in fitted):
        share[kind], spread[kind] = _fit([sample for sample in fitted if sample.kind == kind])
    return Weights(share, spread)


def _fit(fitted: Sequence[Sample]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Fit the weights of right and wrong pixels, and of their errors as Laplace's: a few large ones say little.

    Scenes of the package have a share of `_OWN_SHARE` together, `_OWN_SPREAD` where errors are fitted; each of
    them counts as much as another.
    """
    each, each_spread = (_counts(fitted, own) for own in (_OWN_SHARE, _OWN_SPREAD))
    known = np.concatenate([1 - _unknown(sample) for sample in fitted])
    x = np.concatenate([_inputs(sample) for sample in fitted])
    error = np.concatenate([sample.error for sample in fitted])
    right = np.abs(error) <= RIGHT
    size = np.hypot(error, _LEAST_ERROR)
    middle = each @ x
    scale = np.sqrt(each @ (x - middle) ** 2)
    middle[0], scale[0] = 0.0, 1.0
    z = (x - middle) / scale

    def wrong(w: Vector) -> tuple[float, Vector]:
        share = 1 / (1 + np.exp(-np.clip(z @ w, -30, 30)))
        doubt = 1 - known * share
        slope = np.where(right, share - 1, known * share * (1 - share) / doubt)
        loss = -np.log(np.where(right, known * share, doubt))
        return float(each @ loss + _ridge(w)), (each * slope) @ z + _ridge_slope(w)

    weight = each_spread * known

    def spread(w: Vector) -> tuple[float, Vector]:
        log = z @ w  # of the mean absolute error
        ratio = size * np.exp(-np.clip(log, -50, 50))
        return float(weight @ (log + ratio) + _ridge(w)), (weight * (1 - ratio)) @ z + _ridge_slope(w)

    start = np.zeros(x.shape[1])
    mean = 2 * minimize(spread, start, jac=True).x
    mean[0] += np.log(2)  # the variance is twice the square of the mean absolute error
    return _unscaled(minimize(wrong, start, jac=True).x, middle, scale), _unscaled(mean, middle, scale)


def _counts(fitted: Sequence[Sample], of_own: float) -> Vector:
    """Weigh each pixel; 1 together."""
    count = Counter(sample.own for sample in fitted)
    of_scene = {own: (of_own if own else 1 - of_own) / count[own] for own in count}
    each = np.concatenate([np.full(len(sample.error), of_scene[sample.own] / len(sample.error)) for sample in fitted])
    return np.asarray(each / each.sum())


def write(weights: Weights, fitted: Sequence[Sample]) -> Path:
    """Write the weights where the method takes them from."""
    names = list(dict.fromkeys(sample.scene for sample in fitted))
    path, where = Path(trust.__file__), "`python -m benchmarks confidence --fit`, on"
    lines = textwrap.wrap(f"Written by {where} {', '.join(names)}.", 118)
    share, spread = (str(dict(w)).replace("'", '"') for w in (weights.share, weights.spread))
    with atomic_write(path) as temporary:
        text = _HEAD.format(written="\n".join(lines), share=share, spread=spread)
        temporary.write_text(text, encoding="utf-8")
    return path


def rows(judged: Sequence[Judged]) -> list[Row]:
    """Count the right pixels of each confidence and measure errors: of all maps together, then of each."""
    confidence, deviation, error = (
        np.concatenate(maps)
        for maps in zip(*((one.confidence, one.deviation, one.error) for one in judged), strict=True)
    )
    return [
        _row("all", "all", confidence, deviation, error),
        *(_row(j.scene, j.preset, j.confidence, j.deviation, j.error) for j in judged),
    ]


def _row(scene: str, preset: str, confidence: Vector, deviation: Vector, error: Vector) -> Row:
    said, found = (float(np.sqrt(np.mean(values**2))) for values in (deviation, error))
    within = (float((np.abs(error) <= k * deviation).mean()) for k in (1, 2))
    return Row(scene, preset, _bins(confidence, error), said, found, *within)


def tables(found: Sequence[Row]) -> list[Table]:
    """Make the tables of the confidences and the uncertainties of all rows."""

    def name(row: Row) -> str:
        return ", ".join(dict.fromkeys((row.scene, row.preset)))

    def cell(row: Row, low: float) -> str:
        bins = (b for b in row.bins if b.low == low and b.share >= LEAST_SHARE)
        return next((f"{100 * b.said:.0f} → {100 * b.right:.0f} ({100 * b.share:.0f})" for b in bins), NONE)

    shares: dict[str, Any] = {
        "scene": name,
        **{f"{low:g} to {high:g}": lambda row, low=low: cell(row, low) for low, high in pairwise(EDGES)},
    }
    spreads = {
        "scene": name,
        "said, rms": lambda row: f"{row.said_rms:.3f}",
        "error, rms": lambda row: f"{row.error_rms:.3f}",
        "within 1": lambda row: f"{100 * row.within_1:.0f} %",
        "within 2 deviations": lambda row: f"{100 * row.within_2:.0f} %",
    }
    title = "Percent said to be right → percent right (percent of the pixels)"
    return [
        Table.of(title, 1, found, shares),
        Table.of("Uncertainty, pixels per view step", 1, found, spreads),
    ]


def by_confidence(found: Sequence[Mapping[str, Any]]) -> Table:
    """Make the table of the shares that are right by confidence, from the rows of a file: on all maps, and at worst."""
    columns = ("confidence", "share of pixels", "stated", "right", "right on the worst map")
    whole, *maps = found
    cells = []
    for low, high in pairwise(EDGES):
        together, *each = (_shown_bin(row, low) for row in (whole, *maps))
        if together is not None:
            there = [(one["right"], row) for one, row in zip(each, maps, strict=True) if one is not None]
            right, worst = min(there, key=lambda one: one[0])
            shares = (f"{100 * together[name]:.0f} %" for name in ("share", "said", "right"))
            on_worst = f"{100 * right:.0f} % (`{worst['scene']}`, `{worst['preset']}`)"
            cells.append((f"{low:g} to {high:g}", *shares, on_worst))
    return Table("", columns, 1, cells[::-1])


def _shown_bin(row: Mapping[str, Any], low: float) -> Mapping[str, float] | None:
    """Return the bin of a row that begins there, if it holds enough pixels to be shown."""
    return next((b for b in row["bins"] if b["low"] == low and b["share"] >= LEAST_SHARE), None)


def draw(groups: Mapping[str, Sequence[Judged]], out: Path) -> None:
    """Draw the reliability diagram of groups of maps as a PNG: share right over share said."""
    figure = Figure((5.5, 4.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot((0, 1), (0, 1), color="0.6", linewidth=1)
    axes.fill_between((0, 1), (-0.05, 0.95), (0.05, 1.05), color="0.92", label="within 5 points")
    for name, group in groups.items():
        confidence = np.concatenate([judged.confidence for judged in group])
        error = np.concatenate([judged.error for judged in group])
        points = [(b.said, b.right) for b in _bins(confidence, error) if b.share >= LEAST_SHARE]
        axes.plot(*zip(*points, strict=True), "o-", markersize=4, label=f"{name} ({len(group)} maps)")
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="confidence", ylabel=f"share of pixels within {RIGHT} px of the truth")
    axes.legend(fontsize=8)
    with atomic_write(out) as temporary:
        figure.savefig(temporary, format="png")


def _stated(lf: LightField, scene: str, preset: str) -> Judged:
    """Take pixels of an estimate, with the confidence and the uncertainty of its result."""
    say(f"{scene}, {preset}")
    result = estimate_depth(lf, config=method_of(preset).config, check_cameras=False)
    if result.uncertainty is None:
        raise BenchmarkError(f"the confidence of the preset {preset!r} is no probability; take another one.")
    error, scored = _errors(lf, result.disparity)
    stated = (map_.ravel()[scored].astype(np.float64) for map_ in (result.confidence, result.uncertainty))
    return Judged(scene, preset, error, *stated)


def _errors(lf: LightField, disparity: NDArray[Any]) -> tuple[Vector, NDArray[np.intp]]:
    """Compare a map with the truth: the errors of some pixels, and their places in the flat map."""
    truth, inside = scoring.truth_of(lf), np.s_[BORDER:-BORDER, BORDER:-BORDER]
    error = np.full(lf.size, np.nan)
    error[inside] = (disparity - truth.disparity)[inside]
    if truth.mask is not None:
        error[~truth.mask] = np.nan
    scored = np.flatnonzero(np.isfinite(error))
    if len(scored) > _MOST:
        scored = np.random.default_rng(0).choice(scored, _MOST, replace=False)
    return error.ravel()[scored], scored


def _sample(lf: LightField, scene: str, preset: str, bounds: tuple[float, float] | None = None) -> Sample:
    say(f"{scene}, {preset}")
    place = open_device(DEFAULT)
    method = method_of(preset)
    if not isinstance(method.config, MatchingConfig):
        raise BenchmarkError(f"the preset {preset!r} has no calibrated confidence; take accurate or fast.")
    measured = method.measure(lf, place) if bounds is None else method.measured(lf, bounds, place)
    plan = method.plan(lf.layout, measured, place)
    assert isinstance(plan, MatchingPlan)  # whose configuration it is
    views = place.image(lf.views)
    for work in plan.stages(views).values():
        work(None)
    error, scored = _errors(lf, place.kernels.numpy(plan.disparity))
    features = {feature: map_.ravel()[scored].astype(np.float64) for feature, map_ in plan.features().items()}
    low, high = measured.disparity_range
    return Sample(scene, preset, kind_of(method.config.sweep.resweeps), features, error, high - low)


def _of_nothing(blur: float, seed: int, preset: str) -> Sample:
    """Take pixels of views of blurred noise that have nothing in common: no disparity is right."""
    random = np.random.default_rng(seed).normal(size=(_NOISY, *_NOISE_SIZE, 3))
    noise = gaussian_filter(random, (0, blur, blur, 0))
    views = np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
    low, high = _NOISE_RANGE
    # A truth so far away that all errors are about those of a guess.
    truth = GroundTruth(np.full(_NOISE_SIZE, high + (high - low) / 2, np.float32), position=(0.0, 0.0))
    lf = LightField(views, np.stack([np.arange(_NOISY) - _NOISY // 2, np.zeros(_NOISY)], axis=1), truth=truth)
    return replace(_sample(lf, "own noise", preset, _NOISE_RANGE), own=True)


def _inputs(sample: Sample) -> Vector:
    """Stack the inputs of the weights, [p, 6]."""
    conflict, evidence, bend, relief = (sample.features[name] for name in ("conflict", "evidence", "bend", "relief"))
    return np.stack([np.ones_like(conflict), conflict, evidence, bend, relief, bend * relief], axis=1)


def _unknown(sample: Sample) -> Vector:
    """Return the probability that nothing is known, [p], which no weights change."""
    sure = Weights({sample.kind: (50.0, 0, 0, 0, 0, 0)}, {sample.kind: (0.0, 0, 0, 0, 0, 0)})
    return 1 - sample.judged(sure).confidence


def _bins(confidence: Vector, error: Vector) -> tuple[Bin, ...]:
    found = []
    for low, high in pairwise(EDGES):
        some = (confidence >= low) & ((confidence < high) | (high == 1))
        if some.any():
            right = np.abs(error[some]) <= RIGHT
            found.append(Bin(low, float(confidence[some].mean()), float(right.mean()), float(some.mean())))
    return tuple(found)


def _ridge(w: Vector) -> float:
    return float(_RIDGE * (w[1:] ** 2).sum())


def _ridge_slope(w: Vector) -> Vector:
    return 2 * _RIDGE * np.append(0, w[1:])


def _unscaled(w: Vector, middle: Vector, scale: Vector) -> tuple[float, ...]:
    weights = w / scale
    weights[0] -= float((weights * middle)[1:].sum())
    return tuple(round(float(weight), 3) for weight in weights)
