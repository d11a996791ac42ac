"""Path of the kernels in a checkout: the folder `kernels/` beside `lfgpu/`.

An installed lfgpu does not have this file. There, `lfgpu.kernels` is that folder itself.
"""

from pathlib import Path

__path__ = [str(Path(__file__).parents[1] / "kernels")]
