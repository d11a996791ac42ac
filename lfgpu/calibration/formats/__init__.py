"""Files of calibrations: a table of what is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.colmap import holds_colmap, read_colmap, read_rig
from lfgpu.calibration.formats.entries import read_yaml
from lfgpu.calibration.formats.kalibr import is_kalibr, kalibr_cameras
from lfgpu.calibration.formats.llff import read_llff
from lfgpu.calibration.formats.nerfstudio import nerfstudio_cameras
from lfgpu.calibration.formats.opencv import opencv_cameras
from lfgpu.calibration.formats.toml import read_toml, write_cameras
from lfgpu.errors import LightFieldError
from lfgpu.io.texts import read_json_or_toml

__all__ = ["BESIDE", "Calibration", "read_calibration", "read_toml", "write_cameras"]

BESIDE = ("cameras.toml", "poses_bounds.npy", "transforms.json", "camchain.yaml", "sparse/0", "sparse")
"""Names of calibrations that are looked for beside pictures, in this order."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a file says of cameras.

    Parameters
    ----------
    cameras
        The cameras, with names of pictures where the file has them.
    source
        The file.
    format
        What kind of file it is.
    depths
        Nearest and farthest depth of the scene; None if the file does not say.
    rig
        The cameras of a rig by themselves, where `cameras` are those of images that it took from several places; else
        empty.
    """

    cameras: tuple[Camera, ...]
    source: str
    format: str
    depths: tuple[float, float] | None = None
    rig: tuple[Camera, ...] = ()


def read_calibration(path: str | Path) -> Calibration:
    """Read calibrated cameras.

    Parameters
    ----------
    path
        cameras.toml (lfgpu's own), a YAML or JSON file of OpenCV, camchain.yaml of Kalibr, transforms.json of
        nerfstudio, poses_bounds.npy of LLFF, or a folder with a model of COLMAP.

    Raises
    ------
    LightFieldError
        If there is no such file, it is of another kind, or damaged; the sentence says which entry.
    """
    file = Path(path)
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
        if suffix == ".json" and isinstance(table, Mapping) and "frames" in table:
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
