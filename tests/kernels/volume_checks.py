"""The checks of the operations on cost volumes: how to run them, and how near their outputs must be."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, Values, largest_error, relative_to_terms, size
from programs import WINDOW, Program

from lfgpu.contract import KernelSet

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


# --- a program of them, for devices that can do work as a whole ---


def finding_the_lowest(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """What becomes of a volume with the weights of an image and a reduced volume, and its lowest costs as they were."""
    image, volume = kernels.image(values["image"], device), kernels.field(values["volume"], device)
    reduced, shares = (kernels.field(values[name], device) for name in ("reduced", "shares"))
    shape = values["volume"].shape
    options = {"window": WINDOW, "patch": 3, "sigma_color": 0.5, "sigma_gradient": 0.5, "floor": 1e-3}
    plan = kernels.nlm_weights(values["image"].shape, device, **options)
    weights = kernels.zeros((WINDOW * WINDOW // 2, *shape[1:]), device)
    average, total = (kernels.zeros(shape, device) for _ in range(2))
    disparity, least, edges = (kernels.zeros(shape[1:], device) for _ in range(3))

    def work() -> None:
        plan(image, weights)
        kernels.nlm_average(weights, volume, window=WINDOW, average_out=average)
        kernels.add_reduced(reduced, shares, weight=0.5, volume_inout=average)
        kernels.least_costs(average, least_out=least)
        kernels.edge_weights(image, contrast=0.5, reach=1, weights_out=edges)
        kernels.semi_global(average, image, least, small=0.01, large=0.05, contrast=0.25, sum_out=total)
        kernels.winner_takes_all(volume, first=-1.0, step=0.5, disparity_out=disparity)

    outputs = {"sum": total, "least": least, "edges": edges, "disparity": disparity}
    return Program({"image": image, "volume": volume, "reduced": reduced, "shares": shares}, work, outputs)
