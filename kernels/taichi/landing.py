"""Landing places of reference pixels in the views, and the tent Λ of `kernels/reference/splat.py`."""

import taichi as ti

from .runtime import TASK


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


@ti.func
def tasks_of_view(size: int, cpu: ti.template()):
    """Count the iterations that share a view of `size` pixels: one for each; on a CPU `TASK`, of which one works."""
    count = size
    if ti.static(cpu):
        count = TASK
    return count


@ti.func
def share_of_view(task: int, size: int, cpu: ti.template()):
    """(n, first, end): the view of an iteration, and its pixels: on a CPU, where atomics cost much, all or none."""
    n = task // tasks_of_view(size, cpu)
    first = task % tasks_of_view(size, cpu)
    end = first + 1
    if ti.static(cpu):
        end = ti.select(first == 0, size, 0)
    return n, first, end


@ti.func
def tent(a, softness):
    """Λ(a) for a in [0, 1], as 1 minus the integral of -Λ': without branches, which random fractions mispredict."""
    top = ti.min(a, softness)
    foot = ti.max(a - (1.0 - softness), 0.0)
    return 1.0 - (a - top + (top * top - foot * foot) * (0.5 / softness)) * (1.0 / (1.0 - softness))


@ti.func
def tent_slope(a, softness):
    """Λ'(a) for a in [0, 1]."""
    return -(1.0 / (1.0 - softness)) * ti.min(ti.min(a, 1.0 - a) * (1.0 / softness), 1.0)


@ti.func
def foot(b, softness):
    """Λ(1 - b) for b in [0, 1], with all its digits where it is nearly 0."""
    low = ti.min(b, softness)
    top = ti.max(b - (1.0 - softness), 0.0)
    return (b - low + (low * low - top * top) * (0.5 / softness)) * (1.0 / (1.0 - softness))
