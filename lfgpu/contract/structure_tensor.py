"""Structure tensors on epipolar plane images."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from lfgpu.contract.arrays import Array


class StructureFilters(NamedTuple):
    """The separable filters of a structure tensor: along the views (one set per place of the outer window) and across.

    A gradient is the slope filter in its own direction and the value filter in the other one.
    """

    along_value: Any  # [m, u]
    along_slope: Any  # [m, u]
    along_outer: Any  # [m]
    across_value: Any  # [2 r + 1]
    across_slope: Any  # [2 r + 1]
    across_outer: Any  # [2 r' + 1]


class LocalEstimate(Protocol):
    """Structure tensors on the epipolar plane images of one line of views, planned once."""

    def __call__(self, epis: Array, shear: float, disparity_out: Array, coherence_out: Array) -> None:
        """Disparity and coherence (0 to 1) of the reference view, fields [y, x], from `epis` sheared by `shear`.

        `epis` [u, y, x, c] are stored values. With E(u, x) = scale * epis[u, y, x - shear * u] and J the outer-smoothed
        tensor of its gradient (E_x, E_u), disparity = shear + tan(atan2(2 J_xu, J_xx - J_uu) / 2), which is right for
        disparities within about 1 of `shear`, and coherence = ((J_xx - J_uu)^2 + 4 J_xu^2) / (J_xx + J_uu + floor^2)^2.
        """


class StructureTensors(Protocol):
    """Disparities from the slopes of epipolar plane images."""

    def structure_tensor(
        self, shape: Sequence[int], offsets: Array, filters: StructureFilters, *, scale: float, floor: float
    ) -> LocalEstimate:
        """Plan structure tensors on EPIs of `shape` [u, y, x, c] of one line of views along x.

        `offsets` [u] is each view's place relative to the reference; `filters` holds fields; `floor` is the gradient
        (intensity per pixel) that is taken for noise.
        """

    def keep_more_coherent(
        self,
        disparity: Array,
        coherence: Array,
        trusted: Array | None,
        *,
        shear: float,
        reach: float,
        unit: float,
        low: float,
        high: float,
        vertical: bool,
        best_disparity_out: Array,
        best_coherence_out: Array,
    ) -> None:
        """Replace the best estimate so far by another one where that is better.

        It is if |disparity - shear| <= reach, low <= disparity / unit <= high, `trusted` (a field of its shape) is not
        0 or None, and its coherence is larger; the best disparity becomes disparity / unit. If `vertical`, estimate and
        `trusted` are [x, y] where the best are [y, x].
        """
