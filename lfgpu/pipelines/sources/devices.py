"""Source of cameras, or streams on a network, that OpenCV opens (extra `opencv`)."""

from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.damage import require
from lfgpu.pipelines.sources.base import Frames, Options, check_sizes, light_field

PREFIX = "opencv:"


def recognise(source: str) -> bool:
    return source.startswith(PREFIX)


def frames(source: str, options: Options) -> Frames:
    """Yield the pictures of all devices. All are taken before the first is decoded, so that they are close in time.

    A device without a picture is missing in that frame. When no device has one, the frames end.
    """
    cv2 = require("cv2", "opencv", source)
    names = [name.strip() for name in source.removeprefix(PREFIX).split(",")]
    with ExitStack() as opened:
        devices = []
        for name in names:
            device = cv2.VideoCapture(int(name) if name.isdecimal() else name)
            opened.callback(device.release)
            if not device.isOpened():
                raise LightFieldError(
                    f"OpenCV cannot open {name!r} of {source}; give numbers of devices or addresses, with commas."
                )
            devices.append(device)
        shape: tuple[int, ...] | None = None
        while True:
            there = [bool(device.grab()) for device in devices]
            pictures = [
                _retrieved(cv2, device) if is_there else None for device, is_there in zip(devices, there, strict=True)
            ]
            known = [picture for picture in pictures if picture is not None]
            if not known:
                return
            if shape is None:
                if len(known) < len(pictures):
                    options.say("Waiting until all cameras have a picture.")
                    continue
                shape = known[0].shape
                check_sizes([f"{name!r} of {source}" for name in names], known)
                yield light_field(source, np.stack(known), options)
                continue
            valid = np.array([picture is not None and picture.shape == shape for picture in pictures])
            black = np.zeros(shape, np.uint8)
            views = [p if ok and p is not None else black for p, ok in zip(pictures, valid, strict=True)]
            yield np.stack(views), valid


def _retrieved(cv2: Any, device: Any) -> NDArray[np.uint8] | None:
    """Decode the picture that was grabbed: uint8 [y, x, c], colour as RGB; None if it cannot be decoded."""
    decoded, picture = device.retrieve()
    if not decoded:
        return None
    return picture[..., None] if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
