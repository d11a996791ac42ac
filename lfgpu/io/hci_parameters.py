"""The parameters.cfg of an HCI 4D Light Field Benchmark folder: the grid and the geometry of the cameras."""

from __future__ import annotations

import configparser
import math
from pathlib import Path

from lfgpu.data.geometry import Geometry
from lfgpu.errors import LightFieldError
from lfgpu.io.git_lfs import check_fetched
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
        return self._cameras("num_cams_y"), self._cameras("num_cams_x")

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
        principal_point = None
        if self._config.has_option("intrinsics", "principal_point_x_px"):
            principal_point = (
                self._number("intrinsics", "principal_point_x_px"),
                self._number("intrinsics", "principal_point_y_px"),
            )
        unshifted = None
        if self._config.has_option("extrinsics", "unshifted_cam_x"):
            unshifted = self._number("extrinsics", "unshifted_cam_x"), self._number("extrinsics", "unshifted_cam_y")
        elif math.isfinite(lengths["focus_distance_m"]):
            rows, columns = self.grid_shape()
            unshifted = float(columns // 2), float(rows // 2)
        aspect = self._config.has_option("intrinsics", "pixel_aspect")
        try:
            return Geometry(
                focal_length_px=lengths["focal_length_mm"] / lengths["sensor_size_mm"] * max(size),
                baseline_m=lengths["baseline_mm"] / 1000.0,
                focus_distance_m=lengths["focus_distance_m"],
                principal_point=principal_point,
                pixel_aspect=self._number("intrinsics", "pixel_aspect") if aspect else 1.0,
                unshifted_at=unshifted,
            )
        except LightFieldError as error:
            raise LightFieldError(f"{self._path}: {error}") from error

    def resolution(self) -> tuple[int, int] | None:
        """Return (height, width) of the views as the file has it; None where it does not say."""
        keys = ("image_resolution_y_px", "image_resolution_x_px")
        if not all(self._config.has_option("intrinsics", key) for key in keys):
            return None
        height, width = (self._count("intrinsics", key) for key in keys)
        return height, width

    def _number(self, section: str, key: str) -> float:
        if not self._config.has_option(section, key):
            raise LightFieldError(f"{self._path} has no {key} in [{section}]; add it.")
        text = self._config.get(section, key)
        try:
            return float(text)
        except ValueError:
            raise LightFieldError(f"{self._path}: {key} must be a number, not {text!r}.") from None

    def _count(self, section: str, key: str) -> int:
        value = self._number(section, key)
        if not (value >= 1 and value.is_integer()):
            raise LightFieldError(f"{self._path}: {key} must be a whole number of at least 1, not {value:g}.")
        return int(value)

    def _cameras(self, key: str) -> int:
        count = self._count("extrinsics", key)
        if count > _MOST_CAMERAS:
            raise LightFieldError(f"{self._path}: {key} must be at most {_MOST_CAMERAS}, not {count}.")
        return count


def write_parameters(
    path: Path, *, grid_shape: tuple[int, int], size: tuple[int, int], geometry: Geometry | None, scene: str
) -> None:
    """Write a parameters.cfg that `Parameters` reads back to the same grid and geometry.

    What the benchmark does not know (a principal point off the middle, pixels that are not square, a camera other than
    the middle one whose frame is not shifted) goes into keys of our own that others ignore.
    """
    config = configparser.ConfigParser(interpolation=None)
    intrinsics = {"image_resolution_x_px": size[1], "image_resolution_y_px": size[0]}
    extrinsics: dict[str, float] = {"num_cams_x": grid_shape[1], "num_cams_y": grid_shape[0]}
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
    config.read_dict(
        {"intrinsics": intrinsics | lengths, "extrinsics": extrinsics, "meta": {"scene": " ".join(scene.split())}}
    )
    with path.open("w", encoding="utf-8") as file:
        config.write(file)
