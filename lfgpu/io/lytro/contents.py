"""Contents of a Lytro container: raw picture, views, stacks of refocused pictures, depth table, facts of the camera.

Cameras write the raw picture. Lytro's desktop program and web service write "accelerations" instead: pictures that were
computed from it, for viewers. The first camera's program and the Illum's describe them with different words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.lytro.container import Container, open_container
from lfgpu.io.texts import Members

_PITCHES = (5.0, 60.0)  # pixels between microlenses
_MOST_ROTATION = math.radians(10)
_STRETCH = (0.9, 1.1)


@dataclass(frozen=True)
class MicrolensArray:
    """The design of the microlens array: a hexagonal lattice whose rows run along the rows of the sensor."""

    pitch: float  # distance of neighbours in a row, in pixels of the sensor
    rotation: float  # of the rows against the rows of the sensor, in radians
    stretch: float  # distance of the rows over that of an equilateral lattice


@dataclass(frozen=True)
class Camera:
    """The camera of a capture. What it did not write is None."""

    model: str | None
    taken: str | None
    """Date and time, as it stands in the file."""
    focal_length_mm: float | None
    f_number: float | None
    exposure_s: float | None
    iso: float | None
    microlenses: MicrolensArray | None

    @classmethod
    def of(cls, metadata: Members) -> Camera:
        """Read the metadata of a capture; what is not as it should be is left out."""
        lens, shutter = ("devices", "lens"), ("devices", "shutter")
        focal_length = metadata.find_number(*lens, "focalLength")
        maker, model = (metadata.find_text("camera", key) for key in ("make", "model"))
        iso = metadata.find_number("devices", "sensor", "iso")
        return cls(
            model=" ".join(part for part in (maker, model) if part) or None,
            taken=metadata.find_text("devices", "clock", "zuluTime"),
            focal_length_mm=None if focal_length is None else 1000 * focal_length,
            f_number=metadata.find_number(*lens, "fNumber"),
            exposure_s=metadata.find_number(*shutter, "pixelExposureDuration"),
            iso=metadata.find_number("image", "iso") if iso is None else iso,
            microlenses=_microlenses(metadata),
        )

    def facts(self) -> list[tuple[str, str]]:
        """Return (label, text) of what is known."""
        lens = [
            *([f"{self.focal_length_mm:.4g} mm"] if self.focal_length_mm is not None else []),
            *([f"f/{self.f_number:.3g}"] if self.f_number is not None else []),
            *([f"{self.exposure_s:.3g} s"] if self.exposure_s is not None else []),
            *([f"ISO {self.iso:.0f}"] if self.iso is not None else []),
        ]
        array = self.microlenses
        return [
            *([("camera", ", ".join(filter(None, (self.model, self.taken))))] if self.model or self.taken else []),
            *([("lens", ", ".join(lens))] if lens else []),
            *(
                [
                    (
                        "microlenses",
                        f"{array.pitch:.4g} px apart, turned by {math.degrees(array.rotation):.3f} degrees, as the "
                        "camera says",
                    )
                ]
                if array is not None
                else []
            ),
        ]


def _microlenses(metadata: Members) -> MicrolensArray | None:
    """Read the microlenses; None where the camera did not write them, or wrote what cannot be."""
    mla = ("devices", "mla")
    pitch, pixel = metadata.find_number(*mla, "lensPitch"), metadata.find_number("devices", "sensor", "pixelPitch")
    if not pitch or not pixel or metadata.find(*mla, "tiling") != "hexUniformRowMajor":
        return None
    rotation = metadata.find_number(*mla, "rotation") or 0.0
    across, down = (metadata.find_number(*mla, "scaleFactor", axis) or 1.0 for axis in ("x", "y"))
    array = MicrolensArray(pitch / pixel * across, rotation, down / across)
    possible = (
        _PITCHES[0] <= array.pitch <= _PITCHES[1]
        and abs(array.rotation) <= _MOST_ROTATION
        and _STRETCH[0] <= array.stretch <= _STRETCH[1]
    )
    return array if possible else None


_SIDES = (8, 16384)  # pixels of a picture or table
_LAMBDAS = (-1000.0, 1000.0)
_FRAMES = (("picture", "frameArray"), ("master", "picture", "frameArray"), ("frames",))
"""Places where the first Lytro, the Illum's desktop files and the Illum itself list what belongs to a picture."""


@dataclass(frozen=True)
class Pictures:
    """Pictures of one size, each in a section of its own or all of them in one video."""

    representation: str  # kind of their files: "jpeg", "png", or "h264" for a video
    size: tuple[int, int]  # (height, width) in pixels
    count: int
    sections: tuple[str, ...]
    """Names of the sections: one for each picture, or the one with the video."""


@dataclass(frozen=True, eq=False)
class Views:
    """The scene from several places of the main lens."""

    pictures: Pictures
    coordinates: NDArray[np.float64]
    """[n, 2], (x, y) of each place in Lytro's unit, x to the right and y down."""


@dataclass(frozen=True)
class FocusStack:
    """The scene from one place, focused at several depths."""

    pictures: Pictures
    lambdas: tuple[float, ...]
    """The focus of each; see `DepthTable`."""


@dataclass(frozen=True)
class DepthTable:
    """Lytro's own depth: a number λ for each cell; the larger, the farther. 0 is where the main lens was focused."""

    size: tuple[int, int]  # (height, width) in cells, which together cover a picture
    section: str
    confidence: str | None
    """Name of the section with the confidences, 0 to 1, if there are some."""


@dataclass(frozen=True)
class RawPicture:
    """The picture of the sensor: the section of its values, and the camera's metadata of them."""

    section: str
    metadata: dict[str, Any]


@dataclass(frozen=True)
class Contents:
    """All that is known in a container."""

    container: Container
    raw: RawPicture | None
    views: Views | None
    stacks: tuple[FocusStack, ...]
    depth: DepthTable | None
    camera: Camera | None
    missing: str | None
    """Name of the raw picture, if the table names one that is not in the file."""
    unknown: tuple[str, ...]  # kinds of accelerations that are not known

    @property
    def path(self) -> Path:
        """The file."""
        return self.container.path

    def summary(self) -> str:
        """Describe the contents in words: "37 views of 1080 x 1080 px, a depth table of 330 x 330"; "nothing"."""
        parts = [] if self.raw is None else ["a raw picture"]
        if self.views is not None:
            parts.append(f"{self.views.pictures.count} views of {across(self.views.pictures.size)} px")
        parts += [
            f"a focal stack of {stack.pictures.count} pictures of {across(stack.pictures.size)} px"
            for stack in self.stacks
        ]
        if self.depth is not None:
            parts.append(f"a depth table of {across(self.depth.size)}")
        parts += [f"an acceleration {kind!r}, which is not known" for kind in self.unknown]
        return ", ".join(parts) or "nothing"


def across(size: tuple[int, int]) -> str:
    """Write a (height, width) as people do: "1080 x 720", width first."""
    return f"{size[1]} x {size[0]}"


def read_contents(path: Path) -> Contents:
    """Read the contents of a container; LightFieldError if it is damaged, or names sections that are missing."""
    container = open_container(path)
    frame = Members(path, _frame(container.table))
    metadata = _metadata(container, frame)
    section = frame.values.get("imageRef")
    raw = missing = None
    if container.has(section):
        if metadata is None:
            _section(container, frame, "metadataRef")
            raise LightFieldError(f"{path} is damaged: it says nothing of its raw picture.")
        raw = RawPicture(str(section), metadata)
    elif section is not None:
        missing = str(section)[:60]
    views, stacks, depth, unknown = _accelerations(container)
    camera = None if metadata is None else Camera.of(Members(path, metadata))
    return Contents(container, raw, views, stacks, depth, camera, missing, unknown)


def _frame(table: dict[str, Any]) -> dict[str, Any]:
    """Return the object of the first frame; empty if there is none."""
    for keys in _FRAMES:
        frames: Any = table
        for key in keys:
            frames = frames.get(key) if isinstance(frames, dict) else None
        if isinstance(frames, list) and frames and isinstance(frames[0], dict):
            frame = frames[0].get("frame")
            if isinstance(frame, dict):
                return frame
    return {}


def _metadata(container: Container, frame: Members) -> dict[str, Any] | None:
    """Return the camera's metadata: in a section of its own, or in the table itself; None where there are none."""
    inline, name = frame.values.get("metadata"), frame.values.get("metadataRef")
    if isinstance(inline, dict):
        return inline
    return container.json(str(name), "its metadata") if container.has(name) else None


def _section(container: Container, of: Members, key: str) -> str:
    """Return the name of a section that has to be there."""
    name = of.values.get(key)
    if not container.has(name):
        raise LightFieldError(
            f"{container.path} is incomplete: its {key} names {str(name)[:60]!r}, and there is no such section."
        )
    return str(name)


def _accelerations(
    container: Container,
) -> tuple[Views | None, tuple[FocusStack, ...], DepthTable | None, tuple[str, ...]]:
    views: Views | None = None
    stacks: list[FocusStack] = []
    depths: list[DepthTable] = []
    unknown: list[str] = []
    for kind, content in _listed(container):
        if kind == "edofParallax":
            views = views or _views(container, content)
        elif kind in ("refocusStack", "focusStack"):
            stacks.append(_stack(container, content))
            table = next((key for key in ("depthLut", "depthMap") if key in content.values), None)
            if table is not None:
                depths.append(_depth(container, content.object(table)))
        elif kind == "depthMap":
            depths.insert(0, _depth(container, content))
        else:
            unknown.append(kind)
    return views, tuple(stacks), next(iter(depths), None), tuple(unknown)


def _listed(container: Container) -> list[tuple[str, Members]]:
    """Yield (kind, content) of each acceleration."""
    whole = Members(container.path, container.table)
    for picture in (whole.find("picture"), whole.find("master", "picture")):
        if isinstance(picture, dict) and "accelerationArray" in picture:
            entries = Members(container.path, picture, "picture").objects("accelerationArray")
            return [(entry.text("type").rpartition(".")[2][:60], entry.object("vendorContent")) for entry in entries]
    if "views" not in whole.values:
        return []
    found = [view for view in whole.objects("views") if "accelerations" in view.values]
    return [(entry.text("kind")[:60], entry) for view in found for entry in view.objects("accelerations")]


def _views(container: Container, content: Members) -> Views:
    pictures, entries = _pictures(container, content)
    coordinates = [entry.object("coord") for entry in entries]
    places = [[place.number(axis, -10.0, 10.0) for axis in ("x", "y")] for place in coordinates]
    return Views(pictures, np.array(places, np.float64))


def _stack(container: Container, content: Members) -> FocusStack:
    pictures, entries = _pictures(container, content)
    key = "lambda" if "lambda" in entries[0].values else "focus"
    return FocusStack(pictures, tuple(entry.number(key, *_LAMBDAS) for entry in entries))


def _pictures(container: Container, content: Members) -> tuple[Pictures, list[Members]]:
    """Return the pictures of an acceleration, and what is said of each of them; there is at least one."""
    if "blockOfImages" in content.values:  # a video
        block = content.object("blockOfImages")
        entries = block.objects("metadataArray")
        sections = [_section(container, block, "blockOfImagesRef")]
        kinds = [block.text("representation")]
        sized = entries
    elif "perImage" in content.values:  # the Illum's
        entries = content.objects("perImage")
        sections = [_section(container, entry, "imageRef") for entry in entries]
        kinds, sized = [content.text("representation")], [content]
    else:
        entries = sized = content.objects("imageArray")
        sections = [_section(container, entry, "imageRef") for entry in entries]
        kinds = [entry.text("representation") for entry in entries]
    if not entries:
        raise LightFieldError(f"{container.path} is damaged: an acceleration of it has no pictures.")
    sizes = {(entry.integer("height", *_SIDES), entry.integer("width", *_SIDES)) for entry in sized}
    if len(sizes) > 1 or len(set(kinds)) > 1:
        raise LightFieldError(f"{container.path} has pictures of several sizes or kinds in one stack.")
    return Pictures(kinds[0][:60], sizes.pop(), len(entries), tuple(sections)), entries


def _depth(container: Container, content: Members) -> DepthTable:
    size = content.integer("height", *_SIDES), content.integer("width", *_SIDES)
    table = content.object("depthMap") if "depthMap" in content.values else content
    confidence = content.object("confidenceMap") if "confidenceMap" in content.values else None
    names = []
    for entry in (table, *(() if confidence is None else (confidence,))):
        kind, name = entry.text("representation"), _section(container, entry, "imageRef")
        if kind not in ("raw", "packedFloat"):
            raise LightFieldError(f"{container.path} has a depth table stored as {kind[:60]!r}; known is 'raw'.")
        if container.length(name) != 4 * size[0] * size[1]:
            raise LightFieldError(
                f"{container.path} is damaged: a depth table of {across(size)} is {4 * size[0] * size[1]} bytes, "
                f"this one has {container.length(name)}."
            )
        names.append(name)
    return DepthTable(size, names[0], names[1] if confidence is not None else None)
