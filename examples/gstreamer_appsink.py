"""Depth of cameras that GStreamer delivers, with the time stamps of its buffers: a grabber for `lfgpu live`.

    lfgpu rectify pictures --calibration cameras.yaml -o rectified      # once
    cd examples && lfgpu live gstreamer_appsink:frames --rectify ../rectified

Needs PyGObject and GStreamer. All branches are of one pipeline, so that their buffers have one clock.
"""

from collections.abc import Iterator

import numpy as np

import lfgpu

SOURCES = ("v4l2src device=/dev/video0", "v4l2src device=/dev/video2")
SIZE = (480, 640)  # height, width in pixels
TOLERANCE = 0.01  # seconds


def pipeline_text(sources) -> str:
    """A branch for each camera: it keeps the latest picture only, so that a slow reader never holds a camera up."""
    caps = f"video/x-raw,format=RGB,width={SIZE[1]},height={SIZE[0]}"
    sink = "appsink name=camera{} emit-signals=true max-buffers=1 drop=true sync=false"
    return " ".join(f"{source} ! videoconvert ! {caps} ! {sink.format(n)}" for n, source in enumerate(sources))


def picture_of(sample) -> tuple[np.ndarray, float]:
    """The picture of a sample, uint8 [y, x, 3], and when it was taken, seconds. Rows are padded to 4 bytes."""
    buffer = sample.get_buffer()
    height, width = SIZE
    row = (3 * width + 3) // 4 * 4
    data = np.frombuffer(buffer.extract_dup(0, buffer.get_size()), np.uint8)
    picture = data[: height * row].reshape(height, row)[:, : 3 * width].reshape(height, width, 3)
    return picture, buffer.pts / 1e9


def frames(sources=SOURCES, gst=None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Frames of all cameras: views [n, y, x, c] and which of them are there."""
    if gst is None:
        import gi

        gi.require_version("Gst", "1.0")
        from gi.repository import Gst as gst  # noqa: N813 - the module's own name

        gst.init(None)
    grouper = lfgpu.FrameGrouper(len(sources), (*SIZE, 3), tolerance=TOLERANCE)
    pipeline = gst.parse_launch(pipeline_text(sources))

    def added(sink, camera: int):
        grouper.add(camera, *picture_of(sink.emit("pull-sample")))
        return gst.FlowReturn.OK

    for camera in range(len(sources)):
        sink = pipeline.get_by_name(f"camera{camera}")
        sink.connect("new-sample", added, camera)
        sink.connect("eos", lambda _: grouper.close())
    pipeline.set_state(gst.State.PLAYING)
    try:
        for group in grouper:
            yield group.views, group.valid
    finally:
        pipeline.set_state(gst.State.NULL)


if __name__ == "__main__":
    for views, valid in frames():
        print(views.shape, f"{valid.sum()} cameras")
