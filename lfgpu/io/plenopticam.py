"""Folders that PlenoptiCam exports: viewpoints_9px with 0_0.png ... 8_8.png, row and column."""

import re
from dataclasses import replace
from pathlib import Path

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.brightness import without_dark_parts
from lfgpu.io.folders import sub_folders
from lfgpu.io.grid import check_told
from lfgpu.io.numbered import read_numbered

_FOLDER = re.compile(r"viewpoints_([0-9]{1,3})(?:px|x[0-9]{1,3})?")


def recognise(path: Path) -> str | None:
    """Say why a path is taken for an export of PlenoptiCam; None if it is not."""
    folders = _folders(path)
    return f"it has the views in {folders[0].name}, as PlenoptiCam writes them" if folders else None


def read_plenopticam(path: Path, *, allow_missing: bool = False) -> LightField:
    """Read the folder of viewpoints that PlenoptiCam wrote, or the folder around it.

    Pixels that are less than half as bright as the middle view, at the rim of the main lens, are marked as not valid. A
    grid that seems to have lost some views is an error without `allow_missing`.
    """
    folders = _folders(path)
    if not folders:
        raise LightFieldError(
            f"{path} has no folder viewpoints_9px or the like; give the folder that PlenoptiCam wrote."
        )
    if len(folders) > 1:
        raise LightFieldError(f"{path} has several exports ({', '.join(folder.name for folder in folders)}); give one.")
    light_field = read_numbered(folders[0], allow_missing=allow_missing)
    match = _FOLDER.fullmatch(folders[0].resolve().name) or _FOLDER.fullmatch(folders[0].name)
    side = int(match[1]) if match else 0
    if side and not allow_missing:
        check_told(folders[0], light_field, (side, side))
    return without_dark_parts(path, replace(light_field, name=path.resolve().name))


def _folders(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    if _FOLDER.fullmatch(path.name):
        return [path]
    return [folder for folder in sub_folders(path) if _FOLDER.fullmatch(folder.name)]
