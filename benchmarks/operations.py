"""The operations, as data: which arrays each reads and writes, and how it is called through the kernel contract."""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np

from benchmarks.cases import CHANNELS
from benchmarks.errors import BenchmarkError
from benchmarks.inputs import BYTE, CONFIG, INPUTS, LARGEST_DISPARITY, MATCHING
from benchmarks.operation import PAIRS, Desk, Operation, Slot, Work
from lfgpu.contract import Float64Array, PlaneSweep, StructureFilters
from lfgpu.data.layout import farthest
from lfgpu.methods.matching import trust
from lfgpu.methods.matching.sweep import labels, view_sets
from lfgpu.methods.structure_tensor import structure_filters

_FLOOR = 1e-3  # of what is divided by: there is no division by 0
_JUDGED = 4  # pixels
_UNIT = 0.004  # intensity: the noise in whose units costs are
_RIDGE = 0.5  # pixels squared
_EDGE = 0.3  # pixels per view step: larger differences are depth edges
_DEVIATION = 0.02  # intensity: pixels that differ by this are alike


def find(name: str) -> Operation:
    """The operation of that name; BenchmarkError if there is none."""
    for operation in OPERATIONS:
        if operation.name == name:
            return operation
    raise BenchmarkError(f"unknown operation {name!r}; there are {', '.join(o.name for o in OPERATIONS)}.")


# --- how each is called ---


def _normalization(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    r = CONFIG.refinement
    normalize = k.normalization(on.shapes["views"], on.device, scale=BYTE, sigma=r.detail_scale, floor=r.contrast_floor)
    return Work(lambda: normalize(a["views"], None, a["detail"]))


def _smooth_views(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(
        lambda: k.smooth_views(a["views"], None, scale=BYTE, deviation=_DEVIATION, views_out=a["smoothed_views"])
    )


def _reduce_views(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.reduce_views(a["views"], None, scale=BYTE, views_out=a["reduced_views"], valid_out=None))


def _seen_by_reference(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.seen_by_reference(a["disparity"], a["offsets"], None, None, seen_out=a["seen"]))


def _data_term(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    term = k.data_term(on.shapes["recorded"], a["offsets"], scale=1.0, softness=CONFIG.refinement.softness)
    term.load(a["image"], a["recorded"], a["valid"])
    return Work(lambda: term(a["disparity"], a["gradient"], a["value"]))


def _splat(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(
        lambda: k.splat(
            a["image"],
            a["disparity"],
            a["offsets"],
            softness=CONFIG.refinement.softness,
            views_out=a["predicted"],
            coverage_out=a["coverage"],
        )
    )


def _splat_vjp(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(
        lambda: k.splat_vjp(
            a["image"],
            a["disparity"],
            a["residual"],
            a["offsets"],
            softness=CONFIG.refinement.softness,
            gradient_out=a["gradient"],
        )
    )


def _splat_transpose(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    softness = CONFIG.refinement.softness
    return Work(
        lambda: k.splat_transpose(
            a["residual"], a["disparity"], a["offsets"], softness=softness, image_out=a["image_out"]
        )
    )


def _nlm_weights(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    prior = CONFIG.prior
    weigh = k.nlm_weights(
        on.shapes["image"],
        on.device,
        window=prior.window,
        patch=prior.patch,
        sigma_color=prior.sigma_color,
        sigma_gradient=prior.sigma_gradient,
        floor=prior.floor,
    )
    return Work(lambda: weigh(a["image"], a["weights_out"]))


def _nlm_laplacian(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    window = CONFIG.prior.window
    return Work(lambda: k.nlm_laplacian(a["weights"], a["disparity"], window=window, laplacian_out=a["laplacian"]))


def _nlm_neighbors(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    window = CONFIG.prior.window
    return Work(lambda: k.nlm_neighbors(a["weights"], a["disparity"], window=window, sums_out=a["sums"]))


def _structure_tensor(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    filters = structure_filters(np.asarray(k.numpy(a["line_offsets"]), np.float64), CONFIG.local)
    placed = StructureFilters(*(k.field(f, on.device) for f in filters))
    tensor = k.structure_tensor(
        on.shapes["epis"], a["line_offsets"], placed, scale=BYTE, floor=CONFIG.local.gradient_floor
    )
    return Work(lambda: tensor(a["epis"], 1.0, a["disparity_out"], a["coherence"]))


def _dot(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.dot(a["disparity"], a["other_values"], a["product"]))


def _axpby(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.axpby(0.75, a["disparity"], -0.5, a["other_values"], a["combined"]))


def _lbfgs_learn(on: Desk) -> Work:
    """What an accepted iteration asks of a full memory: `learn` of the trial, and `propose` of the next one.

    Two points are x and trial in turns, so that each call has a pair to keep. `judge`, which looks at a few numbers, is
    left out: its trace has an end.
    """
    k, a = on.kernels, on.arrays
    memory = k.lbfgs(
        on.shapes["x"],
        on.device,
        memory=PAIRS,
        low=-LARGEST_DISPARITY,
        high=LARGEST_DISPARITY,
        first_step=0.02,
        tolerance=0.0,
        patience=5,
        most=1,
    )
    x, gradient = a["x"], a["x_gradient"]
    first, first_gradient = (k.field(k.numpy(array), on.device) for array in (x, gradient))
    ends = ((a["trial"], a["trial_gradient"]), (first, first_gradient))
    turns = cycle(ends)
    zero, value, much_less = (k.scalar(number, on.device) for number in (0.0, 0.0, -1e30))

    def learn() -> None:
        memory.learn(x, gradient, *next(turns))
        memory.propose(x, a["proposed"])

    def begin() -> None:
        nonlocal turns
        turns = cycle(ends)
        k.copy(first, x)
        k.copy(first_gradient, gradient)
        k.copy(zero, value)
        memory.begin(x, gradient, value)
        memory.judge(value, much_less)  # an accepted trial stays accepted until the next one is judged
        for _ in range(PAIRS):
            learn()

    return Work(learn, begin)


def _planned_sweep(on: Desk) -> PlaneSweep:
    """A sweep over the views that lie ready, which has seen them."""
    k, a, config = on.kernels, on.arrays, MATCHING.sweep
    places = _host_offsets(on)
    first, step, count = labels((-LARGEST_DISPARITY, LARGEST_DISPARITY), places, config)
    sweep = k.plane_sweep(
        on.shapes["views"],
        a["offsets"],
        k.field(view_sets(places, config.view_set_angle), on.device),
        first=first,
        step=step,
        count=count,
        scale=BYTE,
        truncation=config.truncation,
        gradient_weight=config.gradient_weight,
        gradient_truncation=config.gradient_truncation,
        softness=config.softness * _UNIT,
        preference=config.view_set_penalty,
        tolerance=config.tolerance / farthest(places),
        least=max(1, math.ceil(config.min_share * (len(places) - 1))),
    )
    sweep.load(a["image"], a["views"], None)
    return sweep


def _sweep_by_view_sets(on: Desk) -> Work:
    sweep, volume = _planned_sweep(on), on.arrays["volume_out"]
    return Work(lambda: sweep.by_view_sets(volume))


def _sweep_by_visibility(on: Desk) -> Work:
    sweep, a = _planned_sweep(on), on.arrays
    return Work(lambda: sweep.by_visibility(a["nearest"], a["volume_out"]))


def _nlm_average(on: Desk) -> Work:
    k, a, window = on.kernels, on.arrays, MATCHING.semi_global.window
    return Work(lambda: k.nlm_average(a["near_weights"], a["volume"], window=window, average_out=a["average"]))


def _semi_global(on: Desk) -> Work:
    k, a, config = on.kernels, on.arrays, MATCHING.semi_global
    return Work(
        lambda: k.semi_global(
            a["volume"],
            a["image"],
            a["other_values"],
            small=config.small_penalty,
            large=config.large_penalty,
            contrast=config.contrast,
            sum_out=a["sum"],
        )
    )


def _add_reduced(on: Desk) -> Work:
    """What is added stays: the volume of the first call is kept to begin with again."""
    k, a, weight = on.kernels, on.arrays, MATCHING.sweep.reduced_weight
    first = k.field(k.numpy(a["volume"]), on.device)
    return Work(
        lambda: k.add_reduced(a["reduced_volume"], a["shares"], weight=weight, volume_inout=a["volume"]),
        lambda: k.copy(first, a["volume"]),
    )


def _edge_weights(on: Desk) -> Work:
    k, a, contrast = on.kernels, on.arrays, MATCHING.sweep.reduced_contrast
    return Work(lambda: k.edge_weights(a["image"], contrast=contrast, reach=1, weights_out=a["weights_out"]))


def _row(on: Desk) -> dict[str, float]:
    """First and distance of the disparities of the volume."""
    return {"first": -LARGEST_DISPARITY, "step": 2 * LARGEST_DISPARITY / (on.shapes["volume"][0] - 1)}


def _least_costs(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.least_costs(a["volume"], least_out=a["least"]))


def _evidence(on: Desk) -> Work:
    k, a, step = on.kernels, on.arrays, _row(on)["step"]
    outputs = {"conflict_out": a["conflict"], "evidence_out": a["evidence"], "cost_out": a["cost"]}
    return Work(lambda: k.evidence(a["volume"], a["path_costs"], step=step, unit=_UNIT, **outputs))


def _line_mean(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.line_mean(a["other_values"], axis=0, reach=_JUDGED, means_out=a["means"]))


def _unevenness(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(lambda: k.unevenness(a["layers"], bend_out=a["bend"], relief_out=a["relief"]))


def _judge(on: Desk) -> Work:
    k, a, v = on.kernels, on.arrays, on.arrays["other_values"]
    share, spread = trust.SHARE["again"], trust.SPREAD["again"]
    outputs = {"confidence_out": a["confidence"], "variance_out": a["variance"]}
    return Work(lambda: k.judge(v, v, v, v, v, v, span=2 * LARGEST_DISPARITY, share=share, spread=spread, **outputs))


def _nlm_plane(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(
        lambda: k.nlm_plane(
            a["surface_weights"],
            a["layers"],
            a["other_values"],
            window=MATCHING.prior.window,
            support=MATCHING.alignment.support,
            ridge=_RIDGE,
            plane_out=a["plane"],
        )
    )


def _winner_takes_all(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    first, step = _row(on).values()
    return Work(lambda: k.winner_takes_all(a["volume"], first=first, step=step, disparity_out=a["disparity_out"]))


def _z_buffer(on: Desk) -> Work:
    """The one that the alignment asks for: what comes within a pixel."""
    k, a = on.kernels, on.arrays
    buffer = k.z_buffer((*on.shapes["nearest_out"], CHANNELS), a["offsets"], reach=1)
    return Work(lambda: buffer(a["layers"], a["nearest_out"]))


def _alignment(on: Desk) -> Work:
    k, a, config = on.kernels, on.arrays, MATCHING.alignment
    align = k.alignment(
        on.shapes["views"],
        a["offsets"],
        scale=BYTE,
        gradient_weight=config.gradient_weight,
        contrast=config.contrast,
        robust=config.robust,
        tolerance=MATCHING.sweep.tolerance / farthest(_host_offsets(on)),
    )
    align.load(a["image"], a["views"], None)
    return Work(lambda: align(a["levels"], a["nearest"], a["curvature"], a["slope"]))


def _nlm_ratio(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(
        lambda: k.nlm_ratio(
            a["surface_weights"],
            a["layers"],
            a["x_gradient"],
            a["other_values"],
            window=MATCHING.prior.window,
            support=MATCHING.alignment.support,
            floor=_FLOOR,
            ratio_out=a["ratio"],
        )
    )


def _nlm_on_surface(on: Desk) -> Work:
    k, a = on.kernels, on.arrays
    return Work(
        lambda: k.nlm_on_surface(
            a["surface_weights"],
            a["layers"],
            window=MATCHING.prior.window,
            support=MATCHING.alignment.support,
            weights_out=a["on_surface"],
        )
    )


def _refine_boundaries(on: Desk) -> Work:
    k, a, config = on.kernels, on.arrays, MATCHING.boundaries
    return Work(
        lambda: k.refine_boundaries(
            a["image"],
            a["layers"],
            step=_EDGE,
            contrast=config.contrast,
            share=config.share,
            disparity_out=a["disparity_out"],
        )
    )


def _host_offsets(on: Desk) -> Float64Array:
    return np.asarray(on.kernels.numpy(on.arrays["offsets"]), np.float64)


_MAP, _OFFSETS, _IMAGE = Slot("disparity", "yx"), Slot("offsets", "n2"), Slot("image", "yxc")
_SPLATTED = (_IMAGE, _MAP, _OFFSETS)
_RECORDED = Slot("views", "nyxc", "uint8")
_VIEWS = (_IMAGE, _RECORDED, _OFFSETS)
_NEAREST, _VOLUME, _LAYERS = Slot("nearest", "nyx"), Slot("volume", "lyx"), Slot("layers", "yx")
_SURFACE_WEIGHTS = Slot("surface_weights", "pyx")
_POINT = (Slot("x", "yx"), Slot("x_gradient", "yx"))

OPERATIONS = (
    Operation(
        "normalization",
        (_RECORDED,),
        (Slot("detail", "nyxc", on_gpu="float16"),),
        _normalization,
    ),
    Operation("smooth_views", (_RECORDED,), (Slot("smoothed_views", "nyxc", "uint16"),), _smooth_views),
    Operation("reduce_views", (_RECORDED,), (Slot("reduced_views", "nrsc", "uint16"),), _reduce_views),
    Operation("seen_by_reference", (_MAP, _OFFSETS), (Slot("seen", "nyx"),), _seen_by_reference, mask=True),
    Operation(
        "data_term",
        (*_SPLATTED, Slot("recorded", "nyxc", on_gpu="float16"), Slot("valid", "nyx")),
        (Slot("gradient", "yx"), Slot("value", "", "float64")),
        _data_term,
    ),
    Operation("splat", _SPLATTED, (Slot("predicted", "nyxc"), Slot("coverage", "nyx")), _splat),
    Operation("splat_vjp", (*_SPLATTED, Slot("residual", "nyxc")), (Slot("gradient", "yx"),), _splat_vjp),
    Operation(
        "splat_transpose", (_MAP, _OFFSETS, Slot("residual", "nyxc")), (Slot("image_out", "yxc"),), _splat_transpose
    ),
    Operation("nlm_weights", (_IMAGE,), (Slot("weights_out", "kyx"),), _nlm_weights),
    Operation("nlm_laplacian", (Slot("weights", "kyx"), _MAP), (Slot("laplacian", "yx"),), _nlm_laplacian),
    Operation("nlm_neighbors", (Slot("weights", "kyx"), _MAP), (Slot("sums", "yx"),), _nlm_neighbors),
    Operation(
        "structure_tensor",
        (Slot("epis", "uyxc", "uint8"), Slot("line_offsets", "u")),
        (Slot("disparity_out", "yx"), Slot("coherence", "yx")),
        _structure_tensor,
        trusted=("coherence", CONFIG.local.coherence_threshold),
    ),
    Operation("plane_sweep_by_view_sets", _VIEWS, (Slot("volume_out", "lyx"),), _sweep_by_view_sets),
    Operation("plane_sweep_by_visibility", (*_VIEWS, _NEAREST), (Slot("volume_out", "lyx"),), _sweep_by_visibility),
    Operation("nlm_average", (Slot("near_weights", "wyx"), _VOLUME), (Slot("average", "lyx"),), _nlm_average),
    Operation(
        "semi_global", (_VOLUME, _IMAGE, Slot("other_values", "yx")), (Slot("sum", "lyx"),), _semi_global, local=False
    ),
    Operation("add_reduced", (Slot("reduced_volume", "lrs"), Slot("shares", "rs"), _VOLUME), (_VOLUME,), _add_reduced),
    Operation("edge_weights", (_IMAGE,), (Slot("weights_out", "yx"),), _edge_weights),
    Operation("least_costs", (_VOLUME,), (Slot("least", "yx"),), _least_costs),
    Operation("winner_takes_all", (_VOLUME,), (Slot("disparity_out", "yx"),), _winner_takes_all),
    Operation(
        "evidence",
        (_VOLUME, Slot("path_costs", "lyx")),
        (Slot("conflict", "yx"), Slot("evidence", "yx"), Slot("cost", "yx")),
        _evidence,
    ),
    Operation("line_mean", (Slot("other_values", "yx"),), (Slot("means", "yx"),), _line_mean),
    Operation("unevenness", (_LAYERS,), (Slot("bend", "yx"), Slot("relief", "yx")), _unevenness),
    Operation(
        "judge",
        (Slot("other_values", "yx"),),
        (Slot("confidence", "yx"), Slot("variance", "yx")),
        _judge,
    ),
    Operation("z_buffer", (_LAYERS, _OFFSETS), (Slot("nearest_out", "nyx"),), _z_buffer),
    Operation(
        "alignment",
        (*_VIEWS, Slot("levels", "yx"), _NEAREST),
        (Slot("curvature", "yx"), Slot("slope", "yx")),
        _alignment,
    ),
    Operation(
        "nlm_ratio",
        (_SURFACE_WEIGHTS, _LAYERS, Slot("x_gradient", "yx"), Slot("other_values", "yx")),
        (Slot("ratio", "yx"),),
        _nlm_ratio,
    ),
    Operation(
        "nlm_plane",
        (_SURFACE_WEIGHTS, _LAYERS, Slot("other_values", "yx")),
        (Slot("plane", "yx"),),
        _nlm_plane,
    ),
    Operation("nlm_on_surface", (_SURFACE_WEIGHTS, _LAYERS), (Slot("on_surface", "pyx"),), _nlm_on_surface),
    Operation("refine_boundaries", (_IMAGE, _LAYERS), (Slot("disparity_out", "yx"),), _refine_boundaries),
    Operation(
        "lbfgs_learn",
        (
            *_POINT,
            Slot("trial", "yx"),
            Slot("trial_gradient", "yx"),
            Slot("steps", "myx", inside=True),
            Slot("differences", "myx", inside=True),
        ),
        (
            *_POINT,
            Slot("step", "yx", inside=True),
            Slot("difference", "yx", inside=True),
            Slot("direction", "yx", inside=True),
            Slot("proposed", "yx"),
        ),
        _lbfgs_learn,
        local=False,
    ),
    Operation("dot", (_MAP, Slot("other_values", "yx")), (Slot("product", "", "float64"),), _dot, local=False),
    Operation("axpby", (_MAP, Slot("other_values", "yx")), (Slot("combined", "yx"),), _axpby),
)

assert all(slot.inside or slot.name in INPUTS for operation in OPERATIONS for slot in operation.reads)
