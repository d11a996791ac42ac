"""Contents of a Lytro container: raw picture, views, facts of the camera, and what else is there by its name.

Cameras write the raw picture. Lytro's desktop program and web service write "accelerations" instead: pictures that were
computed from it, for viewers. The first camera's program and the Illum's describe them with different words.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

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
    def of(cls, metadata: Members) -> Self:
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
        numbers = (self.focal_length_mm, self.f_number, self.exposure_s, self.iso)
        texts = ("{:.4g} mm", "f/{:.3g}", "{:.3g} s", "ISO {:.0f}")
        lens = [text.format(number) for number, text in zip(numbers, texts, strict=True) if number is not None]
        facts = {"camera": ", ".join(filter(None, (self.model, self.taken))), "lens": ", ".join(lens)}
        if (array := self.microlenses) is not None:
            turned = f"turned by {math.degrees(array.rotation):.3f} degrees, as the camera says"
            facts["microlenses"] = f"{array.pitch:.4g} px apart, {turned}"
        return [(label, text) for label, text in facts.items() if text]


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


_SIDES = (8, 16384)  # pixels of a picture
_FRAMES = (("picture", "frameArray"), ("master", "picture", "frameArray"), ("frames",))
"""Places where the first Lytro, the Illum's desktop files and the Illum itself list what belongs to a picture."""
FOCAL_STACK = "a focal stack"
_OTHERS = {"refocusStack": FOCAL_STACK, "focusStack": FOCAL_STACK, "depthMap": "a depth table"}
"""Names of what is no light field: pictures focused at several depths, and Lytro's own depth."""


@dataclass(frozen=True, eq=False)
class Views:
    """The scene from several places of the main lens: pictures of one size, in sections of their own or in a video."""

    representation: str  # kind of the files: "jpeg", "png", or "h264" for a video
    size: tuple[int, int]  # (height, width) in pixels
    sections: tuple[str, ...]  # names of the sections: one for each picture, or the one with the video
    coordinates: NDArray[np.float64]  # [n, 2], (x, y) of each place in Lytro's unit, x to the right and y down


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
    others: tuple[str, ...]  # names of what is no light field
    camera: Camera | None
    missing: str | None  # name of the raw picture, if the table names one that is not in the file

    def summary(self) -> str:
        """Describe the contents in words: "37 views of 1080 x 1080 px, a focal stack"; "nothing"."""
        parts = [] if self.raw is None else ["a raw picture"]
        if self.views is not None:
            parts.append(f"{len(self.views.coordinates)} views of {across(self.views.size)} px")
        return ", ".join([*parts, *self.others]) or "nothing"


def across(size: tuple[int, int]) -> str:
    """Write a (height, width) as people do: "1080 x 720", width first."""
    return f"{size[1]} x {size[0]}"


def read_contents(path: Path) -> Contents:
    """Read the contents of a container; LightFieldError if it is damaged, or names sections that are missing."""
    container = open_container(path)
    frame = Members(path, _frame(Members(path, container.table)))
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
    listed = _accelerations(container)
    of_views = next((content for kind, content in listed if kind == "edofParallax"), None)
    views = None if of_views is None else _views(container, of_views)
    others = [
        _OTHERS.get(kind, f"an acceleration {kind!r}, which is not known")
        for kind, _ in listed
        if kind != "edofParallax"
    ]
    camera = None if metadata is None else Camera.of(Members(path, metadata))
    return Contents(container, raw, views, tuple(others), camera, missing)


def _frame(table: Members) -> dict[str, Any]:
    """Return the object of the first frame; empty if there is none."""
    for keys in _FRAMES:
        frames = table.find(*keys)
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


def _accelerations(container: Container) -> list[tuple[str, Members]]:
    """List (kind, content) of each acceleration."""
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
    if "blockOfImages" in content.values:  # a video
        block = content.object("blockOfImages")
        entries = block.objects("metadataArray")
        sections = [_section(container, block, "blockOfImagesRef")]
        kinds = [block.text("representation")]
    else:
        entries = content.objects("imageArray")
        sections = [_section(container, entry, "imageRef") for entry in entries]
        kinds = [entry.text("representation") for entry in entries]
    if not entries:
        raise LightFieldError(f"{container.path} is damaged: an acceleration of it has no pictures.")
    sizes = {(entry.integer("height", *_SIDES), entry.integer("width", *_SIDES)) for entry in entries}
    if len(sizes) > 1 or len(set(kinds)) > 1:
        raise LightFieldError(f"{container.path} has pictures of several sizes or kinds in one stack.")
    coordinates = [entry.object("coord") for entry in entries]
    places = [[place.number(axis, -10.0, 10.0) for axis in ("x", "y")] for place in coordinates]
    return Views(kinds[0][:60], sizes.pop(), tuple(sections), np.array(places, np.float64))
