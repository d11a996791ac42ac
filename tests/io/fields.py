"""One small light field written in every format that can be read: what tests and fuzzing start from."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lfgpu import scenes
from lfgpu.data import LightField
from lfgpu.io import write_description, write_hci
from lfgpu.io.png import write_png
from tests.io import lytro_samples
from tests.io.samples import grid_of, save_as

SHIFT = 3.0  # of the old HCI format: pixels per view step


def scene(grid: tuple[int, int] = (5, 5), size: tuple[int, int] = (40, 48)) -> LightField:
    """Boxes before a wall, with the truth of the middle view."""
    return scenes.make("boxes", grid=grid, size=size)


def _named(lf: LightField, folder: Path, pattern: str = "view_{0:02d}_{1:02d}.png") -> Path:
    middle = [side // 2 for side in lf.grid_shape or (0, 0)]
    return save_as(folder, lf, lambda v, u: pattern.format(v, u, v - middle[0], u - middle[1]))


def _hci(lf: LightField, place: Path) -> Path:
    write_hci(lf, place / "hci")
    return place / "hci"


def _depth(lf: LightField) -> Any:
    """The depth in the unit of a file with dH = 0.5, focalLength = 60 and shift = SHIFT."""
    return 0.5 * 60.0 / (lf.truth.disparity.astype(np.float64) + SHIFT)


def _export(lf: LightField, place: Path) -> Path:
    folder = place / "export"
    _named(lf, folder / "lf", "{0:02d}_{1:02d}.png")
    rows, columns = lf.grid_shape or (0, 0)
    lines = f"{rows} //vRes\n{columns} //hRes\n5.0e-001 //dH\n60.0 //focalLength\n{SHIFT} //shift\n"
    (folder / "attributes.dat").write_text(lines)
    _depth(lf).astype("<f4").tofile(folder / "depth.bin")
    return folder


def _hdf5(lf: LightField, place: Path) -> Path:
    import h5py

    grid, (rows, columns) = grid_of(lf), lf.grid_shape or (0, 0)
    depth = np.ones(grid.shape[:4], np.float32)
    depth[rows // 2, (columns - 1) // 2] = _depth(lf)
    with h5py.File(place / "buddha.h5", "w") as file:
        file["LF"] = grid[:, ::-1]
        file["GT_DEPTH"] = depth
        attributes = {"dH": 0.5, "dV": 0.5, "focalLength": 60.0, "shift": SHIFT, "hRes": columns, "vRes": rows}
        file.attrs.update(attributes)
    return place / "buddha.h5"


def _stanford(lf: LightField, place: Path) -> Path:
    def name(v: int, u: int) -> str:
        return f"out_{v:02d}_{u:02d}_{7.25 * v - 381.909271:.6f}_{7.25 * u + 1103.376221:.6f}_.png"

    return save_as(place / "stanford" / "rectified", lf, name).parent


def _plenopticam(lf: LightField, place: Path) -> Path:
    folder = place / "plenopticam" / f"viewpoints_{(lf.grid_shape or (0,))[0]}px"
    folder.mkdir(parents=True)
    for view, (u, v) in zip(lf.views, lf.positions, strict=True):
        write_png(folder / f"{round(v)}_{round(u)}.png", view.astype(np.uint16) * 257)
    return folder.parent


def _mat5(lf: LightField, place: Path) -> Path:
    from scipy.io import savemat

    savemat(place / "LF.mat", {"LF": grid_of(lf), "GeneratedByInfo": {"mfilename": "x"}}, do_compression=True)
    return place / "LF.mat"


def _mat7(lf: LightField, place: Path) -> Path:
    import h5py

    weight = np.full((*grid_of(lf).shape[:4], 1), 255, np.uint8)
    weight[0, 0] = 0  # a corner that the main lens shades
    with h5py.File(place / "LF7.mat", "w", userblock_size=512) as file:
        file["LF"] = np.concatenate([grid_of(lf), weight], axis=4).T
    with (place / "LF7.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return place / "LF7.mat"


def _npy(lf: LightField, place: Path) -> Path:
    np.save(place / "views.npy", grid_of(lf))
    return place / "views.npy"


def _npz(lf: LightField, place: Path) -> Path:
    np.savez_compressed(place / "views.npz", views=lf.views, positions=lf.positions)
    return place / "views.npz"


def _tiff(lf: LightField, place: Path) -> Path:
    import tifffile

    tifffile.imwrite(place / "stack.tif", lf.views, photometric="rgb", metadata=None)
    return place / "stack.tif"


def _mosaic(lf: LightField, place: Path) -> Path:
    grid = grid_of(lf)
    rows, columns, height, width, colours = grid.shape
    image = grid.transpose(2, 0, 3, 1, 4).reshape(height * rows, width * columns, colours)
    Image.fromarray(image).save(place / "boxes_eslf.png")
    return place / "boxes_eslf.png"


def _tiles(lf: LightField, place: Path) -> Path:
    grid = grid_of(lf)
    image = np.concatenate([np.concatenate(list(row), axis=1) for row in grid], axis=0)
    Image.fromarray(image).save(place / "boxes_tiles.png")
    return place / "boxes_tiles.png"


def _coded(file: Path, views: Any, **options: Any) -> Path:
    """Write a video without loss."""
    import imageio_ffmpeg

    height, width = views.shape[1:3]
    options |= {"macro_block_size": 1, "ffmpeg_log_level": "error"}
    writer = imageio_ffmpeg.write_frames(str(file), (width, height), pix_fmt_in="rgb24", **options)
    writer.send(None)
    for view in views:
        writer.send(np.ascontiguousarray(view))
    writer.close()
    return file


def _video(lf: LightField, place: Path) -> Path:
    return _coded(place / "rail.mkv", lf.views[lf.row()], codec="ffv1", pix_fmt_out="bgr0")


def _row(lf: LightField, place: Path) -> Path:
    folder = place / "row"
    folder.mkdir()
    for number, index in enumerate(lf.row()):
        Image.fromarray(lf.views[index]).save(folder / f"image_{25 + 2 * number:04d}.jpg", quality=95, subsampling=0)
    return folder


def _row_folders(lf: LightField, place: Path) -> Path:
    return save_as(place / "rows", lf, lambda v, u: f"row_{v + 1:02d}/{u + 1:03d}.bmp")


def _signed(lf: LightField, place: Path) -> Path:
    return _named(lf, place / "signed", "image_{2:+d}_{3:+d}.tif")


def _described(lf: LightField, views: Path, description: Path) -> Path:
    """Views in a folder, and what describes them."""
    from lfgpu.io import read

    write_description(read(_named(lf, views)), description, source={})
    return description


def _toml(lf: LightField, place: Path) -> Path:
    folder = place / "toml"
    return _described(lf, folder / "Bilder – 7", folder / "lightfield.toml").parent


BLENDER_STEP, BLENDER_FOCAL = 0.05, 60.0
"""Metres between cameras, and pixels."""


def blender_depth(lf: LightField) -> Any:
    """The depth of the middle view; there is none behind infinity, where disparities are negative."""
    return BLENDER_STEP * BLENDER_FOCAL / np.maximum(lf.truth.disparity.astype(np.float64), 1e-4)


def linear(view: Any) -> dict[str, Any]:
    """Return the channels of a picture as OpenEXR has them: in linear light."""
    coded = view.astype(np.float64) / 255
    light = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return {colour: np.ascontiguousarray(light[..., index]) for index, colour in enumerate("RGB")}


def write_exr(path: Path, channels: dict[str, Any]) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def _blender(lf: LightField, place: Path) -> Path:
    """Write what the add-on writes: cameras before the wall of a room, turned and off the origin."""
    folder = place / "LFPlane"
    (folder / "exr").mkdir(parents=True)
    height, width = lf.size
    turn = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # right, up and back, a column each
    rows = 2 * BLENDER_FOCAL
    matrix = [[rows / width, 0, 0, 0], [0, rows / height, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]]
    frames = []
    for index, (view, (du, dv)) in enumerate(zip(lf.views, lf.offsets, strict=True)):
        name = f"view_{index:04d}f"
        at = np.array([3.0, -2.0, 1.5]) + BLENDER_STEP * (du * turn[:, 0] - dv * turn[:, 1])
        world = np.eye(4)
        world[:3, :3], world[:3, 3] = turn, at
        frames.append({"name": name, "position": at.tolist(), "world_matrix": world.tolist()})
        depth = np.ascontiguousarray(blender_depth(lf), np.float32)
        write_exr(folder / "exr" / f"{name}.exr", {**linear(view), "Z": depth})
    about = {
        "camera": {"type": "PERSP", "lens_unit": "MILLIMETERS", "focal_length": 50, "projection_matrix": matrix},
        "lf_type": "PLANE",
        "resolution": [width, height],
        "sensor_size": [36, 36 * height / width],
        "frames": frames,
    }
    (folder / "lightfield.json").write_text(json.dumps(about))
    return folder


def _lytro(lf: LightField, place: Path) -> Path:
    """Views in a video without loss, as the first Lytro's program stores them."""
    how = {"codec": "libx264rgb", "pix_fmt_out": "rgb24", "quality": None, "output_params": ["-crf", "0"]}
    coded = _coded(place / "views.h264", lf.views, **how)
    video = coded.read_bytes()
    coded.unlink()
    content, sections = lytro_samples.video(video, lf.size, [{"coord": xy} for xy in _coordinates(lf)])
    file = place / "IMG_0001-stk.lfp"
    file.write_bytes(lytro_samples.processed([("edofParallax", content)], sections))
    return file


def _lytro_pictures(lf: LightField, place: Path) -> Path:
    """Views as pictures, beside a focal stack."""
    content, sections = lytro_samples.pictures(lf.views, [{"coord": xy} for xy in _coordinates(lf)])
    stack, more = lytro_samples.focal_stack(lf.views[:2])
    file = place / "IMG_0002-stk.lfp"
    listed = [("refocusStack", stack), ("edofParallax", content)]
    file.write_bytes(lytro_samples.processed(listed, [*sections, *more]))
    return file


def _coordinates(lf: LightField) -> list[dict[str, float]]:
    return [{"x": 0.1 * du, "y": 0.1 * dv} for du, dv in lf.offsets.tolist()]


@dataclass(frozen=True)
class Sample:
    """A way to write the scene, and the parts of it that come back."""

    format: str
    write: Callable[[LightField, Path], Path]
    """Writes into a folder that exists; what to read."""
    views: str = "full"
    """The pattern of views that the format holds."""
    options: dict[str, Any] = field(default_factory=dict)
    """What has to be told."""
    exact: bool = True
    """Whether the pixels come back as they were."""
    truth: bool = False
    """Whether the ground truth comes back."""


SAMPLES = {
    "hci": Sample("hci", _hci, truth=True),
    "hci-export": Sample("hci-export", _export, truth=True),
    "hci-hdf5": Sample("hci-hdf5", _hdf5, truth=True),
    "blender": Sample("blender", _blender),
    "stanford": Sample("stanford", _stanford),
    "plenopticam": Sample("plenopticam", _plenopticam),
    "lftoolbox-5": Sample("lftoolbox", _mat5),
    "lftoolbox-7.3": Sample("lftoolbox", _mat7),
    "npy": Sample("numpy", _npy),
    "npz": Sample("numpy", _npz),
    "tiff-stack": Sample("tiff-stack", _tiff),
    "mosaic": Sample("mosaic", _mosaic, options={"grid": (5, 5)}),
    "tiles": Sample("tiles", _tiles, options={"grid": (5, 5)}),
    "video": Sample("video", _video, views="row"),
    "lytro": Sample("lytro", _lytro),
    "lytro-pictures": Sample("lytro", _lytro_pictures),
    "named-views": Sample("named-views", lambda lf, place: _named(lf, place / "named")),
    "signed-names": Sample("named-views", _signed),
    "row-folders": Sample("row-folders", _row_folders),
    "camera-row": Sample("camera-row", _row, views="row", exact=False),
    "toml": Sample("lightfield-toml", _toml),
    "json": Sample("lightfield-toml", lambda lf, place: _described(lf, place / "json", place / "json" / "array.json")),
}
