"""Many image files as one array of views, read one by one into memory or onto disk, refused if they are not alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.disk import Collected
from lfgpu.io.images import read_image


def load_views(files: Sequence[Path]) -> tuple[NDArray[Any], tuple[str, ...]]:
    """Read image files into one array.

    Parameters
    ----------
    files
        At least one image file, in the order of the views.

    Returns
    -------
    views
        [n, y, x, c], c = 1 or 3, uint8, uint16 or float32 as in the files.
    notes
        One sentence for each kind of conversion that some of the files needed.

    Raises
    ------
    LightFieldError
        If a file cannot be read, differs from the first in size, colour or dtype, or if memory does not suffice.
    """
    first, remarks = read_image(files[0])
    try:
        views = Collected(files[0].parent, len(files), first)
    except MemoryError as error:
        raise LightFieldError(
            f"{files[0].parent}: {len(files)} views, each {_kind(first)}, do not fit into memory; read fewer views."
        ) from error
    views.append(first)
    counts = Counter(remarks)
    for file in files[1:]:
        image, remarks = read_image(file)
        if image.shape != first.shape or image.dtype != first.dtype:
            raise LightFieldError(
                f"the views in {file.parent} are not alike: {files[0].name} is {_kind(first)}, "
                f"{file.name} is {_kind(image)}; all views must have one size, colour and depth of bits."
            )
        views.append(image)
        counts.update(remarks)
    notes = tuple(f"{remark.capitalize()} in {count} of {len(files)} views." for remark, count in counts.items())
    return views.array(), notes


def _kind(image: NDArray[Any]) -> str:
    height, width, channels = image.shape
    return f"{width} x {height} {'grey' if channels == 1 else 'RGB'} {image.dtype}"
