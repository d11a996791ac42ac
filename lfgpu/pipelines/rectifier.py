"""`Rectifier`: the way from raw pictures of a rig to views of parallel, equal cameras, planned once for many frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.contract import Array, Device, Float32Array, Float64Array
from lfgpu.data import Geometry, LightField
from lfgpu.errors import LightFieldError


@dataclass(frozen=True, eq=False)
class Rectifier:
    """Sources of the pixels of rectified views, and tones of the cameras: n cameras, c colours.

        rectifier = lfgpu.calibration.read_rectifier("rectified")       # what `lfgpu rectify` wrote
        stream = lfgpu.DepthStream(rectifier.pictures(frame), rectifier=rectifier)

    Views are looked up by cubic convolution on the device, in the stored type of the pictures.

    Parameters
    ----------
    places
        float32 [n, y, x, 2], the place (x, y) in the raw picture of each pixel of the rectified view; NaN where the
        picture does not show it.
    squared_radius
        float32 [n, y, x], squared distance of the pixel from the middle of the picture in units of its half diagonal,
        for the vignetting.
    tones
        float64 [n, 3, c]: gain, offset (intensity) and vignetting. A picture shows (gain + vignetting r²) t + offset
        where the reference would show t.
    positions
        float64 [n, 2], (u, v) of the rectified cameras in view steps.
    reference
        Index of the reference view.
    valid
        bool [n, y, x], False where a rectified view shows nothing; None if all is valid.
    geometry
        The camera geometry; None if unknown.
    grid_shape
        (rows, columns) if the positions are places of a grid; None if not.
    name
        Name of the rig in messages.

    Raises
    ------
    LightFieldError
        If shapes do not belong together, or a view shows nothing at all.
    """

    places: Float32Array
    squared_radius: Float32Array
    tones: Float64Array
    positions: Float64Array
    reference: int
    valid: NDArray[np.bool_] | None = None
    geometry: Geometry | None = None
    grid_shape: tuple[int, int] | None = None
    name: str = "rig"

    def __post_init__(self) -> None:
        count, *size, pair = self.places.shape
        shapes = {
            "squared_radius": (self.squared_radius.shape, (count, *size)),
            "tones": (self.tones.shape, (count, 3, self.tones.shape[-1])),
            "positions": (self.positions.shape, (count, 2)),
            "valid": (None if self.valid is None else self.valid.shape, None if self.valid is None else (count, *size)),
        }
        wrong = [name for name, (found, wanted) in shapes.items() if found != wanted]
        if pair != 2 or wrong:
            raise LightFieldError(f"{self.name}: {wrong[0] if wrong else 'places'} of the rectifier has a wrong shape.")
        empty = np.flatnonzero(~np.isfinite(self.places[..., 0]).any(axis=(1, 2)))
        if len(empty):
            raise LightFieldError(
                f"{self.name}: nothing that camera {empty[0]} shows is in the common frame; leave it out of the rig."
            )

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of pictures and views, pixels."""
        return int(self.places.shape[1]), int(self.places.shape[2])

    def pictures(self, frame: ArrayLike, *, white: int | None = None) -> LightField:
        """Make raw pictures [n, y, x, c] of one frame a light field for pipelines and streams with this rectifier.

        `white` is that of `LightField`. LightFieldError if the pictures are of another rig.
        """
        views = np.asarray(frame)
        self._check(views.shape)
        return LightField(views, self.positions, reference=self.reference, name=self.name, white=white)

    def rectified(self, pictures: LightField, device: Device) -> LightField:
        """Rectify raw pictures to a light field, by the kernels that streams use."""
        self._check(pictures.views.shape)
        plan = DeviceViews(self, pictures, device)
        with device.asking():
            plan.work()
        views = np.asarray(device.kernels.numpy(plan.views))
        if pictures.views.dtype != np.float32:
            views = np.rint(views)  # backends that compute in float64 store no whole numbers
        return LightField(
            views.astype(pictures.views.dtype, copy=False),
            self.positions,
            reference=self.reference,
            grid_shape=self.grid_shape,
            valid=self.valid,
            geometry=self.geometry,
            name=pictures.name,
            notes=pictures.notes,
            white=pictures.white,
        )

    def with_tones(self, tones: Float64Array) -> Rectifier:
        """Return the same rectifier with other tones."""
        return replace(self, tones=np.asarray(tones, np.float64))

    def _check(self, shape: Sequence[int]) -> None:
        wanted = (len(self.places), *self.size, self.tones.shape[-1])
        if tuple(shape) != wanted and (wanted[3] != 1 or tuple(shape) != wanted[:3]):
            raise LightFieldError(
                f"pictures must be {list(wanted)} [cameras, y, x, colours] as {self.name} was calibrated for; found "
                f"{list(shape)}."
            )


class DeviceViews:
    """Views on a device for a plan: those of each frame as they are, or rectified there from raw pictures.

    The first frame gives the stored type. The caller holds `device.asking()`, or nobody else asks it.
    """

    def __init__(
        self,
        rectifier: Rectifier | None,
        pictures: LightField,
        device: Device,
        *,
        used: Sequence[int] | None = None,
    ) -> None:
        chosen = list(range(len(pictures.views)) if used is None else used)
        self._device, self._scale, self._chosen = device, pictures.scale, chosen
        whole = len(chosen) == len(pictures.views)
        self.frame: Array = device.image(pictures.views if whole else pictures.views[chosen])
        """[n, y, x, c], as stored; to be written to."""
        self.views: Array = self.frame
        """[n, y, x, c], as stored; for the plan, after `work`."""
        self._table: Array | None = None
        if rectifier is not None:
            table = np.concatenate([rectifier.places[chosen], rectifier.squared_radius[chosen][..., None]], axis=-1)
            self._table = device.field(table)
            self._tones = device.field(self._stored(rectifier.tones))
            shape = (len(chosen), *rectifier.size, pictures.channels)
            self.views = device.zeros_image(shape, pictures.views.dtype.type)

    def work(self) -> None:
        """Start rectifying the current frame, if it is one of raw pictures; may be captured."""
        if self._table is not None:
            self._device.kernels.resample(
                self.frame, self._table, self._tones, white=1.0 / self._scale, views_out=self.views
            )

    def feed(self, work: Callable[[Array], None]) -> None:
        """Start some work on the views of the current frame; may be captured."""
        self.work()
        work(self.views)

    def set_tones(self, tones: Float64Array) -> None:
        """Use other tones [n, 3, c] of all cameras from the next work on, also if it was captured."""
        with self._device.asking():
            self._device.kernels.upload(self._stored(tones), self._tones)

    def _stored(self, tones: Float64Array) -> NDArray[Any]:
        """Tones of the cameras that are used, with offsets as stored."""
        found = np.array(tones[self._chosen], np.float32)
        found[:, 1] /= self._scale
        return found
