"""Metadata of a written map, one JSON text: all that it takes to read the map right."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lfgpu.contract import Float32Array
from lfgpu.data import DisparityMap, Geometry
from lfgpu.errors import LightFieldError
from lfgpu.machine import version_of

DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Errors that come of metadata that are not what they have to be."""

KEY = "lfgpu"
"""Name of the text where metadata have names."""

UNKNOWN_IS_NAN = "NaN is not known"
"""Words of the metadata about unknown pixels, where the format has NaN."""

CONVENTION = (
    "Disparity in pixels per view step, larger is nearer: the point at (x, y) of the reference view is at "
    "(x - d*du, y - d*dv) in the view du steps to the right of and dv steps below it."
)


def map_about(values: DisparityMap, **format_specific: Any) -> str:
    """Return the text of a map, in ASCII on one line; `format_specific` says what the format does to the values."""
    return json.dumps(
        {
            KEY: version_of("lfgpu") or "not installed",
            "content": "disparity",
            "unit": "pixels per view step",
            "convention": CONVENTION,
            "position": None if values.position is None else list(values.position),
            "position_means": "(u, v): column and row of the view that the map belongs to, counted from 0",
            "geometry": None if values.geometry is None else geometry_about(values.geometry),
            "name": values.name,
            "versions": values.versions,
            **format_specific,
        },
        allow_nan=False,
    )


def parse_about(path: Path, text: str) -> dict[str, Any]:
    """Parse the text in the file of a map; LightFieldError that names the file if it is none of ours."""
    try:
        about = json.loads(text)
        if about["content"] != "disparity":
            raise ValueError(f"it holds {about['content']}")
    except DAMAGE as error:
        raise LightFieldError(f"{path} is a damaged map of lfgpu: its metadata cannot be read.") from error
    return dict(about)


def map_of(
    path: Path,
    about: Mapping[str, Any],
    disparity: Float32Array,
    confidence: Float32Array | None,
    uncertainty: Float32Array | None = None,
) -> DisparityMap:
    """Make the map of its values and metadata; LightFieldError that names the file if they are damaged."""
    try:
        position, geometry = about["position"], about["geometry"]
        return DisparityMap(
            disparity,
            confidence,
            position=None if position is None else (float(position[0]), float(position[1])),
            geometry=None if geometry is None else geometry_of(geometry),
            name=str(about["name"]),
            versions=dict(about["versions"]),
            uncertainty=uncertainty,
        )
    except DAMAGE as error:
        raise LightFieldError(f"{path} is a damaged map of lfgpu: its metadata are incomplete.") from error


def geometry_about(geometry: Geometry) -> dict[str, Any]:
    """Return a geometry as JSON takes it: the focus distance of frames that are not shifted is null."""
    values = asdict(geometry)
    if math.isinf(geometry.focus_distance_m):
        values["focus_distance_m"] = None
    return values


def geometry_of(about: Mapping[str, Any]) -> Geometry:
    """Return the geometry that `geometry_about` described; entries that older files lack are as they were then."""
    known = {name: value for name, value in about.items() if value is not None}
    return Geometry(
        **{name: tuple(map(float, v)) if isinstance(v, list) else float(v) for name, v in known.items()}  # type: ignore[arg-type]
    )
