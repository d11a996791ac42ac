"""A sight of the viewer as one HTML file that needs no server and no network: the page itself, with its data inside."""

import base64
import io
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import suppress
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lfgpu.errors import LightFieldError
from lfgpu.viewer import pictures
from lfgpu.viewer.contents import Contents
from lfgpu.viewer.facts import fixed, still
from lfgpu.viewer.probe import difference

_PAGE = Path(__file__).parent / "page"
_QUALITY = 90  # of the views, as WebP
_MOST = 60e6  # bytes of the file: larger ones are of no use to readers
_KEPT_BITS = np.uint32(0xFFFFFC00)  # of the numbers of maps: 13 binary digits behind the first


def standalone(contents: Contents, sight: str) -> bytes:
    """Write the page with all views and maps of `contents`, opened at a sight: the part of an address after "#"."""
    if contents.size is None:
        raise LightFieldError("there is nothing to show yet: open a light field or a map.")
    lf, state = contents.lf, still(contents)
    data = {
        "fixed": fixed(),
        "state": state,
        "sight": sight,
        "views": [] if lf is None else [_webp(pictures.intensities(view, lf)) for view in lf.views],
        "thumbnails": None if lf is None else _array(pictures.thumbnails(lf)),
        "maps": {
            result["name"]: {kind: _map(contents.map(result["name"], kind)) for kind in result["kinds"]}
            for result in state["results"]
        },
        "differences": dict(_differences(contents, [result["name"] for result in state["results"]])),
    }
    text = _page(json.dumps(data).replace("<", "\\u003c"))
    if len(text) > _MOST:
        raise LightFieldError(
            f"the page would have {len(text) / 1e6:.0f} MB, more than {_MOST / 1e6:.0f}: take fewer or smaller views."
        )
    return text.encode()


def _page(data: str) -> str:
    """Put scripts, styles and data into the page."""
    modules = {}
    for file in _PAGE.glob("*.js"):
        name = "server" if file.stem == "offline" else file.stem  # in place of what asks the server
        if file.stem != "server":
            code = re.sub(r'from "\./([\w.]+)"', r'from "lfgpu/\1"', file.read_text(encoding="utf-8"))
            modules[f"lfgpu/{name}.js"] = f"data:text/javascript;base64,{base64.b64encode(code.encode()).decode()}"
    page = (_PAGE / "index.html").read_text(encoding="utf-8")
    page = page.replace('<link rel="icon" href="icon.svg">\n', "").replace("<body ", '<body class="standalone" ')
    for sheet in ("style.css", "vendor/uPlot.min.css"):
        style = (_PAGE / sheet).read_text(encoding="utf-8")
        page = page.replace(f'<link rel="stylesheet" href="{sheet}">', f"<style>{style}</style>")
    plots = (_PAGE / "vendor/uPlot.iife.min.js").read_text(encoding="utf-8")
    page = page.replace('<script defer src="vendor/uPlot.iife.min.js"></script>', f"<script>{plots}</script>")
    begin = (
        f'<script type="application/json" id="data">{data}</script>\n'
        f'<script type="importmap">{json.dumps({"imports": modules})}</script>\n'
        '<script type="module">import "lfgpu/main.js";</script>'
    )
    return page.replace('<script type="module" src="main.js"></script>', begin)


def _differences(contents: Contents, names: list[str]) -> Iterator[tuple[str, Any]]:
    """Describe the difference of all pairs of maps."""
    for first, second in permutations(names, 2):
        for kind in set(contents.kinds(first)) & set(contents.kinds(second)):
            with suppress(LightFieldError), np.errstate(invalid="ignore"):  # nothing is known in both
                apart = contents.map(first, kind) - contents.map(second, kind)  # type: ignore[operator]
                yield f"{kind}|{first}|{second}", difference(apart, kind)


def _webp(view: NDArray[Any]) -> str:
    file, grey = io.BytesIO(), view if view.dtype == np.uint8 else (view >> 8).astype(np.uint8)
    colours = np.ascontiguousarray(np.broadcast_to(grey, (*grey.shape[:2], 3)))
    Image.fromarray(colours).save(file, "WEBP", quality=_QUALITY)
    return base64.b64encode(file.getvalue()).decode()


def _map(values: NDArray[np.float32] | None) -> dict[str, Any]:
    assert values is not None
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    return _array(np.where(np.isfinite(values), bits + np.uint32(0x200), bits).astype(np.uint32) & _KEPT_BITS)


def _array(values: NDArray[Any]) -> dict[str, Any]:
    packed = zlib.compress(np.ascontiguousarray(values).tobytes(), 6)
    return {"shape": values.shape, "data": base64.b64encode(packed).decode()}
