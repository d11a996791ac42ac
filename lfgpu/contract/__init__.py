"""The contract between the host side and the kernels: what a backend is.

Shapes are written [n, y, x, c]: view, row, column, channel. Disparities are in pixels per view step, larger is nearer;
offsets are (du, dv) in view steps; intensities lie in [0, 1], stored ones after multiplication with `scale`.

A backend is the operations of `KernelSet` on arrays of its own and nothing else. Operations write into arrays that the
caller allocated (names end in `_out`) and run on the device that holds them. What is called again and again is a plan
(`DataTerm`, `PlaneSweep`): it allocates what it needs once, when it is made.

One file is one topic. `streaming` and `recording` are optional: a backend without them has None there.
"""

from lfgpu.contract.arrays import Array, Float32Array, Float64Array, Scalar
from lfgpu.contract.backend import KernelSet
from lfgpu.contract.control import Recording
from lfgpu.contract.device import Device
from lfgpu.contract.images import REDUCTION, SMOOTHING_REACH, WHITE, Normalization, bridged
from lfgpu.contract.learned import (
    CLOSE,
    COMPARED,
    COST_UNIT,
    COSTS,
    DECISIONS,
    FACET_REACH,
    FOLD,
    LEAST_ODDS,
    LEAST_WIDTH,
    PEAK_REACH,
    SECTORS,
    Convolution,
    Rows,
    SectorCosts,
    peak_features,
    sectors_of,
)
from lfgpu.contract.matching import (
    GRADIENT_REACH,
    REACH,
    Alignment,
    Disparities,
    PlaneSweep,
    SweepCost,
    ViewSets,
    ZBuffer,
    sweep_shifts,
)
from lfgpu.contract.measuring import GRAIN_WINDOW
from lfgpu.contract.memory import host_memory, take_host_memory
from lfgpu.contract.prior import NlmWeights, OverPatch, PatchGradients, half_window
from lfgpu.contract.range_search import UNSEEN, Details, SideCosts
from lfgpu.contract.solvers import Lbfgs, Residuals
from lfgpu.contract.streaming import Lease, Maps, Slot, Streaming, Transport
from lfgpu.contract.structure_tensor import LocalEstimate, StructureFilters
from lfgpu.contract.synthesis import DataTerm

__all__ = [
    "CLOSE",
    "COMPARED",
    "COSTS",
    "COST_UNIT",
    "DECISIONS",
    "FACET_REACH",
    "FOLD",
    "GRADIENT_REACH",
    "GRAIN_WINDOW",
    "LEAST_ODDS",
    "LEAST_WIDTH",
    "PEAK_REACH",
    "REACH",
    "REDUCTION",
    "SECTORS",
    "SMOOTHING_REACH",
    "UNSEEN",
    "WHITE",
    "Alignment",
    "Array",
    "Convolution",
    "DataTerm",
    "Details",
    "Device",
    "Disparities",
    "Float32Array",
    "Float64Array",
    "KernelSet",
    "Lbfgs",
    "Lease",
    "LocalEstimate",
    "Maps",
    "NlmWeights",
    "Normalization",
    "OverPatch",
    "PatchGradients",
    "PlaneSweep",
    "Recording",
    "Residuals",
    "Rows",
    "Scalar",
    "SectorCosts",
    "SideCosts",
    "Slot",
    "Streaming",
    "StructureFilters",
    "SweepCost",
    "Transport",
    "ViewSets",
    "ZBuffer",
    "bridged",
    "half_window",
    "host_memory",
    "peak_features",
    "sectors_of",
    "sweep_shifts",
    "take_host_memory",
]
