"""The views of a decoded capture as files that can be read again."""

from __future__ import annotations

import json
import os
import re
from typing import TYPE_CHECKING

from lfgpu.io.atomic import atomic_folder, check_no_others
from lfgpu.io.png import write_png

if TYPE_CHECKING:
    from lfgpu.io.lenslet.decode import Decoded

ABOUT_FILE = "lenslet.json"

_VIEW = re.compile(r"view_[0-9]+_[0-9]+\.png")


def write_decoded(decoded: Decoded, out: str | os.PathLike[str]) -> list[str]:
    """Write view_row_col.png (16 bits) and lenslet.json, all or nothing, not beside other views; returns names."""
    lf = decoded.light_field
    names = [f"view_{round(v):02d}_{round(u):02d}.png" for u, v in lf.positions]
    check_no_others(out, names, _VIEW)
    with atomic_folder(out) as folder:
        for name, view in zip(names, lf.views, strict=True):
            write_png(folder / name, view)
        (folder / ABOUT_FILE).write_text(json.dumps(decoded.about, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return [*names, ABOUT_FILE]
