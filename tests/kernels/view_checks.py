"""The operations on stored views: cases and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import Case, Desk, Operation, Outputs, float32, relative_to_terms, scale_of, stored


@dataclass(frozen=True)
class ViewsCase(Case):
    """`count` views stored as `dtype`, of which a line is taken, and what their normalisation is stored as."""

    size: tuple[int, int] = (11, 14)
    count: int = 3
    channels: int = 3
    dtype: str = "float32"
    detail_dtype: str = "float32"
    masked: bool = False
    valid_share: float = 0.7
    sigma: float = 1.5
    floor: float = 0.05
    line: tuple[int, ...] = (2, 0)
    vertical: bool = False

    @property
    def tolerance(self) -> float:
        """Relative error of a float32 backend, and half a step of what the outputs are stored as."""
        return 1e-5 + (2.0**-11 if self.detail_dtype == "float16" else 0.0)


VIEWS_CASES = (
    ViewsCase("colour float32"),
    ViewsCase("grey float32", channels=1, vertical=True),
    ViewsCase("colour uint8 masked", dtype="uint8", masked=True),
    ViewsCase("grey uint8", channels=1, dtype="uint8", vertical=True),
    ViewsCase("colour uint16", dtype="uint16", vertical=True),
    ViewsCase("grey uint16 masked", channels=1, dtype="uint16", masked=True),
    ViewsCase("colour float16", dtype="float16", masked=True),
    ViewsCase("grey float16", channels=1, dtype="float16", vertical=True),
    ViewsCase("detail as float16", detail_dtype="float16", dtype="uint8", masked=True),
    ViewsCase("float16 all along", dtype="float16", detail_dtype="float16"),
    ViewsCase("raw intensities", sigma=0.0, dtype="uint8", masked=True),
    ViewsCase("raw intensities as float16", sigma=0.0, dtype="uint16", detail_dtype="float16", channels=1),
    ViewsCase("fractional reach", sigma=2.2, masked=True),
    ViewsCase("half a pixel of reach", sigma=0.2),  # 2.5 * 0.2 is 0.5: rounded up, and wider still than 0
    ViewsCase("wider than the view", sigma=2.2, size=(4, 5), masked=True),
    ViewsCase("few valid pixels", masked=True, valid_share=0.02, size=(19, 17)),
    ViewsCase("no valid pixel", masked=True, valid_share=0.0),
    ViewsCase("all valid", masked=True, valid_share=2.0, channels=1),
    ViewsCase("one pixel wide", size=(13, 1), vertical=True),
    ViewsCase("one pixel high", size=(1, 13), channels=1, masked=True),
    ViewsCase("one pixel", size=(1, 1), vertical=True),
    ViewsCase("one view", count=1, line=(0,)),
    ViewsCase("a view twice", line=(1, 1, 2, 0)),
    ViewsCase("high floor", floor=0.5, channels=1),
    ViewsCase("work for several threads", size=(61, 38), count=9, dtype="uint8", line=(8, 1, 4, 0, 7), vertical=True),
)


def views_inputs(case: ViewsCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random views with soft structure, so that contrast differs from place to place, and masks."""
    height, width = case.size
    y, x = np.mgrid[:height, :width]
    contrast = 0.5 + 0.45 * np.sin(0.5 * x + 0.3 * y)
    noise = rng.uniform(-0.5, 0.5, (case.count, height, width, case.channels))
    valid = float32(rng.random((case.count, height, width)) < case.valid_share)
    return SimpleNamespace(
        views=stored(0.5 + contrast[..., None] * noise, case.dtype),
        valid=valid * np.float32(0.75) if case.masked else None,  # not 0 is valid, whatever it is
        index=case.count - 1,
        fill=10.0,
        line=case.line,
        vertical=case.vertical,
        detail_dtype=np.dtype(case.detail_dtype).type,
        scale=scale_of(case.dtype),
        sigma=case.sigma,
        floor=case.floor,
    )


def intensities(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"first": desk.image_out(i.views.shape[1:]), "one": desk.image_out(i.views.shape[1:])}
    views, valid = desk.image(i.views), None if i.valid is None else desk.field(i.valid)
    for name, index in (("first", 0), ("one", i.index)):
        desk.kernels.intensities(views, index, valid, scale=i.scale, fill=i.fill, image_out=out[name])
    return out


def line_of_views(desk: Desk, i: SimpleNamespace) -> Outputs:
    _, height, width, channels = i.views.shape
    size = (width, height) if i.vertical else (height, width)
    out = desk.stored_out((len(i.line), *size, channels), i.views.dtype.type)
    desk.kernels.line_of_views(desk.image(i.views), i.line, vertical=i.vertical, epis_out=out)
    fields = desk.out((len(i.line), *size))
    desk.kernels.line_of_views(desk.field(i.views[..., 0]), i.line, vertical=i.vertical, epis_out=fields)
    top, left = height // 3, width // 2
    window = (width - left, height - top) if i.vertical else (height - top, width - left)
    part, options = desk.out((len(i.line), *window)), {"vertical": i.vertical, "corner": (top, left)}
    desk.kernels.line_of_views(desk.field(i.views[..., 0]), i.line, **options, epis_out=part)
    return {"epis": desk.stored_values(out), "fields": fields, "window": part}


def normalization(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Detail after that of other views, which leaves no trace."""
    plan = desk.kernels.normalization(i.views.shape, desk.device, scale=i.scale, sigma=i.sigma, floor=i.floor)
    out = desk.stored_out(i.views.shape, i.detail_dtype)
    other_mask = desk.field(np.arange(i.views[..., 0].size).reshape(i.views.shape[:3]) % 3)
    plan(desk.image(i.views[::-1, ::-1]), other_mask, out)
    plan(desk.image(i.views), None if i.valid is None else desk.field(i.valid), out)
    return {"detail": desk.stored_values(out)}


LINE_OF_VIEWS = Operation(line_of_views, "views")
NORMALIZATION = Operation(normalization, "views", relative_to_terms(detail=lambda i: 1.0 / i.floor if i.sigma else 0.0))
OPERATIONS = (Operation(intensities, "views"), LINE_OF_VIEWS, NORMALIZATION)
