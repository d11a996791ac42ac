"""A step of conjugate gradients, put together from the operations on vectors."""

from .memory import DeviceArray, empty
from .runtime import double, once
from .sums import dot
from .vector import axpby, copy, multiply, ratio


@once
def _workspace(shape: tuple[int, ...]) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
    """M r, and two numbers."""
    return empty(shape), empty((1,), scalar=double()), empty((1,), scalar=double())


def conjugate_step(
    p: DeviceArray, q: DeviceArray, preconditioner: DeviceArray, rz: DeviceArray, x: DeviceArray, r: DeviceArray
) -> None:
    z, number, share = _workspace(p.shape)
    dot(p, q, number)
    ratio(rz, number, share)
    axpby(1.0, x, share, p, x)
    ratio(rz, number, share, factor=-1.0)
    axpby(1.0, r, share, q, r)
    multiply(preconditioner, r, z)
    copy(rz, number)
    dot(r, z, rz)
    ratio(rz, number, share)
    axpby(1.0, z, share, p, p)
