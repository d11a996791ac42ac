"""The benchmark's operations: their traffic, inputs that are like those of an estimate, and errors that are noticed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import accuracy, operations
from benchmarks.cases import CASES, Case
from benchmarks.inputs import INPUTS, LARGEST_DISPARITY, sweep_labels
from benchmarks.operation import Operation, size
from benchmarks.operations import OPERATIONS
from benchmarks.prepare import prepare, whole
from lfgpu._backends import load
from lfgpu.contract.matching import Matching, PlaneSweep
from lfgpu.contract.prior import Prior

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[1]
TINY = CASES[0]


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda operation: operation.name)
def test_traffic_is_the_size_of_the_arrays(operation: Operation) -> None:
    kernels = load("warp")
    for device in ("cpu", "cuda:0"):
        arrays = prepare(operation, kernels, "cpu", TINY, whole(TINY), as_on=device).arrays
        slots = (*operation.reads, *operation.writes)
        counted = [kernels.numpy(arrays[s.name]).nbytes for s in slots if s.axes and not s.inside]
        numbers = sum(8 for slot in slots if not slot.axes)
        inside = sum(4 * size(slot, TINY) for slot in slots if slot.inside)
        assert operation.traffic(TINY, device) == sum(counted) + numbers + inside


def test_every_operation_of_matching_and_its_prior_is_measured() -> None:
    """As kernels/README.md promises; a plan of two kinds of work has a row for each."""
    names = [operation.name for operation in OPERATIONS]
    assert len(set(names)) == len(names)
    asked = {name for part in (Matching, Prior) for name in vars(part) if not name.startswith("_")}
    asked.remove("plane_sweep")
    asked |= {f"plane_sweep_{kind}" for kind in vars(PlaneSweep) if kind.startswith("by_")}
    assert {"plane_sweep_by_visibility", "semi_global", "nlm_on_surface"} <= asked
    assert asked | {"smooth_views", "reduce_views"} <= set(names)


def test_traffic_of_matching_counts_labels_views_and_neighbours() -> None:
    """By hand for 3 x 3 views of 48 x 48: 8 labels, 9 views in colour, 4 neighbours of 3 x 3, 40 of 9 x 9.

    A reduced view has a sixteenth of the pixels.
    """
    pixels = 48 * 48
    image, views, offsets, volume, nearest = 12 * pixels, 27 * pixels, 9 * 2 * 4, 32 * pixels, 36 * pixels
    for name, bytes_ in {
        "smooth_views": views + 2 * views,
        "reduce_views": views + 2 * views // 16,
        "add_reduced": 2 * volume + volume // 16 + 4 * pixels // 16,
        "edge_weights": image + 4 * pixels,
        "plane_sweep_by_view_sets": image + views + offsets + volume,
        "plane_sweep_by_visibility": image + views + offsets + nearest + volume,
        "nlm_average": 16 * pixels + 2 * volume,
        "semi_global": 2 * volume + image + 4 * pixels,
        "least_costs": volume + 4 * pixels,
        "evidence": 2 * volume + 12 * pixels,
        "line_mean": 8 * pixels,
        "unevenness": 12 * pixels,
        "judge": 12 * pixels,
        "nlm_plane": 160 * pixels + 12 * pixels,
        "winner_takes_all": volume + 4 * pixels,
        "z_buffer": 4 * pixels + offsets + nearest,
        "alignment": image + views + offsets + 4 * pixels + nearest + 8 * pixels,
        "nlm_ratio": 160 * pixels + 16 * pixels,
        "nlm_on_surface": 320 * pixels + 4 * pixels,
        "refine_boundaries": image + 8 * pixels,
    }.items():
        assert operations.find(name).traffic(TINY, "cpu") == bytes_, name


@pytest.mark.parametrize(
    "name",
    [
        "smooth_views",
        "add_reduced",
        "plane_sweep_by_view_sets",
        "plane_sweep_by_visibility",
        "z_buffer",
        "alignment",
        "refine_boundaries",
    ],
)
def test_inputs_of_matching_have_something_to_find(name: str) -> None:
    reference, operation = load("reference"), operations.find(name)
    done = prepare(operation, reference, "cpu", TINY, whole(TINY))
    done.once()
    if name == "refine_boundaries":
        assert (done.arrays["disparity_out"] != done.arrays["layers"]).mean() > 0.002
    elif name == "z_buffer":
        assert np.abs(done.arrays["nearest_out"] - done.arrays["layers"]).max() > 1
    elif name == "alignment":
        assert (done.arrays["curvature"] > 0).mean() > 0.9
    elif name == "smooth_views":
        moved = np.abs(done.arrays["smoothed_views"] - 257 * done.arrays["views"]) / 65535
        assert 0.003 < np.median(moved) < 0.03
    elif name == "add_reduced":
        before = INPUTS["volume"](TINY)
        assert np.corrcoef(before.ravel(), (done.arrays["volume"] - before).ravel())[0, 1] > 0.9
    else:
        first, step, _ = sweep_labels(TINY)
        found = first + step * np.argmin(done.arrays["volume_out"], axis=0)
        assert np.median(np.abs(found - INPUTS["disparity"](TINY))) < step


def test_views_that_are_compared_have_half_the_bytes_on_a_gpu() -> None:
    samples = 3 * TINY.samples
    for name in ("normalization", "data_term"):
        operation = operations.find(name)
        assert operation.traffic(TINY, "cpu") - operation.traffic(TINY, "cuda:0") == 2 * samples
    assert operations.find("normalization").tolerance("cuda:0") > 2**-11 > operations.find("dot").tolerance("cuda:0")


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda operation: operation.name)
@pytest.mark.parametrize("case", [Case((3, 3), (100, 110)), Case((5, 3), (96, 130))], ids=lambda case: case.name)
def test_a_window_is_what_the_whole_is_there(operation: Operation, case: Case) -> None:
    """The margin suffices: the reference finds itself, whether it sees all or what is around the window."""
    reference = load("reference")
    done = prepare(operation, reference, "cpu", case, whole(case))
    done.once()
    error, compared = accuracy.compare(operation, case, done, reference, "cpu")
    assert error < 1e-12
    assert compared == "64 x 64 of {} x {} pixels, over all views".format(*case.size) or not operation.local


def test_a_wrong_output_is_noticed() -> None:
    reference, operation = load("reference"), operations.find("splat")
    done = prepare(operation, reference, "cpu", TINY, whole(TINY))
    done.once()
    done.arrays["coverage"][0, 24, 24] += 0.5
    assert accuracy.compare(operation, TINY, done, reference, "cpu")[0] > 0.1


def test_a_wrong_number_and_a_wrong_mask_are_noticed() -> None:
    reference = load("reference")
    for name, output, error in (("data_term", "value", 0.5), ("seen_by_reference", "seen", 1 / (9 * 48 * 48))):
        operation = operations.find(name)
        done = prepare(operation, reference, "cpu", TINY, whole(TINY))
        done.once()
        wrong = done.arrays[output].reshape(-1)
        wrong[0] = 1.5 * wrong[0] if output == "value" else 1 - wrong[0]
        assert accuracy.compare(operation, TINY, done, reference, "cpu")[0] == pytest.approx(error)


@pytest.mark.parametrize("name", ["normalization", "data_term"])
def test_the_reference_sees_inputs_as_the_device_stores_them(name: str) -> None:
    """Views in half precision must not look like an error of the operation; an output in it does."""
    kernels, operation = load("warp"), operations.find(name)
    done = prepare(operation, kernels, "cpu", TINY, whole(TINY), as_on="cuda:0")
    done.once()
    error, _ = accuracy.compare(operation, TINY, done, kernels, "cuda:0")
    assert error <= operation.tolerance("cuda:0")
    assert error > 1e-5 if name == "normalization" else error < 1e-5


def test_learning_is_the_same_after_any_number_of_calls() -> None:
    operation, kernels = operations.find("lbfgs_learn"), load("reference")
    done = prepare(operation, kernels, "cpu", TINY, whole(TINY))
    done.once()
    proposed = done.arrays["proposed"].copy()
    assert np.abs(proposed - done.arrays["trial"]).max() > 0.01
    for _ in range(3):
        done.work.call()
    done.once()
    np.testing.assert_array_equal(done.arrays["proposed"], proposed)


def test_what_is_added_is_added_to_the_first_volume() -> None:
    done = prepare(operations.find("add_reduced"), load("reference"), "cpu", TINY, whole(TINY))
    done.once()
    once = done.arrays["volume"].copy()
    assert np.abs(once - INPUTS["volume"](TINY)).max() > 1e-3
    for _ in range(3):
        done.work.call()
    done.once()
    np.testing.assert_array_equal(done.arrays["volume"], once)


def test_inputs_are_like_those_of_the_method() -> None:
    disparity = INPUTS["disparity"](CASES[1])
    assert np.abs(disparity).max() == pytest.approx(LARGEST_DISPARITY)
    assert np.abs(np.diff(disparity, axis=0)).max() < 0.2
    assert INPUTS["recorded"](TINY).shape == (9, 48, 48, 3)
    step = INPUTS["trial"](TINY) - INPUTS["x"](TINY)
    assert np.vdot(step, INPUTS["trial_gradient"](TINY) - INPUTS["x_gradient"](TINY)) > 0
    weights = INPUTS["weights"](TINY)
    assert weights.shape == (60, 48, 48)
    prepared = prepare(operations.find("nlm_weights"), load("reference"), "cpu", TINY, whole(TINY))
    prepared.once()
    np.testing.assert_array_equal(weights > 0, prepared.arrays["weights_out"] > 0)
    assert 0.5 < INPUTS["valid"](TINY).mean() < 1


def test_the_page_on_measuring_has_each_formula_and_each_case() -> None:
    text = (ROOT / "benchmarks" / "measuring.md").read_text(encoding="utf-8")
    assert all(f"\n| `{operation.name}` | {operation.formula} |\n" in text for operation in OPERATIONS)
    assert all(f"`{case.name}`" in text for case in CASES)
