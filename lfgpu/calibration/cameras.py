"""Calibrated cameras: their place, rotation and lens. Conventions are those of OpenCV.

World to camera: X' = R X + t, with x' to the right, y' down and z' away from the camera. A ray (x, y) = (x'/z', y'/z')
is distorted and lands at pixel (fx x + cx, fy y + cy); the centre of the first pixel is (0, 0).

"pinhole" distorts as Brown and Conrady with OpenCV's k1, k2, p1, p2, k3, k4, k5, k6; "fisheye" as Kannala and Brandt
with k1 to k4: θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lfgpu.contract import Float64Array
from lfgpu.errors import LightFieldError

MODELS = {"pinhole": (0, 4, 5, 8), "fisheye": (0, 4)}
"""The lens models, and how many coefficients each may have."""

_ROUNDS = 30  # of Newton's method
_UNDONE = 1e-6  # how near it comes to the ray that is looked for, in the plane z = 1
_TURN = 1e-3  # how far a rotation may be from an orthonormal matrix
_LARGEST_SIDE = 1_000_000  # pixels
_LARGEST = 1e9  # of pixels, coefficients and lengths in any unit: their products stay finite
_WIDEST = 1000  # sides of a picture to its focal length


@dataclass(frozen=True, eq=False)
class Camera:
    """Calibrated camera.

    Parameters
    ----------
    size
        (height, width) of its pictures in pixels.
    focal_length
        (fx, fy) in pixels, > 0.
    principal_point
        (cx, cy) in pixels.
    distortion
        Coefficients of the model, see above; none by default.
    model
        "pinhole" (default) or "fisheye".
    rotation
        [3, 3], world to camera.
    translation
        [3], world to camera, in the unit of the calibration.
    name
        File of its picture, or another name.

    Raises
    ------
    LightFieldError
        If a number is not finite or beyond what a camera has, the rotation is none or mirrors, or the model is unknown.
    """

    size: tuple[int, int]
    focal_length: tuple[float, float]
    principal_point: tuple[float, float]
    distortion: tuple[float, ...] = ()
    model: str = "pinhole"
    rotation: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    translation: ArrayLike = (0.0, 0.0, 0.0)
    name: str = "camera"

    def __post_init__(self) -> None:
        rotation, translation = np.asarray(self.rotation, np.float64), np.asarray(self.translation, np.float64).ravel()
        if self.model not in MODELS:
            raise LightFieldError(f"{self.name}: lens model must be one of {', '.join(MODELS)}, not {self.model!r}.")
        if len(self.distortion) not in MODELS[self.model]:
            counts = ", ".join(map(str, MODELS[self.model]))
            raise LightFieldError(
                f"{self.name}: a {self.model} lens has {counts} coefficients of distortion, found "
                f"{len(self.distortion)}."
            )
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise LightFieldError(
                f"{self.name}: rotation must be 3 x 3 and translation 3 numbers, found shapes {rotation.shape} and "
                f"{translation.shape}."
            )
        numbers = [*self.focal_length, *self.principal_point, *self.distortion, *rotation.ravel(), *translation]
        if not (np.abs(numbers) <= _LARGEST).all() or min(self.focal_length) <= 0 or min(self.size) < 1:
            raise LightFieldError(
                f"{self.name}: numbers must be finite, up to {_LARGEST:g}, focal lengths and sizes positive."
            )
        if max(self.size) > _LARGEST_SIDE or min(self.focal_length) * _WIDEST < max(self.size):
            raise LightFieldError(
                f"{self.name}: no camera has pictures of {self.size[1]} x {self.size[0]} pixels with a focal length "
                f"of {min(self.focal_length):g}."
            )
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > _TURN:
            raise LightFieldError(f"{self.name}: the rotation must have orthonormal rows; found others.")
        if np.linalg.det(rotation) < 0:
            raise LightFieldError(
                f"{self.name}: the rotation mirrors (its determinant is -1); an axis has a wrong sign."
            )
        u, _, vt = np.linalg.svd(rotation)
        object.__setattr__(self, "rotation", u @ vt)
        object.__setattr__(self, "translation", translation)

    @property
    def centre(self) -> Float64Array:
        """Place of the camera in the world, [3]."""
        return np.asarray(-np.asarray(self.rotation).T @ np.asarray(self.translation))

    @property
    def matrix(self) -> Float64Array:
        """Camera matrix K, [3, 3]."""
        (fx, fy), (cx, cy) = self.focal_length, self.principal_point
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)

    def project(self, rays: ArrayLike) -> Float64Array:
        """Project directions [..., 3] in the camera's frame to pixels [..., 2]; NaN for those behind the camera."""
        directions = np.asarray(rays, np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = directions[..., :2] / np.where(directions[..., 2:] > 0, directions[..., 2:], np.nan)
        return self._distorted(plane) * self.focal_length + self.principal_point

    def rays(self, pixels: ArrayLike) -> Float64Array:
        """Find the directions [..., 3] in the camera's frame, z = 1, of pixels [..., 2]; the inverse of `project`.

        NaN where the lens cannot be undone: no ray lands there.
        """
        goal = (np.asarray(pixels, np.float64) - self.principal_point) / self.focal_length
        found = goal.copy()
        step = 1e-6
        miss = np.zeros_like(goal)
        with np.errstate(all="ignore"):  # what does not converge is NaN in the end
            for _ in range(_ROUNDS if self.distortion else 0):
                here = self._distorted(found)
                by_x = (self._distorted(found + np.array([step, 0.0])) - here) / step
                by_y = (self._distorted(found + np.array([0.0, step])) - here) / step
                miss = here - goal
                if np.abs(miss).max(initial=0) < 1e-13:
                    break
                determinant = by_x[..., 0] * by_y[..., 1] - by_y[..., 0] * by_x[..., 1]
                found = found - np.stack(
                    [
                        (by_y[..., 1] * miss[..., 0] - by_y[..., 0] * miss[..., 1]) / determinant,
                        (by_x[..., 0] * miss[..., 1] - by_x[..., 1] * miss[..., 0]) / determinant,
                    ],
                    axis=-1,
                )
            lost = ~(np.abs(miss).max(axis=-1, keepdims=True) < _UNDONE)
        found = np.where(lost, np.nan, found)
        return np.concatenate([found, np.ones((*found.shape[:-1], 1))], axis=-1)

    def _distorted(self, plane: Float64Array) -> Float64Array:
        """Distort places (x, y) [..., 2] of the plane z = 1 as the lens does."""
        if not any(self.distortion):
            if self.model == "fisheye":
                return plane * _angle_over_radius(plane)[0][..., None]
            return plane
        if self.model == "fisheye":
            factor, angle = _angle_over_radius(plane)
            k = self.distortion
            square = angle**2
            return np.asarray(
                plane * (factor * (1 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))))[..., None]
            )
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, *(0.0,) * 8)[:8]
        x, y = plane[..., 0], plane[..., 1]
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return np.stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )


def _angle_over_radius(plane: Float64Array) -> tuple[Float64Array, Float64Array]:
    radius = np.hypot(plane[..., 0], plane[..., 1])
    angle = np.arctan(radius)
    return np.where(radius > 1e-9, angle / np.maximum(radius, 1e-12), 1.0), angle


def turned(vector: ArrayLike) -> Float64Array:
    """Make the rotation [3, 3] about a vector [3] by its length in radians (Rodrigues)."""
    from scipy.spatial.transform import Rotation  # slow to import, and needed for files and tests only

    return np.asarray(Rotation.from_rotvec(np.ravel(vector)).as_matrix())


def of_quaternion(w: float, x: float, y: float, z: float) -> Float64Array:
    """Make the rotation [3, 3] of a quaternion of any length; LightFieldError if its length is 0."""
    from scipy.spatial.transform import Rotation

    length = math.hypot(w, x, y, z)
    if not 0 < length < math.inf:
        raise LightFieldError(f"({w:g}, {x:g}, {y:g}, {z:g}) is the quaternion of no rotation; its length must be > 0.")
    return np.asarray(Rotation.from_quat(np.array((x, y, z, w)) / length).as_matrix())
