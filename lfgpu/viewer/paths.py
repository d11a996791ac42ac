"""Path of the eye in space: an orbit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PICTURES = 48
"""Pictures of a film."""

_ASIDE, _ABOVE = math.radians(20), math.radians(8)  # of an orbit: how far it goes either way


@dataclass(frozen=True)
class Pose:
    """An eye: its place, what it looks at, and its vertical field of view in radians. Its y axis points down."""

    eye: NDArray[np.float64]
    target: NDArray[np.float64]
    fov: float = 1.0

    @classmethod
    def of(cls, camera: Any) -> Pose:
        """Return the pose of a camera of viser."""
        return cls(np.array(camera.position), np.array(camera.look_at), camera.fov)

    @property
    def away(self) -> float:
        """The distance of what it looks at."""
        return float(np.linalg.norm(self.target - self.eye))

    @property
    def axes(self) -> NDArray[np.float64]:
        """[3, 3], its directions right, down and forward as columns."""
        forward = (self.target - self.eye) / self.away
        right = np.cross((0.0, 1.0, 0.0), forward)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward], axis=1)

    def orbited(self, turn: float) -> Pose:
        """Move the eye around what it looks at: to both sides in one turn, up and down twice; 0 and 1 are here."""
        aside, down = _ASIDE * math.sin(2 * math.pi * turn), _ABOVE * math.sin(4 * math.pi * turn)
        by = (math.cos(down) * math.sin(aside), math.sin(down), -math.cos(down) * math.cos(aside))
        return Pose(self.target + self.away * self.axes @ by, self.target, self.fov)
