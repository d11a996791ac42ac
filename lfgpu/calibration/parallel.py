"""Parallel cameras of a light field, one by one, for programs that know cameras but no light fields."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.contract import Float64Array
from lfgpu.data import Geometry, LightField
from lfgpu.errors import LightFieldError


def world_of(lf: LightField) -> Geometry:
    """Give the geometry a frame that all views share: of the camera whose frame is not shifted, else the reference.

    LightFieldError if the light field has no geometry.
    """
    if lf.geometry is None:
        raise LightFieldError(
            f"{lf.name} has no geometry, so its cameras are not known; give focal length and baseline in a description "
            "(`lfgpu info --write`), or rectify it with a calibration."
        )
    here = lf.geometry.unshifted_at or tuple(map(float, lf.positions[lf.reference_index]))
    return replace(lf.geometry, unshifted_at=(here[0], here[1]))


def ideal_cameras(lf: LightField, moved: Float64Array | None = None) -> tuple[Camera, ...]:
    """Make the cameras of a light field by its geometry: parallel, in a plane, their frames shifted (in metres)."""
    geometry = lf.geometry
    assert geometry is not None
    height, width = lf.size
    cx, cy = geometry.principal_point or ((width - 1) / 2, (height - 1) / 2)
    here = geometry.unshifted_at or tuple(lf.positions[lf.reference_index])
    places = lf.positions - here + (0 if moved is None else moved)
    centres = geometry.centres(places)
    focal = geometry.focal_length_px, geometry.focal_length_px * geometry.pixel_aspect
    shift = places * geometry.baseline_m * geometry.focal_length_px / geometry.focus_distance_m
    return tuple(
        Camera(
            size=lf.size,
            focal_length=focal,
            principal_point=(float(cx + step[0]), float(cy + step[1])),
            translation=(-centre[0], -centre[1], 0.0),
            name=lf.files[n] if lf.files else f"view_{n:03d}.png",
        )
        for n, (centre, step) in enumerate(zip(centres, shift, strict=True))
    )


@dataclass(frozen=True, eq=False)
class CameraInfo:
    """Camera in the terms of `sensor_msgs/CameraInfo` of ROS: lists in row order.

    Parameters
    ----------
    width, height
        Pixels.
    distortion_model
        "plumb_bob": Brown and Conrady.
    d
        Its five coefficients: 0, as views are rectified.
    k
        [9], the camera matrix.
    r
        [9], the rotation into the rectified frame: the identity.
    p
        [12], the projection, with the place of the camera: P[3] = -fx * (metres to the right of the reference), P[7]
        the same downwards.
    q
        [16], from (x, y, disparity, 1) to the homogeneous point (X, Y, Z, W) in metres in the camera's own frame, for
        `cv2.reprojectImageTo3D`. Disparity is that of the camera's map, pixels per view step.
    """

    width: int
    height: int
    distortion_model: str
    d: tuple[float, ...]
    k: tuple[float, ...]
    r: tuple[float, ...]
    p: tuple[float, ...]
    q: tuple[float, ...]


def camera_info(lf: LightField, index: int | None = None) -> CameraInfo:
    """Describe the camera of one view in the terms of ROS and OpenCV. Its depth image (REP 118) is `result.depth`.

    The depth image is float32 in metres, NaN where unknown, infinity beyond the horizon.

    Parameters
    ----------
    lf
        The light field.
    index
        Index of the view; default None: the reference.

    Raises
    ------
    LightFieldError
        If the geometry is unknown, or there is no such view.

    Examples
    --------
    >>> lfgpu.calibration.camera_info(lf).width
    80
    """
    geometry = world_of(lf)
    n = lf.reference_index if index is None else index
    if not 0 <= n < len(lf.views):
        raise LightFieldError(f"view {n} does not exist; give an index from 0 to {len(lf.views) - 1}.")
    cameras = ideal_cameras(replace(lf, geometry=geometry))
    camera, (height, width) = cameras[n], lf.size
    right, down, _ = camera.centre - cameras[lf.reference_index].centre
    (fx, fy), (cx, cy) = camera.focal_length, camera.principal_point
    p = (fx, 0.0, cx, -fx * right, 0.0, fy, cy, -fy * down, 0.0, 0.0, 1.0, 0.0)
    # Z = 1 / W with W = disparity / (baseline f) + 1 / F; the frame's shift goes into the principal point.
    w = 1 / (geometry.baseline_m * geometry.focal_length_px)
    q = np.array(
        [[1 / fx, 0, 0, -cx / fx], [0, 1 / fy, 0, -cy / fy], [0, 0, 0, 1], [0, 0, w, 1 / geometry.focus_distance_m]]
    )
    return CameraInfo(
        width,
        height,
        "plumb_bob",
        (0.0,) * 5,
        tuple(map(float, camera.matrix.ravel())),
        tuple(map(float, np.eye(3).ravel())),
        tuple(map(float, p)),
        tuple(map(float, q.ravel())),
    )
