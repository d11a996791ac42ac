"""Processed Lytro containers: the views of one as a light field, and what there is to say of those without views."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io.arrays import field_of
from lfgpu.io.inside import Inside
from lfgpu.io.limits import check_memory
from lfgpu.io.lytro.container import is_container
from lfgpu.io.lytro.contents import Contents, Views, read_contents
from lfgpu.io.lytro.pictures import decoded, depth_table


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
    distances = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    np.fill_diagonal(distances, np.inf)
    step = float(np.median(distances.min(axis=1)))
    if step <= 0:
        raise LightFieldError(f"{path} is damaged: several of its views stand in one place.")
    return step
