"""Entries of calibrations: numbers of the right count, matrices of OpenCV, YAML that stays small."""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lfgpu.calibration.cameras import Camera, turned
from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError
from lfgpu.io.damage import require
from lfgpu.io.texts import read_text
from lfgpu.printable import printable

_LARGEST_YAML = 1 << 20  # bytes; the parser takes a second for about 100 kB
_LARGEST = 1e12  # in any unit: products of such numbers stay finite
_WITHOUT_POINT = re.compile(r"[-+]?\d+[eE][-+]?\d+$")  # 1e-5, which YAML 1.1 takes for a text
_MOST_SHOWN = 60  # characters of a wrong value
_MOST_NODES = 1 << 18  # of a YAML file, those of its aliases counted each time


@contextmanager
def entries_of(path: Path, what: str = "") -> Iterator[None]:
    """Turn errors of wrong or missing entries into LightFieldErrors that name the file, and the camera `what`."""
    where = f"{path}: {what}" if what else str(path)
    try:
        yield
    except LightFieldError as error:
        raise LightFieldError(f"{path}: {error}") from error
    except KeyError as error:
        raise LightFieldError(f"{where} has no {error.args[0]}.") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise LightFieldError(f"{where} has wrong entries: {error}.") from error


def numbers(value: Any, *shape: int) -> Float64Array:
    """Convert a number, lists of numbers, or a matrix of OpenCV to an array of a shape, in which -1 is any length.

    ValueError if these are no finite numbers of a size that cameras have, or not so many.
    """
    found = _matrix(value) if isinstance(value, Mapping) else value
    try:
        array = np.asarray(found)
        if array.size and array.dtype.kind not in "iufO":
            raise ValueError
        array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        shown = printable(repr(value), longest=_MOST_SHOWN)
        raise ValueError(f"numbers were expected, found {shown}") from None
    if not (np.abs(array) <= _LARGEST).all():
        raise ValueError(f"numbers up to {_LARGEST:g} were expected, found {array[~(np.abs(array) <= _LARGEST)][0]:g}")
    if not shape:
        return array
    if math.prod(array.shape) % max(1, abs(math.prod(shape))) or (-1 not in shape and array.size != math.prod(shape)):
        raise ValueError(f"{abs(math.prod(shape))} numbers were expected, found {array.size}")
    return array.reshape(shape)


def camera_of(
    matrix: Float64Array,
    lens: Float64Array,
    turn: Float64Array,
    shift: Float64Array,
    size: Float64Array,
    fisheye: bool,
    name: str,
) -> Camera:
    """Make a camera of OpenCV's numbers: its matrix K, distortion, rotation (matrix or vector), translation, size."""
    coefficients = lens.tolist()
    while len(coefficients) > (4 if fisheye else 8) and coefficients[-1] == 0:
        coefficients.pop()  # thin prisms and tilts, not used
    return Camera(
        size=(whole(size[1]), whole(size[0])),
        focal_length=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal_point=(float(matrix[0, 2]), float(matrix[1, 2])),
        distortion=tuple(coefficients) if any(coefficients) else (),
        model="fisheye" if fisheye else "pinhole",
        rotation=turned(numbers(turn, 3)) if turn.size == 3 else numbers(turn, 3, 3),
        translation=shift,
        name=name,
    )


def whole(value: Any) -> int:
    """Convert an entry to a whole number; ValueError if it is none."""
    number = float(numbers(value, 1)[0])
    if not number.is_integer():
        raise ValueError(f"a whole number was expected, found {number:g}")
    return int(number)


def _matrix(node: Mapping[Any, Any]) -> Any:
    """Array of a matrix of OpenCV: rows and cols, or sizes, and data."""
    if "data" not in node:
        raise ValueError("a matrix without data was found")
    shape = [whole(side) for side in _listed(node.get("sizes") or [node.get("rows"), node.get("cols")])]
    values = numbers(node["data"]).ravel()
    count = math.prod(shape)
    if min(shape, default=0) < 0 or values.size % max(1, count) or not count <= values.size:
        raise ValueError(f"a matrix of {' x '.join(map(str, shape))} was found that has {values.size} numbers")
    channels = values.size // max(1, count)  # "3d" is a matrix of three numbers an element
    return values.reshape([*shape, channels] if channels > 1 else shape) if count else values[:0]


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def read_yaml(path: Path) -> Any:
    """Read a YAML file, plain values only, no more than a calibration has; matrices of OpenCV stay tables."""
    yaml = require("yaml", "calibration", path)
    maker: Any = type("Loader", (yaml.SafeLoader,), {})  # so that what is added stays here
    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        maker.add_constructor(f"tag:yaml.org,2002:{tag}", lambda loader, node: loader.construct_mapping(node, True))
    maker.add_implicit_resolver("tag:yaml.org,2002:float", _WITHOUT_POINT, list("-+0123456789"))
    lines = read_text(path, errors="replace", largest=_LARGEST_YAML).splitlines()
    if lines and lines[0].startswith("%YAML"):  # OpenCV writes "%YAML:1.0", which YAML does not know
        lines[0] = ""
    try:
        loader = maker("\n".join(lines))
        node = loader.get_single_node()
        if _unfolded(node, {}) > _MOST_NODES:
            raise ValueError("its aliases unfold to more than any calibration has")
        return None if node is None else loader.construct_document(node)
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise LightFieldError(f"{path} is not valid YAML: {' '.join(str(error).split()).rstrip('.')}.") from error


def _unfolded(node: Any, known: dict[int, int]) -> int:
    """Count the nodes below a node of YAML, those of aliases each time; ValueError for a circle."""
    if id(node) in known:
        if not known[id(node)]:
            raise ValueError("it has an alias of something that it is in")
        return known[id(node)]
    known[id(node)] = 0
    inside = node.value if node is not None and isinstance(node.value, list) else ()
    parts = (part for entry in inside for part in (entry if isinstance(entry, tuple) else (entry,)))
    known[id(node)] = 1 + sum(_unfolded(part, known) for part in parts)
    return known[id(node)]
