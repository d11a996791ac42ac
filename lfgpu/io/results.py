"""NumPy files of whole results, the maps as arrays and everything else as one JSON text, and of maps alone.

The arrays of a result are `disparity`, `confidence`, the map after each stage as `stage_NAME` (such as `stage_sweep`)
and, with a geometry, `depth` in metres, all float32 [y, x]; `trace`, float64; and `lfgpu`, the rest as one JSON text.

Those of the maps of all views are `disparities` and `confidences`, float32 [n, y, x], with a geometry also `depths` in
metres; `positions`, float64 [n, 2], (u, v) of each view; `keys`, the indices of those that were estimated themselves;
`convention`, a sentence; `timings`, a JSON text; and the result of the reference view with "reference_" before names.
"""

import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.config import as_dict, restored
from lfgpu.contract import Float32Array
from lfgpu.data import DepthResult, DisparityMap, ViewsResult
from lfgpu.errors import LightFieldError
from lfgpu.io.about import (
    CONVENTION,
    DAMAGE,
    UNKNOWN_IS_NAN,
    geometry_about,
    geometry_of,
    map_about,
    map_of,
    parse_about,
)
from lfgpu.io.folders import head, not_waited_for
from lfgpu.io.numpy_file import MAGIC, header, load_arrays
from lfgpu.methods import METHODS
from lfgpu.printable import printable

ABOUT_KEY = "lfgpu"
"""The array of the .npz that holds the JSON text; other .npz files have none of that name."""

VIEWS_CONVENTION = (
    "Disparity in pixels per view step, larger is nearer: the point at (x, y) of view a is at "
    "(x - d*(u_b - u_a), y - d*(v_b - v_a)) in view b, with (u, v) their positions."
)

NPZ_KEY = "lfgpu_map"
"""The array of an .npz that holds the metadata of a map by itself."""

_AXES = 2  # of a map
_MAP_KEY = "disparity"  # the array that is taken for the map
_STAGE = "stage_"  # what the names of the stages' arrays begin with
_REFERENCE = "reference_"  # what those of the reference view begin with among the maps of all views
_TEXTS = ("name", "status", "backend", "device")
_OTHERS = ("position", "disparity_range", "notes", "remarks", "converged", "versions", "timings")
"""Fields of a result that stand in its JSON text as they are."""
_LAYOUT = 2  # goes up when a file of the old layout can no longer be read as one of the new


def write_whole(result: DepthResult | ViewsResult, path: Path) -> None:
    """Write a result with everything, or the maps of all views."""
    store(path, arrays_of_result(result) if isinstance(result, DepthResult) else arrays_of_views(result))


def read_whole(path: Path) -> DepthResult | ViewsResult | None:
    """Read what `write_whole` wrote, also in a version of lfgpu with other parameters; None for other archives."""
    if holds_views(path):
        return _views_of(path, load_arrays(path, of_maps=True))
    return _result_of(path, load_arrays(path, of_maps=True)) if has_array(path, ABOUT_KEY) else None


def _views_of(path: Path, arrays: Mapping[str, NDArray[Any]]) -> ViewsResult:
    own = {name.removeprefix(_REFERENCE): a for name, a in arrays.items() if name.startswith(_REFERENCE)}
    reference = _result_of(path, own)
    with _damage_named(path):
        result = ViewsResult(
            arrays["disparities"],
            arrays["confidences"],
            arrays["positions"],
            tuple(int(key) for key in arrays["keys"]),
            reference,
            {str(name): float(seconds) for name, seconds in json.loads(str(arrays["timings"])).items()},
        )
        _check_views(result)
    return result


def _result_of(path: Path, arrays: Mapping[str, NDArray[Any]]) -> DepthResult:
    with _damage_named(path):
        about = json.loads(str(arrays[ABOUT_KEY]))
        known = about["layout"] == _LAYOUT and about["config"].get("method") in METHODS
        result = _result(arrays, about) if known else None
        if result is not None:
            maps = {"disparity": result.disparity, "confidence": result.confidence, "uncertainty": result.uncertainty}
            shape = (*result.disparity.shape, 0, 0)[:2]  # which no other than [y, x] has
            _check(maps | result.stages, np.float32, shape)
            return result
    raise LightFieldError(
        f"{path} was written by a later version of lfgpu, or by a method that this one does not have; "
        "the maps beside it, such as disparity.pfm, can still be read."
    )


def holds_views(path: Path) -> bool:
    """Tell whether a file is an .npz with the maps of all views, going by the names of its arrays only."""
    return has_array(path, f"{_REFERENCE}{ABOUT_KEY}")


def has_array(path: Path, name: str) -> bool:
    """Tell whether a file is an .npz with an array of that name; False for a damaged one."""
    try:
        not_waited_for(path)
        with zipfile.ZipFile(path) as archive:
            return f"{name}.npy" in archive.namelist()
    except Exception:  # zipfile raises whatever comes to it when a file is damaged; who reads it says what it is
        return False


def arrays_of_views(result: ViewsResult) -> dict[str, NDArray[Any]]:
    """Return the arrays of the maps of all views, by name."""
    arrays: dict[str, NDArray[Any]] = {
        "disparities": result.disparities,
        "confidences": result.confidences,
        "positions": result.positions,
        "keys": np.asarray(result.keys),
        "convention": np.array(VIEWS_CONVENTION),
        "timings": np.array(json.dumps(result.timings, allow_nan=False)),
        **{f"{_REFERENCE}{name}": values for name, values in arrays_of_result(result.reference).items()},
    }
    if (depths := result.depths) is not None:
        arrays["depths"] = depths
    return arrays


def arrays_of_result(result: DepthResult) -> dict[str, NDArray[Any]]:
    """Return the arrays of a result, by name."""
    arrays: dict[str, NDArray[Any]] = {
        "disparity": result.disparity,
        "confidence": result.confidence,
        **{f"{_STAGE}{name}": values for name, values in result.stages.items()},
        "trace": np.asarray(result.trace, np.float64),
        ABOUT_KEY: np.array(json.dumps(_about(result), allow_nan=False, ensure_ascii=False)),
    }
    if result.depth is not None:
        arrays["depth"] = result.depth
    if result.uncertainty is not None:
        arrays["uncertainty"] = result.uncertainty
    return arrays


def store(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays as .npz to a path that is there to be written."""
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)  # to pack them would save a sixth, in 60 times the time


def _about(result: DepthResult) -> dict[str, Any]:
    return {
        "layout": _LAYOUT,
        "convention": CONVENTION,
        **{name: getattr(result, name) for name in (*_TEXTS, *_OTHERS)},
        "geometry": None if result.geometry is None else geometry_about(result.geometry),
        "config": as_dict(result.config),
    }


def _result(arrays: Mapping[str, NDArray[Any]], about: Mapping[str, Any]) -> DepthResult:
    u, v = map(float, about["position"])
    low, high = map(float, about["disparity_range"])
    return DepthResult(
        **{name: str(about[name]) for name in _TEXTS},
        disparity=arrays["disparity"],
        confidence=arrays["confidence"],
        stages={name.removeprefix(_STAGE): values for name, values in arrays.items() if name.startswith(_STAGE)},
        position=(u, v),
        disparity_range=(low, high),
        config=restored(about["config"], METHODS[about["config"]["method"]].presets),  # parameters come and go
        converged=bool(about["converged"]),
        versions=dict(about["versions"]),
        trace=tuple(map(float, arrays["trace"])),
        timings={str(name): float(seconds) for name, seconds in about["timings"].items()},
        geometry=None if about["geometry"] is None else geometry_of(about["geometry"]),
        uncertainty=arrays.get("uncertainty"),
        notes=tuple(map(str, about.get("notes", ()))),
        remarks=tuple(printable(str(sentence)) for sentence in about.get("remarks", [])),
    )


def _check(arrays: Mapping[str, NDArray[Any] | None], dtype: type[np.generic], shape: tuple[int, ...]) -> None:
    """Raise ValueError unless arrays, as far as they are there, have a type and a shape."""
    for name, values in arrays.items():
        if values is not None and (values.dtype != dtype or values.shape != shape):
            raise ValueError(f"{name} is {values.dtype} of shape {values.shape}, not {np.dtype(dtype)} {shape}")


def _check_views(result: ViewsResult) -> None:
    count = result.disparities.shape[0] if result.disparities.ndim else 0
    maps = {"disparities": result.disparities, "confidences": result.confidences}
    _check(maps, np.float32, (count, *result.reference.disparity.shape))
    _check({"positions": result.positions}, np.float64, (count, 2))
    if not np.isfinite(result.positions).all():
        raise ValueError("positions are not finite")
    if not all(0 <= key < count for key in result.keys):
        raise ValueError(f"keys name views beyond the {count} that it has")


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    try:
        yield
    except DAMAGE as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise LightFieldError(f"{path} is a damaged result of lfgpu: {reason}.") from error


# --- maps alone ---


def recognise_npz(path: Path) -> bool:
    """Tell whether an archive holds a map or those of all views, going by the names of its arrays."""
    return has_array(path, _MAP_KEY) or holds_views(path)


def write_npz(values: DisparityMap, path: Path, image: NDArray[Any] | None) -> None:
    """Write `disparity`, `confidence`, `uncertainty` and `depth` as far as known, and the metadata as a text."""
    store(path, values.known_maps | {NPZ_KEY: np.array(map_about(values, invalid=UNKNOWN_IS_NAN))})


def read_npz(path: Path) -> DisparityMap:
    """Read the array `disparity`, whatever else there is; confidence and metadata if they are of a map by itself."""
    arrays = load_arrays(path, (_MAP_KEY, NPZ_KEY, "confidence", "uncertainty"), of_maps=True)
    disparity = _as_map(path, arrays[_MAP_KEY])
    if NPZ_KEY not in arrays:
        return DisparityMap(disparity, name=path.name)
    about = parse_about(path, str(arrays[NPZ_KEY]))
    return map_of(path, about, disparity, arrays.get("confidence"), arrays.get("uncertainty"))


def recognise_npy(path: Path) -> bool:
    """Tell by its header whether an array is [y, x]; False for one of views."""
    try:
        with path.open("rb") as file:
            return head(path, len(MAGIC)) == MAGIC and len(header(path, file)[0]) == _AXES
    except Exception:  # damaged, which whoever reads it will say
        return False


def read_npy(path: Path) -> DisparityMap:
    """Read the array of an .npy as a map."""
    return DisparityMap(_as_map(path, load_arrays(path, ("disparity",))["disparity"]), name=path.name)


def _as_map(path: Path, values: NDArray[Any]) -> Float32Array:
    if values.ndim != _AXES or values.dtype.kind not in "fiu" or 0 in values.shape:
        raise LightFieldError(f"{path} must hold numbers [y, x]; found {values.dtype} of shape {values.shape}.")
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)
