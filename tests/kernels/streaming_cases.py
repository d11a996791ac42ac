"""The cases of streams: two frames of a texture that moves between them, and what was known before."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from cases import Case, float32, scale_of, stored


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
