"""Rectification, that is pictures looked up at other places, with other tones: cases and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, stored


@dataclass(frozen=True)
class ResamplingCase(Case):
    """`count` pictures of `size` stored as `dtype`, looked up up to `reach` pixels beside their pixels."""

    size: tuple[int, int] = (11, 14)
    out_size: tuple[int, int] = (11, 14)
    count: int = 3
    channels: int = 3
    dtype: str = "uint8"
    white: float | None = None
    reach: float = 2.5
    tones: float = 0.2
    tolerance: float = 1e-5


RESAMPLING_CASES = (
    ResamplingCase("colour uint8"),
    ResamplingCase("grey uint8", channels=1),
    ResamplingCase("colour uint16 of 12 bits", dtype="uint16", white=4095.0),
    ResamplingCase("grey uint16", dtype="uint16", channels=1),
    ResamplingCase("colour float32", dtype="float32"),
    ResamplingCase("grey float32", dtype="float32", channels=1),
    ResamplingCase("colour float16", dtype="float16", tolerance=1e-3),
    ResamplingCase("own pixels", reach=0.0, tones=0.0),
    ResamplingCase("strong tones", tones=3.0, dtype="float32", tolerance=1e-4),
    ResamplingCase("mostly outside", reach=20.0),
    ResamplingCase("smaller pictures", size=(7, 5)),
    ResamplingCase("larger pictures", size=(23, 30), dtype="float32"),
    ResamplingCase("one pixel wide", size=(13, 1), out_size=(13, 1)),
    ResamplingCase("one pixel high", size=(1, 13), out_size=(1, 13), channels=1),
    ResamplingCase("one pixel", size=(1, 1), out_size=(1, 1)),
    ResamplingCase("one view", count=1),
    ResamplingCase("work for several threads", size=(61, 38), out_size=(61, 38), count=9),
)


def resampling_inputs(case: ResamplingCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random pictures and tones; places beside the pixels, some of them NaN, none on the very edge of the pictures."""
    (height, width), (rows, columns) = case.size, case.out_size
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    beside = rng.uniform(-case.reach, case.reach, (case.count, rows, columns, 2))
    places = np.stack([x, y], axis=-1) + beside
    for axis, size in ((0, width), (1, height)):
        at = places[..., axis]
        on_edge = np.minimum(np.abs(at + 0.5), np.abs(at - size + 0.5)) < 1e-3
        at[on_edge] = 0.0
    places[rng.random(places.shape[:3]) < 0.05] = np.nan
    q = rng.random((case.count, rows, columns, 1))
    white = case.white or (1.0 if case.dtype.startswith("float") else float(np.iinfo(case.dtype).max))
    tones = case.tones * rng.normal(size=(case.count, 3, case.channels)) * np.array([1.0, white, 1.0])[:, None]
    tones[:, 0] += 1.0
    return SimpleNamespace(
        pictures=stored(rng.random((case.count, height, width, case.channels)), case.dtype),
        places=np.concatenate([places, q], axis=-1).astype(np.float32),
        tones=tones.astype(np.float32),
        white=white,
        whole=not case.dtype.startswith("float"),
    )


def resample(desk: Desk, i: SimpleNamespace) -> Outputs:
    shape = (*i.places.shape[:3], i.pictures.shape[-1])
    out = desk.stored_out(shape, i.pictures.dtype.type)
    desk.kernels.resample(
        desk.image(i.pictures), desk.field(i.places), desk.field(i.tones), white=i.white, views_out=out
    )
    return {"views": desk.stored_values(out)}


def resample_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to white; where whole numbers are stored, what is more than a half is off by the rest."""
    off = np.abs(got["views"] - want["views"]).max(initial=0.0) - (0.5 if i.whole else 0.0)
    return {"views": max(float(off), 0.0) / i.white}


RESAMPLE = Operation(resample, "resampling", resample_errors)
OPERATIONS = (RESAMPLE,)
