"""Two frames of a texture that moves between them, and what was known before: cases and checks of streams."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, float32, scale_of, stored


@dataclass(frozen=True)
class StreamingCase(Case):
    """A frame `size` pixels large in which the texture lies (dx, dy) farther right and down than in the one before."""

    size: tuple[int, int] = (30, 34)
    channels: int = 3
    shift: tuple[float, float] = (0.7, -0.4)
    dtype: str = "uint8"
    masked: bool = False
    cut: bool = False  # whether the right half is another scene
    tolerance = 1e-5


STREAMING_CASES = (
    StreamingCase("moving"),
    StreamingCase("grey float32", channels=1, dtype="float32"),
    StreamingCase("still masked", shift=(0.0, 0.0), masked=True),
    StreamingCase("farther than it may", shift=(2.6, 0.0), dtype="uint16"),
    StreamingCase("cut", cut=True, dtype="float16"),
    StreamingCase("one pixel high", size=(1, 40), channels=1),
    StreamingCase("more pixels than samples", size=(130, 70), channels=1, masked=True),
)


def _texture(size: tuple[int, int], channels: int, shift: tuple[float, float]) -> np.ndarray:
    """A picture [y, x, c] on [0, 1].

    A grey one has texture in more than one direction, too: along a single wave nothing but rounding tells the motion.
    """
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    x, y = x - shift[0], y - shift[1]
    waves = np.stack([np.sin(0.7 * x + 0.2 * y), np.cos(0.5 * y - 0.3 * x), np.sin(0.4 * x + 0.6 * y + 1)], axis=2)
    return 0.5 + 0.2 * (waves if channels == 3 else waves.mean(2, keepdims=True))


def streaming_inputs(case: StreamingCase, rng: np.random.Generator) -> SimpleNamespace:
    """Two frames, fields of what is known, and views of which the second is the reference."""
    last, image = (_texture(case.size, case.channels, shift) for shift in ((0.0, 0.0), case.shift))
    if case.cut:
        image[:, case.size[1] // 2 :] = 1 - image[:, case.size[1] // 2 :]
    steps = np.cumsum(rng.random(case.size) < 0.1, axis=1)  # surfaces, one beside the other
    views = np.stack([rng.random(image.shape), image, rng.random(image.shape)])
    before = np.stack([views[0], last, views[2]])
    if case.dtype.startswith("float"):
        views[1, 0, 0, 0] = 2.0  # beyond what intensities are, in one channel
    return SimpleNamespace(
        image=float32(image),
        last=float32(last),
        past=float32(steps + 0.02 * rng.random(case.size)),
        frames=float32(1 + 5 * rng.random(case.size)),
        rate=float32(0.1 * rng.normal(size=case.size)),
        confidence=float32(rng.random(case.size)),
        same=float32(rng.random(case.size)),
        disparity=float32(steps + 0.3 * rng.normal(size=case.size)),
        volume=float32(rng.random((5, *case.size))),
        views=stored(views.clip(0, None), case.dtype),
        before=stored(before.clip(0, None), case.dtype),
        present=np.array([1, 0, 1], np.float32),
        base=float32(rng.random((3, *case.size)) < 0.7) if case.masked else None,
        scale=scale_of(case.dtype),
    )


ROUNDED = 1e-3
"""What differs by more is not rounding: another motion was chosen."""

DOUBTFUL = 2e-3
"""The share of pixels at which two motions may fit so nearly alike that rounding decides between them.

Changes are rounded by about 1e-6 of themselves, and one of nine is chosen: a pixel in 1e5, 0.1 of the largest frame.
These are two pixels of a frame of 1,020.
"""


def motion(desk: Desk, i: SimpleNamespace) -> Outputs:
    """What looks the same, and the past carried along; after another pair of frames, which leaves no trace."""
    image, last = desk.image(i.image), desk.image(i.last)
    found, same = desk.kernels.streaming.motion(image), desk.out(i.past.shape)
    found.find(last, image, tolerance=0.1, same_out=same)
    found.find(image, last, tolerance=0.01, same_out=same)
    names = ("past", "frames", "rate", "confidence")
    out = {name: desk.out(i.past.shape) for name in names}
    known = [desk.field(getattr(i, name)) for name in names]
    found.carry(*known, support=0.1, **{f"{name}_out": field for name, field in out.items()})
    return {"same": same, **out}


def bias(desk: Desk, i: SimpleNamespace) -> Outputs:
    volume = desk.held(i.volume)
    past, trust = desk.field(i.past), desk.field(i.confidence)
    desk.kernels.streaming.bias(past, trust, volume, first=-0.5, step=0.4, strength=0.3, reach=1.5)
    return {"volume": volume}


def blend(desk: Desk, i: SimpleNamespace) -> Outputs:
    disparity, names = desk.held(i.disparity), ("frames", "rates", "weights")
    out = {name: desk.out(i.past.shape) for name in names}
    desk.kernels.streaming.blend(
        *(desk.field(values) for values in (i.past, i.same, i.frames, i.rate)),
        disparity,
        persistence=0.7,
        support=0.3,
        steady=0.8,
        rate_gain=0.2,
        **{f"{name}_out": field for name, field in out.items()},
    )
    return {"disparity": disparity, **out}


def transport(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Three frames, and a map of the last: what changed, which views were there, and what came of the work."""
    kernels, size = desk.kernels, i.past.shape
    views = kernels.zeros_image(i.views.shape, desk.device, i.views.dtype)
    disparity, confidence = desk.held(i.disparity), desk.held(i.confidence)
    numbers = kernels.scalar(0.25, desk.device), kernels.scalar(0.5, desk.device)
    traffic = kernels.streaming.transport(
        views, (disparity, confidence, *numbers), reference=1, scale=i.scale, tolerance=0.02, results=1
    )
    traffic.enter()
    shares = []
    for frame, present in ((i.views, np.ones(3)), (i.before, np.ones(3)), (i.views, i.present)):
        slot = traffic.slot()
        slot.host[:], slot.present[:] = frame, present
        traffic.send(slot, 0, 2)
        traffic.send(slot, 2, 3)
        shares += traffic.bring(slot)
    mask, seen = desk.out(i.views.shape[:3]), desk.image_out((*size, i.views.shape[3]))

    def work() -> None:
        kernels.intensities(views, 2, None, scale=i.scale, fill=0.0, image_out=seen)
        kernels.axpby(2.0, disparity, 1.0, confidence, disparity)

    maps = traffic.solve(work, lambda: traffic.mask(None if i.base is None else desk.field(i.base), mask))
    _, trust, moved = traffic.wait(maps)
    lease = traffic.lease(maps)
    kernels.fill(7.0, disparity)
    traffic.synchronize()
    got = kernels.field(lease.numpy(0), desk.device), kernels.field(lease.numpy(1), desk.device)
    return {
        "shares": shares,
        "numbers": [trust, moved],
        "mask": mask,
        "seen": seen,
        "disparity": got[0],
        "confidence": got[1],
    }


def motion_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The share of pixels that differ, less what rounding may decide."""
    return {
        name: max(0.0, float((np.abs(got[name] - want[name]) > ROUNDED * np.abs(want[name]).max()).mean()) - DOUBTFUL)
        for name in want
    }


OPERATIONS = (
    Operation(motion, "streaming", motion_errors),
    Operation(bias, "streaming"),
    Operation(blend, "streaming"),
    Operation(transport, "streaming"),
)
