"""The checks of the local estimate: the structure tensor of EPIs, and the more coherent of two estimates."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, Values, largest_error

from lfgpu.contract import StructureFilters


def structure_tensor(desk: Desk, i: SimpleNamespace) -> Outputs:
    filters = StructureFilters(*map(desk.field, i.filters))
    plan = desk.kernels.structure_tensor(i.epis.shape, desk.field(i.offsets), filters, scale=i.scale, floor=i.floor)
    shape = i.epis.shape[1:3]
    plan(desk.image(i.epis[::-1, ::-1]), i.shear + 1.0, desk.out(shape), desk.out(shape))  # leaves no trace
    out = {"disparity": desk.out(shape), "coherence": desk.out(shape)}
    plan(desk.image(i.epis), i.shear, out["disparity"], out["coherence"])
    return out


def keep_more_coherent(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"disparity": desk.held(i.best_disparity), "coherence": desk.held(i.best_coherence)}
    for estimate in i.estimates:
        desk.kernels.keep_more_coherent(
            desk.field(estimate.disparity),
            desk.field(estimate.coherence),
            None if estimate.trusted is None else desk.field(estimate.trusted),
            **i.options,
            best_disparity_out=out["disparity"],
            best_coherence_out=out["coherence"],
        )
    return out


def structure_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The angle between the two directions, not their tangents, as far as the tensor has a direction at all.

    The angle is that of (J_xx - J_uu, 2 J_xu), whose length is √coherence times the trace; its error in float32 is
    relative to the trace. One turn of that vector is half a turn of the direction.
    """
    angle = np.arctan(got["disparity"].astype(np.float64) - i.shear) - np.arctan(want["disparity"] - i.shear)
    direction = np.sqrt(want["coherence"].clip(0)) * np.abs(np.sin(angle))
    return {"disparity": float(direction.max()), "coherence": largest_error(got["coherence"], want["coherence"], 1.0)}


STRUCTURE_TENSOR = Operation(structure_tensor, "epi", structure_errors)
KEEP_MORE_COHERENT = Operation(keep_more_coherent, "coherence")
OPERATIONS = (STRUCTURE_TENSOR, KEEP_MORE_COHERENT)
