"""The scene in space that a page asks for."""

from dataclasses import dataclass
from typing import Any, Self

from lfgpu.errors import LightFieldError
from lfgpu.viewer.contents import FINAL

LARGEST = 1e9
"""No number of a page is larger: what is computed from it stays finite."""


@dataclass(frozen=True)
class Scene:
    """The scene in space that a page asks for."""

    result: str = ""
    stage: str = FINAL
    metric: bool = True  # true if points are in metres; else their depth is the disparity
    paint: str = "picture"  # source of the colours of the points: "picture", or one of the `QUANTITIES`
    colours: str = "viridis"
    low: float = 0.0
    high: float = 1.0
    exposure: float = 0.0
    gamma: float = 1.0  # the picture is brighter by 2**exposure, then to the power of 1 / gamma
    least: float = 0.0  # points of a smaller confidence are left out
    size: float = 1.3  # size of the points, distances of neighbours
    mesh: bool = False
    cameras: bool = False
    background: str = "light"
    aspect: float = 1.0  # width over height of the frame
    x: int = 0
    y: int = 0  # the pixel that is marked
    x0: int = -1
    y0: int = -1  # the pixel from which a line leads to it; -1 for none
    orbit: bool = False  # true if the eye moves around what it looks at

    @classmethod
    def of(cls, values: dict[str, Any]) -> Self:
        """Make a scene of plain values; LightFieldError if one is missing its type."""
        try:
            found = {name: type(getattr(cls, name))(value) for name, value in values.items()}
            if not all(abs(value) <= LARGEST for value in found.values() if isinstance(value, int | float)):
                raise ValueError("a number is too large")
            return cls(**found)
        except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
            raise LightFieldError(f"this cannot be shown in space: {error}.") from None
