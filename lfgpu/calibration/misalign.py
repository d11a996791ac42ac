"""Misaligned cameras, made on purpose, with the calibration that an honest checkerboard would give.

`lfgpu scene --misalign` and tests of calibration use it: the light field is the one of a rig whose cameras are turned
and have other focal lengths, lenses and sensors. Everything follows from a seed.
"""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from lfgpu.calibration.cameras import Camera, turned
from lfgpu.calibration.parallel import ideal_cameras
from lfgpu.calibration.resample import pixels
from lfgpu.cameras.tones import squared_radius_at
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import LightField
from lfgpu.data.light_field_checks import check_number
from lfgpu.errors import LightFieldError


@dataclass(frozen=True)
class Misalignment:
    """Size of the faults of cameras: standard deviations of independent draws for each view."""

    shift: float = 0.0  # pixels by which turning a camera to the side moves its picture, along each axis
    roll: float = 0.0  # degrees about its axis
    scale: float = 0.0  # share by which its focal length differs
    distortion: float = 0.0  # of its k1, the first coefficient of Brown and Conrady
    position: float = 0.0  # view steps beside its place, along each axis; scenes are rendered from there
    gain: float = 0.0  # share by which each colour is brighter
    offset: float = 0.0  # intensity that is added to each colour
    vignetting: float = 0.0  # share by which the corners are darker
    noise: float = 0.0  # intensity of the noise of each pixel

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(f"misalignment: {field.name}", getattr(self, field.name), 0, 1e3)

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text such as "shift=1,gain=0.1"; LightFieldError if a name is unknown or a number is none."""
        known = [field.name for field in fields(cls)]
        found: dict[str, float] = {}
        for part in text.split(","):
            name, equals, value = (piece.strip() for piece in part.partition("="))
            try:
                if not equals or name not in known:
                    raise ValueError
                found[name] = float(value)
            except ValueError:
                raise LightFieldError(
                    f"misalignment must be NAME=NUMBER,... with names of {', '.join(known)}, not {text!r}."
                ) from None
        return cls(**found)


CHECKERBOARD = Misalignment(shift=0.15, roll=0.01, scale=2e-4, distortion=1e-3, position=0.01)
"""Faults of each camera that an ordinary calibration with a checkerboard leaves."""


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Light field of misaligned cameras."""

    light_field: LightField  # the recorded views, at the positions that they should have
    cameras: tuple[Camera, ...]  # the cameras, exactly
    calibrated: tuple[Camera, ...]  # the cameras by the calibration with a checkerboard
    gain: Float64Array  # float64 [n, c]: the middle of a view shows gain * t + offset where it should show t
    offset: Float64Array


def displacements(count: int, reference: int, sigma: float, seed: int) -> Float64Array:
    """Draw displacements of cameras [n, 2], view steps; the reference stays at its place."""
    moved = np.random.default_rng([seed, 0]).normal(0, sigma, (count, 2)) if sigma else np.zeros((count, 2))
    moved[reference] = 0
    return moved


def disturb(lf: LightField, how: Misalignment, *, seed: int = 0, moved: Float64Array | None = None) -> Disturbed:
    """Record the scene of a light field, whose cameras are right, with misaligned cameras.

    The reference view stays as it is, but for noise. Positions cannot be changed here: `moved` are the `displacements`
    [n, 2], view steps, at which the views were taken. LightFieldError if the light field has no geometry, or positions
    should change that it does not have.
    """
    if lf.geometry is None:
        raise LightFieldError(f"{lf.name} has no geometry: what turning its cameras does is not known.")
    count, reference = len(lf.views), lf.reference_index
    if moved is None:
        if how.position:
            raise LightFieldError("positions of recorded cameras cannot be changed; render a scene from there.")
        moved = np.zeros((count, 2))
    draws = np.random.default_rng([seed, 1])
    ideal = ideal_cameras(lf, moved)
    cameras = _worse(ideal, how, draws, skip=reference)
    checkerboard = replace(CHECKERBOARD, position=0.0)
    calibrated = _worse(cameras, checkerboard, np.random.default_rng([seed, 2]), skip=-1)
    spread = CHECKERBOARD.position * lf.geometry.baseline_m
    noise = np.random.default_rng([seed, 3]).normal(0, spread, (count, 3))
    calibrated = tuple(
        replace(camera, translation=np.asarray(camera.translation) + step)
        for camera, step in zip(calibrated, noise, strict=True)
    )
    gain = 1 + draws.normal(0, how.gain, (count, lf.channels)) if how.gain else np.ones((count, lf.channels))
    offset = draws.normal(0, how.offset, (count, lf.channels)) if how.offset else np.zeros((count, lf.channels))
    falloff = np.abs(draws.normal(0, how.vignetting, count)) if how.vignetting else np.zeros(count)
    gain[reference], offset[reference], falloff[reference] = 1, 0, 0
    across = squared_radius_at(pixels(*lf.size), lf.size)
    views = np.empty_like(lf.views)
    for n in range(count):
        view = _seen(lf.image(n), ideal[n], cameras[n])
        view = gain[n] * (1 - falloff[n] * across[..., None]) * view + offset[n]
        if how.noise:
            view = view + np.random.default_rng([seed, 4, n]).normal(0, how.noise, view.shape)
        view = np.clip(view, 0, 1)
        views[n] = view if lf.views.dtype == np.float32 else np.rint(view / lf.scale)
    return Disturbed(replace(lf, views=views, files=()), cameras, calibrated, gain, offset)


def _worse(
    cameras: tuple[Camera, ...], how: Misalignment, draws: np.random.Generator, *, skip: int
) -> tuple[Camera, ...]:
    """Turn cameras about their centres and change focal lengths and lenses; the one numbered `skip` stays."""
    found = []
    for n, camera in enumerate(cameras):
        x, y, z, scale, k1 = draws.normal(size=5)
        if n == skip:
            found.append(camera)
            continue
        fx, fy = camera.focal_length
        turn = turned((-how.shift * y / fy, how.shift * x / fx, np.deg2rad(how.roll) * z))
        rotation = turn @ np.asarray(camera.rotation)
        factor = 1 + how.scale * scale
        lens = list(camera.distortion) or ([0.0] * 4 if how.distortion else [])
        if how.distortion:
            lens[0] += how.distortion * k1
        found.append(
            replace(
                camera,
                focal_length=(fx * factor, fy * factor),
                distortion=tuple(lens),
                rotation=rotation,
                translation=-rotation @ camera.centre,
            )
        )
    return tuple(found)


def _seen(image: Float32Array, ideal: Camera, real: Camera) -> Float32Array:
    """Resample the image [y, x, c] of an ideal camera to that of the real one at its place."""
    from scipy import ndimage  # slow to import, and rarely needed

    if real is ideal:
        return image
    rays = real.rays(pixels(*image.shape[:2])) @ np.asarray(real.rotation) @ np.asarray(ideal.rotation).T
    at = ideal.project(rays)
    planes = [
        ndimage.map_coordinates(image[..., c], [at[..., 1], at[..., 0]], order=5, mode="mirror", output=np.float32)
        for c in range(image.shape[2])
    ]
    return np.stack(planes, axis=-1)
