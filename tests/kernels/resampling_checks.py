"""The checks of the operation behind rectification; as `checks.py`, they know nothing of pytest."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, Values


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
