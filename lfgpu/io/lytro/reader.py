"""Processed Lytro containers: the views of one as a light field, and its contents in words."""

import io
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import Inside, LightField
from lfgpu.data.geometry import usual_gap
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow, video
from lfgpu.io.arrays import field_of
from lfgpu.io.damage import check_claim, check_memory, require
from lfgpu.io.lytro.container import Container, is_container
from lfgpu.io.lytro.contents import FOCAL_STACK, Contents, Views, across, read_contents

_STILL = {"jpeg": "JPEG", "png": "PNG"}
"""Representations of single pictures, and Pillow's names of them."""


def decoded(container: Container, views: Views) -> Iterator[NDArray[np.uint8]]:
    """Decode the views, each uint8 [y, x, 3]; LightFieldError if they are damaged, or not as the container says."""
    check_claim(container.path, (*views.size, 3), np.uint8)
    if views.representation in _STILL:
        return (_still(container, name, views) for name in views.sections)
    if views.representation == "h264":
        return _video(container, views)
    raise LightFieldError(
        f"{container.path} has pictures stored as {views.representation!r}; known are jpeg, png and h264."
    )


def _still(container: Container, name: str, views: Views) -> NDArray[np.uint8]:
    try:
        with pillow.decoding(io.BytesIO(container.data(name)), _STILL[views.representation]) as image:
            found = (image.height, image.width)
            if found == views.size:
                return np.asarray(image.convert("RGB"))
    except Exception as error:  # decoders raise whatever comes to them when data are damaged
        reason = " ".join(str(error).split()).rstrip(".")
        if "BytesIO" in reason:
            reason = f"it is not {views.representation}"
        raise LightFieldError(f"{container.path} is damaged: a picture in it cannot be read ({reason}).") from error
    raise LightFieldError(
        f"{container.path} is damaged: a picture in it is {across(found)} px, where it says {across(views.size)}."
    )


def _video(container: Container, views: Views) -> Iterator[NDArray[np.uint8]]:
    require("imageio_ffmpeg", "video", container.path)
    count, expected = 0, len(views.coordinates)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pictures.h264"
        file.write_bytes(container.data(views.sections[0]))
        for frame in video.frames(file, name=container.path, demuxer="h264"):
            if frame.shape[:2] != views.size:
                raise LightFieldError(
                    f"{container.path} is damaged: a picture in it is {across(frame.shape[:2])} px, where it says "
                    f"{across(views.size)}."
                )
            count += 1
            if count > expected:
                break
            yield frame
    if count != expected:
        more = "more" if count > expected else str(count)
        raise LightFieldError(
            f"{container.path} is damaged: it says that its video has {expected} pictures, it has {more}."
        )


def recognise(path: Path) -> str | None:
    """Say why a file is taken for a container without a raw picture; None if it is not, or damaged."""
    if not is_container(path):
        return None
    try:
        contents = read_contents(path)
    except LightFieldError:  # whoever reads raw pictures says what is wrong
        return None
    return None if contents.raw is not None else "it is a container of Lytro's program, not of the camera"


def read_lytro(path: Path) -> LightField:
    """Read the views of a processed container (.lfp).

    The places of the views on the main lens become view steps by the distance of nearest neighbours; they lie on a
    hexagonal lattice, x to the right and y down. The view in the middle is the reference. A focal stack shows the scene
    from one place only and is refused.
    """
    contents = read_contents(path)
    if contents.views is None:
        raise LightFieldError(f"{path} is no light field: {_reason(contents)}.")
    places, step = contents.views.coordinates, _step(path, contents.views)
    shape = (len(places), *contents.views.size, 3)
    check_memory(path, math.prod(shape), advice="use a machine with more")
    views = np.empty(shape, np.uint8)
    for view, picture in zip(views, decoded(contents.container, contents.views), strict=True):
        view[...] = picture
    middle = int(np.argmin(np.hypot(*places.T)))
    notes = (
        f"One view step is {step:.4g} in Lytro's unit, the distance of neighbouring views.",
        "Lytro's program computed the views from its own depth: what it got wrong is wrong in them, too.",
    )
    return field_of(path, views, places / step, reference=middle, notes=notes)


def inside(path: Path) -> Inside:
    """Describe what a container holds beside views, or instead of them."""
    contents = read_contents(path)
    facts = [("contents", contents.summary()), *(() if contents.camera is None else contents.camera.facts())]
    has_views = contents.raw is not None or contents.views is not None
    return Inside(tuple(facts), None if has_views else f"{_reason(contents)}.")


def _reason(contents: Contents) -> str:
    """Say why there is no light field in a container, without the full stop."""
    give = "give the container with the raw picture, as the camera wrote it"
    if FOCAL_STACK in contents.others:
        return (
            f"it holds {contents.summary()}, and no views: pictures focused at several depths all show the scene from "
            f"one place, and depth needs several; {give}, or one with views"
        )
    lost = (
        "" if contents.missing is None else f"; the raw picture {contents.missing!r} that it names is not in this file"
    )
    return f"it holds {contents.summary()}{lost}; {give}"


def _step(path: Path, views: Views) -> float:
    """Measure the median distance of each view's nearest neighbour."""
    places: NDArray[np.float64] = views.coordinates
    if len(places) < 2:
        raise LightFieldError(f"{path} has one view only; depth needs at least two.")
    if len(places) > 2000:
        raise LightFieldError(f"{path} is damaged: it claims {len(places)} views.")
    if (step := usual_gap(places)) <= 0:
        raise LightFieldError(f"{path} is damaged: several of its views stand in one place.")
    return step
