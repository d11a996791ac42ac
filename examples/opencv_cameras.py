"""Depth of cameras that OpenCV opens, each with a clock of its own: a grabber for `lfgpu live`.

    lfgpu rectify pictures --calibration cameras.yaml -o rectified      # once
    cd examples && lfgpu live opencv_cameras:frames --rectify ../rectified

Each camera has a thread. What they record within 10 ms of each other is a frame; a camera that is missing is left out.
"""

import threading
import time
from collections.abc import Iterator

import numpy as np

import lfgpu

SOURCES = (0, 1, 2)  # what cv2.VideoCapture opens: numbers of cameras, addresses of streams
TOLERANCE = 0.01  # seconds


def record(camera: int, capture, grouper: lfgpu.FrameGrouper) -> None:
    """Add pictures of one camera until it ends; OpenCV gives them as blue, green, red."""
    while True:
        there, picture = capture.read()
        if not there:
            return
        grouper.add(camera, picture[..., ::-1], time.monotonic())


def frames(sources=SOURCES, capture=None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Frames of all cameras: views [n, y, x, c] and which of them are there."""
    if capture is None:
        import cv2

        capture = cv2.VideoCapture
    opened = [capture(source) for source in sources]
    shapes = []
    for source, one in zip(sources, opened, strict=True):
        there, picture = one.read()
        if not there:
            raise SystemExit(f"camera {source} gives no picture.")
        shapes.append(picture.shape)
    if len(set(shapes)) > 1:
        raise SystemExit(f"the cameras give pictures of {sorted(set(shapes))}; set them to one size.")
    grouper = lfgpu.FrameGrouper(len(opened), shapes[0], tolerance=TOLERANCE)
    threads = [threading.Thread(target=record, args=(n, one, grouper), daemon=True) for n, one in enumerate(opened)]
    for thread in threads:
        thread.start()

    def end() -> None:
        for thread in threads:
            thread.join()
        grouper.close()

    threading.Thread(target=end, daemon=True).start()
    for group in grouper:
        yield group.views, group.valid


if __name__ == "__main__":
    for views, valid in frames():
        print(views.shape, f"{valid.sum()} cameras")
