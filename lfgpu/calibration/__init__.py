"""Calibration: cameras as they are, and how they become parallel ones in a plane."""

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.export import export_scene
from lfgpu.calibration.formats import Calibration, read_calibration, write_cameras
from lfgpu.calibration.misalign import Disturbed, Misalignment, disturb
from lfgpu.calibration.parallel import CameraInfo, camera_info
from lfgpu.calibration.rectifiers import read_rectifier
from lfgpu.calibration.rectify import Rectified, rectify, write_rectified
from lfgpu.calibration.refine import Refinement, equalise, refine
from lfgpu.calibration.rig import Rig, fit_rig
from lfgpu.cameras import Explanation, explain, residual_pictures
from lfgpu.cameras.tones import Tones
from lfgpu.io.views import load_pictures
from lfgpu.pipelines.rig_watch import RigWatch
from lfgpu.pipelines.verdict import judged

__all__ = [
    "Calibration",
    "Camera",
    "CameraInfo",
    "Disturbed",
    "Explanation",
    "Misalignment",
    "Rectified",
    "Refinement",
    "Rig",
    "RigWatch",
    "Tones",
    "camera_info",
    "disturb",
    "equalise",
    "explain",
    "export_scene",
    "fit_rig",
    "judged",
    "load_pictures",
    "read_calibration",
    "read_rectifier",
    "rectify",
    "refine",
    "residual_pictures",
    "write_cameras",
    "write_rectified",
]
