"""The views of a decoded capture as files that can be read again."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_folder
from lfgpu.io.png import write_png

if TYPE_CHECKING:
    from lfgpu.io.lenslet.decode import Decoded

ABOUT_FILE = "lenslet.json"

_VIEW = re.compile(r"view_[0-9]+_[0-9]+\.png")


def write_decoded(decoded: Decoded, out: str | os.PathLike[str]) -> list[str]:
    """Write view_row_col.png (16 bits) and lenslet.json, all or nothing, not beside other views; returns names."""
    lf = decoded.light_field
    names = [f"view_{round(v):02d}_{round(u):02d}.png" for u, v in lf.positions]
    check_no_others(Path(out), names)
    with atomic_folder(out) as folder:
        for name, view in zip(names, lf.views, strict=True):
            write_png(folder / name, view)
        (folder / ABOUT_FILE).write_text(json.dumps(decoded.about, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return [*names, ABOUT_FILE]


def check_no_others(out: Path, names: list[str]) -> None:
    """Raise LightFieldError if a folder holds views that would stay beside those of these names."""
    if not out.is_dir():
        return
    if others := sorted(path.name for path in out.iterdir() if _VIEW.fullmatch(path.name) and path.name not in names):
        raise LightFieldError(f"{out} holds other views already, such as {others[0]}; choose an empty folder.")
