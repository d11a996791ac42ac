"""The refinement of the preset `paper` makes no map worse than what it started from."""

import pytest

from lfgpu import estimate_depth, evaluate, scenes


@pytest.mark.parametrize("name", ["boxes", "planes", "relief", "textureless"])
def test_the_judge_lets_nothing_through_that_makes_the_map_worse(name: str) -> None:
    lf = scenes.make(name, grid=(5, 5), size=(96, 96))
    assert lf.truth is not None
    result = estimate_depth(lf, config="paper", disparity_range=(-1.6, 1.7), device="cpu")
    start, end = (evaluate(result.stages[stage], lf.truth.disparity) for stage in ("propagate", "refine"))
    assert end.mse_100 < start.mse_100
