"""Self-calibration: views are moved, turned, scaled and brightened so that one map explains them all.

A coarse map and the cameras are found in turns, from coarse pictures to fine ones. The map tells which views see a
point; photometric bundle adjustment (`lfgpu/cameras/bundle.py`) then moves the cameras and, with them, the disparities
of its points. In the end every view is resampled once. `explain` compares before and after: a change that does not
explain the views better is not kept.

The reference view and the plane of disparity 0, which the views cannot tell, stay as they were.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, backend_named, open_device
from lfgpu.calibration.resample import pixels, resampled, through
from lfgpu.cameras.bundle import MODELS, Bundle, homographies, most_points
from lfgpu.cameras.explanation import explain
from lfgpu.cameras.looking import measured_tones
from lfgpu.cameras.points import choose_points
from lfgpu.cameras.tones import Tones
from lfgpu.contract import Device, Float32Array, Float64Array
from lfgpu.data import DepthResult, LightField
from lfgpu.errors import LightFieldError
from lfgpu.pipelines.estimate import estimate_depth

_COARSE, _MIDDLE = 128, 256  # pixels: longer sides of the pictures that maps are made from
_SMOOTH = 2.0  # pixels: standard deviation with which views are smoothed in the first round, at least
_ROUNDS = 3
_STEPS = 6
_POINTS = 3000  # of the first round; later ones take twice as many
_NEARLY = 0.05  # pixels: what is smoothed need not be lined up better
_STILL = 0.01  # pixels: what moves no view farther is done
_WORTHWHILE = 0.02  # pixels rms: resampling blurs more than less is worth
_AUDIBLE = 0.005  # share of the brightness rms: the same for tones
_FEWEST = 200  # points
_LEAST_CONTRAST = 1e-3
_NOT_WORSE = 0.05  # dB
_LEVEL_MATTERS = 0.005  # pixels per view step: half of what the finest BadPix allows


@dataclass(frozen=True, eq=False)
class Refinement:
    """Result of self-calibration. n views, c colours.

    Parameters
    ----------
    light_field
        The light field with its views lined up and equalised, with masks where they show nothing; the given one if
        nothing was worth changing.
    homographies
        float64 [n, 3, 3], from pixels of the new views to those of the given ones, (x, y, 1).
    shift, shift_error
        float64 [n, 2], pixels to the right and down by which the middle of a given view stood off, and standard error.
    rotation, scale
        float64 [n], degrees clockwise and share by which a given view was turned and larger.
    level_error
        Standard deviation, pixels per view step, of the one number by which all disparities may be off: the plane of
        disparity 0 cannot be told from the views. It follows from the size of the shifts, as if they were independent
        of each other: σ / √(Σ ‖o‖²) with the offsets o of the views. 0 if views were not moved.
    position_change
        float64 [n, 2], view steps that were added to the positions.
    tones
        Gain, offset and vignetting of the given views against the reference.
    psnr_before, psnr_after
        dB, of the views as predicted from the reference and a coarse map.
    kept
        True if anything was changed.
    status
        A sentence on the changes and their reason.
    """

    light_field: LightField
    homographies: Float64Array
    shift: Float64Array
    shift_error: Float64Array
    rotation: Float64Array
    scale: Float64Array
    level_error: float
    position_change: Float64Array
    tones: Tones
    psnr_before: float
    psnr_after: float
    kept: bool
    status: str


def refine(
    lf: LightField,
    *,
    model: str = "similarity",
    positions: bool = False,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Refinement:
    """Line the views of a light field up with each other, and equalise them.

    Parameters
    ----------
    lf
        The light field; its cameras look nearly the same way, off by some pixels.
    model
        Kind of the faults: "shift", "similarity" (default: shift, rotation, scale) or "homography".
    positions
        True: the positions of the cameras are looked for, too. Default False.
    disparity_range
        As for `estimate_depth`.
    backend, device
        Where maps are estimated, as for `estimate_depth`; the rest is done on the host.

    Raises
    ------
    LightFieldError
        If there is no such model, or the views have too little texture.
    BackendError
        If the backend or the device is not there.

    Examples
    --------
    >>> found = lfgpu.calibration.refine(lfgpu.read("rig"), disparity_range=(-2, 2))
    >>> found.shift.shape
    (25, 2)
    """
    if model not in MODELS:
        raise LightFieldError(f"model must be one of {', '.join(MODELS)}, not {model!r}.")
    search = _Search(lf, model, positions, disparity_range, open_device(backend, device))
    for coarseness in (_COARSE, *(_MIDDLE,) * (_ROUNDS - 1)):
        if search.round(coarseness) < _STILL:
            break
    return search.result()


def equalise(
    lf: LightField,
    *,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Refinement:
    """Give all views the brightness of the reference: gain and offset of each colour, and vignetting.

    Parameters and errors are those of `refine`; views are not moved.

    Examples
    --------
    >>> lfgpu.calibration.equalise(lf, disparity_range=(-2, 2)).light_field.size
    (64, 80)
    """
    search = _Search(lf, "similarity", False, disparity_range, open_device(backend, device))
    search.round(_MIDDLE, moving=False)
    return search.result()


class _Search:
    """Search for the unknowns in rounds that improve them."""

    def __init__(
        self,
        lf: LightField,
        model: str,
        positions: bool,
        disparity_range: tuple[float, float] | None,
        device: Device,
    ) -> None:
        self._lf, self._model, self._positions = lf, model, positions
        self._range, self._device = disparity_range, device
        count = len(lf.views)
        self.warps = np.zeros((count, MODELS[model]))
        self.shifted = np.zeros((count, 2))
        self.tones = _by_moments(lf)
        self._radius = float(np.hypot(*lf.size)) / 2
        self._bundle: Bundle | None = None
        self._moving = False

    def round(self, coarseness: int, *, moving: bool = True) -> float:
        """Estimate a coarse map of the views as they would be now, then the cameras; returns the largest move."""
        lf = self._lf
        factor = max(1, max(lf.size) // coarseness)
        small = self._now(factor)
        disparity = _enlarged(self._map(small, factor).disparity, factor, lf.size)
        columns = self.warps.shape[1] + 4
        moved = replace(lf, positions=lf.positions + self.shifted, grid_shape=None, truth=None)
        most = min(_POINTS if coarseness == _COARSE else 2 * _POINTS, most_points(len(lf.views), columns))
        points = choose_points(moved, disparity, self._device, most=most)
        if len(points.x) < _FEWEST:
            raise LightFieldError(
                f"{lf.name}: only {len(points.x)} points of the reference have texture on smooth surfaces; "
                f"{_FEWEST} are needed to line views up."
            )
        # What is off by pixels is found in smooth pictures only, however small they are.
        smoothing = max(factor / 4, _SMOOTH if coarseness == _COARSE else 0.0)
        bundle = Bundle(moved, points, model=self._model, free_positions=self._positions, smoothing=smoothing)
        bundle.warps[:] = self.warps
        bundle.tones[:, 0], bundle.tones[:, 1] = self.tones.gain.mean(1), self.tones.offset.mean(1)
        bundle.tones[lf.reference_index] = 1, 0
        self._bundle, self._moving = bundle, moving
        if moving:
            bundle.run(_STEPS, tolerance=_NEARLY)
            bundle.load(0.0)
            bundle.run(_STEPS, tolerance=_STILL)
            before = self.warps
            self.warps = _with_reference_fixed(bundle.warps, lf.reference_index, lf.offsets)
            self.shifted = self.shifted + _without_scale(bundle.shifted, lf)
            distance = float(np.abs(self.warps - before).max()) * self._radius
            bundle.warps[:] = self.warps
        else:
            distance = 0.0
        gain, offset, falloff = measured_tones(moved, bundle, vignetting=True)
        self.tones = Tones(gain, offset, falloff)
        return distance

    def result(self) -> Refinement:
        lf, bundle = self._lf, self._bundle
        assert bundle is not None
        back = homographies(self.warps, lf.size)
        rms = float(np.sqrt((self.warps**2).sum(1).mean())) * self._radius
        level = float(np.clip(np.median(bundle.brightness), 0.05, 1))
        unequal = self.tones.brightness(level) - 1
        edges = self.tones.vignetting
        tonal = float(np.sqrt((unequal**2).mean() + (edges**2).mean() / 4))
        geometric = self._moving and (rms >= _WORTHWHILE or bool(np.abs(self.shifted).max() > 0.01))
        error = np.zeros((len(lf.views), 2))
        if bundle.influence.size:
            error = np.sqrt(((bundle.influence[:, :2] * bundle.radius) ** 2).sum(2))
        shape = self.warps.shape[1]
        rotation = np.rad2deg(self.warps[:, 2]) if shape > 2 else np.zeros(len(lf.views))
        scale = self.warps[:, 3].copy() if shape > 2 else np.zeros(len(lf.views))
        found = Refinement(
            lf, back, self.warps[:, :2] * self._radius, error, rotation, scale, 0.0, self.shifted, self.tones,
            np.nan, np.nan, False, "nothing is worth changing: the views fit together as they are.",
        )  # fmt: skip
        if not geometric and tonal < _AUDIBLE:
            return found
        factor = max(1, max(lf.size) // _MIDDLE)
        before, after = (self._score(small, factor) for small in (self._small(factor), self._now(factor)))
        if not after >= before - _NOT_WORSE:
            return replace(
                found,
                psnr_before=before,
                psnr_after=after,
                status="nothing was changed: it would explain the views worse "
                f"({after:.1f} dB instead of {before:.1f}).",
            )
        moved = f"lined up ({rms:.2f} px rms)" if geometric else "left where they are"
        lined_up = self._full(back if geometric else None)
        # The part of independent shifts in proportion to the offsets: the reference stands, and one part is taken out.
        spread = (found.shift**2).sum() / max(2 * len(found.shift) - 3, 1)
        level_error = float(np.sqrt(spread / (lf.offsets**2).sum())) if geometric else 0.0
        if level_error > _LEVEL_MATTERS:
            lined_up = replace(lined_up, notes=(*lined_up.notes, _level_note(lf, bundle, level_error)))
        return replace(
            found,
            light_field=lined_up,
            level_error=level_error,
            homographies=back if geometric else np.tile(np.eye(3), (len(lf.views), 1, 1)),
            psnr_before=before,
            psnr_after=after,
            kept=True,
            status=f"views {moved} and equalised ({100 * tonal:.1f} % rms): predicted with {after:.1f} dB instead of "
            f"{before:.1f}.",
        )

    # --- helpers ---

    def _full(self, back: Float64Array | None) -> LightField:
        """Make the light field at full size, each view resampled once at most."""
        lf = self._lf
        views, valid = self._resampled(lf, back)
        moved = bool((self.shifted != 0).any())
        return replace(
            lf,
            views=views,
            valid=valid,
            positions=lf.positions + self.shifted,
            grid_shape=None if moved else lf.grid_shape,
            files=(),
        )

    def _now(self, factor: int) -> LightField:
        """Make the light field as it would be now, shrunk by `factor`."""
        small = self._small(factor)
        views, valid = self._resampled(small, homographies(self.warps, small.size))
        return replace(small, views=views, valid=valid, positions=self._lf.positions + self.shifted, grid_shape=None)

    def _small(self, factor: int) -> LightField:
        lf = self._lf
        return lf.downsampled(factor) if factor > 1 else replace(lf, geometry=None, truth=None, files=())

    def _resampled(self, lf: LightField, back: Float64Array | None) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
        """Look up the views of a light field through homographies (None: not moved) and equalise them; also masks."""
        grid = pixels(*lf.size)

        def places(n: int) -> Float64Array | None:
            still = back is None or np.allclose(back[n], np.eye(3), atol=1e-9)
            return None if back is None or still else through(back[n], grid)

        return resampled(lf, places, self.tones.equalised)

    def _map(self, small: LightField, factor: int) -> DepthResult:
        """Estimate a map of a light field that was shrunk by `factor`."""
        return estimate_depth(
            small,
            config="fast",
            disparity_range=None if self._range is None else (self._range[0] / factor, self._range[1] / factor),
            backend=backend_named(self._device.kernels.name),
            device=self._device.name,
            check_cameras=False,
        )

    def _score(self, small: LightField, factor: int) -> float:
        """Predict a light field that was shrunk by `factor` from a coarse map of its own; returns the PSNR."""
        backend = backend_named(self._device.kernels.name)
        return explain(small, self._map(small, factor), backend=backend, device=self._device.name).mean_psnr


def _by_moments(lf: LightField) -> Tones:
    """Match mean and contrast of each view and colour to those of the reference; returns gains and offsets."""
    count = len(lf.views)
    mean, contrast = np.empty((count, lf.channels)), np.empty((count, lf.channels))
    for n in range(count):
        view = lf.image(n).reshape(-1, lf.channels)
        if lf.valid is not None:
            view = view[lf.valid[n].ravel()]
        mean[n], contrast[n] = view.mean(0, dtype=np.float64), view.std(0, dtype=np.float64)
    ref = lf.reference_index
    gain = np.clip((contrast + _LEAST_CONTRAST) / (contrast[ref] + _LEAST_CONTRAST), 0.25, 4)
    return Tones(gain, mean - gain * mean[ref], np.zeros_like(gain))


def _with_reference_fixed(warps: Float64Array, reference: int, offsets: Float64Array) -> Float64Array:
    """Remove from warps the warp of the reference, and the part in proportion to the offsets.

    The composition is of first order, which is enough near the identity.
    """
    fixed = warps - warps[reference]
    total = float((offsets**2).sum())
    slope = float((fixed[:, :2] * offsets).sum()) / total
    fixed[:, :2] -= slope * offsets
    return np.asarray(fixed)


def _level_note(lf: LightField, bundle: Bundle, error: float) -> str:
    said = (
        "Lined up by what the views show: all disparities may be off by the same number, about "
        f"{error:.2g} px per view step (one standard deviation), as views do not tell the plane of disparity 0; a "
        "calibration does."
    )
    if lf.geometry is None:
        return said
    middle = float(np.median(bundle.disparity))
    depth, other = (float(lf.geometry.depth(d)) for d in (middle, middle + error))
    if not np.isfinite(depth + other):
        return said
    return f"{said} At a depth of {depth:.3g} m that is {abs(depth - other):.2g} m."


def _without_scale(shifted: Float64Array, lf: LightField) -> Float64Array:
    """Remove from changes of positions that of the reference and a common scale, which disparities take up."""
    fixed = shifted - shifted[lf.reference_index]
    offsets = lf.offsets
    return np.asarray(fixed - (fixed * offsets).sum() / (offsets**2).sum() * offsets)


def _enlarged(map_: Float32Array, factor: int, size: tuple[int, int]) -> Float32Array:
    """Enlarge a map of shrunk views to views of full size."""
    if factor == 1:
        return map_
    full = np.repeat(np.repeat(map_ * factor, factor, axis=0), factor, axis=1)
    beyond = [(0, size[axis] - full.shape[axis]) for axis in (0, 1)]
    return np.pad(full, beyond, mode="edge").astype(np.float32)
