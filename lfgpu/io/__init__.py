"""Light fields, maps and masks from and to files."""

from lfgpu.io.atomic import atomic_folder, atomic_write, check_writable
from lfgpu.io.description import write_description
from lfgpu.io.formats import FORMATS, Format, read, recognise
from lfgpu.io.hci import write_hci
from lfgpu.io.maps import read_map, read_mask
from lfgpu.io.pfm import write_pfm
from lfgpu.io.results import holds_result, holds_views, read_result, read_views, write_result, write_views
from lfgpu.io.writers import WRITERS, Writer, load, save, writer_of

__all__ = [
    "FORMATS",
    "WRITERS",
    "Format",
    "Writer",
    "atomic_folder",
    "atomic_write",
    "check_writable",
    "holds_result",
    "holds_views",
    "load",
    "read",
    "read_map",
    "read_mask",
    "read_result",
    "read_views",
    "recognise",
    "save",
    "write_description",
    "write_hci",
    "write_pfm",
    "write_result",
    "write_views",
    "writer_of",
]
