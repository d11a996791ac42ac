"""Light fields, maps and masks from and to files."""

from lfgpu.io.atomic import atomic_folder, atomic_write, check_writable
from lfgpu.io.description import write_description
from lfgpu.io.formats import FORMATS, Format, read, recognise
from lfgpu.io.hci import write_hci
from lfgpu.io.maps import read_map, read_mask
from lfgpu.io.pfm import write_pfm
from lfgpu.io.results import holds_result, read_result, write_result, write_views

__all__ = [
    "FORMATS",
    "Format",
    "atomic_folder",
    "atomic_write",
    "check_writable",
    "holds_result",
    "read",
    "read_map",
    "read_mask",
    "read_result",
    "recognise",
    "write_description",
    "write_hci",
    "write_pfm",
    "write_result",
    "write_views",
]
