"""Files of calibrations: a table of what is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.colmap import holds_colmap, read_colmap, read_rig
from lfgpu.calibration.formats.kalibr import is_kalibr, read_kalibr
from lfgpu.calibration.formats.llff import read_llff
from lfgpu.calibration.formats.nerfstudio import read_nerfstudio
from lfgpu.calibration.formats.opencv import read_opencv, yaml_or_json
from lfgpu.calibration.formats.toml import read_toml, write_cameras
from lfgpu.errors import LightFieldError

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
    elif suffix == ".json" and '"frames"' in file.read_text(encoding="utf-8", errors="replace"):
        cameras, name = read_nerfstudio(file), "nerfstudio"
    elif suffix in (".yaml", ".yml") and is_kalibr(yaml_or_json(file)):
        cameras, name = read_kalibr(file), "Kalibr"
    elif suffix in (".yaml", ".yml", ".json"):
        cameras, name = read_opencv(file), "OpenCV"
    else:
        raise LightFieldError(
            f"{file} is no calibration that is known: give a .toml, .yaml, .json or .npy file, or a folder of COLMAP."
        )
    return Calibration(tuple(cameras), str(file), name, depths, tuple(rig))
