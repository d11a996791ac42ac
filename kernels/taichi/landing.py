"""Landing places of reference pixels in the views."""

import taichi as ti


@ti.dataclass
class Landing:
    """The landing place of a reference pixel in a view: the pixel above and to the left, and the rest beyond it."""

    x: ti.i32
    y: ti.i32
    ax: ti.f32
    ay: ti.f32


@ti.func
def land(x: int, y: int, disparity: float, du: float, dv: float):
    # The shift is split before the column is added: a small number keeps its digits in float32.
    shift_x = -disparity * du
    shift_y = -disparity * dv
    whole_x = ti.floor(shift_x)
    whole_y = ti.floor(shift_y)
    return Landing(
        x=x + ti.cast(whole_x, ti.i32), y=y + ti.cast(whole_y, ti.i32), ax=shift_x - whole_x, ay=shift_y - whole_y
    )


@ti.func
def inside(x: int, y: int, height: int, width: int):
    return x >= 0 and x < width and y >= 0 and y < height


@ti.func
def nearest(whole: int, beyond: float):
    """Compute the whole number nearest to whole + beyond with `beyond` in [0, 1]; halves round to even."""
    result = whole
    if beyond > 0.5 or (beyond == 0.5 and whole % 2 != 0):
        result += 1
    return result


@ti.func
def within(whole: int, beyond: float, size: int):
    """True if whole + beyond lies in [0, size - 1]."""
    return whole >= 0 and (whole < size - 1 or (whole == size - 1 and beyond == 0.0))
