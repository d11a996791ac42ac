"""Rigs: the cameras of light fields as the generator draws others like them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import open_device
from lfgpu.contract import Float64Array
from lfgpu.data import LightField
from lfgpu.methods import method_of
from lfgpu.methods.matching.noise import measured_grain
from lfgpu.pipelines.pipeline import measured_on

_SPREAD = 0.25  # standard deviation of the logarithms of mean intensity and noise of a rig's scenes
_BRIGHTEST = 0.9  # mean intensity of a scene, at most


@dataclass(frozen=True)
class Rig:
    """Cameras and what was measured of their light fields.

    Parameters
    ----------
    arrays
        The offsets [n, 2] of the views beside the reference, of each light field; the farthest has
        max(|du|, |dv|) = 1.
    limits
        The least and the largest disparity, pixels in the farthest view.
    size
        Rows and columns of the views, at least.
    grain
        Standard deviation of the noise of a view, intensity.
    level
        Mean intensity.
    levels
        The largest code of the camera.
    is_grey
        Whether views have one channel, which is the mean of three here.
    """

    arrays: tuple[tuple[tuple[float, float], ...], ...]
    limits: tuple[float, float]
    size: tuple[int, int]
    grain: float
    level: float
    levels: int
    is_grey: bool

    def draw_array(self, rng: np.random.Generator) -> Float64Array:
        """Choose the array of one of the light fields."""
        return np.array(self.arrays[int(rng.integers(len(self.arrays)))])

    def expose(self, lights: NDArray[Any], means: NDArray[Any], rng: np.random.Generator) -> None:
        """Change the light of scenes, so that views have the rig's brightness and noise.

        `means` [b] are the mean intensities that the scenes have in the present light.
        """
        level = np.minimum(self.level * np.exp(_SPREAD * rng.standard_normal(len(lights))), _BRIGHTEST)
        lights["exposure"] *= (level / np.maximum(means, 1e-3)) ** lights["gamma"]
        grain = self.grain * (math.sqrt(3) if self.is_grey else 1) * np.exp(_SPREAD * rng.standard_normal(len(lights)))
        shot = rng.random(len(lights))  # the share of the noise's variance that grows with the light
        lights["read"], lights["shot"] = grain * np.sqrt(1 - shot), grain * np.sqrt(shot / level)
        lights["levels"] = self.levels


def measured_rig(light_fields: Sequence[LightField], *, backend: str, device: str) -> Rig:
    """Measure cameras, disparities, noise and brightness of light fields of one rig; LightFieldError as `measured_on`.

    The noise is that of the least noisy light field: what textures add to it differs from one to the next.
    """
    arrays, low, high, grains, levels = [], math.inf, -math.inf, [], []
    method, place = method_of("learned"), open_device(backend, device)
    for lf in light_fields:
        layout = lf.layout.subset(method.used_views(lf.offsets))
        offsets = np.delete(layout.offsets, layout.reference, 0)
        arrays.append(tuple((float(du), float(dv)) for du, dv in offsets / np.abs(offsets).max()))
        measured, _ = measured_on(lf, config="learned", disparity_range=None, backend=backend, device=device)
        low = min(low, measured.disparity_range[0] * layout.farthest)
        high = max(high, measured.disparity_range[1] * layout.farthest)
        grains.append(measured_grain(lf, place))
        levels.append(float(lf.image(lf.reference_index).mean()))
    return Rig(
        arrays=tuple(arrays),
        limits=(low, high),
        size=(min(lf.size[0] for lf in light_fields), min(lf.size[1] for lf in light_fields)),
        grain=min(grains),
        level=float(np.mean(levels)),
        levels=min(round(1 / lf.scale) if lf.views.dtype.kind == "u" else 65535 for lf in light_fields),
        is_grey=all(lf.channels == 1 for lf in light_fields),
    )
