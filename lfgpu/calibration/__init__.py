"""Cameras as they are: how well they fit together, and how they become parallel ones in a plane."""

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.export import export_scene
from lfgpu.calibration.formats import Calibration, read_calibration, write_cameras
from lfgpu.calibration.glance import glance
from lfgpu.calibration.judge import Explanation, explain, residual_pictures
from lfgpu.calibration.misalign import Disturbed, Misalignment, disturb
from lfgpu.calibration.parallel import CameraInfo, camera_info
from lfgpu.calibration.quick_look import remarks
from lfgpu.calibration.rectifiers import read_rectifier
from lfgpu.calibration.rectify import Rectified, rectify, write_rectified
from lfgpu.calibration.refine import Refinement, equalise, refine
from lfgpu.calibration.rig import Rig, fit_rig
from lfgpu.calibration.tones import Tones
from lfgpu.calibration.trust import judged
from lfgpu.calibration.watch import RigWatch
from lfgpu.io.pictures import load_pictures

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
    "glance",
    "judged",
    "load_pictures",
    "read_calibration",
    "read_rectifier",
    "rectify",
    "refine",
    "remarks",
    "residual_pictures",
    "write_cameras",
    "write_rectified",
]
