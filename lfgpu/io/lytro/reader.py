"""Processed Lytro containers: the views of one as a light field, and its contents, described or written as files."""

import json
import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.geometry import usual_gap
from lfgpu.data.lightfield import LightField
from lfgpu.data.reading import Inside
from lfgpu.errors import LightFieldError
from lfgpu.io import pillow, video
from lfgpu.io.arrays import field_of
from lfgpu.io.atomic import atomic_folder
from lfgpu.io.damage import check_claim, check_memory
from lfgpu.io.description import write_description
from lfgpu.io.lytro.container import Container, is_container
from lfgpu.io.lytro.contents import Contents, DepthTable, FocusStack, Pictures, Views, across, read_contents
from lfgpu.io.pfm import write_pfm
from lfgpu.io.png import write_png

_STILL = {"jpeg": "JPEG", "png": "PNG"}
"""Representations of single pictures, and Pillow's names of them."""


def decoded(container: Container, pictures: Pictures) -> Iterator[NDArray[np.uint8]]:
    """Decode the pictures, each uint8 [y, x, 3]; LightFieldError if they are damaged, or not as the container says."""
    check_claim(container.path, (*pictures.size, 3), np.uint8)
    if pictures.representation in _STILL:
        return (_still(container, name, pictures) for name in pictures.sections)
    if pictures.representation == "h264":
        return _video(container, pictures)
    raise LightFieldError(
        f"{container.path} has pictures stored as {pictures.representation!r}; known are jpeg, png and h264."
    )


def depth_table(container: Container, table: DepthTable) -> NDArray[np.float32]:
    """Read λ, float32 [y, x]; NaN where the file has no finite number."""
    return _table(container, table.section, table.size)


def confidence_table(container: Container, table: DepthTable) -> NDArray[np.float32] | None:
    """Read the confidence of each cell, float32 [y, x]; None if the container has none."""
    return None if table.confidence is None else _table(container, table.confidence, table.size)


def _table(container: Container, name: str, size: tuple[int, int]) -> NDArray[np.float32]:
    values = np.frombuffer(container.data(name), "<f4").reshape(size).astype(np.float32)
    values[~np.isfinite(values)] = np.nan
    return values


def _still(container: Container, name: str, pictures: Pictures) -> NDArray[np.uint8]:
    try:
        with pillow.decoding(container.data(name), _STILL[pictures.representation]) as image:
            found = (image.height, image.width)
            if found == pictures.size:
                return np.asarray(image.convert("RGB"))
    except Exception as error:  # decoders raise whatever comes to them when data are damaged
        reason = " ".join(str(error).split()).rstrip(".")
        if "BytesIO" in reason:
            reason = f"it is not {pictures.representation}"
        raise LightFieldError(f"{container.path} is damaged: a picture in it cannot be read ({reason}).") from error
    raise LightFieldError(
        f"{container.path} is damaged: a picture in it is {across(found)} px, where it says {across(pictures.size)}."
    )


def _video(container: Container, pictures: Pictures) -> Iterator[NDArray[np.uint8]]:
    video.check_available(container.path)
    count = 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pictures.h264"
        file.write_bytes(container.data(pictures.sections[0]))
        for frame in video.frames(file, name=container.path, demuxer="h264"):
            if frame.shape[:2] != pictures.size:
                raise LightFieldError(
                    f"{container.path} is damaged: a picture in it is {across(frame.shape[:2])} px, where it says "
                    f"{across(pictures.size)}."
                )
            count += 1
            if count > pictures.count:
                break
            yield frame
    if count != pictures.count:
        more = "more" if count > pictures.count else str(count)
        raise LightFieldError(
            f"{container.path} is damaged: it says that its video has {pictures.count} pictures, it has {more}."
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
    pictures, step = contents.views.pictures, _step(path, contents.views)
    height, width = pictures.size
    check_memory(path, 3 * pictures.count * height * width, advice="use a machine with more")
    views = np.empty((pictures.count, height, width, 3), np.uint8)
    for view, picture in zip(views, decoded(contents.container, pictures), strict=True):
        view[...] = picture
    positions = contents.views.coordinates / step
    middle = int(np.argmin(np.hypot(*contents.views.coordinates.T)))
    notes = (
        f"One view step is {step:.4g} in Lytro's unit, the distance of neighbouring views.",
        "Lytro's program computed the views from its own depth: what it got wrong is wrong in them, too.",
    )
    return field_of(path, views, positions, reference=middle, notes=notes)


def inside(path: Path) -> Inside:
    """Describe what a container holds beside views, or instead of them."""
    contents = read_contents(path)
    facts = [("contents", contents.summary())]
    for stack in contents.stacks:
        low, high = min(stack.lambdas), max(stack.lambdas)
        facts.append(("focal stack", f"{len(stack.lambdas)} pictures focused at λ {low:.3g} to {high:.3g}"))
    if contents.depth is not None:
        table = depth_table(contents.container, contents.depth)
        known = table[np.isfinite(table)]
        span = f"λ {known.min():.3g} to {known.max():.3g}" if known.size else "unknown everywhere"
        also = ", with confidences" if contents.depth.confidence else ""
        facts.append(("depth table", f"{span}{also}; Lytro's unit, larger is farther"))
    if contents.camera is not None:
        facts += contents.camera.facts()
    has_views = contents.raw is not None or contents.views is not None
    return Inside(tuple(facts), None if has_views else f"{_reason(contents)}.")


def _reason(contents: Contents) -> str:
    """Say why there is no light field in a container, without the full stop."""
    give = "give the container with the raw picture, as the camera wrote it"
    if contents.missing is not None and not contents.stacks:
        return (
            f"it holds {contents.summary()}; the raw picture {contents.missing!r} that it names is not in this file; "
            f"{give}"
        )
    if contents.stacks:
        return (
            f"it holds {contents.summary()}, and no views: pictures focused at several depths all show the scene from "
            f"one place, and depth needs several; {give}, or one with views"
        )
    return f"it holds {contents.summary()}; {give}"


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


ABOUT_FILE = "lytro.json"
DEPTH_FILE, CONFIDENCE_FILE = "lambda.pfm", "confidence.pfm"
DESCRIPTION_FILE = "lightfield.toml"


def write_contents(path: Path, out: str | os.PathLike[str]) -> list[tuple[str, str]]:
    """Write what a container holds into a folder, all or nothing; returns (file, meaning) of each.

    Refocused pictures become focus_00.jpg ... (as they are in the file) or focus_00.png ... (of a video), views
    view_00.png ... with a lightfield.toml, Lytro's depth table lambda.pfm and confidence.pfm; lytro.json says the rest.
    """
    contents = read_contents(path)
    written: list[tuple[str, str]] = []
    about: dict[str, Any] = {"source": path.name, "contents": contents.summary()}
    with atomic_folder(out) as folder:
        if contents.views is not None:
            written += _write_views(path, folder)
        for number, stack in enumerate(contents.stacks):
            prefix = "focus" if len(contents.stacks) == 1 else f"focus_{number}"
            names = _write_stack(contents, stack, folder, prefix)
            about.setdefault("focal_stacks", []).append(
                [{"file": name, "lambda": value} for name, value in zip(names, stack.lambdas, strict=True)]
            )
            written.append((f"{names[0]} ...", f"{len(names)} pictures focused at λ as {ABOUT_FILE} says"))
        if contents.depth is not None:
            write_pfm(folder / DEPTH_FILE, depth_table(contents.container, contents.depth))
            written.append((DEPTH_FILE, "Lytro's depth table, λ; larger is farther"))
            confidence = confidence_table(contents.container, contents.depth)
            if confidence is not None:
                write_pfm(folder / CONFIDENCE_FILE, confidence)
                written.append((CONFIDENCE_FILE, "Lytro's confidence in it, 0 to 1"))
        if contents.camera is not None:
            about["camera"] = dict(contents.camera.facts())
        (folder / ABOUT_FILE).write_text(json.dumps(about, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    written.append((ABOUT_FILE, "what the container holds, and the camera"))
    return written


def _write_views(path: Path, folder: Path) -> list[tuple[str, str]]:
    light_field = read_lytro(path)
    files = [folder / f"view_{index:02d}.png" for index in range(len(light_field.views))]
    for file, view in zip(files, light_field.views, strict=True):
        write_png(file, view)
    described = replace(light_field, files=tuple(map(str, files)), name=path.stem)
    write_description(described, folder / DESCRIPTION_FILE, source={})
    return [("view_00.png ...", f"{len(files)} views"), (DESCRIPTION_FILE, "where they stand; read the folder")]


def _write_stack(contents: Contents, stack: FocusStack, folder: Path, prefix: str) -> list[str]:
    pictures = stack.pictures
    suffix = "jpg" if pictures.representation == "jpeg" else "png"
    names = [f"{prefix}_{index:02d}.{suffix}" for index in range(pictures.count)]
    if suffix == "jpg":
        for name, section in zip(names, pictures.sections, strict=True):
            (folder / name).write_bytes(contents.container.data(section))
    else:
        for name, picture in zip(names, decoded(contents.container, pictures), strict=True):
            write_png(folder / name, picture)
    return names
