"""Sources that the figures of a result file depend on, and their hash, which tells whether the file is stale."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]

_MAPS = ("kernels/warp", "lfgpu/contract", "lfgpu/methods", "lfgpu/solvers", "lfgpu/metrics.py")
_STREAMS = (*_MAPS, "lfgpu/pipelines/*.py")  # frames come from memory, by none of its `sources`
_REFINED = tuple(f"lfgpu/calibration/{name}.py" for name in ("cameras", "misalign", "parallel", "refine", "resample"))
_CAMERAS = (*_REFINED, "lfgpu/cameras", "kernels/warp")
SOURCES: Mapping[str, tuple[str, ...]] = {
    "ablation": (*_MAPS, "lfgpu/scenes"),
    "batches": (*_STREAMS, "lfgpu/batch", "lfgpu/io"),
    "call": (*_STREAMS, "lfgpu/cameras"),
    "confidence": (*_MAPS, "lfgpu/cameras"),
    "flicker": _STREAMS,
    "gpu_parity": ("kernels", "lfgpu/contract", "lfgpu/methods", "lfgpu/solvers", "tests/kernels"),
    "judge": _CAMERAS,
    "like": (*_MAPS, "lfgpu/scenes", "lfgpu/training"),
    "live": _STREAMS,
    "measuring": (*_MAPS, "lfgpu/pipelines/estimate.py"),
    "misalignment": (*_CAMERAS, *_MAPS),
    "pairs": (*_STREAMS, "lfgpu/cameras", "lfgpu/cli", "lfgpu/io"),
    "paper": ("kernels", *_MAPS, "lfgpu/io/lenslet", "tests/printed.py"),
    "population": (*_MAPS, "lfgpu/scenes"),
    "rectify": (*_STREAMS, "lfgpu/calibration"),
    "rendering": (*_MAPS, "lfgpu/viz/rendering.py"),
    "scaling": _STREAMS,
    "soak": _STREAMS,
    "suite": ("kernels", *_STREAMS, "benchmarks/operations.py", "benchmarks/pipelines.py"),
    "tile_differences": _STREAMS,
}
"""By benchmark: folders and files, as patterns, that its figures depend on, beside its own module."""

_OTHERS = (".h", ".cuh", ".cpp", ".toml", ".npz")


def stamp(benchmark: str) -> dict[str, str]:
    """Return the entry `sources` of a result file: the benchmark, and the hash of its sources."""
    return {"benchmark": benchmark, "hash": hash_of(benchmark)}


def is_stale(content: Any) -> bool:
    """Tell whether a result file, read from JSON, was measured with other sources than those that are here."""
    entry = content.get("sources", {})
    return entry.get("benchmark") not in SOURCES or entry.get("hash") != hash_of(entry["benchmark"])


@cache
def hash_of(benchmark: str, root: Path = ROOT) -> str:
    """Hash the sources of a benchmark: names of files, code without comments and docstrings, and weights."""
    found = hashlib.sha256()
    for path in sorted(set(_files(root, (*SOURCES[benchmark], f"benchmarks/{benchmark}.py")))):
        found.update(f"{path.relative_to(root).as_posix()}\n".encode())
        found.update(_content(path))
        found.update(b"\n")
    return found.hexdigest()[:16]


@cache
def _content(path: Path) -> bytes:
    """Return the shape of code, or what another file holds; most files are sources of several benchmarks."""
    return _shape(ast.parse(path.read_text(encoding="utf-8"))).encode() if path.suffix == ".py" else path.read_bytes()


def _files(root: Path, places: Iterable[str]) -> Iterator[Path]:
    for path in (path for place in places for path in root.glob(place)):
        found = [path] if path.is_file() else path.rglob("*")
        yield from (file for file in found if file.suffix in (".py", *_OTHERS))


def _shape(node: Any) -> str:
    """Write code so that comments, docstrings, line breaks and the version of Python make no difference."""
    if isinstance(node, list):
        return "".join(_shape(one) for one in node if not _is_text(one))
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = (f"{name}={_shape(value)}" for name, value in ast.iter_fields(node) if value not in (None, []))
    return f"{type(node).__name__}({' '.join(fields)})"


def _is_text(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
