"""HDF5 files by way of the optional h5py: opened for reading only, sizes judged first, nothing outside the file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import check_claim, read_as, require

MAGIC = b"\x89HDF\r\n\x1a\n"


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open the root group; whatever h5py raises in the block becomes a LightFieldError that names the file."""
    h5py = require("h5py", "hdf5", path)
    with read_as(path, "HDF5"), h5py.File(path, "r") as file:
        yield file


def datasets(root: Any) -> dict[str, Any]:
    """Return the datasets at the top level that lie in the file itself, by name.

    Links by name are left out: on their way they may leave the file by another link.
    """
    h5py = require("h5py", "hdf5", Path(root.filename))
    own = [name for name in root if isinstance(root.get(name, getlink=True), h5py.HardLink)]
    return {name: entry for name in own if isinstance(entry := root.get(name), h5py.Dataset)}


def load(path: Path, dataset: Any) -> NDArray[Any]:
    """Load a numeric dataset as an array; LightFieldError if it claims too much or lies in another file."""
    check_shape(path, dataset)
    return np.asarray(dataset[()])


def check_shape(path: Path, dataset: Any) -> None:
    """Raise LightFieldError unless a dataset is an honest array of numbers within the file."""
    if dataset.shape is None or dataset.dtype.kind not in "fiu":
        raise LightFieldError(f"{path}: {dataset.name} holds {dataset.dtype}; wanted is an array of numbers.")
    if dataset.external or dataset.is_virtual:
        raise LightFieldError(f"{path}: {dataset.name} lies in other files; put everything into one.")
    if 0 in dataset.shape:
        raise LightFieldError(f"{path}: {dataset.name} has the shape {dataset.shape}: there is nothing in it.")
    check_claim(path, dataset.shape, dataset.dtype)


def number(path: Path, root: Any, name: str) -> float | None:
    """Return an attribute of the root as a number; None if there is none of that name."""
    if name not in root.attrs:
        return None
    value = np.asarray(root.attrs[name])
    if value.size != 1 or value.dtype.kind not in "fiu":
        raise LightFieldError(f"{path}: the attribute {name} must be a number, not {value.tolist()!r}.")
    return float(value.reshape(-1)[0])
