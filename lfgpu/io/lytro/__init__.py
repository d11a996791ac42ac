"""Containers of Lytro cameras and of the programs that belong to them.

`container` finds the sections, `contents` says what they are and what the camera wrote of itself, and `reader` decodes
pictures and makes a light field of the views that a processed container holds. Raw pictures are decoded by
`lfgpu.io.lenslet`.
"""

from lfgpu.io.lytro.reader import inside, read_lytro, recognise
