"""Numbers of a rectification: as a file, and as the `Rectifier` of further pictures of the same cameras."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.calibration.formats.entries import camera_of
from lfgpu.calibration.refine import Refinement
from lfgpu.calibration.resample import pixels, through
from lfgpu.calibration.rig import Rig
from lfgpu.cameras.tones import Tones, squared_radius_at
from lfgpu.contract import Float64Array
from lfgpu.data import Geometry, LightField
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io import read
from lfgpu.io.numpy_file import load_arrays
from lfgpu.pipelines.rectifier import Rectifier
from lfgpu.threads import in_threads

NUMBERS = "rectified.npz"
_OF_TONES = ("gain", "offset", "vignetting")
_OF_GEOMETRY = ("focal_length_px", "baseline_m", "focus_distance_m")
_OF_RIGS = (
    "rotation", "positions", "ahead", "corrected_at", "geometry", "reference", "matrices", "distortions", "models",
    "rotations", "translations",
)  # fmt: skip


def read_rectifier(folder: str | os.PathLike[str]) -> Rectifier:
    """Read the rectifier of a folder that `lfgpu rectify` wrote.

    LightFieldError if the folder holds none, or is damaged.

    Examples
    --------
    >>> rectified = lfgpu.calibration.rectify("rig", calibration="rig/cameras.toml")
    >>> lfgpu.calibration.write_rectified(rectified, "rectified")
    >>> type(lfgpu.calibration.read_rectifier("rectified")).__name__
    'Rectifier'
    """
    path = named(folder)
    if not (path / NUMBERS).is_file():
        raise LightFieldError(f"{path} holds no {NUMBERS}; give a folder that `lfgpu rectify` wrote.")
    lf = read(path, lazy=True)
    values = load_arrays(path / NUMBERS, ("homographies", *_OF_TONES, *_OF_RIGS))
    try:
        count = len(values["homographies"])
        tones = Tones(**vars(_equal(count, lf.channels)) | {name: values[name] for name in _OF_TONES if name in values})
        rig = _rig_of(values, lf.size, path) if "matrices" in values else None
        if count != len(lf.views):
            raise ValueError(f"numbers of {count} cameras, {len(lf.views)} views")
        return _made(lf, rig, values["homographies"], tones)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise LightFieldError(f"{path / NUMBERS} is damaged ({error}); run `lfgpu rectify` again.") from error


def rectifier_of(lf: LightField, rig: Rig | None, found: Refinement | None) -> Rectifier:
    """Make the rectifier of a rectified light field; LightFieldError if the frame shows nothing of a camera."""
    count = len(lf.views)
    if rig is not None and len(rig.cameras) != count:
        raise LightFieldError(
            f"{lf.name}: the common frame shows nothing of {len(rig.cameras) - count} cameras; leave them out."
        )
    if found is not None and found.kept:
        return _made(lf, rig, found.homographies, found.tones)
    return _made(lf, rig, _still(count), _equal(count, lf.channels))


def numbers(lf: LightField, rig: Rig | None, found: Refinement | None) -> dict[str, NDArray[Any]]:
    """Collect the numbers that lead from a rectified light field back to the pictures, by the name of their array."""
    told: dict[str, NDArray[Any]] = {"homographies": _still(len(lf.views))}
    if found is not None and found.kept:
        told = {"homographies": found.homographies, **vars(found.tones)}
    if rig is not None:
        geometry = rig.geometry
        assert geometry.principal_point is not None
        lenses = np.zeros((len(rig.cameras), 8))
        for n, camera in enumerate(rig.cameras):
            lenses[n, : len(camera.distortion)] = camera.distortion
        told |= {
            "rotation": rig.rotation,
            "positions": rig.positions,
            "ahead": rig.ahead,
            "corrected_at": np.array(rig.corrected_at),
            "geometry": np.array([*(getattr(geometry, name) for name in _OF_GEOMETRY), *geometry.principal_point]),
            "reference": np.array(rig.reference),
            "models": np.array([camera.model for camera in rig.cameras]),
            "matrices": np.stack([camera.matrix for camera in rig.cameras]),
            "distortions": lenses,
            "rotations": np.stack([np.asarray(camera.rotation) for camera in rig.cameras]),
            "translations": np.stack([np.asarray(camera.translation) for camera in rig.cameras]),
            "reference_centre": rig.cameras[rig.reference].centre,
        }
    return told


# --- steps ---


def _still(count: int) -> Float64Array:
    return np.tile(np.eye(3), (count, 1, 1))


def _equal(count: int, channels: int) -> Tones:
    return Tones(np.ones((count, channels)), np.zeros((count, channels)), np.zeros((count, channels)))


def _made(lf: LightField, rig: Rig | None, homographies: Float64Array, tones: Tones) -> Rectifier:
    count, (height, width) = len(lf.views), lf.size
    grid = pixels(height, width)
    places = np.empty((count, height, width, 2), np.float32)
    radius2 = np.empty((count, height, width), np.float32)

    def work(n: int) -> None:
        at = through(homographies[n], grid)
        places[n] = at if rig is None else rig.places(n, at)
        radius2[n] = squared_radius_at(at, lf.size)

    in_threads(work, range(count))
    return Rectifier(
        places,
        radius2,
        np.stack([tones.gain, tones.offset, tones.vignetting], axis=1),
        lf.positions,
        lf.reference_index,
        valid=lf.valid,
        geometry=lf.geometry,
        grid_shape=lf.grid_shape,
        name=lf.name,
    )


def _rig_of(values: dict[str, Any], size: tuple[int, int], path: Path) -> Rig:
    kinds = ("matrices", "distortions", "rotations", "translations", "models")
    cameras = [
        camera_of(matrix, lens, turn, shift, np.array(size[::-1]), model == "fisheye", f"{path.name}: camera {n}")
        for n, (matrix, lens, turn, shift, model) in enumerate(zip(*(values[kind] for kind in kinds), strict=True))
    ]
    focal, baseline, focus, x, y = map(float, values["geometry"])
    geometry = Geometry(focal, baseline, focus, principal_point=(x, y), unshifted_at=(0.0, 0.0))
    return Rig(
        tuple(cameras),
        values["rotation"],
        values["positions"],
        values["ahead"],
        geometry,
        int(values["reference"]),
        float(values["corrected_at"]),
        (),
    )
