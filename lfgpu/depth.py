"""The whole method on one page: from a light field to a disparity map."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, load, package_of, pick_device
from lfgpu.config import Config, preset
from lfgpu.energy import Energy
from lfgpu.errors import BackendError, LightFieldError
from lfgpu.initial import LocalEstimator, find_disparity_range
from lfgpu.lightfield import LightField
from lfgpu.model import ForwardModel
from lfgpu.prior import UNLIKE_ANY, NonLocalMeans
from lfgpu.propagation import Propagation
from lfgpu.result import DepthResult
from lfgpu.solvers.lbfgs import BoundedLbfgs
from lfgpu.solvers.lbfgsb import ScipyLbfgsb
from lfgpu.types import Array, Float32Array

STAGES = ("local", "propagate", "refine")

_SOLVERS: dict[str, type[BoundedLbfgs] | type[ScipyLbfgsb]] = {"lbfgs": BoundedLbfgs, "lbfgsb": ScipyLbfgsb}

Progress = Callable[[str, int, float], None]


def estimate_depth(
    lf: LightField,
    *,
    config: Config | str = "paper",
    disparity_range: tuple[float, float] | None = None,
    backend: str = DEFAULT,
    device: str | None = None,
    deterministic: bool = False,
    on_progress: Progress | None = None,
) -> DepthResult:
    """Estimate the disparity of the reference view of a light field (Sajjadi et al. 2016).

    Structure tensors on epipolar plane images give a first map where the views are coherent; a non-local-means
    propagation fills the rest; the refinement makes the map predict all recorded views best, under the same prior.

    Parameters
    ----------
    lf
        The light field; its `reference` is the view that is estimated.
    config
        All parameters, or the name of a preset. Default "paper".
    disparity_range
        (low, high) bounds of the disparity in pixels per view step, larger is nearer. Default: found from the views.
    backend
        "warp" (default), "taichi" or "reference".
    device
        "cpu", "cuda", "cuda:1"; default is the backend's best.
    deterministic
        Whether the map must have the same bits each time on the same device, whatever the number of threads. So it has
        with "warp" and "reference" anyway, and with "taichi" on a CPU; elsewhere BackendError. Default False.
    on_progress
        Called as on_progress(stage, iteration, value): stage is one of STAGES, value the energy (refine), the relative
        residual (propagate) or 0 (local).

    Returns
    -------
    DepthResult
        Disparity, confidence and depth, all [y, x] of the reference view at full size.

    Raises
    ------
    LightFieldError
        If the range or a parameter is wrong or the views allow no estimate.
    BackendError
        If the backend or the device is not there, or is not deterministic when it must be.
    """
    pipeline = DepthPipeline(
        lf,
        config=config,
        disparity_range=disparity_range,
        backend=backend,
        device=device,
        deterministic=deterministic,
    )
    return pipeline.estimate(on_progress=on_progress)


class DepthPipeline:
    """The method for light fields of one kind: everything is allocated once, and views go in as often as they come.

        pipeline = DepthPipeline(lf, disparity_range=(-2, 2))
        pipeline.upload(views)          # [n, y, x, c], like lf.views
        pipeline.run()                  # asks for all work and returns
        pipeline.disparity()            # float32 [y, x]; waits for the device

    On a GPU, `run` is one graph of work that the device goes through without the host, once it has been captured:
    the second run does that.

    Parameters
    ----------
    lf
        A light field of that kind: its cameras, size, stored type, masks and reference view count. Its views are the
        first to be there.
    config, disparity_range, backend, device, deterministic
        As for `estimate_depth`.

    Raises
    ------
    LightFieldError, BackendError
        As `estimate_depth`.
    """

    def __init__(
        self,
        lf: LightField,
        *,
        config: Config | str = "paper",
        disparity_range: tuple[float, float] | None = None,
        backend: str = DEFAULT,
        device: str | None = None,
        deterministic: bool = False,
    ) -> None:
        parameters = preset(config) if isinstance(config, str) else config
        if not isinstance(parameters, Config):
            raise LightFieldError(f"config must be a Config or the name of a preset, not {type(config).__name__}.")
        bounds = None if disparity_range is None else _checked_range(disparity_range, lf)
        self.kernels = load(backend)
        self.device = pick_device(self.kernels, device)
        if deterministic and not self.kernels.is_deterministic(self.device):
            raise BackendError(
                f"backend {backend!r} on {self.device} adds up in an order that differs from run to run; use backend "
                f"{DEFAULT!r}, or the CPU."
            )
        self.config, self._lf, self._backend = parameters, lf, backend
        self._timings: dict[str, float] = {}
        self._graph: Callable[[], None] | None = None
        self._runs = 0
        start = perf_counter()
        self.bounds = bounds or find_disparity_range(lf, parameters.local, self.kernels, self.device)
        self._allocate()
        self._preparation = perf_counter() - start

    def _allocate(self) -> None:
        lf, config, where = self._lf, self.config, (self.kernels, self.device)
        shape = (*lf.size, lf.channels)
        self._views = self.kernels.image(lf.views, self.device)
        self._valid = None if lf.valid is None else self.kernels.field(lf.valid, self.device)
        self._reference = self.kernels.zeros_image(shape, self.device)
        self._local = LocalEstimator(lf, self.bounds, config.local, *where)
        self._prior = NonLocalMeans(shape, config.prior, *where)
        self._propagation = Propagation(lf.size, self.bounds, self._prior, config.propagation)
        self._confidence, self._disparity = (self.kernels.zeros(lf.size, self.device) for _ in range(2))
        self._model = ForwardModel(lf, config.refinement, *where)
        self._energy = Energy(self._model, self._prior, config.refinement.smoothness)
        self._refinement = _SOLVERS[config.refinement.solver](
            lf.size,
            self.bounds,
            *where,
            tolerance=config.refinement.tolerance,
            max_iterations=config.refinement.max_iterations,
        )

    def upload(self, views: Any) -> None:
        """Take other views [n, y, x, c], of the shape and type of the light field's; LightFieldError if they differ.

        NumPy, or any array that has `__dlpack__` (PyTorch, CuPy, JAX): on the pipeline's own GPU it is copied there, by
        the "warp" backend in the order of its stream.
        """
        if not hasattr(views, "dtype"):
            raise LightFieldError(f"views must be an array, not {type(views).__name__}.")
        expected, found = self._lf.views, str(views.dtype).removeprefix("torch.")
        if tuple(views.shape) != expected.shape or found != str(expected.dtype):
            raise LightFieldError(
                f"views must be {expected.dtype} {list(expected.shape)} as those that the pipeline was made for, found "
                f"{found} {list(views.shape)}."
            )
        if not isinstance(views, np.ndarray) and (self.device == "cpu" or self._backend != "warp"):
            views = _on_host(views)
        if isinstance(views, np.ndarray) and views.dtype.kind == "f" and not np.isfinite(views).all():
            raise LightFieldError("views hold values that are not finite (NaN or infinity); mask or replace them.")
        try:
            self.kernels.upload(views, self._views)
        except RuntimeError as error:  # what Warp says of strides and devices
            raise LightFieldError(
                f"views cannot be taken ({error}); make them contiguous, on {self.device}."
            ) from error

    def run(self) -> None:
        """Estimate from the views that are there."""
        if self._graph is None and self._runs > 0 and self.config.is_on_device:
            self._graph = self.kernels.capture(self._work, self.device)
        (self._graph or self._work)()
        self._runs += 1

    @property
    def device_disparity(self) -> Array:
        """The map of the last run where it was computed, an array of the backend [y, x] that the next run writes over.

        One of Warp has `__cuda_array_interface__` and `__dlpack__`: torch.from_dlpack(pipeline.device_disparity).
        """
        return self._disparity

    def disparity(self) -> Float32Array:
        """The map of the last run, float32 [y, x]; waits for the device. LightFieldError if nothing was coherent."""
        self._check()
        return self._map(self._disparity)

    def estimate(self, *, on_progress: Progress | None = None) -> DepthResult:
        """Run and return everything; waits for the device after each stage."""
        with self._timed("total"):
            for stage, work in (("local", self._estimate), ("propagate", self._fill), ("refine", self._refine)):
                with self._timed(stage):
                    if stage == "local" and on_progress is not None:
                        on_progress(stage, 0, 0.0)
                    work(None if on_progress is None else _of_stage(on_progress, stage))
                    self.kernels.number(self._propagation.trusted)  # waits
                if stage == "propagate":
                    self._runs += 1
                    self._check()
        if self._runs == 1:
            for name in ("local", "total"):  # finding the range was a part of them
                self._timings[name] += self._preparation
        return self.result()

    def result(self) -> DepthResult:
        """Everything about the last run; waits for the device. LightFieldError if nothing was coherent."""
        self._check()
        lf, refined = self._lf, self._refinement.report()
        coherence, local = self._map(self._local.coherence), self._map(self._local.disparity)
        disparity, position = self._map(self._disparity), lf.positions[lf.reference_index]
        return DepthResult(
            disparity=disparity,
            confidence=self._map(self._confidence),
            stages={
                "local": np.where(coherence > 0, local, np.float32(np.nan)),
                "propagated": self._map(self._propagation.filled),
                "refined": disparity,
            },
            position=(float(position[0]), float(position[1])),
            disparity_range=self.bounds,
            config=self.config,
            status=f"Propagation: {self._propagation.report().status} Refinement: {refined.status}",
            converged=refined.converged,
            trace=refined.trace,
            timings=dict(self._timings),
            backend=self._backend,
            device=self.device,
            versions={
                name: importlib.metadata.version(name)
                for name in ("lfgpu", *dict.fromkeys(("numpy", "scipy", package_of(self._backend))))
            },
            geometry=lf.geometry,
            name=lf.name,
        )

    def _work(self) -> None:
        self._estimate(None)
        self._fill(None)
        self._refine(None)

    def _estimate(self, _: Callable[[int, float], None] | None) -> None:
        self._local.run(self._views)

    def _fill(self, callback: Callable[[int, float], None] | None) -> None:
        self.kernels.intensities(
            self._views,
            self._lf.reference_index,
            self._valid,
            scale=self._lf.scale,
            fill=UNLIKE_ANY,
            image_out=self._reference,
        )
        self._prior.load(self._reference)
        self._propagation.run(self._local.disparity, self._local.coherence, callback)
        self._prior.mean(self._local.coherence, self._confidence)

    def _refine(self, callback: Callable[[int, float], None] | None) -> None:
        self._model.load(self._views, self._propagation.filled)
        self._energy.load()
        self.kernels.copy(self._propagation.filled, self._disparity)
        self._refinement.minimize(self._energy, self._disparity, callback, curvature=self._energy.curvature)

    def _map(self, field: Array) -> Float32Array:
        return self.kernels.numpy(field).astype(np.float32, copy=False)

    def _check(self) -> None:
        if self._runs == 0:
            raise LightFieldError(f"{self._lf.name}: nothing has been estimated yet; call run() or estimate() first.")
        if self.kernels.number(self._propagation.trusted) == 0:
            raise LightFieldError(
                f"{self._lf.name}: no pixel has a coherent estimate within the disparity range: the views have no "
                "texture, are masked, or the range is wrong; give another one, or lower local.coherence_threshold."
            )

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self._timings[stage] = perf_counter() - start


def _on_host(views: Any) -> NDArray[Any]:
    try:
        return np.from_dlpack(views)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise LightFieldError(
            f"views are on another device than the pipeline ({error}); copy them to the CPU first, or make the "
            "pipeline for that device with the warp backend."
        ) from error


def _of_stage(on_progress: Progress, stage: str) -> Callable[[int, float], None]:
    return lambda iteration, value: on_progress(stage, iteration, value)


def _checked_range(disparity_range: tuple[float, float], lf: LightField) -> tuple[float, float]:
    try:
        low, high = (float(bound) for bound in disparity_range)
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise LightFieldError(
            "disparity range must be two finite numbers, low < high, in pixels per view step; found "
            f"{disparity_range!r}."
        )
    distances = np.abs(lf.offsets).max(1)
    nearest, size = distances[distances > 0].min(), max(lf.size)
    if max(abs(low), abs(high)) * nearest >= size:
        raise LightFieldError(
            f"disparity range {low:g}, {high:g} is in pixels per view step: already the nearest view would be shifted "
            f"by {max(abs(low), abs(high)) * nearest:g} px, out of views of {size} px; give smaller disparities."
        )
    return low, high
