"""A first result in a fresh process, from import to end: `python -m benchmarks.first_result SCENE BACKEND DEVICE`."""

import sys
from pathlib import Path

from benchmarks import scene
from lfgpu import estimate_depth

estimate_depth(scene.load(Path(sys.argv[1])), backend=sys.argv[2], device=sys.argv[3])
