"""Surfaces as GLB whose colours are seen as they are: without light, and with the tone mapping of viser undone."""

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# The tone mapping of three.js that viser leaves switched on (ACES, a fit by S. Hill): two matrices, between them a
# quotient of polynomials.
_INTO = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_OUT_OF = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_ABOVE, _BELOW = (1.0, 0.0245786, -0.000090537), (0.983729, 0.4329510, 0.238081)
_EXPOSURE = 0.6
_WHITEST = 1.0  # of what the quotient gives: its limit is 1.0165

_FLOAT, _WHOLE = 5126, 5125  # component types of glTF


def surface_glb(points: ArrayLike, triangles: ArrayLike, colours: NDArray[np.uint8]) -> bytes:
    """Write a surface with a colour [n, 3] at each of its points [n, 3]."""
    arrays = [
        (np.ascontiguousarray(triangles, np.uint32).ravel(), _WHOLE, "SCALAR"),
        (np.ascontiguousarray(points, np.float32), _FLOAT, "VEC3"),
        (before_tones(colours).astype(np.float32), _FLOAT, "VEC3"),
    ]
    accessors: list[dict[str, Any]] = []
    views, at = [], 0
    for number, (values, kind, shape) in enumerate(arrays):
        ends = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if shape == "VEC3" else {}
        accessors.append({"bufferView": number, "componentType": kind, "count": len(values), "type": shape, **ends})
        views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes})
        at += values.nbytes
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}, "doubleSided": True}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1, "COLOR_0": 2}, "indices": 0, "material": 0}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    content = b"".join(values.tobytes() for values, _, _ in arrays)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(content))
    return (
        header + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    )


def before_tones(colours: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Compute the intensities [n, 3] that tone mapping turns into colours [n, 3] of a screen."""
    share = colours / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    mapped = np.clip(light @ np.linalg.inv(_OUT_OF).T, 0, _WHITEST)
    a, b, c = (above - mapped * below for above, below in zip(_ABOVE, _BELOW, strict=True))
    found = (np.sqrt(b * b - 4 * a * c) - b) / (2 * a)
    return np.maximum(_EXPOSURE * found @ np.linalg.inv(_INTO).T, 0)
