"""Files of calibrations."""

from lfgpu.calibration.formats.toml import read_toml, write_cameras

__all__ = ["read_toml", "write_cameras"]
