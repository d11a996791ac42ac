"""The old HCI light fields (Wanner, Meister, Goldluecke: Datasets and Benchmarks for Densely Sampled 4D Light Fields,
VMV 2013): one HDF5 file each, or folders exported from them."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import hdf5
from lfgpu.io.arrays import grid_field
from lfgpu.io.damage import check_fetched
from lfgpu.io.flips import flipped
from lfgpu.io.folders import entries, head, sub_folders
from lfgpu.io.grid import check_told
from lfgpu.io.images import mask_beside
from lfgpu.io.numbered import read_numbered
from lfgpu.io.parallax import runs_as_truth
from lfgpu.io.texts import read_text

ATTRIBUTES_FILE, DEPTH_FILE, MASK_FILE = "attributes.dat", "depth.bin", "mask.png"

_WIDEST = 20  # a focal length below a 20th of the width, a field of view of 168 degrees, cannot be in pixels


# --- one HDF5 file ---


def recognise_hdf5(path: Path) -> str | None:
    """Say why a path is taken for an HDF5 light field, or a folder with one; None if it is not."""
    if path.is_dir():
        file = _only_hdf5(path)
        return f"its only HDF5 file is {file.name}" if file else None
    return "it begins as HDF5 files do" if head(path, 8) == hdf5.MAGIC else None


def read_hci_hdf5(path: Path) -> LightField:
    """Read an old HCI light field from HDF5 (extra `hdf5`): the file, or a folder with one HDF5 file.

    `LF` is [v, u, y, x, c], its second axis counted from the right. Depth `GT_DEPTH` [v, u, y, x], or [y, x] of the
    middle view, becomes the ground truth by d = dH focalLength / depth - shift. Where there is ground truth, it also
    tells whether the axes run as they should; one that does not is turned round, with a note.
    """
    file = (_only_hdf5(path) or path) if path.is_dir() else path
    if head(file, 8) != hdf5.MAGIC:
        raise LightFieldError(f"{file} is not an HDF5 file; give the .h5 file of an old HCI light field.")
    with hdf5.opened(file) as root:
        arrays = hdf5.datasets(root)
        if "LF" not in arrays:
            raise LightFieldError(f"{file} has no dataset LF; it holds {', '.join(arrays) or 'none at its top'}.")
        hdf5.check_shape(file, arrays["LF"])
        if arrays["LF"].ndim not in (4, 5):
            raise LightFieldError(f"{file}: LF must be [v, u, y, x, c], found shape {arrays['LF'].shape}.")
        grid = hdf5.load(file, arrays["LF"])
        numbers = {name: hdf5.number(file, root, name) for name in ("dH", "dV", "focalLength", "shift")}
        depth = _middle(file, arrays.get("GT_DEPTH"), grid.shape[:4])
        mask = _middle(file, arrays.get("GT_DEPTH_MASK"), grid.shape[:4])
    light_field = flipped(grid_field(file, grid if grid.ndim == 5 else grid[..., None]), "u")
    return _turned(_known(light_field, file, numbers, depth, None if mask is None else mask != 0))


def _only_hdf5(folder: Path) -> Path | None:
    files = [entry for entry in entries(folder) if entry.suffix.lower() in (".h5", ".hdf5")]
    return files[0] if len(files) == 1 and head(files[0], 8) == hdf5.MAGIC else None


def _middle(path: Path, dataset: Any, shape: tuple[int, ...]) -> NDArray[Any] | None:
    """Return the part of a dataset [v, u, y, x] that belongs to the middle view, or all of a dataset [y, x]."""
    if dataset is None:
        return None
    hdf5.check_shape(path, dataset)
    if dataset.shape == shape:
        # Counted from the right, the middle of an even number of columns is one place to the left.
        return np.asarray(dataset[shape[0] // 2, (shape[1] - 1) // 2])
    if dataset.shape == shape[2:]:
        return np.asarray(dataset[()])
    raise LightFieldError(
        f"{path}: {dataset.name} has shape {dataset.shape}, which does not fit views of {shape[2]} x {shape[3]}."
    )


# --- an exported folder ---


def recognise_export(path: Path) -> str | None:
    """Say why a path is taken for an exported folder; None if it is not."""
    if not path.is_dir() or not (path / ATTRIBUTES_FILE).is_file():
        return None
    return f"it is a folder with {ATTRIBUTES_FILE}"


def read_hci_export(path: Path, *, allow_missing: bool = False) -> LightField:
    """Read a folder exported from an old HCI light field: lf/ROW_COLUMN.png, attributes.dat and depth.bin.

    attributes.dat has lines such as `9.375 //focalLength`; depth.bin is float32 [y, x], little endian, the depth of the
    middle view, and mask.png, where there is one, tells where it is scored. A grid that seems to have lost some views
    is an error without `allow_missing`.
    """
    if not (path / ATTRIBUTES_FILE).is_file():
        raise LightFieldError(f"{path} has no {ATTRIBUTES_FILE}; give the folder that holds it and the views.")
    numbers = _attributes(path / ATTRIBUTES_FILE)
    views = next((folder for folder in sub_folders(path) if folder.name == "lf"), path)
    light_field = replace(read_numbered(views, allow_missing=allow_missing), name=path.resolve().name)
    rows, columns = (int(numbers.get(name) or 0) for name in ("vRes", "hRes"))
    if rows and columns and not allow_missing:
        check_told(path / ATTRIBUTES_FILE, light_field, (rows, columns))
    depth, file = None, path / DEPTH_FILE
    if file.is_file():
        check_fetched(file)
        (height, width), size = light_field.size, file.stat().st_size
        if size != 4 * height * width:
            raise LightFieldError(
                f"{file} has {size} bytes; the depth of {width} x {height} pixels is {4 * height * width}."
            )
        depth = np.fromfile(file, "<f4").reshape(height, width)
    mask = mask_beside(path / MASK_FILE, light_field.size)
    return _known(light_field, path / ATTRIBUTES_FILE, numbers, depth, mask)


def _attributes(path: Path) -> dict[str, float | None]:
    numbers: dict[str, float | None] = {}
    for line in read_text(path, errors="replace").splitlines():
        value, slashes, name = (part.strip() for part in line.partition("//"))
        try:
            if slashes:
                numbers[name] = float(value)
        except ValueError:
            raise LightFieldError(f"{path}: {name!r} must be a number, not {value!r}.") from None
    return {name: number for name, number in numbers.items() if number is not None and math.isfinite(number)}


# --- what both have ---


def _known(
    light_field: LightField,
    path: Path,
    numbers: dict[str, float | None],
    depth: NDArray[Any] | None,
    mask: NDArray[np.bool_] | None,
) -> LightField:
    """Add the cameras and the ground truth: disparities are dH f / Z - shift for the depth Z of the file.

    The rendered scenes have the focal length in widths of the sensor, and the baseline multiplied by the width.
    """
    baseline, focal_length, shift = (numbers.get(name) for name in ("dH", "focalLength", "shift"))
    if baseline is None or focal_length is None or shift is None:
        note = "dH, focalLength or shift is not known: neither are metric depth and ground truth."
        return replace(light_field, notes=(*light_field.notes, note))
    if not (0 < baseline < math.inf and 0 < focal_length < math.inf and math.isfinite(shift)):
        raise LightFieldError(
            f"{path}: dH and focalLength must be positive and shift finite, not {baseline}, {focal_length}, {shift}."
        )
    vertical = numbers.get("dV")
    if vertical is not None and not math.isclose(vertical, baseline, rel_tol=1e-6):
        raise LightFieldError(
            f"{path}: the cameras stand {baseline} apart across and {vertical} down; describe them in a "
            "lightfield.toml, with positions in units of the first."
        )
    truth, geometry, width = None, None, light_field.size[1]
    u, v = light_field.positions[light_field.reference_index]
    rows, columns = light_field.grid_shape or (1, 1)
    if depth is not None and (u, v) == (columns // 2, rows // 2):
        z = np.where(np.isfinite(depth) & (depth > 0), depth.astype(np.float64), np.nan)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # a file may hold any bits
            found = baseline * focal_length / z - shift
            disparity = np.where(np.isfinite(found), found, np.nan).astype(np.float32)
        truth = GroundTruth(disparity, (float(u), float(v)), mask)
    if shift >= 0:  # else the plane of disparity 0 would lie beyond infinity: these cannot be real cameras
        scale = width if focal_length < width / _WIDEST else 1
        focus = baseline * focal_length / shift if shift > 0 else math.inf
        geometry = Geometry(focal_length * scale, baseline / scale, focus)
    notes = (*light_field.notes, "Lengths have no unit in the file: they are taken for metres.")
    return replace(light_field, geometry=geometry, truth=truth, notes=notes)


def _turned(light_field: LightField) -> LightField:
    for axis, name in enumerate("uv"):
        if runs_as_truth(light_field, axis) is False:
            light_field = flipped(light_field, name)
            note = f"The {('columns', 'rows')[axis]} of views count against the ground truth; they were turned round."
            light_field = replace(light_field, notes=(*light_field.notes, note))
    return light_field
