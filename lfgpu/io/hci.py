"""Folders of the HCI 4D Light Field Benchmark: input_Cam000.png ..., parameters.cfg and ground truth."""

import configparser
import math
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_folder, check_no_others
from lfgpu.io.damage import check_fetched, naming
from lfgpu.io.folders import image_files
from lfgpu.io.grid import by_place, read_grid
from lfgpu.io.images import check_size, mask_beside
from lfgpu.io.map_formats import read_map
from lfgpu.io.pfm import write_pfm
from lfgpu.io.png import write_png
from lfgpu.io.texts import read_text

PARAMETERS_FILE = "parameters.cfg"

_LENGTHS = {
    "focal_length_mm": "intrinsics",
    "sensor_size_mm": "intrinsics",
    "baseline_mm": "extrinsics",
    "focus_distance_m": "extrinsics",
}
_MOST_CAMERAS = 1000  # along one axis
_SENSOR_SIZE_MM = 35.0  # of the benchmark's scenes; it only fixes the unit of the focal length


class Parameters:
    """The contents of one parameters.cfg. Every error names the file.

    `disp_min` and `disp_max` are not looked at: they come from the ground truth, and no estimate may know them.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._config = configparser.ConfigParser(interpolation=None)
        check_fetched(path)
        try:
            self._config.read_string(read_text(path), source=path.name)
        except (configparser.Error, UnicodeDecodeError) as error:
            raise LightFieldError(
                f"{path} is not a valid configuration file: {' '.join(str(error).split())}."
            ) from error

    def grid_shape(self) -> tuple[int, int]:
        """Return (rows, columns) of the camera grid, from num_cams_y and num_cams_x."""
        rows, columns = (self._count("extrinsics", f"num_cams_{axis}", _MOST_CAMERAS) for axis in "yx")
        return rows, columns

    def geometry(self, size: tuple[int, int]) -> Geometry | None:
        """Return the geometry for views of (height, width) pixels; None if the file says nothing of lengths.

        The sensor's size is that of its longer side, so that views which were scaled as a whole are covered as well.
        The camera whose frame is not shifted is the middle one (rows // 2, columns // 2), unless our own keys say else.
        """
        given = {key for key, section in _LENGTHS.items() if self._config.has_option(section, key)}
        if not given:
            return None
        lengths = {key: self._number(section, key) for key, section in _LENGTHS.items()}
        if not lengths["sensor_size_mm"] > 0:
            raise LightFieldError(f"{self._path}: sensor_size_mm must be positive, not {lengths['sensor_size_mm']:g}.")
        principal_point = self._pair("intrinsics", "principal_point_{}_px")
        unshifted = self._pair("extrinsics", "unshifted_cam_{}")
        if unshifted is None and math.isfinite(lengths["focus_distance_m"]):
            rows, columns = self.grid_shape()
            unshifted = float(columns // 2), float(rows // 2)
        aspect = self._config.has_option("intrinsics", "pixel_aspect")
        with naming(self._path):
            return Geometry(
                focal_length_px=lengths["focal_length_mm"] / lengths["sensor_size_mm"] * max(size),
                baseline_m=lengths["baseline_mm"] / 1000.0,
                focus_distance_m=lengths["focus_distance_m"],
                principal_point=principal_point,
                pixel_aspect=self._number("intrinsics", "pixel_aspect") if aspect else 1.0,
                unshifted_at=unshifted,
            )

    def resolution(self) -> tuple[int, int] | None:
        """Return (height, width) of the views as the file has it; None where it does not say."""
        keys = ("image_resolution_y_px", "image_resolution_x_px")
        if not all(self._config.has_option("intrinsics", key) for key in keys):
            return None
        height, width = (self._count("intrinsics", key) for key in keys)
        return height, width

    def _pair(self, section: str, keys: str) -> tuple[float, float] | None:
        if not self._config.has_option(section, keys.format("x")):
            return None
        return self._number(section, keys.format("x")), self._number(section, keys.format("y"))

    def _number(self, section: str, key: str) -> float:
        if not self._config.has_option(section, key):
            raise LightFieldError(f"{self._path} has no {key} in [{section}]; add it.")
        text = self._config.get(section, key)
        try:
            return float(text)
        except ValueError:
            raise LightFieldError(f"{self._path}: {key} must be a number, not {text!r}.") from None

    def _count(self, section: str, key: str, most: float = math.inf) -> int:
        value = self._number(section, key)
        if not (value >= 1 and value.is_integer()):
            raise LightFieldError(f"{self._path}: {key} must be a whole number of at least 1, not {value:g}.")
        if value > most:
            raise LightFieldError(f"{self._path}: {key} must be at most {most}, not {value:.0f}.")
        return int(value)


def _write_parameters(path: Path, light_field: LightField) -> None:
    """Write a parameters.cfg that `Parameters` reads back to the same grid and geometry.

    What the benchmark does not know (a principal point off the middle, pixels that are not square, a camera other than
    the middle one whose frame is not shifted) goes into keys of our own that others ignore.
    """
    config = configparser.ConfigParser(interpolation=None)
    size, (rows, columns), geometry = light_field.size, light_field.grid_shape or (0, 0), light_field.geometry
    intrinsics = {"image_resolution_x_px": size[1], "image_resolution_y_px": size[0]}
    extrinsics: dict[str, float] = {"num_cams_x": columns, "num_cams_y": rows}
    lengths: dict[str, float] = {}
    if geometry is not None:
        lengths["focal_length_mm"] = geometry.focal_length_px * _SENSOR_SIZE_MM / max(size)
        lengths["sensor_size_mm"] = _SENSOR_SIZE_MM
        extrinsics["baseline_mm"] = geometry.baseline_m * 1000.0
        extrinsics["focus_distance_m"] = geometry.focus_distance_m
        if geometry.principal_point is not None:
            lengths["principal_point_x_px"], lengths["principal_point_y_px"] = geometry.principal_point
        if geometry.pixel_aspect != 1:
            lengths["pixel_aspect"] = geometry.pixel_aspect
        if geometry.unshifted_at is not None:
            extrinsics["unshifted_cam_x"], extrinsics["unshifted_cam_y"] = geometry.unshifted_at
    meta = {"scene": " ".join(light_field.name.split())}
    config.read_dict({"intrinsics": intrinsics | lengths, "extrinsics": extrinsics, "meta": meta})
    with path.open("w", encoding="utf-8") as file:
        config.write(file)


DISPARITY_FILE = "gt_disp_lowres.pfm"
DEPTH_FILE = "gt_depth_lowres.pfm"
MASK_FILE = "valid_mask.png"

_VIEW_NAME = re.compile(r"input_cam([0-9]{1,6})", re.IGNORECASE)
_OURS = re.compile(rf"{_VIEW_NAME.pattern}\..*|{DISPARITY_FILE}|{DEPTH_FILE}|{MASK_FILE}", re.IGNORECASE)


def recognise(path: Path) -> str | None:
    """Say why a path is taken for an HCI folder; None if it is not."""
    views = _view_files(path) if path.is_dir() else []
    return f"it is a folder with {views[0][1].name}" if views else None


def read_hci(path: Path, *, allow_missing: bool = False) -> LightField:
    """Read an HCI 4D folder.

    The view with index i stands at row i // columns, column i % columns; all views may be there or only some. The
    geometry comes from parameters.cfg, where d = B f (1/Z - 1/F); the ground truth of the centre view (rows // 2,
    columns // 2) from gt_disp_lowres.pfm, and where it is scored from valid_mask.png, where non-zero is valid. Without
    parameters.cfg a square grid is taken if the highest index is the last one of such a grid. A grid that seems to have
    lost some views is an error without `allow_missing`.
    """
    views = _view_files(path)
    if not views:
        raise LightFieldError(f"{path} has no views named input_Cam000.png and so on; give the folder that holds them.")
    last = max(index for index, _ in views)
    parameters = Parameters(path / PARAMETERS_FILE) if (path / PARAMETERS_FILE).is_file() else None
    rows, columns = shape = _square_grid(path, last) if parameters is None else parameters.grid_shape()
    if last >= rows * columns:
        raise LightFieldError(
            f"{path / PARAMETERS_FILE} says {rows} x {columns} views, which ends at index {rows * columns - 1}, "
            f"but there is a view with index {last}; correct num_cams_x and num_cams_y."
        )
    places = by_place((divmod(index, columns), file) for index, file in views)
    light_field = read_grid(places, shape, folder=path, allow_missing=allow_missing)
    geometry, notes = _geometry(parameters, light_field.size)
    return replace(
        light_field,
        geometry=geometry,
        truth=_truth(path, shape, light_field.size),
        notes=(*notes, *light_field.notes),
    )


def write_hci(light_field: LightField, folder: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a grid of views as an HCI 4D folder that `read_hci` reads back; whole or not at all.

    uint8 and uint16 views are stored exactly, as PNG of 8 or 16 bits; float32 views are cut to [0, 1] and rounded to 16
    bits (an error of at most 1/131070). The ground truth is stored if it belongs to the centre view (rows // 2, columns
    // 2), its depth too if the geometry is known. Some places of the grid may be empty. Returns sentences about what
    the format could not hold. LightFieldError if the folder holds more of another light field.
    """
    shape = light_field.grid_shape
    if shape is None:
        raise LightFieldError(f"{light_field.name} is not a grid of views; the HCI format holds grids only.")
    columns = shape[1]
    centre = (float(columns // 2), float(shape[0] // 2))
    truth = light_field.truth
    if truth is not None and truth.position != centre:
        truth = None
    with atomic_folder(folder) as place:
        for view, (u, v) in zip(light_field.views, light_field.positions, strict=True):
            write_png(place / f"input_Cam{round(v) * columns + round(u):03d}.png", view)
        _write_parameters(place / PARAMETERS_FILE, light_field)
        if truth is not None:
            _write_truth(place, truth, light_field.geometry)
        check_no_others(folder, {file.name for file in place.iterdir()}, _OURS)
    return _left_out(light_field, centre)


def _view_files(folder: Path) -> list[tuple[int, Path]]:
    matches = ((_VIEW_NAME.fullmatch(file.stem), file) for file in image_files(folder))
    return [(int(match[1]), file) for match, file in matches if match]


def _square_grid(folder: Path, last: int) -> tuple[int, int]:
    side = math.isqrt(last + 1)
    if side * side != last + 1:
        raise LightFieldError(
            f"{folder} has no {PARAMETERS_FILE}, and its views up to index {last} do not fill a square grid; add a "
            f"{PARAMETERS_FILE} with num_cams_x and num_cams_y in [extrinsics]."
        )
    return side, side


def _geometry(parameters: Parameters | None, size: tuple[int, int]) -> tuple[Geometry | None, tuple[str, ...]]:
    if parameters is None:
        return None, (f"There is no {PARAMETERS_FILE}: a square grid is assumed, and metric depth is not known.",)
    geometry = parameters.geometry(size)
    if geometry is None:
        return None, (f"{PARAMETERS_FILE} does not describe the cameras: metric depth is not known.",)
    resolution = parameters.resolution()
    if resolution in (None, size):
        return geometry, ()
    return geometry, (
        f"{PARAMETERS_FILE} is for views of {resolution[1]} x {resolution[0]} pixels and these have "
        f"{size[1]} x {size[0]}: metric depth is right if they were scaled, not cropped.",
    )


def _truth(folder: Path, shape: tuple[int, int], size: tuple[int, int]) -> GroundTruth | None:
    path = folder / DISPARITY_FILE
    if not path.is_file():
        return None
    disparity = read_map(path)
    check_size(path, disparity, size)
    mask = mask_beside(folder / MASK_FILE, size)
    known = np.where(np.isfinite(disparity), disparity, np.float32(np.nan))
    return GroundTruth(known, (float(shape[1] // 2), float(shape[0] // 2)), mask)


def _write_truth(folder: Path, truth: GroundTruth, geometry: Geometry | None) -> None:
    write_pfm(folder / DISPARITY_FILE, truth.disparity)
    if geometry is not None:
        write_pfm(folder / DEPTH_FILE, geometry.depth(truth.disparity))
    if truth.mask is not None:
        write_png(folder / MASK_FILE, truth.mask[..., None])


def _left_out(light_field: LightField, centre: tuple[float, float]) -> tuple[str, ...]:
    sentences = []
    if light_field.views.dtype == np.float32:
        sentences.append("The float32 views were rounded to 16 bits.")
    if light_field.truth is not None and light_field.truth.position != centre:
        sentences.append("The ground truth was left out: the format holds that of the centre view of the grid only.")
    if light_field.valid is not None:
        sentences.append("The validity of the views' pixels was left out: the format has no place for it.")
    u, v = light_field.positions[light_field.reference_index]
    if (u, v) != centre:
        sentences.append("The choice of the reference view was left out: readers take the centre view of the grid.")
    return tuple(sentences)
