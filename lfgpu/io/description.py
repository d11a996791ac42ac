"""lightfield.toml (or .json): a description of any array of cameras, by hand or by `lfgpu info --write`.

What may stand in it is in docs/formats.md. Files are named relative to the description; nothing in it is run.
"""

import json
import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_write, check_writable
from lfgpu.io.damage import naming, read_as
from lfgpu.io.images import check_size, read_mask
from lfgpu.io.map_formats import read_map
from lfgpu.io.pfm import write_pfm
from lfgpu.io.png import write_png
from lfgpu.io.texts import read_json_or_toml, to_toml
from lfgpu.io.views import load_views
from lfgpu.printable import printable

DEFAULT_NAME = "lightfield.toml"

_MOST_SHOWN = 80  # characters of a wrong value

_PLACES = ("principal_point", "unshifted_at")  # of the geometry; the rest of it are lengths
_TOLD = ("grid", "every", "order", "pattern", "frame", "axes", "unit", "transpose", "flip")
"""Options of `lfgpu.read` that a source may have."""
_KEYS = {
    "": {"name", "grid", "reference", "geometry", "truth", "source", "views"},
    "geometry": {"focal_length_px", "baseline_m", "focus_distance_m", "pixel_aspect", *_PLACES},
    "truth": {"disparity", "position", "mask"},
    "source": {"path", "format", *_TOLD},
    "views": {"file", "position", "valid"},
}
_NAMING = ("file", "valid", "disparity", "mask", "path")  # those of them that are names of files


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a description, or a folder with one; None if it is not."""
    if path.is_dir():
        return f"it is a folder with {DEFAULT_NAME}" if (path / DEFAULT_NAME).is_file() else None
    if path.name == DEFAULT_NAME or path.suffix.lower() in (".toml", ".json"):
        return f"it is a description ({path.suffix.lower().removeprefix('.')})" if path.is_file() else None
    return None


def read_description(
    path: Path, *, allow_missing: bool = False, read: Callable[..., LightField] | None = None
) -> LightField:
    """Read a light field from its description: a .toml or .json file, or a folder that holds lightfield.toml.

    `read` reads the light field of another format that a description with a `source` names; `allow_missing` is handed
    on to it. Errors name the entry of the description that is unknown or wrong.
    """
    file = path / DEFAULT_NAME if path.is_dir() else path
    with read_as(file):
        if not file.is_file():
            raise LightFieldError(f"{file} is not a description of a light field; name a .toml or .json file.")
    parsed = read_json_or_toml(file)
    with naming(file):
        table = _table(parsed, "")
        listed = _listed_views(table.get("views"))
        if (source := table.get("source")) is not None:
            light_field = _of_source(file, _table(source, "source"), listed, allow_missing, read)
        else:
            light_field = _of_files(file, listed)
        return replace(light_field, **_rest(file, table))


def named_by(path: Path) -> list[Path]:
    """Return the files and folders that a description names, there or not; none for all that is not a description."""
    try:
        if recognise(path) is None:
            return []
        file = path / DEFAULT_NAME if path.is_dir() else path
        table = _table(read_json_or_toml(file), "")
        tables = _listed_views(table.get("views"))
        tables += [_table(table[kind], kind) for kind in ("truth", "source") if kind in table]
    except (LightFieldError, OSError):  # whoever reads it says what is wrong
        return []
    names = [part[key] for part in tables for key in _NAMING if key in part]
    return [file.parent / name for name in names if isinstance(name, str)]


def write_description(light_field: LightField, path: str | os.PathLike[str], *, source: Mapping[str, Any]) -> None:
    """Write the description of a light field that was read from files, for `read_description` to read back.

    Views with files of their own are named one by one. Otherwise the description names the `source`, `path`, `format`
    and what else `lfgpu.read` was told, which is read again, and the positions of its views. Ground truth goes into
    files beside it: NAME.truth.pfm, NAME.mask.png; so does the validity of views: NAME.valid_000.png and so on.
    """
    target = named(path)
    if target.suffix.lower() not in (".toml", ".json"):
        raise LightFieldError(f"{target} must be named .toml or .json.")
    check_writable(target, folder=False)
    folder = target.resolve().parent
    table: dict[str, Any] = {"name": light_field.name, "reference": light_field.reference_index}
    if light_field.grid_shape is not None:
        table["grid"] = list(light_field.grid_shape)
    if light_field.geometry is not None:
        table["geometry"] = _geometry_table(light_field.geometry)
    places = [[float(u), float(v)] for u, v in light_field.positions]
    if light_field.files:
        table["views"] = [
            {"file": _relative(name, folder), "position": place}
            for name, place in zip(light_field.files, places, strict=True)
        ]
        if light_field.valid is not None:
            for index, (view, mask) in enumerate(zip(table["views"], light_field.valid, strict=True)):
                view["valid"] = _write_mask(mask, target.with_name(f"{target.stem}.valid_{index:03d}.png"))
        if light_field.truth is not None:
            table["truth"] = _write_truth(light_field.truth, target)
    else:
        table["source"] = {
            key: _relative(value, folder) if key == "path" else list(value) if key == "grid" else value
            for key, value in source.items()
            if value
        }
        table["views"] = [{"position": place} for place in places]
    text = json.dumps(table, indent=1, ensure_ascii=False) if target.suffix.lower() == ".json" else to_toml(table)
    try:
        content = text.encode()
    except UnicodeEncodeError as error:
        raise LightFieldError(f"{target} cannot be written: a file has a name that is not UTF-8; rename it.") from error
    with atomic_write(target) as temporary:
        temporary.write_bytes(content)


# --- reading ---


def _listed_views(views: Any) -> list[Mapping[str, Any]]:
    if views is None:
        return []
    if not isinstance(views, list):
        raise LightFieldError("views must be a list, one [[views]] for each.")
    return [_table(view, "views", f"views[{index}]") for index, view in enumerate(views)]


def _of_files(file: Path, listed: list[Mapping[str, Any]]) -> LightField:
    if len(listed) < 2:
        raise LightFieldError(f"it lists {len(listed)} views; depth needs at least two, each with file and position.")
    images = [_file(file, view, f"views[{index}]", "file") for index, view in enumerate(listed)]
    where = _positions(listed)
    views, valid, notes = load_views(images)
    if any("valid" in view for view in listed):
        valid = np.ones(views.shape[:3], np.bool_) if valid is None else valid
        for index, view in enumerate(listed):
            if "valid" in view:
                name = _file(file, view, f"views[{index}]", "valid")
                mask = read_mask(name)
                check_size(name, mask, views.shape[1:3])
                valid[index] &= mask
    return LightField(views, where, valid=valid, files=tuple(map(str, images)), notes=notes)


def _of_source(
    file: Path,
    source: Mapping[str, Any],
    listed: list[Mapping[str, Any]],
    allow_missing: bool,
    read: Callable[..., LightField] | None,
) -> LightField:
    path = source.get("path")
    chosen = source.get("format")
    if read is None or not isinstance(path, str) or not isinstance(chosen, str) or chosen == "lightfield-toml":
        raise LightFieldError("source must name a path and its format, one that `lfgpu.read` knows.")
    options = {name: value for name, value in source.items() if name in _TOLD}
    if "grid" in source:
        options["grid"] = _pair(source["grid"], "source.grid", whole=True)
    with naming("source"):
        light_field = read(file.parent / path, format=chosen, allow_missing=allow_missing, **options)
    if not listed:
        return light_field
    if len(listed) != len(light_field.views):
        raise LightFieldError(f"it lists {len(listed)} views, {path} has {len(light_field.views)}.")
    if any(set(view) != {"position"} for view in listed):
        raise LightFieldError("beside a source, views have a position and nothing else.")
    where = _positions(listed)
    truth = light_field.truth
    if truth is not None:
        index = light_field.index_of(truth.position[1], truth.position[0])
        truth = replace(truth, position=(float(where[index, 0]), float(where[index, 1])))
    return replace(light_field, positions=where, grid_shape=None, truth=truth)


def _rest(file: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of the light field that the description gives for the whole."""
    fields: dict[str, Any] = {}
    fields["name"] = table.get("name", file.resolve().parent.name if file.name == DEFAULT_NAME else file.stem)
    if not isinstance(fields["name"], str):
        raise LightFieldError(f"name must be a text, not {_shown(fields['name'])}.")
    if "grid" in table:
        fields["grid_shape"] = _pair(table["grid"], "grid", whole=True)
    if "reference" in table:
        fields["reference"] = _whole(table["reference"], "reference", least=0)
    if "geometry" in table:
        fields["geometry"] = _geometry(_table(table["geometry"], "geometry"))
    if "truth" in table:
        fields["truth"] = _truth(file, _table(table["truth"], "truth"))
    return fields


def _geometry(table: Mapping[str, Any]) -> Geometry:
    for key in ("focal_length_px", "baseline_m"):
        if key not in table:
            raise LightFieldError(f"geometry has no {key}; add it or leave geometry out.")
    fields: dict[str, Any] = {
        key: (_pair if key in _PLACES else _number)(value, f"geometry.{key}") for key, value in table.items()
    }
    return Geometry(**fields)


def _truth(file: Path, table: Mapping[str, Any]) -> GroundTruth:
    if "disparity" not in table or "position" not in table:
        raise LightFieldError("truth must have a file of disparity and the position of its view.")
    disparity = read_map(_file(file, table, "truth", "disparity"))
    mask = read_mask(_file(file, table, "truth", "mask")) if "mask" in table else None
    position = _pair(table["position"], "truth.position")
    return GroundTruth(np.where(np.isfinite(disparity), disparity, np.float32(np.nan)), position, mask)


def _positions(listed: list[Mapping[str, Any]]) -> NDArray[np.float64]:
    for index, view in enumerate(listed):
        if "position" not in view:
            raise LightFieldError(f"views[{index}] has no position = [u, v].")
    pairs = [_pair(view["position"], f"views[{index}].position") for index, view in enumerate(listed)]
    return np.array(pairs, np.float64)


def _table(value: Any, kind: str, name: str = "") -> Mapping[str, Any]:
    what, known = name or kind or "a description", ", ".join(sorted(_KEYS[kind]))
    if not isinstance(value, dict):
        raise LightFieldError(f"{what} must be a table of {known}.")
    if unknown := sorted(set(value) - _KEYS[kind]):
        calibration = not kind and not {"frames", "cameras", "cameraData"}.isdisjoint(unknown)
        raise LightFieldError(
            f"{what} has an unknown entry {_shown(unknown[0])}; known are {known}."
            + " It looks like a calibration, which lfgpu rectify takes (--calibration)." * calibration
        )
    return value


def _file(file: Path, table: Mapping[str, Any], name: str, key: str) -> Path:
    if not isinstance(table.get(key), str) or not table[key]:
        raise LightFieldError(f"{name} has no {key}, the name of a file.")
    found = file.parent / table[key]
    with suppress(OSError, ValueError):  # too long a name, a zero byte
        if found.is_file():
            return found
    raise LightFieldError(f"{name}.{key} names {found}, which is not a file.")


def _number(value: Any, name: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and not math.isnan(value):
            return float(value)
    except OverflowError:
        raise LightFieldError(f"{name} is too large a number.") from None
    raise LightFieldError(f"{name} must be a number, not {_shown(value)}.")


def _shown(value: Any) -> str:
    try:
        return printable(repr(value), longest=_MOST_SHOWN)
    except ValueError:  # Python writes no number of more than 4300 digits
        return "a number of thousands of digits"


def _whole(value: Any, name: str, least: int = 1) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= 10**6:
        raise LightFieldError(f"{name} must be a whole number from {least} to 1000000, not {_shown(value)}.")
    return value


def _pair(value: Any, name: str, *, whole: bool = False) -> tuple[Any, Any]:
    if not isinstance(value, list) or len(value) != 2:
        raise LightFieldError(f"{name} must be a pair of numbers, not {_shown(value)}.")
    part = _whole if whole else _number
    return part(value[0], name), part(value[1], name)


# --- writing ---


def _geometry_table(geometry: Geometry) -> dict[str, Any]:
    told = {key: value for key, value in asdict(geometry).items() if value not in (None, math.inf)}
    if geometry.pixel_aspect == 1:
        del told["pixel_aspect"]
    return {key: [float(x) for x in value] if isinstance(value, tuple) else float(value) for key, value in told.items()}


def _write_truth(truth: GroundTruth, target: Path) -> dict[str, Any]:
    disparity = target.with_name(f"{target.stem}.truth.pfm")
    write_pfm(disparity, truth.disparity)
    table: dict[str, Any] = {"disparity": disparity.name, "position": [float(place) for place in truth.position]}
    if truth.mask is not None:
        table["mask"] = _write_mask(truth.mask, target.with_name(f"{target.stem}.mask.png"))
    return table


def _write_mask(mask: NDArray[np.bool_], target: Path) -> str:
    with atomic_write(target) as temporary:
        write_png(temporary, mask[..., None])
    return target.name


def _relative(name: str | os.PathLike[str], folder: Path) -> str:
    try:
        return Path(os.path.relpath(Path(name).resolve(), folder)).as_posix()
    except ValueError:  # another drive
        return str(Path(name).resolve())
