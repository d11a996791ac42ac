"""`DepthPipeline`: a method with all memory allocated, for many light fields of one kind."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from lfgpu._backends import DEFAULT, BackendName, open_device, package_of
from lfgpu.config import Config
from lfgpu.contract import Float32Array, host_memory, take_host_memory
from lfgpu.data import DepthResult, LightField, check_light_field, interop
from lfgpu.data.light_field_checks import check_scaled
from lfgpu.data.mapping import is_mapped
from lfgpu.errors import BackendError, LightFieldError
from lfgpu.machine import version_of
from lfgpu.methods import PresetName, configured, method_of
from lfgpu.methods.base import Plan, Work
from lfgpu.methods.footprint import check_memory
from lfgpu.methods.measured import Measured, checked_range
from lfgpu.methods.recycling import KeepingDevice, RecyclingDevice
from lfgpu.pipelines.range_confirmation import confirm
from lfgpu.pipelines.rectifier import DeviceViews, Rectifier
from lfgpu.pipelines.rehearsal import Rehearsal
from lfgpu.pipelines.verdict import map_notes
from lfgpu.threads import do_waiting

_LOG = logging.getLogger(__name__)
_NOT_FINITE = "views hold NaN or infinity; mask or replace these values."

Progress = Callable[[str, int, float], None]
"""Called as progress(stage, iteration, value)."""


class DepthPipeline:
    """Depth estimator for many light fields of one kind. All memory is allocated once.

    On a GPU, the second run captures all work as a graph. From then on `run` launches this graph, which needs no host.

    Parameters
    ----------
    lf
        Gives the cameras, size, stored type, masks and reference view. Its views are the first input. The noise, and
        the disparity range if it is not given, are measured on them. The first `estimate` confirms that range; before
        `run`, `confirm_range` does.
    config, weights, disparity_range, backend, device, deterministic
        As for `estimate_depth`.
    measured
        The disparity range and the noise, if they were measured before; then `disparity_range` is not used. Default
        None: measured on the views of `lf`.
    rectifier
        Rectifier of raw pictures, which works on the device before each estimate, in the same graph. Then `lf` and all
        uploads are raw pictures in the order of its cameras (`Rectifier.pictures`); positions, reference view, masks
        and geometry are those of the rectifier. Default None: frames are views of parallel cameras.

    Raises
    ------
    LightFieldError, BackendError
        As `estimate_depth`; also if the pictures are not those of the rectifier's cameras.

    Examples
    --------
    >>> pipeline = lfgpu.DepthPipeline(lf, config="fast", disparity_range=(-2, 2))
    >>> pipeline.upload(lf.views)  # [n, y, x, c]
    >>> pipeline.run()  # starts the work and returns
    >>> pipeline.disparity().shape  # waits for the device
    (64, 80)
    """

    def __init__(
        self,
        lf: LightField,
        *,
        config: Config | PresetName | None = None,
        weights: str | os.PathLike[str] | None = None,
        disparity_range: tuple[float, float] | None = None,
        backend: BackendName = DEFAULT,
        device: str | None = None,
        deterministic: bool = False,
        measured: Measured | None = None,
        rectifier: Rectifier | None = None,
    ) -> None:
        check_light_field(lf)
        self.config = configured(config, weights)
        self.method = method_of(self.config)
        self._device = place = open_device(backend, device)
        self.kernels, self.device = place.kernels, place.name
        if deterministic and not self.kernels.is_deterministic(self.device):
            raise BackendError(
                f"backend {backend!r} on {self.device} is not deterministic: its order of summation differs from run "
                f"to run; use backend {DEFAULT!r}, or the CPU."
            )
        pictures = lf
        if rectifier is not None:
            lf = rectifier.rectified(pictures, place)
        self._backend, self._is_raw = backend, rectifier is not None
        self._buffers = RecyclingDevice(place.kernels, place.name)
        self._measuring = KeepingDevice(place.kernels, place.name) if place.is_gpu else place  # a CPU allocates fast
        self._plan: Plan
        self._bytes = 0  # of its memory, about
        self._graph: Callable[[], None] | None = None
        self._is_loaded = False  # whether the plan has run, which loads all kernels
        if disparity_range is not None:
            disparity_range = checked_range(disparity_range, lf.layout)
        self._begin(lf, is_found=measured is None and disparity_range is None)
        used = self.method.used_views(lf.offsets)  # no others go to the device
        self._used = used if len(used) < len(lf.views) else None
        self._kind = lf.layout
        self._layout = self._kind if self._used is None else self._kind.subset(used)
        with self._device.asking():
            with self._timed("compile"):
                if measured is None:
                    Rehearsal(self.method, lf, place).measure(disparity_range)
            with self._timed("measure"):
                self._front = DeviceViews(rectifier, pictures, place, used=used)
                self.measured = measured or self._measure(disparity_range)
            with self._timed("compile"):
                Rehearsal(self.method, lf, place, used=self._used).run(self.measured)
            with self._timed("measure"):
                self._waited_for = place.scalar(0.0)  # who reads it waits for all that was asked
                self._replan(self.measured)

    def take(
        self, lf: LightField, *, disparity_range: tuple[float, float] | None = None, measured: Measured | None = None
    ) -> None:
        """Go on with another light field, as if the pipeline had been made for it.

        Parameters
        ----------
        lf
            A light field of the same kind: equal positions, reference view, size, stored type, scale and masks.
        disparity_range, measured
            As for the pipeline.

        Raises
        ------
        LightFieldError
            If it is of another kind; then the pipeline keeps the one before. If the range is wrong or none is found;
            then the pipeline goes on when it takes a light field that has one.
        """
        check_light_field(lf)
        if not lf.layout.is_like(self._kind):
            raise LightFieldError(
                f"{lf.name} is of another kind than the light field of the pipeline: other cameras, reference view, "
                "size, stored type or masks; make a pipeline for it."
            )
        self._begin(lf, is_found=measured is None and disparity_range is None)
        self._timings["compile"] = 0.0
        with self._timed("measure"), self._device.asking():
            self.kernels.upload(lf.views, self._front.frame, chosen=self._used)
            found = measured or self._measure(disparity_range)
            if found != self.measured:
                self._follow_measured(found)

    def let_go(self) -> int:
        """Let go of the light field, until the pipeline takes another; returns the bytes that stay, about."""
        del self._lf
        return self._bytes

    def _begin(self, lf: LightField, *, is_found: bool) -> None:
        self._lf = lf
        self._timings: dict[str, float] = {}
        self._runs, self._is_whole = 0, False  # whether the map in memory is whole: of a run that came to its end
        self._is_found = is_found  # and no map has confirmed the range
        self._notes: tuple[str, ...] = ()  # about that range
        self._unseen = False  # True if the views came from a GPU, where nobody looks for NaN

    def _measure(self, disparity_range: tuple[float, float] | None) -> Measured:
        shown = {} if self._is_raw else {"views": self._front.views, "held": self._used}
        return self.method.measure(self._lf, self._measuring, disparity_range=disparity_range, **shown)

    def upload(self, views: Any) -> None:
        """Replace the views.

        Parameters
        ----------
        views
            The new views [n, y, x, c] (raw pictures if there is a rectifier), of the same shape and type as the light
            field's, with any strides: a NumPy array, or an array with DLPack or `__cuda_array_interface__` (PyTorch,
            CuPy, JAX, Numba).

        Raises
        ------
        LightFieldError
            If the shape, type or device is not that of the pipeline, or if a value is NaN, infinite, far from [0, 1] or
            masked by NumPy.

        Notes
        -----
        The "warp" backend copies an array on the pipeline's own GPU there, without the host. The copy runs on the
        current stream of PyTorch or CuPy: it waits for their earlier work, and their later work waits for it. So the
        array may be changed or freed at once. For other libraries, and for arrays in host memory, the host waits until
        the copy is done. Values from a GPU are not checked here: if one is not finite, `disparity` and `result` raise,
        and `device_disparity` is meaningless.
        """
        place = interop.place_of("views", views)
        (found, shape), expected = interop.kind_of("views", views), self._lf.views
        if shape != expected.shape or found != str(expected.dtype):
            raise LightFieldError(
                f"views must be {expected.dtype} {list(expected.shape)}, like those that the pipeline was made for; "
                f"found {found} {list(shape)}."
            )
        if place == "cpu":
            views = interop.on_host("views", views)
            if views.dtype.kind == "f":
                low, high = float(views.min()), float(views.max())
                if not np.isfinite(low + high):
                    raise LightFieldError(_NOT_FINITE)
                check_scaled("views", low, high)
        elif self._backend != "warp" or self.device == "cpu":
            raise LightFieldError(
                f"views are on {place}, but the pipeline is on {self.device} with backend {self._backend!r}; copy them "
                "to the CPU first, or make the pipeline for that GPU with backend 'warp'."
            )
        elif place not in (self.device, interop.SOME_GPU):
            raise LightFieldError(f"views are on {place}, but the pipeline is on {self.device}; copy them there first.")
        try:
            with self._device.asking():
                self.kernels.upload(views, self._front.frame, chosen=self._used)
        except (BufferError, RuntimeError) as error:  # raised by the library of the array
            raise LightFieldError(f"views cannot be read: {' '.join(str(error).split())}") from error
        self._unseen = place != "cpu" and expected.dtype.kind == "f"

    def run(self) -> None:
        """Estimate the disparity of the current views. Returns before the device has finished."""
        self._is_whole = False
        work = self._captured() or self.work
        with self._device.asking():
            work()
        self._runs, self._is_whole, self._is_loaded = self._runs + 1, True, True

    def _captured(self) -> Callable[[], None] | None:
        """Return all work as a graph; None until it has run once, and where the device cannot repeat work alone."""
        if self._graph is None and self._is_loaded and self.method.is_on_device:
            self._graph = self.kernels.capture(self.work, self.device)
        return self._graph

    @property
    def bounds(self) -> tuple[float, float]:
        """(low, high) of the disparities, pixels per view step."""
        return self.measured.disparity_range

    @property
    def device_disparity(self) -> Any:
        """The map of the last run in device memory, [y, x], float32 (float64 with backend "reference"); not copied.

            torch.from_dlpack(pipeline.device_disparity)
            cupy.asarray(pipeline.device_disparity)

        It has DLPack, and `__cuda_array_interface__` on a GPU or `__array_interface__` on a CPU.

        Raises
        ------
        BackendError
            With backend "taichi", which cannot share arrays.

        Notes
        -----
        The stream that takes the array waits for work that was started before: take it anew after each run, which
        overwrites it. Finish reading it before the next run, or upload the next views from the stream that reads it.
        """
        return self.kernels.shared(self._plan.disparity)

    @property
    def device_confidence(self) -> Any:
        """The confidence of the last run in device memory, [y, x], 0 to 1; as `device_disparity`."""
        return self.kernels.shared(self._plan.confidence)

    def disparity(self) -> Float32Array:
        """Download the map of the last run, float32 [y, x]; waits for the device.

        Raises
        ------
        LightFieldError
            If there was no run, if the views showed too little, or if they came from a GPU and were not finite.
        """
        self._check_whole()
        disparity, trust = self.kernels.read(self._plan.disparity, self._plan.trust)
        self._plan.check(self._lf.name, trust)
        return disparity.astype(np.float32, copy=False)

    def estimate(self, *, on_progress: Progress | None = None) -> DepthResult:
        """Run all stages and return the result; waits for the device.

        With `on_progress`, and on a CPU, it waits after each stage, and the timings are those of stages.
        The first run also does what `confirm_range` does.
        """
        before = self._timings if self._runs == 0 else {}  # what came before the first run is a part of it
        try:
            with self._whole_or_undone():
                self._timings = dict(before)
                with self._timed("total"):
                    if on_progress is None and self._device.is_gpu and self.method.is_on_device:
                        self._follow_at_once()
                    else:
                        self._rectify()
                        self._follow(self.stages(), on_progress)
                self._timings["total"] += sum(before.values())
                self._runs, self._is_whole, self._is_loaded = self._runs + 1, True, True
            return self.result()
        finally:
            take_host_memory(0, 0)

    def _follow(self, stages: Iterable[str], on_progress: Progress | None) -> None:
        for stage in stages:
            self._do(stage, on_progress)
            if stage == self.method.MATCHED and self._runs == 0:
                self._widen(stage, on_progress)
            if stage == self._plan.decided:
                self._plan.check(self._lf.name, self.kernels.number(self._plan.trust))

    def _follow_at_once(self) -> None:
        """Run all stages, and wait for the last only; again those after the first one, if that takes a wider range."""
        # One map of each stage, disparity, confidence and uncertainty; that of the first stage again for `_widen`.
        again = self._runs == 0 and self._is_found
        self._done("run", self._captured() or self.work, maps=len(self.method.stages) + 3 + again)
        first, measured = self.method.MATCHED, self.measured
        if first is not None and self._runs == 0:
            self._widen(first, None)
        if self.measured is not measured:
            self._follow([stage for stage in self.stages() if stage != first], None)

    def confirm_range(self) -> tuple[str, ...]:
        """Take a wider disparity range where the first map shows surfaces at the ends of the one that was found.

        Only the first stage runs; waits for the device. A range that was given stays; after a run, any range does.

        Returns
        -------
        A sentence if surfaces may lie beyond the widest range, too; else nothing.
        """
        stage = self.method.MATCHED
        if stage is not None and self._is_found and self._runs == 0:
            with self._whole_or_undone():
                self._rectify()
                self._do(stage, None)
                self._widen(stage, None)
        return self._notes

    def result(self) -> DepthResult:
        """Return the result of the last run; waits for the device. Raises as `disparity`.

        Its notes are those that the map alone gives; `lfgpu.judged` adds the verdict of the views.
        """
        self._check_whole()
        self._plan.check(self._lf.name, self.kernels.number(self._plan.trust))
        lf, solution, maps = self._lf, self._plan.solution(), self._plan.maps()
        final = maps[self.method.stages[-1].name]
        disparity = host_memory(final.shape, final.dtype)
        disparity[...] = final
        position = lf.positions[lf.reference_index]
        confidence = self.kernels.numpy(self._plan.confidence).astype(np.float32, copy=False)
        return DepthResult(
            disparity=disparity,
            confidence=confidence,
            uncertainty=self._plan.uncertainty(),
            stages=maps,
            position=(float(position[0]), float(position[1])),
            disparity_range=self.measured.disparity_range,
            config=self.config,
            status=solution.status,
            converged=solution.converged,
            trace=solution.trace,
            timings=dict(self._timings),
            backend=self._backend,
            device=self.device,
            versions={
                name: version_of(name) or "not installed"
                for name in ("lfgpu", *dict.fromkeys(("numpy", "scipy", package_of(self._backend))))
            },
            geometry=lf.geometry,
            name=lf.name,
            notes=(*self._notes, *map_notes(disparity, confidence, self.bounds)),
        )

    def stages(self) -> dict[str, Work]:
        """Return the work of each stage, by name and in order; each stage needs those before it, and rectified views.

        `method.stages` describes the stages. Call a stage with a callback(iteration, value), which it calls after each
        iteration, or with None; it can be captured only with None. `run` and `estimate` do all stages.
        """
        return self._plan.stages(self._front.views)

    def work(self) -> None:
        """Start all stages, one operation after the other. `run` does this until it has captured them."""
        self._front.work()
        for stage in self.stages().values():
            stage(None)

    def _do(self, stage: str, on_progress: Progress | None) -> None:
        """Run one stage; waits for the device."""
        if on_progress is not None:
            on_progress(stage, 0, 0.0)
        told = None if on_progress is None else partial(on_progress, stage)
        self._done(stage, partial(self.stages()[stage], told))

    def _rectify(self) -> None:
        if self._is_raw:
            self._done("rectify", self._front.work)

    def _done(self, part: str, work: Callable[[], object], *, maps: int = 0) -> None:
        """Do work on the device as a timed part of the estimate; the host takes memory for so many `maps` meanwhile."""
        with self._timed(part):
            with self._device.asking():
                work()
            if self._device.is_gpu:
                do_waiting()
            if maps:
                take_host_memory(4 * math.prod(self._layout.size), maps)
            self.kernels.number(self._waited_for)

    def _widen(self, stage: str, on_progress: Progress | None) -> None:
        """Repeat the first stage within a wider range if surfaces lie at the ends of the found one; once."""
        if not self._is_found:
            return
        self._is_found = False

        def match(bounds: tuple[float, float]) -> Float32Array:
            with self._timed("measure"), self._device.asking():
                self._follow_measured(self.method.measured(self._lf, bounds, self._device))
            self._do(stage, on_progress)
            return self._plan.maps(stage)[stage]

        doubt = confirm(self._lf.layout, self.bounds, self._plan.maps(stage)[stage], match)
        self._notes = () if doubt is None else (doubt,)

    def _follow_measured(self, measured: Measured) -> None:
        """Have the plan, and its graph, go on with other numbers if it can, else plan anew in the same memory."""
        if hasattr(self, "_plan") and self._plan.follow(measured):
            self.measured = measured
        else:
            self._replan(measured)

    def _replan(self, measured: Measured) -> None:
        self.measured = measured
        self._graph, self._is_loaded = None, False
        with suppress(AttributeError):
            del self._plan  # its memory first
        self._buffers.begin()
        needed = self.method.footprint(self._layout, measured, on_gpu=self._device.is_gpu)
        held = 0 if is_mapped(self._lf.views) else self._lf.views.nbytes
        self._bytes = check_memory(needed, self._layout.size, self.device, held=held)
        self._plan = self.method.plan(self._layout, measured, self._buffers)

    @contextmanager
    def _whole_or_undone(self) -> Iterator[None]:
        """Put range, plan and timings back if the work is not done, by an interruption as by an error."""
        measured, is_found, timings = self.measured, self._is_found, self._timings
        self._is_whole = False
        try:
            yield
        except BaseException:
            self._is_found, self._timings = is_found, timings
            if self.measured is not measured:
                with self._device.asking():
                    self._follow_measured(measured)
            raise

    def _check_whole(self) -> None:
        """Raise LightFieldError if the last run did not come to its end, or views were not finite."""
        if not self._is_whole:
            state = "the last estimate did not come to its end" if self._runs else "nothing has been estimated yet"
            raise LightFieldError(f"{self._lf.name}: {state}; call run() or estimate() first.")
        if self._unseen and not self._plan.is_finite():
            raise LightFieldError(_NOT_FINITE)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self._timings[stage] = self._timings.get(stage, 0.0) + perf_counter() - start


def measured_on(
    lf: LightField,
    *,
    config: Config | PresetName,
    disparity_range: tuple[float, float] | None,
    backend: str,
    device: str,
) -> tuple[Measured, tuple[str, ...]]:
    """Measure range and noise on the first of many light fields; a range that is found is confirmed (`confirm_range`).

    Returns also a sentence if surfaces may lie beyond the range that was found, which is logged as well.
    """
    if disparity_range is not None:
        return method_of(config).measure(lf, open_device(backend, device), disparity_range=disparity_range), ()
    pipeline = DepthPipeline(lf, config=config, backend=backend, device=device)  # type: ignore[arg-type]
    notes = pipeline.confirm_range()
    for note in notes:
        _LOG.warning(note)
    return pipeline.measured, notes
