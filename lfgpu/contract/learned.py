"""The learned aggregation: costs by angular sector, convolutions, and a map from what these say of each disparity.

A *volume* is an image [l, y, x, c], stored as float16 or float32, with any number of channels c. In a *folded* image
the FOLD x FOLD pixels of a square are channels of one: pixel (FOLD y + i, FOLD x + j) and channel c of an image are
pixel (y, x) and channel FOLD^2 c + FOLD i + j of the folded one. Beyond its border the image goes on with its border
pixels until the folded one is full.

A volume may hold fewer rows than there are: row y is then row y modulo these, until a later one takes its place.
Operations that write `Rows` of an output read such volumes, and write them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfgpu.contract.arrays import Array, Float32Array, Float64Array, Scalar

SECTORS = 8
"""Directions around the reference view, in which the views lie."""

COSTS = 2 * SECTORS
"""Costs of a pixel and a disparity."""

COST_UNIT = 0.02
"""Difference in intensity from which costs grow like its logarithm."""

FOLD = 2
"""Pixels of an image, each way, in one of a folded image."""

PEAK_REACH = 2
"""Disparities on either side of the likeliest one that its mean is over."""

LEAST_ODDS, LEAST_WIDTH = 1e-3, 0.05
"""Offsets of a probability, and of a deviation in steps, that keep their logarithms finite."""


FACET_REACH = 2
"""Pixels on each side of a pixel through which `facets` fits a plane."""

COMPARED = 12
"""Features of a pixel that `compare_maps` gives."""

DECISIONS = 3
"""Numbers of a pixel that `choose` takes."""

CLOSE = 0.5
"""Pixels in the farthest view: maps that are closer show one surface, and a mean of them does, too."""


@dataclass(frozen=True)
class Rows:
    """The rows of a volume from `first` to before `last`, of so many in `all`."""

    first: int
    last: int
    all: int


class SectorCosts(Protocol):
    """Costs of the views in each sector at a row of disparities, planned for light fields of one kind.

    A view n takes part where `PlaneSweep` says, and belongs to one sector (`sectors_of`). With D_n = f (scale *
    recorded_n at p - d o_n, bilinear) - f I, f being a factor, the COSTS of a pixel are g(mean_n mean_c |D_n|) for each
    sector and, behind these, g(mean_c |mean_n D_n|), over the views n of the sector that take part;
    g(x) = log(1 + x / COST_UNIT) / 4. A sector of which no view takes part costs the mean over the others, and 1 if no
    view takes part at all.
    """

    def load(self, image: Array, recorded: Array, valid: Array | None) -> None:
        """Take a reference image [y, x, c] and `recorded` views [n, y, x, c] with their `valid` [n, y, x] or None."""

    def __call__(
        self, first: Array, factor: Scalar, costs_out: Array, *, step: float, rows: Rows | None = None
    ) -> None:
        """costs [l, y', x', FOLD^2 COSTS], folded: those at first + l step; `first` is a map [y, x]. None: all rows."""


class Convolution(Protocol):
    """A convolution with its bias, its strides, what is added to it and its rectifier; weights are planned."""

    def __call__(self, volume: Array, added: Array | None, volume_out: Array, *, rows: Rows | None = None) -> None:
        """Write sum_k w_k volume(stride p + k - size // 2) + bias + added.

        Beyond its border `volume` is 0; ceil(size / stride) are the sizes of what is written. `added` is a volume,
        stored as `volume` is, whose sizes divide these; each of its pixels counts for as many next to each other.
        Negative results are 0 if the plan is `rectified`. With `rows` of the output, `volume` has stride times as many
        rows as these are in all, and pixels of `added` count for as many rows as columns.
        """


class Learned(Protocol):
    """Operations of a network that finds disparities."""

    def brightness(self, image: Array, *, factor_out: Scalar) -> None:
        """Compute the factor that brings an image to about a mean of 0.4: 0.4 / (mean + 0.08), but 0.5 to 4."""

    def fold(self, image: Array, factor: Scalar, *, folded_out: Array) -> None:
        """factor * image [y, x, c], folded to a volume [1, y', x', 4 FOLD^2]; of a grey image all three channels are
        it, and the last FOLD^2 channels are 0.
        """

    def sector_costs(self, shape: Sequence[int], offsets: Array, *, scale: float) -> SectorCosts:
        """Plan the costs of views of `shape` [n, y, x, c]; the field `offsets` [n, 2] is read once."""

    def convolution(
        self,
        weights: Float32Array,
        bias: Float32Array,
        device: str,
        *,
        strides: tuple[int, int, int] = (1, 1, 1),
        rectified: bool = False,
    ) -> Convolution:
        """Plan a convolution with weights [l, y, x, c_in, c_out] of odd sizes and a bias [c_out].

        Numbers of channels are multiples of 8, but that of the output may be a multiple of 4. Where volumes are stored
        as float16, weights may be rounded to that, too.
        """

    def peak(
        self,
        logits: Array,
        first: Array,
        *,
        step: float,
        disparity_out: Array,
        probability_out: Array,
        deviation_out: Array,
        rows: Rows | None = None,
    ) -> None:
        """Find the peak of the distributions softmax_l of folded logits [l, y', x', FOLD^2] at first + l step.

        disparity [y, x] is the mean over the likeliest l, the first one of several, and PEAK_REACH on either side;
        deviation is the standard deviation there, and probability what these have of the whole distribution. `first` is
        [y, x]. With `rows` of the logits, only the pixels that are folded into these are written.
        """

    def judge_peak(
        self,
        probability: Array,
        deviation: Array,
        *,
        step: float,
        limit: float,
        share: Sequence[float],
        spread: Sequence[float],
        confidence_out: Array,
        variance_out: Array,
    ) -> None:
        """Compute how likely a pixel of a map is within `limit` of the truth, and its variance, from `peak`.

        With f = `peak_features`(probability, deviation / step), the confidence is the logistic function of
        share[:3] . f + share[3] log(limit / step), and the variance is step^2 exp(spread . f). All maps are [y, x].
        """

    def planes(self, map_: Array, *, planes_out: Array) -> None:
        """Fit a plane to the pixels of a map [y, x] that are at most FACET_REACH rows and columns from each pixel.

        planes_out is an image [y, x, 4]: the plane's value at the pixel, its slopes along x and y (0 in a window of one
        column or row), and the mean square difference of the pixels in the image from it.
        """

    def facets(self, planes: Array, *, facets_out: Array) -> None:
        """Compute a map of the best ones of `planes` [y, x, 4].

        Each pixel of facets [y, x] is the value, at this pixel, of the plane with the least mean square difference of
        those of all pixels at most FACET_REACH rows and columns away; of several, the first one by rows.
        """

    def compare_maps(
        self,
        first: Sequence[Array],
        second: Sequence[Array],
        *,
        farthest: float,
        span: float,
        features_out: Array,
    ) -> None:
        """Compute features [1, y', x', FOLD^2 COMPARED], folded, of two maps of the same views.

        Each is (disparity, confidence, variance, near, wide), all [y, x]; the last two are means of the disparity
        around. f being the offset of the `farthest` view, the COMPARED features are, with k for the first and the
        second map and a = f (second - first),

        - log odds(confidence_k) / 4, with LEAST_ODDS as in `peak_features`;
        - log(f sqrt(variance_k)) / 3, the deviation being 1e-3 to 20;
        - asinh(a / 0.05) / 4 and log(1 + |a| / 0.03) / 4;
        - asinh(f (disparity_k - near_k) / 0.1) / 4, and the same with wide_k;
        - log(f) / 2 and log(1 + f span) / 4, `span` being that of the disparities that were compared.
        """

    def choose(
        self,
        decisions: Array,
        first: Array,
        second: Array,
        *,
        farthest: float,
        disparity_out: Array,
        confidence_out: Array,
        variance_out: Array,
    ) -> None:
        """Make one of two maps [y, x] by `decisions` [1, y', x', FOLD^2 DECISIONS], folded.

        Of the decisions (c, r, s) of a pixel, p = logistic(c) is the weight of the second map. Where the maps are
        closer than CLOSE / farthest the disparity is their mean; elsewhere it is the second one if p > 1/2, and the
        first one if not. The confidence is logistic(r), the variance exp(2 s) / farthest^2 with s from -7 to 4.
        """


def peak_features(probability: NDArray[Any], deviation: NDArray[Any]) -> Float64Array:
    """Compute the features [3, ...] on which the trust in a peak depends; `deviation` is in steps."""
    odds = np.log((probability + LEAST_ODDS) / (1 - probability + LEAST_ODDS))
    return np.stack([np.ones_like(odds), odds, np.log(deviation + LEAST_WIDTH)])


def sectors_of(offsets: NDArray[Any]) -> NDArray[np.int64]:
    """Compute the sector of each view: the one whose middle, a multiple of 360 / SECTORS degrees, its angle is nearest
    to; -1 for the reference.
    """
    du, dv = np.asarray(offsets, np.float64).T
    sectors = np.rint(np.arctan2(dv, du) * SECTORS / (2 * np.pi)).astype(np.int64) % SECTORS
    return np.where(np.hypot(du, dv) > 1e-3, sectors, -1)
