"""The checks of the splat, the data term, and of what the reference sees of other views."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, adjoint_tolerance, compute, largest_error, relative_to_terms, size

from lfgpu.contract import KernelSet


def splat(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"views": desk.image_out(i.views.shape), "coverage": desk.out(i.views.shape[:3])}
    desk.kernels.splat(
        desk.image(i.image),
        desk.field(i.disparity),
        desk.field(i.offsets),
        softness=i.softness,
        views_out=out["views"],
        coverage_out=out["coverage"],
    )
    return out


def data_term(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The value and the gradient after another light field was loaded and compared, which leaves no trace."""
    plan = desk.kernels.data_term(i.recorded.shape, desk.field(i.offsets), scale=i.scale, softness=i.softness)
    gradient, value = desk.out(i.disparity.shape), desk.number_out()
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1] + 1), desk.image(i.recorded[:, ::-1]), other_mask)
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan(desk.field(i.disparity), gradient, value)
    curvature = desk.out(i.disparity.shape)
    plan.curvature(curvature)
    return {"value": desk.kernels.number(value), "gradient": gradient, "curvature": curvature}


def seen_by_reference(desk: Desk, i: SimpleNamespace) -> Outputs:
    known, valid = desk.field(i.known), desk.field(i.valid)
    masks = {"anything": (None, None), "known": (known, None), "valid": (None, valid), "both": (known, valid)}
    out = {name: desk.out(i.valid.shape) for name in masks}
    disparity, offsets = desk.field(i.disparity), desk.field(i.offsets)
    for name, given in masks.items():
        desk.kernels.seen_by_reference(disparity, offsets, *given, seen_out=out[name])
    return out


SPLAT = Operation(splat, "splat")
DATA_TERM = Operation(data_term, "splat", relative_to_terms(gradient=lambda i: size(i.image, i.offsets)))
SEEN_BY_REFERENCE = Operation(seen_by_reference, "seen")
OPERATIONS = (SPLAT, DATA_TERM, SEEN_BY_REFERENCE)


def check_masked_pixels_do_not_count(
    kernels: KernelSet, device: str, i: SimpleNamespace, operation: Operation = DATA_TERM
) -> None:
    """What is recorded where `valid` is 0 changes neither value nor gradient; all valid is the same as no mask."""
    hidden = i.valid == 0
    before = compute(kernels, device, operation, i)
    recorded = i.recorded.copy()
    recorded[hidden] = 1e4 if recorded.dtype.kind == "f" else np.iinfo(recorded.dtype).max - recorded[hidden]
    after = compute(kernels, device, operation, SimpleNamespace(**{**vars(i), "recorded": recorded}))
    all_valid, no_mask = (
        compute(kernels, device, operation, SimpleNamespace(**{**vars(i), "valid": valid}))
        for valid in (np.ones_like(i.valid), None)
    )
    tolerance = adjoint_tolerance(kernels)
    for name in before:
        assert largest_error(after[name], before[name]) <= tolerance, f"masked pixels change the {name}"
        assert largest_error(all_valid[name], no_mask[name]) <= tolerance, f"a mask of ones changes the {name}"


def check_masked_view_is_a_missing_view(
    kernels: KernelSet, device: str, i: SimpleNamespace, operation: Operation = DATA_TERM
) -> None:
    """A view without a valid pixel gives value and gradient of the light field without that view."""
    valid = np.ones(i.recorded.shape[:3], np.float32)
    valid[0] = 0
    masked = SimpleNamespace(**{**vars(i), "valid": valid})
    missing = SimpleNamespace(**{**vars(i), "recorded": i.recorded[1:], "offsets": i.offsets[1:], "valid": None})
    got, want = (compute(kernels, device, operation, inputs) for inputs in (masked, missing))
    for name in ("value", "gradient"):
        assert largest_error(got[name], want[name]) <= adjoint_tolerance(kernels), f"a masked view changes the {name}"


def check_nothing_valid_is_nothing_at_all(
    kernels: KernelSet, device: str, i: SimpleNamespace, operation: Operation = DATA_TERM
) -> None:
    """Where no recorded pixel is valid, there is nothing to differ from: value and gradient are 0."""
    hidden = SimpleNamespace(**{**vars(i), "valid": np.zeros_like(i.valid)})
    outputs = compute(kernels, device, operation, hidden)
    for name in ("value", "gradient"):
        assert not outputs[name].any(), f"without a valid pixel the {name} is not 0"
