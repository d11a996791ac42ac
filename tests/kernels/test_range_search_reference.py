"""The operations that find the disparity range in the reference against loops."""

import itertools
import math
from dataclasses import replace
from typing import Any

import checks
import numpy as np
import pytest
from range_search_cases import RangeSearchCase, range_search_inputs
from range_search_checks import COSTS, DETAILS, DISTINCT, SHRINK

from lfgpu._backends import load
from lfgpu.contract import UNSEEN

REFERENCE = load("reference")
CASE = RangeSearchCase("any", size=(17, 19), masked=True)
ASKEW = replace(CASE, size=(25, 27), lines=((((-1.0, -0.5), (-2.0, -1.0)), ((1.0, 0.5),)),), count=5)


def run(operation: checks.Operation, case: RangeSearchCase, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
    inputs = range_search_inputs(case, rng)
    return inputs, checks.compute(REFERENCE, "cpu", operation, inputs)


def test_shrink_is_the_mean_of_blocks(rng: np.random.Generator) -> None:
    i, got = run(SHRINK, CASE, rng)
    assert 0 < got["known"].mean() < 1
    for k, y, x in np.ndindex(got["values"].shape):
        rows, columns = (range(i.factor * at, i.factor * (at + 1)) for at in (y, x))
        block = [(row, column) for row in rows for column in columns]
        values = [float(value) for row, column in block for value in i.views[i.chosen[k], row, column]]
        assert got["known"][k, y, x] == all(i.valid[k, row, column] != 0 for row, column in block)
        if got["known"][k, y, x]:
            assert got["values"][k, y, x] == pytest.approx(i.scale * sum(values) / len(values), rel=1e-12)


@pytest.mark.parametrize("factor", [1, 2])
def test_details_are_without_their_mean(factor: int, rng: np.random.Generator) -> None:
    i, got = run(DETAILS, replace(CASE, factor=factor), rng)
    height, width = i.small
    images = i.images[:, : factor * height, : factor * width].astype(np.float64)
    images = sum(images[:, dy::factor, dx::factor] for dy in range(factor) for dx in range(factor)) / factor**2
    for n, y, x in np.ndindex(got["values"].shape):
        around = range(-(i.window // 2), i.window // 2 + 1)
        places = [(min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)) for dy in around for dx in around]
        near = [images[n, row, column] for row, column in places if not math.isnan(images[n, row, column])]
        assert got["known"][n, y, x] != math.isnan(images[n, y, x])
        if got["known"][n, y, x]:
            assert got["values"][n, y, x] == pytest.approx(images[n, y, x] - sum(near) / len(near), abs=1e-12)


@pytest.mark.parametrize("case", [CASE, ASKEW], ids=["cross", "askew"])
def test_costs_are_means_of_differences(case: RangeSearchCase, rng: np.random.Generator) -> None:
    i, got = run(COSTS, case, rng)
    height, width = i.small

    def shown(view: int, x: float, y: float) -> float:
        """The detail of a view at a place, NaN outside."""
        total = 0.0
        for row, column in itertools.product((math.floor(y), math.ceil(y)), (math.floor(x), math.ceil(x))):
            weight = (1 - abs(y - row)) * (1 - abs(x - column))
            inside = 0 <= row < height and 0 <= column < width
            total += weight * float(i.details[view, row, column]) if inside else math.nan
        rows, columns = len({math.floor(y), math.ceil(y)}), len({math.floor(x), math.ceil(x)})
        return total * (rows * columns / 4)  # a place in a row or a column of pixels was counted more than once

    seen = 0
    for m, label, y, x in np.ndindex(len(i.lines), case.count, height, width):
        if (y + 2 * x + label) % 7:
            continue
        disparity, costs = case.first + case.step * label, []
        for side in i.lines[m]:
            terms = []
            for view, dy, dx in itertools.product(side, (-1, 0, 1), (-1, 0, 1)):
                if 0 <= y + dy < height and 0 <= x + dx < width:
                    du, dv = i.offsets[view]
                    there = shown(view, x + dx - disparity * du, y + dy - disparity * dv)
                    terms.append(abs(there - float(i.details[0, y + dy, x + dx])))
            terms = [term for term in terms if not math.isnan(term)]
            costs.append(sum(terms) / len(terms) if len(terms) >= 4.5 * len(side) else UNSEEN)
        seen += min(costs) < UNSEEN
        assert got["volume"][m, label, y, x] == pytest.approx(min(costs), abs=1e-12)
    assert seen > 20


def test_the_distinct_minimum_is_that_of_a_loop(rng: np.random.Generator) -> None:
    i, got = run(DISTINCT, CASE, rng)
    count = CASE.count
    for y, x in np.ndindex(*i.small):
        costs = [float(np.minimum(i.volume[:, label, y, x].astype(np.float64), 1).mean()) for label in range(count)]
        k = costs.index(min(costs))
        others = [cost for label, cost in enumerate(costs) if abs(label - k) > CASE.apart]
        place, least, spread, other, worst = got["found"][:, y, x]
        assert (least, spread) == (costs[k], max(costs) - costs[k])
        assert other == (min(others) - costs[k] if others else UNSEEN)
        if 0 < k < count - 1:
            before, here, next_ = costs[k - 1 : k + 2]
            bend = before - 2 * here + next_
            assert place == pytest.approx(k + ((before - next_) / (2 * bend) if bend > 1e-9 else 0))
            assert worst == i.volume[:, k, y, x].max()
        else:
            assert (place, worst) == (k, UNSEEN)
