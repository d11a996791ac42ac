"""Light fields that the IDLab add-on of Blender rendered: lightfield.json, and an image for each camera.

The file says how the camera projects, and where it stood for each image; OpenEXR images hold the depth as well.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import Geometry, GroundTruth, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.damage import naming
from lfgpu.io.exr import channel, read_channels
from lfgpu.io.texts import Members, read_json_or_toml
from lfgpu.io.views import load_views

CONFIGURATION_FILE = "lightfield.json"

_LARGEST = 1 << 26  # bytes of the configuration; 100 000 cameras need less
_PLACES = ("exr/{}.exr", "png/{}.png", "{}.exr", "{}.png")  # of the image of a camera, by its name
_PARALLEL = 1e-3  # of the cameras' axes: what their directions may differ by
_FLAT = 1e-2  # of a view step, and of the distance of the farthest cameras: how far one may stand off the plane
_NOTHING = 1e9  # Blender's depth, in its unit, where nothing is in the way


def recognise(path: Path) -> str | None:
    """Say why a path is taken for a light field of the add-on; None if it is not."""
    file = _file(path)
    if file is None:
        return None
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as text:
            start = text.read(1 << 16)
    except OSError:
        return None
    named = '"frames"' in start and '"camera"' in start
    return f"it has a {file.name} as the light field add-on of Blender writes it" if named else None


def read_blender(path: Path, *, allow_missing: bool = False) -> LightField:
    """Read a light field that Blender rendered, of cameras that stand in a plane and look at right angles to it.

    One view step is the median distance of neighbouring cameras. Colours of OpenEXR images are linear; they become
    uint16 by the transfer function of sRGB, and what is brighter than white becomes white. The depth of the reference
    view is the ground truth. With `allow_missing`, cameras without an image are left out.

    `path` is lightfield.json or the folder that holds it. The images are in its folders exr or png, or beside it.
    """
    file = _file(path)
    if file is None:
        raise LightFieldError(f"{path} has no {CONFIGURATION_FILE}; give the folder that Blender rendered to.")
    parsed = read_json_or_toml(file, largest=_LARGEST)
    if not isinstance(parsed, dict):
        raise LightFieldError(f"{file} is a JSON {type(parsed).__name__}, not an object.")
    whole = Members(file, parsed)
    frames = whole.objects("frames")
    if len(frames) < 2:
        raise LightFieldError(f"{file} has {len(frames)} cameras; depth needs at least two views of the scene.")
    centres, step = _in_plane(file, frames)
    images = [_image(file, frame.text("name")) for frame in frames]
    notes = []
    there = [index for index, image in enumerate(images) if image is not None]
    if len(there) < len(images):
        lost = next(frame.text("name") for frame, image in zip(frames, images, strict=True) if image is None)
        if not allow_missing or len(there) < 2:
            raise LightFieldError(
                f"{file.parent} lacks the images of {len(images) - len(there)} of {len(images)} cameras, such as "
                f"{lost}; render them, or pass allow_missing=True (--allow-missing on the command line)."
            )
        notes.append(f"Left out {len(images) - len(there)} of {len(images)} cameras, whose images are not there.")
    chosen = [image for image in images if image is not None]
    views, valid, more = load_views(chosen)
    places, depth = centres[there], None
    off = np.round(np.hypot(*(places - (places.min(axis=0) + places.max(axis=0)) / 2).T), 9)
    # Of several cameras in the middle the one below and to the right.
    middle = int(max(np.flatnonzero(off == off.min()), key=lambda index: (places[index, 1], places[index, 0])))
    if chosen[middle].suffix.lower() == ".exr":
        depth = channel(read_channels(chosen[middle])[0], "Z", "V")
    geometry = _geometry(file, whole, views.shape[1:3], step)
    positions = geometry.positions(places)
    positions -= positions.min(axis=0)
    whole_steps = bool(np.abs(positions - np.rint(positions)).max() < _FLAT)
    shape = tuple(int(n) + 1 for n in np.rint(positions.max(axis=0))[::-1])
    gridded = whole_steps and math.prod(shape) <= 4 * len(there)
    if gridded:
        positions = np.rint(positions)
    with naming(file):
        light_field = LightField(
            views,
            positions,
            reference=middle,
            valid=valid,
            grid_shape=(shape[0], shape[1]) if gridded else None,
            geometry=geometry,
            files=() if depth is not None else tuple(map(str, chosen)),
            name=file.resolve().parent.name,
            notes=(*notes, *more, f"One view step is {step:.6g} m, the distance of neighbouring cameras."),
        )
    if depth is None:
        return light_field
    u, v = light_field.positions[light_field.reference_index]
    return replace(light_field, truth=GroundTruth(_disparity(geometry, depth), (float(u), float(v))))


def _file(path: Path) -> Path | None:
    file = path / CONFIGURATION_FILE if path.is_dir() else path
    return file if file.is_file() and file.suffix.lower() == ".json" else None


# --- cameras ---


def _in_plane(file: Path, frames: list[Members]) -> tuple[NDArray[np.float64], float]:
    """Return the places of cameras in their plane, [n, 2] (right, down) in metres, and the distance of neighbours."""
    from scipy.spatial import cKDTree  # slow to import, and rarely needed

    axes, places = (np.array(a) for a in zip(*(_pose(file, frame) for frame in frames), strict=True))
    if np.abs(axes - axes[0]).max() > _PARALLEL:
        raise LightFieldError(
            f"{file} has cameras that look in several directions, as those of a cylinder, a sphere or a cuboid do; a "
            "light field needs parallel ones: render a plane, or write a description of one face."
        )
    # The columns of the matrix are the camera's right, up and back.
    own = places @ axes[0]
    centres = np.stack([own[:, 0], -own[:, 1]], axis=1)
    order = np.unique(np.round(centres, 12), axis=0)
    if len(order) < len(centres):
        raise LightFieldError(f"{file} has several cameras in one place.")
    step = float(np.median(cKDTree(centres).query(centres, k=2)[0][:, 1]))
    off = float(np.ptp(own[:, 2]))
    if off > _FLAT * step:
        raise LightFieldError(
            f"{file} has cameras that stand up to {off:.4g} m before others; a light field needs them in one plane, at "
            "right angles to where they look."
        )
    return centres, step


def _pose(file: Path, frame: Members) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the camera's axes [3, 3], one a column, and its place [3]."""
    from scipy.spatial.transform import Rotation

    if frame.values.get("world_matrix") is not None:
        matrix = _numbers(file, frame, "world_matrix", (4, 4))
        axes, place = matrix[:3, :3], matrix[:3, 3]
        axes = axes / np.maximum(np.linalg.norm(axes, axis=0), 1e-12)
    else:
        place = _numbers(file, frame, "position", (3,))
        # Blender's default rotation: about x first, then y, then z, in radians.
        axes = Rotation.from_euler("xyz", _numbers(file, frame, "rotation", (3,))).as_matrix()
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        raise LightFieldError(f"{file} is damaged: the axes of the camera {frame.text('name')[:60]!r} are no axes.")
    return axes, place


def _numbers(file: Path, of: Members, key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    try:
        found = np.array(of.values.get(key), np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.zeros(0)
    if found.shape != shape or not (np.abs(found) < 1e9).all():
        raise LightFieldError(f"{file} is damaged: {key} must be {' x '.join(map(str, shape))} numbers.")
    return found


def _geometry(file: Path, whole: Members, size: tuple[int, ...], step: float) -> Geometry:
    camera = whole.object("camera")
    if camera.text("type") != "PERSP":
        raise LightFieldError(
            f"{file} is of cameras of the type {camera.text('type')[:20]!r}; light fields are of perspective ones."
        )
    height, width = size
    told = _numbers(file, whole, "resolution", (2,))
    if tuple(told) != (width, height):
        raise LightFieldError(
            f"{file} says {told[0]:g} x {told[1]:g} px, but the images are {width} x {height}: they are of another run."
        )
    if camera.values.get("projection_matrix") is not None:
        matrix = _numbers(file, camera, "projection_matrix", (4, 4))
        across, down = abs(matrix[0, 0]) * width / 2, abs(matrix[1, 1]) * height / 2
        # Points before the camera have negative z: the axis meets the image at -(third column), from its middle.
        point = ((1 - matrix[0, 2]) * width / 2 - 0.5, (1 + matrix[1, 2]) * height / 2 - 0.5)
    elif "angle" in camera.values:
        across = down = max(width, height) / 2 / math.tan(camera.number("angle", 1e-3, 3.1) / 2)
        point = ((width - 1) / 2, (height - 1) / 2)
    else:
        sensor = _numbers(file, whole, "sensor_size", (2,))
        across = down = camera.number("focal_length", 1e-3, 1e6) * width / max(float(sensor[0]), 1e-9)
        point = ((width - 1) / 2, (height - 1) / 2)
    if not (0 < across < 1e9 and 0 < down < 1e9):
        raise LightFieldError(f"{file} is damaged: its focal length is {across:g} x {down:g} px.")
    return Geometry(float(across), step, principal_point=point, pixel_aspect=float(down / across))


# --- images ---


def _image(file: Path, name: str) -> Path | None:
    if not name or Path(name).name != name or "\0" in name:
        raise LightFieldError(f"{file} is damaged: {name[:60]!r} is no name of an image.")
    try:
        return next((path for place in _PLACES if (path := file.parent / place.format(name)).is_file()), None)
    except OSError:  # longer than names can be
        raise LightFieldError(f"{file} is damaged: {name[:60]!r}... is no name of an image.") from None


def _disparity(geometry: Geometry, depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert depths along the optical axis: 0 where nothing is in the way, NaN where there is no depth."""
    known = np.where(depth > 0, depth, np.nan).astype(np.float64)
    known[known >= _NOTHING] = np.inf
    return geometry.disparity(known).astype(np.float32)
