"""Raw captures made from known light fields, and containers to put them in: what decoding has to find again."""

import hashlib
import json
import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfgpu.data import LightField


@dataclass(frozen=True)
class Camera:
    """A lenslet camera. Centres of lenses are at origin + k * along + row * down, (x, y) in pixels."""

    pitch: float = 9.3
    degrees: float = 0.4
    size: tuple[int, int] = (520, 560)
    bayer: str = "bggr"
    phase: tuple[float, float] = (0.3, -0.2)
    """Where the middle lens is, off the middle of the sensor."""
    upright: bool = False
    square: bool = False

    @property
    def axes(self) -> NDArray[np.float64]:
        c, s = math.cos(math.radians(self.degrees)), math.sin(math.radians(self.degrees))
        return np.array([[c, s], [-s, c]])

    @property
    def row_distance(self) -> float:
        return self.pitch * (1 if self.square else math.sqrt(3) / 2)

    @property
    def shift(self) -> float:
        """Of every second row, in pitches."""
        return 0.0 if self.square else 0.5

    @property
    def middle(self) -> NDArray[np.float64]:
        return (np.array(self.size[::-1]) - 1) / 2 + self.phase

    def lens(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """For each pixel: the centre of its lens in the axes of the grid, and its offset from it: [2, y, x] each."""
        y, x = np.mgrid[: self.size[0], : self.size[1]].astype(np.float64)
        q = np.einsum("ij,jyx->iyx", self.axes, np.stack([x - self.middle[0], y - self.middle[1]]))
        best, nearest = np.full(self.size, np.inf), np.zeros_like(q)
        for odd in (0, 1):  # a hexagonal lattice is two rectangular ones
            row = 2 * np.rint((q[1] / self.row_distance - odd) / 2) + odd
            k = np.rint(q[0] / self.pitch - odd * self.shift) + odd * self.shift
            centre = np.stack([k * self.pitch, row * self.row_distance])
            distance = np.hypot(*(q - centre))
            nearest = np.where(distance < best, centre, nearest)
            best = np.minimum(distance, best)
        return nearest, q - nearest

    def centres(self) -> NDArray[np.float64]:
        """(x, y) of all lenses on the sensor, [n, 2]."""
        reach = int(max(self.size) / self.pitch) + 2
        row, k = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        q = np.stack([(k + self.shift * (row % 2)) * self.pitch, row * self.row_distance], axis=-1).reshape(-1, 2)
        points = self.middle + q @ self.axes
        inside = (points > self.pitch).all(1) & (points < np.array(self.size[::-1]) - self.pitch).all(1)
        return points[inside]

    def light(self, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """What share of the light a pixel gets: a disc that darkens outwards, and gaps that are not quite black."""
        radius = np.hypot(*offset) / (self.pitch / 2)
        rim = np.clip((1.1 - radius) / 0.3, 0, 1)
        return 0.06 + 0.94 * (1 - 0.35 * np.minimum(radius, 1.2) ** 2) * rim * rim * (3 - 2 * rim)

    def colours(self) -> NDArray[np.int64]:
        """[y, x], the colour of each pixel."""
        y, x = np.mgrid[: self.size[0], : self.size[1]]
        return np.array(["rgb".index(c) for c in self.bayer]).reshape(2, 2)[y % 2, x % 2]


@dataclass(frozen=True)
class Sample:
    """A capture, [y, x] in [0, 1], its white image, and the light field behind them."""

    camera: Camera
    scene: LightField
    raw: NDArray[np.float64]
    white: NDArray[np.float64]

    def expected(self, shape: tuple[int, int], first: Any, side: float, du: float, dv: float) -> NDArray[np.float64]:
        """The view at (du, dv) [y, x, c], at pixels `side` apart from `first` (x, y) on the sensor on."""
        y, x = np.mgrid[: shape[0], : shape[1]] * side
        q = self.camera.axes @ (np.asarray(first) - self.camera.middle)
        return np.stack([sampled(self.scene, self.camera, (q[0] + x, q[1] + y), (du, dv), c) for c in range(3)], -1)

    def truth(self, shape: tuple[int, int], first: Any, side: float) -> NDArray[np.float64]:
        """The disparity of the middle view there."""
        y, x = np.mgrid[: shape[0], : shape[1]] * side
        q = self.camera.axes @ (np.asarray(first) - self.camera.middle)
        height, width = self.scene.size
        place = [
            (q[1] + y) / self.camera.row_distance + (height - 1) / 2,
            (q[0] + x) / self.camera.row_distance + (width - 1) / 2,
        ]
        return ndimage.map_coordinates(self.scene.truth.disparity, place, order=1, mode="nearest")


def sampled(scene: LightField, camera: Camera, q: Any, offset: Any, colour: Any) -> NDArray[np.float64]:
    """The scene seen by lenses at `q` (x, y in the axes of the grid) from (du, dv): linear in all four dimensions."""
    rows, columns = scene.grid_shape or (0, 0)
    height, width = scene.size
    grid = (scene.views * scene.scale).reshape(rows, columns, height, width, 3)
    at = np.broadcast_arrays(
        offset[1] + (rows - 1) / 2,
        offset[0] + (columns - 1) / 2,
        q[1] / camera.row_distance + (height - 1) / 2,
        q[0] / camera.row_distance + (width - 1) / 2,
        colour,
    )
    return ndimage.map_coordinates(grid, at, order=1, mode="nearest")


def capture(scene: LightField, camera: Camera, *, noise: float = 0.0, seed: int = 0) -> Sample:
    """Record with a camera a light field whose views are a pixel of the sensor apart."""
    centre, offset = camera.lens()
    light = camera.light(offset)
    raw = sampled(scene, camera, centre, offset, camera.colours()) * light
    raw = np.clip(raw + np.random.default_rng(seed).normal(0, noise, raw.shape) if noise else raw, 0, 1)
    gains = np.array([0.8, 1.0, 0.6])[camera.colours()]  # the lamp of the white image is not white
    return Sample(camera, scene, raw, 0.9 * light * gains)


def eight_bit(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(values * 255).astype(np.uint8)


# --- containers ---


def packed(values: NDArray[np.uint16], bits: int) -> bytes:
    """12-bit values big endian, 10-bit values little endian, as the cameras pack them."""
    v = values.ravel().astype(np.uint16)
    if bits == 12:
        a, b = v[0::2], v[1::2]
        columns = [a >> 4, (a & 15) << 4 | b >> 8, b & 255]
    else:
        columns = [v[i::4] >> 2 for i in range(4)]
        columns.append(sum((v[i::4] & 3) << (2 * i) for i in range(4)))
    return np.stack(columns, axis=1).astype(np.uint8).tobytes()


def metadata(shape: tuple[int, int], *, bits: int = 12, first: str = "b") -> dict[str, Any]:
    """What the first Lytro (12 bits) or the Illum (10 bits) says of a picture, as far as it matters."""
    black, white = (168, 4095) if bits == 12 else (64, 1023)
    details = {
        "pixelFormat": {
            "rightShift": 0,
            "black": dict.fromkeys(("r", "gr", "gb", "b"), black),
            "white": dict.fromkeys(("r", "gr", "gb", "b"), white),
        },
        "pixelPacking": {"endianness": "big" if bits == 12 else "little", "bitsPerPixel": bits},
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": first},
    }
    image = {"width": shape[1], "height": shape[0], "orientation": 1, "representation": "rawPacked"}
    color = {"whiteBalanceGain": {"r": 1.0, "gr": 1.0, "gb": 1.0, "b": 1.0}}
    if bits == 12:
        return {"type": "lightField", "image": {**image, "rawDetails": details, "color": color}}
    return {"image": {**image, **details, "color": color}}


def section(kind: bytes, data: bytes) -> tuple[bytes, str]:
    name = f"sha1-{hashlib.sha1(data, usedforsecurity=False).hexdigest()}"
    head = b"\x89LF" + kind + b"\r\n\x1a\n" + bytes(4) + struct.pack(">I", len(data))
    body = head + name.encode().ljust(80, b"\0") + data
    return body + bytes(-len(body) % 16), name


def container(image: bytes, about: dict[str, Any], *, illum: bool = False) -> bytes:
    """A container as the first Lytro writes it (the table first), or as the Illum does (the table last)."""
    parts, names = zip(*(section(b"C", data) for data in (image, json.dumps(about).encode(), b"{}")), strict=True)
    frame = {"frame": dict(zip(("imageRef", "metadataRef", "privateMetadataRef"), names, strict=True))}
    table = json.dumps({"frames": [frame]} if illum else {"picture": {"frameArray": [frame]}})
    # imageio's reader of the first Lytro's files skips five bytes after the table: so long is its padding there.
    table += " " * ((11 - len(table)) % 16)
    last = section(b"M", table.encode())[0]
    head = b"\x89LFP\r\n\x1a\n" + struct.pack(">II", 1, 0)
    return head + (b"".join(parts) + last if illum else last + b"".join(parts))
