"""Rectification of pictures, or a light field, to a light field whose cameras are parallel and alike."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu._backends import DEFAULT, BackendName
from lfgpu.calibration.formats import BESIDE, Calibration, read_calibration
from lfgpu.calibration.rectifiers import NUMBERS, numbers, rectifier_of
from lfgpu.calibration.refine import Refinement, equalise, refine
from lfgpu.calibration.resample import pixels, through
from lfgpu.calibration.rig import Rig, fit_rig, matched, told_by_order
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import DepthResult, DisparityMap, LightField
from lfgpu.data.geometry import UNITS
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io import atomic_folder, check_no_inputs, check_writable, read, write_description
from lfgpu.io.contradictions import contradictions
from lfgpu.io.png import write_png
from lfgpu.io.taken import check_unit, plausible
from lfgpu.io.views import load_pictures
from lfgpu.pipelines.rectifier import Rectifier

POINTS_FILE, DEPTH_FILE = "points.ply", "original_depth.pfm"
"""Files that `lfgpu rectify --points` adds."""

_BY_ORDER = ("Kalibr", "LLFF")  # formats that have no names of pictures


@dataclass(frozen=True, eq=False)
class Rectified:
    """Result of `rectify`.

    Parameters
    ----------
    light_field
        Views of parallel cameras in a plane; masked where no picture shows anything.
    rig
        Rig of the calibration; None without a calibration.
    refinement
        Result of self-calibration or equalisation; None if neither was asked for.
    disparity_range
        (low, high) of the disparities, as told, or of the depths that are known; None if neither is.
    files
        Files of the pictures, which `write_rectified` does not replace.
    """

    light_field: LightField
    rig: Rig | None
    refinement: Refinement | None
    disparity_range: tuple[float, float] | None = None
    files: tuple[str, ...] = ()

    def rectifier(self) -> Rectifier:
        """Make a rectifier of other pictures of these cameras, for `lfgpu.DepthPipeline` and `lfgpu.DepthStream`.

        LightFieldError if the common frame shows nothing of a camera.
        """
        return rectifier_of(self.light_field, self.rig, self.refinement)

    def original_depth(self, result: DepthResult | DisparityMap) -> Float32Array:
        """Compute metric depth in the frame of a camera and in its original picture, lens and all, float32 [y, x].

        Parameters
        ----------
        result
            A map of one of the rectified views, whose camera is meant.

        Returns
        -------
        Distance along the camera's own axis in the unit of the calibration; NaN where the map does not reach or is
        unknown, infinity beyond the horizon.

        Raises
        ------
        LightFieldError
            If there was no calibration, or the map is not of one of the views.
        """
        lf, rig = self.light_field, self.rig
        if rig is None or len(lf.views) != len(rig.cameras):
            raise LightFieldError(f"{lf.name} was not rectified with a calibration of all its cameras.")
        u, v = result.position or lf.positions[lf.reference_index]
        index = lf.index_of(v, u)
        if result.disparity.shape != lf.size:
            raise LightFieldError(f"the map must be of {lf.size}, found {result.disparity.shape}.")
        height, width = lf.size
        at, along = rig.back(index, pixels(height, width))
        if self.refinement is not None and self.refinement.kept:
            at = through(np.linalg.inv(self.refinement.homographies[index]), at)
        with np.errstate(invalid="ignore"):
            column, row = np.rint(np.nan_to_num(at, nan=-1e6)).clip(-1e6, 1e6).astype(np.intp).transpose(2, 0, 1)
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            disparity = result.disparity[row.clip(0, height - 1), column.clip(0, width - 1)]
            depth = (rig.geometry.depth(disparity) - rig.ahead[index]) / along[..., 2]
            return np.where(inside & (depth > 0), depth, np.nan).astype(np.float32)


def calibration_beside(folder: Path) -> Path | None:
    """Find the calibration in a folder of pictures, or above it; None if there is none."""
    for place in (folder, folder.parent):
        for name in BESIDE:
            if (place / name).exists():
                return place / name
    return None


def rectify(
    source: LightField | str | os.PathLike[str],
    *,
    calibration: Calibration | str | os.PathLike[str] | None = None,
    unit: str | None = None,
    model: str | None = None,
    positions: bool = False,
    tones: bool = False,
    depths: tuple[float, float] | None = None,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Rectified:
    """Make the cameras of pictures or of a light field parallel and alike.

    Parameters
    ----------
    source
        A light field, or the path of one, or of a folder with pictures (these need a calibration).
    calibration
        Calibrated cameras, or their file, see `read_calibration`; None takes one that lies beside pictures.
    unit
        Unit of the lengths in the file, "mm", "cm" or "m", as for `read_calibration`. Default None: metres.
    model
        Also line views up by their contents: "shift", "similarity" or "homography", as for `refine`. Default None: no.
    positions
        True: `refine` looks for the positions of the cameras, too. Default False.
    tones
        True: give all views the brightness of the reference. Lining up does so, too. Default False.
    depths
        (near, far) of the scene in the unit of the calibration; Default None: those of the calibration, if
        it has some.
    disparity_range, backend, device
        As for `refine`.

    Raises
    ------
    LightFieldError
        If calibration and pictures do not belong together, or the cameras are no light field; see `fit_rig`, `refine`.

    Examples
    --------
    >>> lfgpu.calibration.rectify("rig", calibration="rig/cameras.toml").light_field.size
    (64, 80)
    """
    check_unit(unit)
    if calibration is None and not isinstance(source, LightField):
        calibration = calibration_beside(named(source))
    if calibration is not None and not isinstance(calibration, Calibration):
        calibration = read_calibration(calibration, unit=unit)
    pictures = source if isinstance(source, LightField) else _loaded(named(source), calibrated=calibration is not None)
    rig, lf = None, pictures
    if unit is not None and depths is not None:
        depths = (UNITS[unit] * depths[0], UNITS[unit] * depths[1])
    if calibration is not None:
        names = pictures.files or tuple(f"view_{n:03d}" for n in range(len(pictures.views)))
        cameras = matched(calibration.cameras, names, pictures.size, calibration.source, rig=calibration.rig)
        if pictures.files and calibration.format not in _BY_ORDER and (said := told_by_order(cameras, names)):
            pictures = replace(pictures, notes=(*pictures.notes, said))
        told = isinstance(source, LightField) or pictures.truth is not None
        reference = pictures.reference if told else None
        depths = depths or calibration.depths
        rig = fit_rig(cameras, depths=depths, reference=reference)
        disparity_range = disparity_range or _range(rig, depths)
        if unit is None and not plausible(rig.geometry):
            doubt = (
                f"Neighbouring cameras would stand {rig.geometry.baseline_m:.4g} m apart: lengths of the calibration "
                "are probably no metres; say their unit with unit= (--unit mm or cm on the command line), or depths "
                "are of that unit."
            )
            pictures = replace(pictures, notes=(*pictures.notes, doubt))
        lf = _with_truth(rig.light_field(pictures), pictures, rig)
    elif not model and not tones:
        raise LightFieldError(
            f"{pictures.name} has no calibration beside it; name one (--calibration, or calibration=), or line the "
            "views up by what they show (--refine, or model=)."
        )
    if model is None and not tones:
        return Rectified(_looked_at_again(lf, pictures), rig, None, disparity_range, pictures.files)
    options: dict[str, Any] = {"disparity_range": disparity_range, "backend": backend, "device": device}
    found = refine(lf, model=model, positions=positions, **options) if model else equalise(lf, **options)
    if found.kept and rig is not None and len(lf.views) == len(pictures.views):
        found = replace(found, light_field=_composed(pictures, rig, found))
    return Rectified(_looked_at_again(found.light_field, pictures), rig, found, disparity_range, pictures.files)


def write_rectified(result: Rectified, folder: str | os.PathLike[str]) -> None:
    """Write a rectified light field as a folder that `lfgpu.read` reads: views, masks, lightfield.toml.

    The numbers to go back to the original pictures are in rectified.npz: `homographies` [n, 3, 3] from pixels that are
    written to rectified ones, and with a calibration `rotation` [3, 3] (world to the common frame), `positions`,
    `ahead`, `corrected_at`, the common camera, and of the original cameras `matrices`, `distortions`, `rotations` and
    `translations`. points.ply and original_depth.pfm of an earlier run, which are of another map, are removed.
    LightFieldError if a picture that was read would be replaced.

    Examples
    --------
    >>> rectified = lfgpu.calibration.rectify("rig", calibration="rig/cameras.toml")
    >>> lfgpu.calibration.write_rectified(rectified, "rectified")
    >>> lfgpu.read("rectified").size
    (64, 80)
    """
    check_writable(folder)
    lf = result.light_field
    names = [f"view_{n:03d}.png" for n in range(len(lf.views))]
    check_no_inputs((Path(folder, name) for name in names), result.files)
    with atomic_folder(folder, ours=(POINTS_FILE, DEPTH_FILE), mark=NUMBERS) as place:
        for name, view in zip(names, lf.views, strict=True):
            write_png(place / name, view)
        files = tuple(str(place / name) for name in names)
        write_description(replace(lf, files=files), place / "lightfield.toml", source={})
        np.savez_compressed(place / NUMBERS, **numbers(lf, result.rig, result.refinement))  # type: ignore[arg-type]


# --- steps ---


def _loaded(path: Path, *, calibrated: bool) -> LightField:
    """Load the pictures of a calibrated folder; a light field with a known truth, or without calibration, as such."""
    if not path.is_dir() or not calibrated:
        return read(path, allow_missing=True)
    try:
        known = read(path, allow_missing=True)
    except LightFieldError:
        return load_pictures(path)
    return known if known.truth is not None or not known.files else load_pictures(path)


def _range(rig: Rig, depths: tuple[float, float] | None) -> tuple[float, float] | None:
    """Compute the disparities of the depths, and add a tenth on either side."""
    if depths is None:
        return None
    near, far = (float(rig.geometry.disparity(depth)) for depth in depths)
    return far - 0.1 * (near - far), near + 0.1 * (near - far)


def _with_truth(lf: LightField, pictures: LightField, rig: Rig) -> LightField:
    """Convert the truth to the rectified cameras, if the reference view did not change by a pixel.

    Rectified cameras have another disparity 0 and another baseline, so the truth is converted by way of depth. Without
    the geometry of the pictures their depth is unknown, and the truth is left out.
    """
    truth, geometry = pictures.reference_truth(), pictures.geometry
    if truth is None or geometry is None or len(lf.views) != len(pictures.views):
        return lf
    grid = pixels(*pictures.size)
    if np.abs(rig.places(rig.reference, grid) - grid).max() > 0.5:
        return lf
    u, v = lf.positions[lf.reference_index]
    disparity = rig.geometry.disparity(geometry.depth(truth.disparity)).astype(np.float32)
    return replace(lf, truth=replace(truth, disparity=disparity, position=(float(u), float(v))))


def _looked_at_again(lf: LightField, pictures: LightField) -> LightField:
    """Replace notes on how the pictures contradict the places of their cameras by notes on how the views still do."""
    before = contradictions(pictures)
    return replace(lf, notes=(*(note for note in lf.notes if note not in before), *contradictions(lf)))


def _composed(pictures: LightField, rig: Rig, found: Refinement) -> LightField:
    """Resample the refined light field from the pictures in one go."""
    grid = pixels(*pictures.size)

    def tone(view: Float32Array, n: int, _: Float64Array) -> Float32Array:
        return found.tones.equalised(view, n, through(found.homographies[n], grid))

    once = rig.light_field(pictures, homographies=found.homographies, tone=tone)
    return replace(found.light_field, views=once.views, valid=once.valid)
