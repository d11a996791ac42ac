"""Files of calibrations, and the table of their readers."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.colmap import holds_colmap, read_colmap, read_rig
from lfgpu.calibration.formats.devices import (
    depthai_cameras,
    google_cameras,
    is_depthai,
    is_google,
    is_stereo,
    read_llff,
    stereo_cameras,
)
from lfgpu.calibration.formats.entries import entries_of, read_yaml
from lfgpu.calibration.formats.nerfstudio import nerfstudio_cameras
from lfgpu.calibration.formats.opencv import is_kalibr, kalibr_cameras, opencv_cameras
from lfgpu.calibration.formats.toml import read_toml, write_cameras
from lfgpu.data.geometry import UNITS
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io.taken import check_unit
from lfgpu.io.texts import read_json_or_toml

BESIDE = (
    *("cameras.toml", "poses_bounds.npy", "transforms.json", "transforms_train.json", "models.json", "camchain.yaml"),
    *("sparse/0", "sparse"),
)
"""Names of calibrations that are looked for beside pictures, in this order."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Cameras that a file describes.

    Parameters
    ----------
    cameras
        The cameras, with names of pictures where the file has them.
    source
        The file.
    format
        Name of the format.
    depths
        Nearest and farthest depth of the scene; None if the file has none.
    rig
        The cameras of a rig by themselves, where `cameras` are those of images that it took from several places; else
        empty.
    """

    cameras: tuple[Camera, ...]
    source: str
    format: str
    depths: tuple[float, float] | None = None
    rig: tuple[Camera, ...] = ()


def read_calibration(path: str | os.PathLike[str], *, unit: str | None = None) -> Calibration:
    """Read calibrated cameras.

    Parameters
    ----------
    path
        cameras.toml (lfgpu's own), a YAML or JSON file of OpenCV, camchain.yaml of Kalibr, transforms.json of
        nerfstudio (also the transforms_train.json with camera_angle_x alone), poses_bounds.npy of LLFF, models.json of
        Google's camera rigs, the JSON file of depthai, or a folder with a model of COLMAP.
    unit
        Unit of the lengths in it: "mm", "cm" or "m"; they become metres. Default None: they are metres already, or of
        no unit, but for depthai's, which are centimetres.

    Raises
    ------
    LightFieldError
        If there is no such file, it is of another kind, or damaged; the sentence says which entry.

    Examples
    --------
    >>> lfgpu.calibration.read_calibration("rig/cameras.toml").cameras[0].name
    'input_Cam000.png'
    """
    check_unit(unit)
    found = _read(path)
    if unit is None or UNITS[unit] == 1:
        return found
    scale = UNITS[unit] / (_CENTIMETRE if found.format == "depthai" else 1)
    return replace(
        found,
        cameras=tuple(_scaled(camera, scale) for camera in found.cameras),
        rig=tuple(_scaled(camera, scale) for camera in found.rig),
        depths=None if found.depths is None else (scale * found.depths[0], scale * found.depths[1]),
    )


def _scaled(camera: Camera, scale: float) -> Camera:
    return replace(camera, translation=scale * np.asarray(camera.translation))


def _read(path: str | os.PathLike[str]) -> Calibration:
    file = named(path)
    depths, rig, suffix = None, list[Camera](), file.suffix.lower()
    if file.is_dir():
        if not holds_colmap(file):
            raise LightFieldError(f"{file} holds no model of COLMAP (cameras and images, .bin or .txt).")
        cameras, rig, name = read_colmap(file), read_rig(file), "COLMAP"
    elif not file.is_file():
        raise LightFieldError(f"{file} does not exist; name the file of a calibration.")
    elif suffix == ".toml":
        cameras, name = read_toml(file), "lfgpu"
    elif suffix == ".npy":
        (cameras, depths), name = read_llff(file), "LLFF"
    elif suffix in (".yaml", ".yml", ".json"):
        table = read_json_or_toml(file) if suffix == ".json" else read_yaml(file)
        listed = next(((read, name) for known, read, name in _OF_DEVICES if known(table)), None)
        if listed is not None:
            with entries_of(file):
                cameras, name = listed[0](table), listed[1]
        elif suffix == ".json" and isinstance(table, Mapping) and "frames" in table:
            cameras, name = nerfstudio_cameras(file, table), "nerfstudio"
        elif suffix != ".json" and is_kalibr(table):
            cameras, name = kalibr_cameras(file, table), "Kalibr"
        else:
            cameras, name = opencv_cameras(file, table), "OpenCV"
    else:
        raise LightFieldError(
            f"{file} is no calibration that is known: give a .toml, .yaml, .json or .npy file, or a folder of COLMAP."
        )
    if not cameras:
        raise LightFieldError(f"{file} has no cameras.")
    return Calibration(tuple(cameras), str(file), name, depths, tuple(rig))


_CENTIMETRE = UNITS["cm"]
_OF_DEVICES: tuple[tuple[Callable[[Any], bool], Callable[[Any], list[Camera]], str], ...] = (
    (is_google, google_cameras, "Google"),
    (is_depthai, depthai_cameras, "depthai"),
    (is_stereo, stereo_cameras, "OpenCV"),
)
