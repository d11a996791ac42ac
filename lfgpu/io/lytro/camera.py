"""Facts that a Lytro camera wrote of itself and of a capture."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfgpu.io.texts import Members

_PITCHES = (5.0, 60.0)  # pixels between microlenses
_MOST_ROTATION = math.radians(10)
_STRETCH = (0.9, 1.1)


@dataclass(frozen=True)
class MicrolensArray:
    """The design of the microlens array: a hexagonal lattice whose rows run along the rows of the sensor."""

    pitch: float
    """Distance of neighbours in a row, in pixels of the sensor."""
    rotation: float
    """Of the rows against the rows of the sensor, in radians."""
    stretch: float
    """Distance of the rows over that of an equilateral lattice."""


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
