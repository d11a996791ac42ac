"""From pictures of a checkerboard to depth: OpenCV calibrates an array of five cameras, lfgpu does the rest.

    pip install 'lfgpu[opencv]'
    python examples/checkerboard.py

The pictures are made here, of cameras that are turned a little and have lenses; with cameras of your own, read yours.
"""

import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

import lfgpu
from lfgpu.calibration import Camera, read_calibration, rectify

SIZE = (300, 400)  # height, width in pixels
CORNERS = (9, 6)  # inner corners across and down; one even, one odd, so that there are no two ways to hold it
SQUARE = 0.028  # metres
PLACES = [(0.0, 0.0), (-0.03, 0.0), (0.03, 0.0), (0.0, -0.03), (0.0, 0.03)]  # metres to the right and down
DISTANCE = 0.6  # of the boards, metres; what is recorded later stands about there


def rig(rng: np.random.Generator) -> list[Camera]:
    """The cameras as they are, which nobody knows: turned by some tenths of a degree, with different lenses."""
    cameras = []
    for n, (right, down) in enumerate(PLACES):
        turn = Rotation.from_rotvec(rng.normal(0, 0.005, 3)).as_matrix()
        cameras.append(
            Camera(
                size=SIZE,
                focal_length=(420 + rng.normal(0, 3), 421 + rng.normal(0, 3)),
                principal_point=(SIZE[1] / 2 + rng.normal(0, 3), SIZE[0] / 2 + rng.normal(0, 3)),
                distortion=(-0.15 + rng.normal(0, 0.02), 0.05, 0.0, 0.0),
                rotation=turn,
                translation=-turn @ (right, down, 0.0),
                name=f"camera_{n}",
            )
        )
    return cameras


def seen(camera: Camera, pose: np.ndarray, paint, background: float = 0.6) -> np.ndarray:
    """What a camera records of a plane at `pose` [3, 4] (plane to world), painted as `paint` says: uint8 [y, x]."""
    height, width = camera.size
    total, times = np.zeros((height, width)), 3
    for dy, dx in np.ndindex(times, times):  # several rays a pixel, so that edges are soft
        y, x = np.mgrid[:height, :width] + np.array([dy, dx])[:, None, None] / times - (times - 1) / (2 * times)
        rays = camera.rays(np.stack([x, y], -1)) @ np.asarray(camera.rotation)
        normal, origin = pose[:, 2], pose[:, 3]
        far = ((origin - camera.centre) @ normal) / (rays @ normal)
        on_plane = (camera.centre + far[..., None] * rays - origin) @ pose[:, :2]
        total += paint(on_plane[..., 0], on_plane[..., 1], background)
    return np.rint(255 * total / times**2).astype(np.uint8)


def board(x: np.ndarray, y: np.ndarray, background: float) -> np.ndarray:
    """A checkerboard with a white margin; its first inner corner is at (0, 0)."""
    column, row = np.floor(x / SQUARE), np.floor(y / SQUARE)
    squares = (column >= -1) & (column < CORNERS[0]) & (row >= -1) & (row < CORNERS[1])
    margin = (column >= -2) & (column <= CORNERS[0]) & (row >= -2) & (row <= CORNERS[1])
    return np.where(squares, np.where((column + row) % 2 == 0, 0.1, 0.95), np.where(margin, 0.95, background))


def wall(texture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A painted wall, 1.5 mm a sample."""
    places = [(y / 0.0015) % texture.shape[0], (x / 0.0015) % texture.shape[1]]
    return np.asarray(ndimage.map_coordinates(texture, places, order=1, mode="grid-wrap"))


def refined(view: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners [n, 1, 2] where the edges around each meet: those of small squares are found some 0.05 px to one side."""
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    return cv2.cornerSubPix(view, np.float32(corners).reshape(-1, 1, 2), (4, 4), (-1, -1), until)


def calibrate(pictures: list[list[np.ndarray]]) -> dict:
    """OpenCV's calibration of pictures[camera][pose]: each camera by itself, then where it stands to the first one."""
    grid = np.zeros((CORNERS[0] * CORNERS[1], 3), np.float32)
    grid[:, :2] = SQUARE * np.mgrid[: CORNERS[0], : CORNERS[1]].T.reshape(-1, 2)
    corners = []
    for views in pictures:
        found = [cv2.findChessboardCornersSB(view, CORNERS, flags=cv2.CALIB_CB_ACCURACY) for view in views]
        corners.append([refined(view, points) if ok else None for view, (ok, points) in zip(views, found, strict=True)])
    size, fixed = SIZE[::-1], cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    lenses = []
    for points in corners:
        known = [p for p in points if p is not None]
        _, matrix, lens, *_ = cv2.calibrateCamera([grid] * len(known), known, size, None, None, flags=fixed)
        lenses.append((matrix, lens))
    cameras = []
    for n, (matrix, lens) in enumerate(lenses):
        turn, shift = np.eye(3), np.zeros((3, 1))
        if n > 0:
            both = [(a, b) for a, b in zip(corners[0], corners[n], strict=True) if a is not None and b is not None]
            first, here = ([pair[k] for pair in both] for k in (0, 1))
            options = {"flags": cv2.CALIB_FIX_INTRINSIC}
            answer = cv2.stereoCalibrate([grid] * len(both), first, here, *lenses[0], matrix, lens, size, **options)
            turn, shift = answer[5], answer[6]
        cameras.append(
            {
                "name": f"camera_{n}",
                "K": matrix.tolist(),
                "D": lens.ravel()[:4].tolist(),
                "R": turn.tolist(),
                "T": shift.ravel().tolist(),
                "image_size": [SIZE[1], SIZE[0]],
            }
        )
    return {"cameras": cameras}


def main(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the first camera, in its own picture, and the true one, metres [y, x]."""
    rng = np.random.default_rng(seed)
    cameras = rig(rng)
    poses = []
    for _ in range(10):
        turn = Rotation.from_euler("xyz", rng.uniform(-0.4, 0.4, 3)).as_matrix()
        middle = SQUARE * (np.array(CORNERS) - 1) / 2
        place = [rng.uniform(-0.06, 0.06), rng.uniform(-0.04, 0.04), DISTANCE * rng.uniform(0.75, 1.1)]
        poses.append(np.column_stack([turn, np.array(place) - turn[:, :2] @ middle]))
    boards = [[seen(camera, pose, board) for pose in poses] for camera in cameras]

    # What the cameras are for: a painted wall that leans away to the right.
    texture = np.clip(0.5 + 0.6 * ndimage.gaussian_filter(rng.normal(size=(500, 500)), 1.5, mode="wrap") * 5, 0, 1)
    turn = Rotation.from_euler("y", -0.5).as_matrix()
    pose = np.column_stack([turn, [0.0, 0.0, DISTANCE]])
    views = np.stack([seen(camera, pose, lambda x, y, _: wall(texture, x, y)) for camera in cameras])

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cameras.json"
        file.write_text(json.dumps(calibrate(boards)))
        calibration = read_calibration(file)
    pictures = lfgpu.LightField(views[..., None], np.array(PLACES), reference=0, name="five cameras")
    rectified = rectify(pictures, calibration=calibration, depths=(0.4, 1.0))
    result = lfgpu.estimate_depth(rectified.light_field, disparity_range=rectified.disparity_range)
    depth = rectified.original_depth(result)

    height, width = SIZE
    y, x = np.mgrid[:height, :width].astype(float)
    rays = cameras[0].rays(np.stack([x, y], -1)) @ np.asarray(cameras[0].rotation)
    true = (pose[:, 3] - cameras[0].centre) @ pose[:, 2] / (rays @ pose[:, 2])
    error = np.abs(depth / true - 1)
    known = np.isfinite(error)
    print(
        f"{true.min():.2f} to {true.max():.2f} m; {100 * known.mean():.0f} % of the pixels have a depth, half of them "
        f"right to {100 * np.median(error[known]):.2f} %, 9 of 10 to {100 * np.quantile(error[known], 0.9):.2f} %"
    )
    return depth, true


if __name__ == "__main__":
    main()
