"""The operations on cost volumes: cases, their random inputs and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import nlm_checks
import numpy as np
from checks import Desk, Operation, Outputs, Values, largest_error, relative_to_terms, size

from lfgpu.contract import REDUCTION


@dataclass(frozen=True)
class VolumeCase(nlm_checks.NlmCase):
    """A volume of `count` slices with costs in `costs`, and what changes of the disparity cost on a path."""

    count: int = 5
    costs: tuple[float, float] = (0.0, 1.0)
    small: float = 0.125
    large: float = 0.5
    contrast: float = 0.25
    first: float = -1.0
    step: float = 0.375


VOLUME_CASES = (
    VolumeCase("colour"),
    VolumeCase("grey", channels=1),
    VolumeCase("as few slices as there can be", count=3),
    VolumeCase("slices for several threads of a path", size=(7, 9), count=35),
    VolumeCase("many slices", size=(6, 7), count=131, channels=1),
    VolumeCase("very many slices", size=(3, 5), count=300),
    VolumeCase("window of the paper", window=11, size=(17, 19), count=9),
    VolumeCase("one pixel wide", size=(13, 1)),
    VolumeCase("one pixel high", size=(1, 13), channels=1),
    VolumeCase("one pixel", size=(1, 1), channels=1),
    VolumeCase("window wider than image", size=(4, 3), window=11),
    VolumeCase("wide", size=(5, 83), window=7),
    VolumeCase("high", size=(71, 6), window=3, channels=1),
    VolumeCase("costs below 0", costs=(-3.0, -1.0)),
    VolumeCase("costs that outweigh changes", costs=(0.0, 100.0)),
    VolumeCase("changes that outweigh costs", costs=(0.0, 0.01)),
    VolumeCase("image without contrast", contrast=100.0),
    VolumeCase("edges everywhere", contrast=0.01),
    VolumeCase("large changes cost little", large=0.01),
    VolumeCase("changes cost nothing", small=0.0, large=0.0),
    VolumeCase("work for several threads", size=(69, 53), window=7, count=17),
)

REDUCED_CASES = (
    *(case for case in VOLUME_CASES if min(case.size) >= REDUCTION),
    VolumeCase("one reduced pixel", size=(4, 4)),
    VolumeCase("one reduced pixel and what is left over", size=(7, 5)),
    VolumeCase("nothing left over", size=(8, 20)),
    VolumeCase("one row of reduced pixels", size=(6, 29)),
    VolumeCase("one column of reduced pixels", size=(27, 4)),
)
"""Those whose views have a reduced pixel."""

JUDGED = ((-3.5, 2.0), (-2.0, 4.0), (-7.0, 1.0), (-4.6, 1.5), (-1.3, 0.0), (0.0, 2.5))
"""The conflict, evidence, bend and relief that are judged, and the evidence and the cost farther around."""


def volume_inputs(case: VolumeCase, rng: np.random.Generator) -> SimpleNamespace:
    """A random volume, another one of so few different costs that many are least, and the inputs of the weights."""
    i = nlm_checks.nlm_inputs(case, rng)
    shape = (case.count, *case.size)
    i.volume = rng.uniform(*case.costs, shape).astype(np.float32)
    i.alike = (rng.integers(0, 4, shape) / 4).astype(np.float32)
    i.step_costs = {"small": case.small, "large": case.large, "contrast": case.contrast}
    i.penalty_scale = rng.uniform(0.5, 4.0, case.size).astype(np.float32)
    i.row = {"first": case.first, "step": case.step}
    last = case.first + case.step * (case.count - 1)
    i.map = rng.uniform(case.first - 0.5, last + 0.5, case.size).astype(np.float32)
    i.unit = 0.5 * (case.costs[1] - case.costs[0])
    # Some of the best paths cost what the best disparity costs.
    i.path_costs = (8 * i.volume + rng.choice([0.0, 1.0], shape) * i.unit).astype(np.float32)
    i.conflict, i.sure, i.bend, i.relief, i.wide, i.dear = (
        rng.uniform(low, high, case.size).astype(np.float32) for low, high in JUDGED
    )
    i.reduced = rng.uniform(*case.costs, (case.count, *(side // REDUCTION for side in case.size))).astype(np.float32)
    i.shares = rng.uniform(0.2, 1.0, i.reduced.shape[1:]).astype(np.float32)
    i.weight, i.edge_contrast = 0.7, 0.4
    i.span = 3.3
    i.weights_of_judge = {
        "share": (0.5, -1.25, 0.75, -0.5, 0.25, 0.125),
        "spread": (-3.0, 0.5, -0.25, 1.0, -0.75, -0.25),
    }
    return i


ROUNDING = 2.0**-22
"""Of the bend of a parabola, relative to the differences that it is made of."""


def nlm_average(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.volume.shape)
    desk.kernels.nlm_average(desk.field(i.weights), desk.field(i.volume), window=i.window, average_out=out)
    return {"average": out}


def semi_global(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.volume.shape)
    scale = desk.field(i.penalty_scale)
    desk.kernels.semi_global(desk.field(i.volume), desk.image(i.image), scale, **i.step_costs, sum_out=out)
    return {"sum": out}


def add_reduced(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.held(i.volume)
    desk.kernels.add_reduced(desk.field(i.reduced), desk.field(i.shares), weight=i.weight, volume_inout=out)
    return {"volume": out}


def edge_weights(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Beside edges, and farther around."""
    out = {name: desk.out(i.volume.shape[1:]) for name in ("beside", "around")}
    for name, reach in (("beside", 1), ("around", 3)):
        desk.kernels.edge_weights(desk.image(i.image), contrast=i.edge_contrast, reach=reach, weights_out=out[name])
    return out


def least_costs(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.volume.shape[1:])
    desk.kernels.least_costs(desk.field(i.volume), least_out=out)
    return {"least": out}


def winner_takes_all(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Of a random volume, and of one in which many costs are the least."""
    out = {name: desk.out(i.volume.shape[1:]) for name in ("random", "alike")}
    desk.kernels.winner_takes_all(desk.field(i.volume), **i.row, disparity_out=out["random"])
    desk.kernels.winner_takes_all(desk.field(i.alike), **i.row, disparity_out=out["alike"])
    return out


def evidence(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {name: desk.out(i.volume.shape[1:]) for name in ("conflict", "evidence", "cost")}
    desk.kernels.evidence(
        desk.field(i.volume),
        desk.field(i.path_costs),
        step=i.row["step"],
        unit=i.unit,
        conflict_out=out["conflict"],
        evidence_out=out["evidence"],
        cost_out=out["cost"],
    )
    return out


def line_mean(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {name: desk.out(i.map.shape) for name in ("down", "across", "far", "same")}
    for name, axis, reach in (("down", 0, 2), ("across", 1, 3), ("far", 1, 50), ("same", 0, 0)):
        desk.kernels.line_mean(desk.field(i.map), axis=axis, reach=reach, means_out=out[name])
    return out


def unevenness(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Of a map without order, and of a slanted plane."""
    y, x = np.mgrid[: i.map.shape[0], : i.map.shape[1]]
    maps = {"random": i.map, "plane": ((x + 2 * y) / 64).astype(np.float32)}
    out = {f"{name} {what}": desk.out(i.map.shape) for name in maps for what in ("bend", "relief")}
    for name, map_ in maps.items():
        desk.kernels.unevenness(desk.field(map_), bend_out=out[f"{name} bend"], relief_out=out[f"{name} relief"])
    return out


def judge(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {name: desk.out(i.conflict.shape) for name in ("confidence", "variance")}
    desk.kernels.judge(
        [desk.field(values) for values in (i.conflict, i.sure, i.bend, i.relief, i.wide, i.dear)],
        span=i.span,
        **i.weights_of_judge,
        confidence_out=out["confidence"],
        variance_out=out["variance"],
    )
    return out


def bends(volume: Values) -> tuple[Values, Values]:
    """Of each pixel's parabola, [y, x], and the size of what may be lost of it in float32."""
    exact = volume.astype(np.float64)
    k = exact.argmin(0).clip(1, len(exact) - 2)
    before, here, after = (np.take_along_axis(exact, (k + near)[None], 0)[0] for near in (-1, 0, 1))
    return before - 2 * here + after, ROUNDING * (np.abs(before - here) + np.abs(after - here))


def lowest_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the whole row, but where rounding decides whether a parabola bends upwards; which is the least cost
    is beyond doubt, as costs are exact in float32, and in the volume of few costs all is.
    """
    bend, rounding = bends(i.volume)
    decided = np.abs(bend - 1e-9) > rounding
    assert decided.mean() > 0.95, "too much is undecided: the check says little"
    largest = max(abs(i.row["first"]), abs(i.row["first"] + i.row["step"] * len(i.volume)))
    return {
        "random": largest_error(got["random"][decided], want["random"][decided], largest),
        "alike": largest_error(got["alike"], want["alike"], largest),
    }


OPERATIONS = (
    Operation(nlm_average, "volume", relative_to_terms(average=lambda i: size(i.volume))),
    Operation(semi_global, "volume", relative_to_terms(sum=lambda i: size(i.volume))),
    Operation(add_reduced, "reduced", relative_to_terms(volume=lambda i: size(i.volume))),
    Operation(edge_weights, "volume"),
    Operation(least_costs, "volume"),
    Operation(winner_takes_all, "volume", lowest_errors),
    Operation(
        evidence,
        "volume",
        # The logarithm of step times a sum: that of the step, and that of the sum.
        relative_to_terms(conflict=lambda i: size(i.volume) / i.unit, evidence=lambda i: abs(np.log(i.row["step"]))),
    ),
    Operation(line_mean, "volume"),
    Operation(unevenness, "volume"),
    Operation(judge, "volume"),
)
AVERAGE, SEMI_GLOBAL, ADD_REDUCED, EDGES, LEAST, LOWEST, EVIDENCE, LINE_MEAN, UNEVENNESS, JUDGE = OPERATIONS
