"""A film: the frames that `lfgpu live --record` kept, and the maps that `lfgpu live -o` wrote of them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from lfgpu.data import DisparityMap, LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import read
from lfgpu.io.description import DEFAULT_NAME
from lfgpu.io.live_maps import LOG, LiveMaps, fingerprint


@dataclass(frozen=True)
class Film:
    """Light fields of the same cameras, one after the other."""

    path: Path  # the folder of the frames
    frames: dict[int, Path]  # the folder of each frame by its number, in order
    maps: LiveMaps | None = None  # the maps of the frames, if there are some

    @classmethod
    def of(cls, path: Path) -> Self | None:
        """Return the film in a folder; None if there is none."""
        found = {int(place.name.rpartition("_")[2]): place for place in path.glob("frame_" + "[0-9]" * 6)}
        frames = {number: found[number] for number in sorted(found) if (found[number] / DEFAULT_NAME).is_file()}
        return cls(path, frames) if frames else None

    @property
    def name(self) -> str:
        """The name of the folder."""
        return self.path.resolve().name

    def light_field(self, number: int) -> LightField:
        """Read the light field of a frame; LightFieldError if there is none, or it cannot be read."""
        if number not in self.frames:
            raise LightFieldError(f"{self.path} has no frame {number}.")
        return replace(read(self.frames[number], allow_missing=True), name=self.name)

    def with_maps(self, path: Path, number: int) -> Self:
        """Return the film with the maps in a folder; LightFieldError if none is of its frame `number`."""
        maps = LiveMaps.of(path)
        if maps.number(_of(self.light_field(number)), number) is None:
            raise LightFieldError(
                f"{path} holds maps of other frames: none is of {self.frames[number]}; give the maps of this recording."
            )
        return replace(self, maps=maps)

    def map(self, number: int, lf: LightField) -> DisparityMap | None:
        """Read the map of a frame, whose light field is `lf`; None if there is none.

        Frames that were played again after some were lost are numbered anew: the picture says which map is theirs.
        """
        if self.maps is None or (found := self.maps.number(_of(lf), number)) is None:
            return None
        return self.maps.map(found)


def _of(lf: LightField) -> str:
    return fingerprint(lf.views[lf.reference_index])


def holds_maps_of_frames(path: Path) -> bool:
    """Tell whether a folder is what `lfgpu live -o` wrote."""
    return (path / LOG).is_file()
