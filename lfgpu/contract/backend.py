"""A whole backend: the operations by topic, and what only some backends can do."""

from typing import Any, Protocol

import numpy as np

from lfgpu.contract.changing import Changing
from lfgpu.contract.control import Control, Recording
from lfgpu.contract.images import Images
from lfgpu.contract.learned import Learned
from lfgpu.contract.matching import Matching
from lfgpu.contract.measuring import Measuring
from lfgpu.contract.memory import Memory
from lfgpu.contract.prior import Prior
from lfgpu.contract.range_search import RangeSearch
from lfgpu.contract.solvers import Solvers, Vectors
from lfgpu.contract.streaming import Streaming
from lfgpu.contract.structure_tensor import StructureTensors
from lfgpu.contract.synthesis import Synthesis


class KernelSet(
    Memory,
    Control,
    Images,
    Prior,
    StructureTensors,
    RangeSearch,
    Measuring,
    Matching,
    Learned,
    Synthesis,
    Vectors,
    Solvers,
    Protocol,
):
    """One backend: memory, the operations of the methods, and the vector operations of a solver."""

    @property
    def name(self) -> str:
        """The name under which the backend is asked for."""

    @property
    def dtype(self) -> type[np.floating[Any]]:
        """The type of fields: float32 on devices, float64 in the reference."""

    @property
    def compiles(self) -> bool:
        """True if operations are compiled when they are first used."""

    @property
    def streaming(self) -> Streaming | None:
        """Frames and maps on their way while the device works; None if the backend has no streams."""

    @property
    def changing(self) -> Changing | None:
        """Numbers that change while work stays captured; None if the backend takes plain numbers only."""

    @property
    def recording(self) -> Recording | None:
        """Work as a file for programs without Python; None if the backend cannot write it."""
