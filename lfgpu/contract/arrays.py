"""The arrays and numbers of a backend."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = Any
"""An array on a device, of whatever type the backend uses; only its own backend looks inside."""

Scalar: TypeAlias = Any
"""One float64 number on a device; `Memory.number` waits for it."""

Float64Array: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]
