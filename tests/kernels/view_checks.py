"""The checks of the operations on stored views."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, relative_to_terms


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
    return {"epis": desk.stored_values(out), "fields": fields}


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
