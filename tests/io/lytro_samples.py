"""Containers as Lytro's programs write them: views, focal stacks, and what cameras say of themselves."""

import io
import json
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tests.io.lenslet_samples import section

LOST = "sha1-" + 40 * "0"
"""Name of a section that is in another file: processed containers name the raw picture that they were made from."""

CAMERA: dict[str, Any] = {
    "camera": {"make": "Lytro, Inc.", "model": "F01"},
    "devices": {
        "clock": {"zuluTime": "2015-05-05T10:07:34.000Z"},
        "sensor": {"pixelPitch": 1.4e-06, "iso": 100},
        "lens": {"focalLength": 0.00653, "fNumber": 1.91},
        "shutter": {"pixelExposureDuration": 0.0125},
        "mla": {
            "tiling": "hexUniformRowMajor",
            "lensPitch": 1.4e-05,
            "rotation": 0.0019,
            "scaleFactor": {"x": 1, "y": 1.0002},
        },
    },
}
"""What a camera says of itself, as far as it matters."""

Images: TypeAlias = Sequence[NDArray[np.uint8]] | NDArray[np.uint8]

Part: TypeAlias = tuple[dict[str, Any], list[bytes]]
"""The content of an acceleration, and the data of its sections."""


def name(data: bytes) -> str:
    """Return the name of the section of some data."""
    return section(b"C", data)[1]


def coded(image: NDArray[np.uint8], kind: str) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, kind, quality=95)
    return file.getvalue()


def video(data: bytes, size: tuple[int, int], each: Sequence[dict[str, Any]]) -> Part:
    """A video of pictures, of each of which something is said."""
    about = [{"height": size[0], "width": size[1], **one} for one in each]
    return {"blockOfImages": {"representation": "h264", "blockOfImagesRef": name(data), "metadataArray": about}}, [data]


def pictures(images: Images, each: Sequence[dict[str, Any]]) -> Part:
    """Pictures without loss, of each of which something is said."""
    data = [coded(image, "PNG") for image in images]
    height, width = images[0].shape[:2]
    listed = [
        {"representation": "png", "height": height, "width": width, "imageRef": name(one), **about}
        for one, about in zip(data, each, strict=True)
    ]
    return {"imageArray": listed}, data


def focal_stack(images: Images) -> Part:
    """JPEG pictures focused at λ = -1, 0, 1, ..."""
    data = [coded(image, "JPEG") for image in images]
    height, width = images[0].shape[:2]
    listed = [
        {"representation": "jpeg", "height": height, "width": width, "imageRef": name(one), "lambda": float(i - 1)}
        for i, one in enumerate(data)
    ]
    return {"defaultLambda": 0, "imageArray": listed}, data


def processed(
    accelerations: Sequence[tuple[str, dict[str, Any]]], data: Sequence[bytes], *, camera: dict[str, Any] | None = None
) -> bytes:
    """A container as the first Lytro's program writes it: the table, then data; the raw picture is elsewhere."""
    said = [] if camera is None else [json.dumps(camera).encode()]
    frame = {"imageRef": LOST, "metadataRef": name(said[0]) if said else LOST}
    listed = [{"type": f"com.lytro.acceleration.{kind}", "vendorContent": content} for kind, content in accelerations]
    table = {"picture": {"frameArray": [{"frame": frame}], "accelerationArray": listed}}
    return whole(table, [*said, *data])


def of_illum(content: dict[str, Any], data: Sequence[bytes], *, camera: dict[str, Any]) -> bytes:
    """A container as the Illum's program writes it: what the camera says stands in the table."""
    table = {
        "frames": [{"frame": {"metadata": camera}}],
        "views": [{"recipe": {}}, {"recipe": {}, "accelerations": [content]}],
    }
    return whole(table, data)


def whole(table: dict[str, Any], data: Sequence[bytes]) -> bytes:
    """A container of a table and sections of data, each once."""
    head = b"\x89LFP\r\n\x1a\n" + bytes([0, 0, 0, 1, 0, 0, 0, 0])
    first = section(b"M", json.dumps(table).encode())[0]
    return head + first + b"".join(section(b"C", one)[0] for one in dict.fromkeys(data))
