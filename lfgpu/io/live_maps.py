"""The maps that `lfgpu live -o` keeps: a file for each frame, and a log that says which frame each map is of."""

import json
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lfgpu.data import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io.about import DAMAGE
from lfgpu.io.folders import not_waited_for
from lfgpu.io.map_formats import read_map
from lfgpu.io.pfm import write_pfm

LOG = "live.json"
"""The file that says what became of each frame."""

_DISPARITY, _CONFIDENCE = "disparity_{:06d}.pfm", "confidence_{:06d}.pfm"


def fingerprint(view: NDArray[Any]) -> str:
    """Compute a text that tells pictures [y, x, c] apart: that of a frame is the fingerprint of its reference view."""
    kind = blake2b(f"{view.dtype.str} {view.shape}".encode(), digest_size=16)
    return blake2b(np.ascontiguousarray(view).data, digest_size=12, person=kind.digest()).hexdigest()


def write_live_map(folder: Path, number: int, disparity: NDArray[np.float32], confidence: NDArray[np.float32]) -> None:
    """Write the map of a frame."""
    for name, values in ((_DISPARITY, disparity), (_CONFIDENCE, confidence)):
        write_pfm(folder / name.format(number), values)


def remove_live_maps(folder: Path) -> None:
    """Remove the log of an earlier run, and before it the maps that it names."""
    with suppress(LightFieldError):  # without a log nobody knows whose files they are
        for number, _, has_map in LiveMaps.of(folder).frames:
            for name in (_DISPARITY, _CONFIDENCE) if has_map else ():
                if (path := folder / name.format(number)).is_file():
                    path.unlink()
    (folder / LOG).unlink(missing_ok=True)


@dataclass(frozen=True)
class LiveMaps:
    """The maps in a folder, found by the reference view of the frame that they are of."""

    path: Path
    frames: tuple[tuple[int, str, bool], ...]
    """Of each frame: its number, the fingerprint of its reference view, and if it has a map."""

    @classmethod
    def of(cls, path: Path) -> Self:
        """Find the maps in a folder; LightFieldError if the log does not say which frames they are of."""
        log = path / LOG
        not_waited_for(log)
        try:
            frames = json.loads(log.read_text(encoding="utf-8"))["frames"]
            found = tuple((int(frame["frame"]), str(frame["reference"]), "error" not in frame) for frame in frames)
        except (OSError, *DAMAGE):
            raise LightFieldError(
                f"{log} does not say which frame each map is of; make the maps again with lfgpu live -o."
            ) from None
        return cls(path, found)

    def number(self, reference: str, near: int) -> int | None:
        """Return the number of the frame with a reference view of this fingerprint; None if there is none.

        Of several frames with the same picture it is the one numbered `near`, else the first.
        """
        same = [number for number, known, _ in self.frames if known == reference]
        return near if near in same else next(iter(same), None)

    def map(self, number: int) -> DisparityMap | None:
        """Read the map of a frame; None if the log names none. LightFieldError if its file is missing."""
        if (number, True) not in {(frame, has_map) for frame, _, has_map in self.frames}:
            return None
        confidence = self.path / _CONFIDENCE.format(number)
        return DisparityMap(
            read_map(self.path / _DISPARITY.format(number)), read_map(confidence) if confidence.is_file() else None
        )
