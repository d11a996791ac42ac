"""Rig of parallel cameras in a plane for calibrated ones: the plane, the rotation, the sources of pixels.

The rectified cameras stand at the centres of the real ones, moved into one plane, and look the same way: along the
plane's normal. They share one focal length, and their frames are shifted such that what all of them look at is at
disparity 0. A real camera differs from that by a rotation, which is a homography, and by its lens; both are undone in
one resampling. A camera before or behind the plane is corrected by its scale, exactly at one depth.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.resample import pixels, resampled, through
from lfgpu.contract import Float32Array, Float64Array
from lfgpu.data import LightField
from lfgpu.data.geometry import Geometry, usual_gap
from lfgpu.errors import LightFieldError

_FLAT = 0.3  # of the extent in the plane: rms distance of cameras from it that is still a plane
_LINE = 0.1  # of the longer extent: cameras with less of the shorter one stand in a line
_ASKEW = math.cos(math.radians(60))
_ASPECT = 0.005  # by which the shapes of pictures and of the calibration's pictures may differ
_ALONG = 0.5  # sine: cameras in a line that look at a smaller angle to it stand behind each other
_ZOOM = 1.5  # by which a focal length may differ from the median of all cameras
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Rig:
    """Rig of parallel cameras in a plane that stand for calibrated ones."""

    cameras: tuple[Camera, ...]  # for pictures of one size
    rotation: Float64Array  # [3, 3], world to the frame of all rectified cameras: x right, y down, z along the normal
    positions: Float64Array  # float64 [n, 2], (u, v) in view steps; the reference stands at (0, 0)
    ahead: Float64Array  # float64 [n], distance of each camera before the plane, in the unit of the calibration
    geometry: Geometry  # focal length, length of a view step, distance of the plane of disparity 0
    reference: int
    corrected_at: float  # depth at which cameras off the plane are corrected exactly; infinity corrects nothing
    notes: tuple[str, ...]  # remaining faults, one sentence each

    def places(self, index: int, at: Float64Array) -> Float64Array:
        """Find the pixels [..., 2] of picture `index` that its rectified pixels `at` [..., 2] show; NaN if none."""
        geometry = self.geometry
        assert geometry.principal_point is not None
        shift = self.positions[index] * geometry.baseline_m * geometry.focal_length_px / geometry.focus_distance_m
        plane = (at - geometry.principal_point - shift) / geometry.focal_length_px
        depth = np.full((*plane.shape[:-1], 1), 1.0 - self.ahead[index] / self.corrected_at)
        camera = self.cameras[index]
        return camera.project(np.concatenate([plane, depth], axis=-1) @ self.rotation @ np.asarray(camera.rotation).T)

    def back(self, index: int, at: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Invert `places`: find the rectified pixels [..., 2] of pixels `at` [..., 2] of a picture, and directions.

        The directions [..., 3] are those of the pixels' rays in the common frame, 1 long along the camera's own axis.
        """
        geometry, camera = self.geometry, self.cameras[index]
        assert geometry.principal_point is not None
        along = camera.rays(at) @ np.asarray(camera.rotation) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = along[..., :2] / np.where(along[..., 2:] > 0, along[..., 2:], np.nan)
        plane = plane * (1.0 - self.ahead[index] / self.corrected_at)
        shift = self.positions[index] * geometry.baseline_m * geometry.focal_length_px / geometry.focus_distance_m
        return plane * geometry.focal_length_px + geometry.principal_point + shift, along

    def light_field(
        self,
        pictures: LightField,
        *,
        homographies: Float64Array | None = None,
        tone: Callable[[Float32Array, int, Float64Array], Float32Array] | None = None,
    ) -> LightField:
        """Rectify pictures [n, y, x, c] of these cameras to a light field; each is resampled once.

        `homographies` [n, 3, 3] lead from pixels of what comes out to rectified pixels, as `refine` finds them; `tone`
        is that of `resampled`.
        """
        grid = pixels(*pictures.size)

        def places(n: int) -> Float64Array:
            return self.places(n, grid if homographies is None else through(homographies[n], grid))

        views, valid = resampled(pictures, places, tone)
        if valid is not None and not bool(valid[self.reference].any()):
            raise LightFieldError(
                f"nothing of {self.cameras[self.reference].name} is left in the common frame; the calibration is of "
                "other cameras."
            )
        kept = np.ones(len(views), np.bool_) if valid is None else np.asarray(valid.any(axis=(1, 2)))
        lost = [camera.name for camera, is_kept in zip(self.cameras, kept, strict=True) if not is_kept]
        told = f"{lost[0]}{f' and {len(lost) - 1} more' if lost[1:] else ''}" if lost else ""
        if kept.sum() < 2:
            raise LightFieldError(
                f"{told} show nothing of what {self.cameras[self.reference].name} shows: the cameras look in different "
                "directions, or the calibration is of other cameras."
            )
        notes = (f"Left out, as nothing of it is in the common frame: {told}.",) if lost else ()
        return LightField(
            views[kept],
            self.positions[kept],
            reference=int(kept[: self.reference].sum()),
            valid=None if valid is None else valid[kept],
            geometry=self.geometry,
            name=pictures.name,
            notes=(*pictures.notes, *self.notes, *notes),
        )


def fit_rig(
    cameras: Sequence[Camera], *, depths: tuple[float, float] | None = None, reference: int | None = None
) -> Rig:
    """Fit the rig of parallel cameras in a plane that is nearest to calibrated ones.

    Cameras off the plane are corrected for what lies between `depths`, (near, far) in the unit of the calibration, else
    for the distance at which the cameras look at one point. LightFieldError if the cameras do not stand about in a
    plane, do not look about along its normal, or have focal lengths that differ by half.
    """
    if len(cameras) < 2:
        raise LightFieldError("a rig needs at least two calibrated cameras.")
    if depths is not None and not _SAME < depths[0] < depths[1]:
        raise LightFieldError(
            f"the nearest and farthest depth must be 0 < near < far, found {depths[0]:g} and {depths[1]:g}."
        )
    sizes = {camera.size for camera in cameras}
    if len(sizes) > 1:
        raise LightFieldError(f"the cameras have pictures of {len(sizes)} sizes; rectify those of one size.")
    _check_focal_lengths(cameras)
    centres = np.stack([camera.centre for camera in cameras])
    forward = np.stack([np.asarray(camera.rotation)[2] for camera in cameras])
    axes = _axes(centres, forward, np.stack([np.asarray(camera.rotation)[0] for camera in cameras]))
    for camera, direction in zip(cameras, forward, strict=True):
        if direction @ axes[2] < _ASKEW:
            raise LightFieldError(
                f"{camera.name} looks {math.degrees(math.acos(np.clip(direction @ axes[2], -1, 1))):.0f} degrees away "
                "from the others' common direction; a light field needs cameras that look the same way."
            )
    local = centres @ axes.T
    middle = (local[:, :2].min(0) + local[:, :2].max(0)) / 2
    if reference is None:
        reference = int(np.argmin(np.hypot(*(local[:, :2] - middle).T)))
    local = local - local[reference]
    extent = float(np.sqrt((np.var(local[:, :2], axis=0)).sum()))
    if not extent > _SAME * max(1.0, float(np.abs(centres).max())):
        raise LightFieldError("all cameras stand in one place; depth needs cameras beside each other.")
    ahead = local[:, 2] - np.median(local[:, 2])
    off = float(np.sqrt(np.mean(ahead**2)))
    if off > _FLAT * extent:
        raise LightFieldError(
            f"the cameras do not stand in a plane: they are {off:.3g} off it (rms) and {extent:.3g} apart in it; a "
            "light field needs cameras side by side."
        )
    baseline = usual_gap(local[:, :2])
    if not baseline > _SAME * extent:
        raise LightFieldError("half of the cameras stand where others do; give each place once.")
    positions = local[:, :2] / baseline
    focal = float(np.exp(np.mean([np.log(camera.focal_length) for camera in cameras])))
    principal, focus = _frames(cameras, axes, positions, baseline, focal)
    near, far = depths or (math.nan, math.nan)
    at = 2 / (1 / near + 1 / far) if depths else focus
    geometry = Geometry(focal, baseline, focus, principal_point=principal, unshifted_at=(0.0, 0.0))
    return Rig(tuple(cameras), axes, positions, ahead, geometry, reference, at, _notes(ahead, at, depths, cameras[0]))


def _check_focal_lengths(cameras: Sequence[Camera]) -> None:
    lengths = [float(np.mean(camera.focal_length)) for camera in cameras]
    usual = float(np.median(lengths))
    for camera, length in zip(cameras, lengths, strict=True):
        if not usual / _ZOOM < length < usual * _ZOOM:
            raise LightFieldError(
                f"{camera.name} has a focal length of {length:.4g} px, the others about {usual:.4g} px: its "
                "calibration may be of pictures of another size; give all cameras the calibration of these pictures."
            )


def matched(
    cameras: Sequence[Camera],
    names: Sequence[str],
    size: tuple[int, int],
    source: str,
    *,
    rig: Sequence[Camera] = (),
) -> list[Camera]:
    """Find the camera of each picture: by name where the calibration has names of pictures, else by order.

    If no picture is one that was calibrated, the cameras of the calibration's `rig` are taken, if it has one. Cameras
    are scaled to the size of the pictures if these have the same shape. LightFieldError if a picture has no camera, two
    have the same one, a name is that of two cameras, or the shapes differ.
    """

    def named(known: Sequence[Camera]) -> list[Camera | None]:
        by_name: dict[str, list[Camera]] = {}
        for camera in known:
            by_name.setdefault(_stem(camera.name), []).append(camera)
        pictures: dict[str, str] = {}
        for name in names:
            stem = _stem(name)
            if len(by_name.get(stem, ())) > 1 and not rig:  # cameras of a rig each have a picture of that name
                raise LightFieldError(
                    f"{source} has {len(by_name[stem])} cameras of the name {by_name[stem][0].name}; give each camera "
                    "the name of its own picture."
                )
            if stem in by_name and stem in pictures:
                raise LightFieldError(
                    f"{pictures[stem]} and {name} both have the name of the camera {by_name[stem][0].name} of "
                    f"{source}; give it one picture."
                )
            pictures[stem] = name
        return [by_name[_stem(name)][0] if _stem(name) in by_name else None for name in names]

    found = named(cameras)
    if rig and not any(found):
        cameras, found = rig, named(rig)
    if not any(found):
        if len(cameras) != len(names):
            raise LightFieldError(
                f"{source} calibrates {len(cameras)} cameras, there are {len(names)} pictures, and none has the name "
                f"of a camera ({cameras[0].name}, ...)."
            )
        found = list(cameras)
    missing = [name for name, camera in zip(names, found, strict=True) if camera is None]
    if missing:
        raise LightFieldError(
            f"{source} has no camera for {missing[0]}" + (f" and {len(missing) - 1} more" if missing[1:] else "") +
            "; calibrate it, or take its picture away."
        )  # fmt: skip
    return [_scaled(camera, size, source) for camera in found if camera is not None]


def told_by_order(cameras: Sequence[Camera], names: Sequence[str]) -> str | None:
    """Say so if no picture has the name of the camera that it was `matched` with; else None."""
    if any(_stem(camera.name) == _stem(name) for camera, name in zip(cameras, names, strict=True)):
        return None
    return (
        f"No picture has the name of a camera, so they were matched in order: {_last(names[0])} is of "
        f"{cameras[0].name}, ..., {_last(names[-1])} of {cameras[-1].name}."
    )


def _scaled(camera: Camera, size: tuple[int, int], source: str) -> Camera:
    if camera.size == size:
        return camera
    down, across = size[0] / camera.size[0], size[1] / camera.size[1]
    if abs(down / across - 1) > _ASPECT:
        raise LightFieldError(
            f"{source}: {camera.name} was calibrated for pictures of {camera.size[1]} x {camera.size[0]}, these are "
            f"{size[1]} x {size[0]}: the calibration is of other pictures."
        )
    (fx, fy), (cx, cy) = camera.focal_length, camera.principal_point
    return replace(
        camera,
        size=size,
        focal_length=(fx * across, fy * down),
        principal_point=((cx + 0.5) * across - 0.5, (cy + 0.5) * down - 0.5),
    )


# --- steps ---


def _axes(centres: Float64Array, forward: Float64Array, right: Float64Array) -> Float64Array:
    """Find the axes of the common frame, [3, 3]: rows x, y, z."""
    spread = centres - centres.mean(0)
    _, sizes, directions = np.linalg.svd(spread, full_matrices=True)
    sizes = np.concatenate([sizes, np.zeros(3)])[:3]
    mean = forward.mean(0)
    if sizes[1] > _LINE * sizes[0]:
        z = directions[2] * np.sign(directions[2] @ mean or 1.0)
    else:  # in a line: the normal that is nearest to where the cameras look
        z = mean - (mean @ directions[0]) * directions[0]
    if np.linalg.norm(z) <= _ALONG * np.linalg.norm(mean):
        raise LightFieldError("the cameras look along the line on which they stand; they must stand side by side.")
    z = z / np.linalg.norm(z)
    x = right.mean(0)
    x = x - (x @ z) * z
    if np.linalg.norm(x) < _SAME:
        raise LightFieldError("the cameras are turned against each other; their pictures have no common right side.")
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _frames(
    cameras: Sequence[Camera], axes: Float64Array, positions: Float64Array, baseline: float, focal: float
) -> tuple[tuple[float, float], float]:
    """Find the principal point of the reference and the distance of the plane of disparity 0.

    The middles of the pictures come to lie about in the middles of the rectified ones.
    """
    seen = []
    for camera in cameras:
        height, width = camera.size
        ray = camera.rays(((width - 1) / 2, (height - 1) / 2)) @ np.asarray(camera.rotation) @ axes.T
        if not np.isfinite(ray).all():
            raise LightFieldError(
                f"{camera.name}: its distortion cannot be undone in the middle of the picture; the coefficients are "
                "wrong."
            )
        seen.append(ray[:2] / ray[2])
    middle = (np.array(cameras[0].size[::-1]) - 1) / 2
    wanted = middle - focal * np.array(seen)
    places = positions - positions.mean(0)
    slope = float((places * (wanted - wanted.mean(0))).sum() / (places**2).sum())
    slope = max(slope, 0.0)
    x, y = (wanted - slope * positions).mean(0)
    return (float(x), float(y)), focal * baseline / slope if slope > 1e-6 else math.inf


def _notes(ahead: Float64Array, at: float, depths: tuple[float, float] | None, camera: Camera) -> tuple[str, ...]:
    most, radius = float(np.abs(ahead).max()), float(np.hypot(*camera.size)) / 2
    if most == 0:
        return ()
    ends = depths or (at, math.inf)
    left = max(most * abs(1 / end - (0 if math.isinf(at) else 1 / at)) for end in ends) * radius
    if left < 0.05:
        return ()
    what = f"for depths from {ends[0]:.3g} to {ends[1]:.3g}" if depths else "at infinite depth"
    return (
        f"Cameras stand up to {most:.3g} off their plane; corrected for the depth {at:.3g}, up to {left:.2g} px are "
        f"left in the corners {what}.",
    )


def _last(name: str) -> str:
    return name.replace("\\", "/").rsplit("/", 1)[-1]


def _stem(name: str) -> str:
    return _last(name).rsplit(".", 1)[0].lower()
