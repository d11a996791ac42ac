"""A film: the frames that `lfgpu live --record` kept, and the maps that `lfgpu live -o` wrote of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import read, read_map
from lfgpu.io.description import DEFAULT_NAME

_RECORD, _DISPARITY, _CONFIDENCE = "live.json", "disparity_{:06d}.pfm", "confidence_{:06d}.pfm"


@dataclass(frozen=True)
class Film:
    """Light fields of the same cameras, one after the other.

    Parameters
    ----------
    path
        The folder of the frames.
    frames
        The folder of each frame by its number, in order.
    maps
        The folder of the maps; None if there are none.
    """

    path: Path
    frames: dict[int, Path]
    maps: Path | None = None

    @classmethod
    def of(cls, path: Path) -> Film | None:
        """The film in a folder; None if there is none."""
        frames = _recorded(path)
        return cls(path, frames) if frames else None

    @property
    def name(self) -> str:
        """The name of the folder."""
        return self.path.resolve().name

    def light_field(self, number: int) -> LightField:
        """The light field of a frame; LightFieldError if there is none, or it cannot be read."""
        if number not in self.frames:
            raise LightFieldError(f"{self.path} has no frame {number}.")
        return replace(read(self.frames[number], allow_missing=True), name=self.name)

    def map(self, number: int) -> DisparityMap | None:
        """The map of a frame; None if there is none."""
        if self.maps is None or not (path := self.maps / _DISPARITY.format(number)).is_file():
            return None
        confidence = self.maps / _CONFIDENCE.format(number)
        return DisparityMap(read_map(path), read_map(confidence) if confidence.is_file() else None)


def holds_maps_of_frames(path: Path) -> bool:
    """Whether a folder is what `lfgpu live -o` wrote."""
    return (path / _RECORD).is_file()


def _recorded(folder: Path) -> dict[int, Path]:
    """The folders of recorded frames by their numbers, in order; empty if nothing was recorded in `folder`."""
    found = {int(place.name.rpartition("_")[2]): place for place in folder.glob("frame_" + "[0-9]" * 6)}
    return {number: found[number] for number in sorted(found) if (found[number] / DEFAULT_NAME).is_file()}
