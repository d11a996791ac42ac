"""The numbers that a limited-memory BFGS solver keeps besides its vectors."""

import warp as wp

wp.set_module_options({"enable_backward": False})

LEAST_CURVATURE = 1e-10  # least s . y over |s| |y| of a pair that is kept


@wp.struct
class State:
    """One number each."""

    go_on: wp.array(dtype=wp.float64)
    step: wp.array(dtype=wp.float64)
    slope: wp.array(dtype=wp.float64)
    accepted: wp.array(dtype=int)
    rejections: wp.array(dtype=int)
    judged: wp.array(dtype=int)
    newest: wp.array(dtype=int)  # slot of the newest pair
    pairs: wp.array(dtype=int)
    length: wp.array(dtype=int)  # of the trace
    flat: wp.array(dtype=int)
