"""Source of videos: one for each camera, or one whose frames are grids of views (extra `video`)."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import video
from lfgpu.io.folders import entries, listed, natural_order
from lfgpu.io.naming import families
from lfgpu.pipelines.sources.base import Frames, Options, check_sizes, light_field


def recognise(source: str) -> bool:
    path = Path(source)
    return path.is_file() and video.recognise(path) is not None


def recognise_folder(source: str) -> bool:
    path = Path(source)
    return path.is_dir() and len(_videos(path)) > 0


def tiled_frames(source: str, options: Options) -> Frames:
    """Yield the frames of one video, each cut into rows x columns views."""
    if options.grid is None:
        raise LightFieldError(
            f"{source} is one video: say how many views each of its frames holds, such as --grid 3x3, or give a folder "
            "with one video for each camera."
        )
    rows, columns = options.grid
    for index, picture in enumerate(video.frames(Path(source))):
        height, width = picture.shape[0] // rows, picture.shape[1] // columns
        if (height * rows, width * columns) != picture.shape[:2] or min(height, width) < 2:
            raise LightFieldError(
                f"{source} has frames of {picture.shape[1]} x {picture.shape[0]} pixels, which cannot be cut into "
                f"{rows} x {columns} views (rows x columns); give another grid."
            )
        tiles = picture.reshape(rows, height, columns, width, -1).transpose(0, 2, 1, 3, 4)
        yield _first(source, np.ascontiguousarray(tiles).reshape(-1, height, width, 3), index, options)


def frames_of_cameras(source: str, options: Options) -> Frames:
    """Yield the frames of one video for each camera, in the order of their names, until the shortest ends."""
    paths = _videos(Path(source))
    _check_named_alike(Path(source), paths)
    with ExitStack() as opened:
        films = [opened.enter_context(closing(video.frames(path))) for path in paths]
        for index, pictures in enumerate(zip(*films, strict=False)):
            check_sizes([str(path) for path in paths], pictures)
            yield _first(source, np.stack(pictures), index, options)


def _check_named_alike(folder: Path, paths: list[Path]) -> None:
    """Raise LightFieldError that names the few films, such as previews, that are not named as most are."""
    most = next(iter(families(paths, folder)), [])
    odd = [path for path in paths if path not in {name.file for name in most}]
    if 0 < len(odd) < len(most):
        raise LightFieldError(
            f"{folder} holds {listed(odd)}, not named as the films of cameras such as {most[0].file.name}: move what "
            "is of no camera out of the folder, and name the films of cameras alike."
        )


def _first(source: str, views: NDArray[Any], index: int, options: Options) -> LightField | NDArray[Any]:
    return views if index else light_field(Path(source).name, views, options)


def _videos(folder: Path) -> list[Path]:
    found = [path for path in entries(folder) if path.is_file() and video.recognise(path) is not None]
    return sorted(found, key=lambda path: natural_order(path.name))
