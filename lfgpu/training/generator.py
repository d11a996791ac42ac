"""Batches of generated light fields, the same for the same seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
import warp as wp

from lfgpu.contract import Float64Array
from lfgpu.training import casting
from lfgpu.training.rig import Rig
from lfgpu.training.scenes import SPANS, Tables, draw_array, draw_scenes
from lfgpu.training.sectors import order_of_sectors, warp_stream
from lfgpu.training.textures import SIDE, draw_textures

_SAME = 0.05  # of the distance of the farthest view: cameras that are nearer stand in one place


@dataclass(frozen=True)
class Batch:
    """Light fields of one array with their truth."""

    views: torch.Tensor
    """float32 [b, n, y, x, 3], sorted by sector, `margin` pixels larger than the reference on each side."""
    reference: torch.Tensor  # float32 [b, y, x, 3]
    truth: torch.Tensor  # float32 [b, y, x], pixels in the farthest view
    offsets: Float64Array  # [n, 2], relative to the farthest view
    starts: list[int]
    margin: int

    def turned(self, rng: np.random.Generator, *, keep: bool = False) -> Batch:
        """Mirror, transpose and recolour the light fields at random: others of the same truth.

        With `keep`, they are mirrored and transposed only where this leaves the array of cameras as it is.
        """
        views, reference, truth, offsets = self.views, self.reference, self.truth, self.offsets.copy()
        if rng.random() < 0.5 and not (keep and _differ(offsets, offsets[:, ::-1])):
            views, reference, truth = views.transpose(2, 3), reference.transpose(1, 2), truth.transpose(1, 2)
            offsets = offsets[:, ::-1]
        for axis in (0, 1):
            mirrored = offsets * np.where(np.arange(2) == axis, -1.0, 1.0)
            if rng.random() < 0.5 and not (keep and _differ(offsets, mirrored)):
                views, reference, truth = views.flip(3 - axis), reference.flip(2 - axis), truth.flip(2 - axis)
                offsets = mirrored
        colours = torch.tensor(rng.permutation(3), device=views.device)
        order, starts = order_of_sectors(offsets)
        views = views[:, torch.tensor(order, device=views.device)][..., colours]
        return Batch(
            views, reference[..., colours].contiguous(), truth.contiguous(), offsets[order], starts, self.margin
        )


def _differ(offsets: Float64Array, others: Float64Array) -> bool:
    """Say whether two arrays of as many cameras are not the same."""
    return bool(np.abs(offsets[:, None] - others).max(2).min(1).max() > _SAME)


class Generator:
    """A source of light fields without end.

    Parameters
    ----------
    seed
        Batch k of the same numbers is always the same.
    device
        Of Warp and PyTorch, "cpu" or "cuda:0".
    side
        Pixels of the reference, each way.
    textures
        Number of textures that scenes choose from, at least 20.
    rays
        Rays of a pixel, each way.
    rig
        The cameras that all light fields are of. Default None: cameras of any kind.
    spans
        Pixels in the farthest view over which the disparities of a scene are spread, unless the rig says it.
    matt
        Share of the scenes in which all things are matt, textured and in good light.
    """

    margin = 16

    def __init__(
        self,
        seed: Sequence[int],
        device: str,
        *,
        side: int = 192,
        textures: int = 64,
        rays: int = 4,
        rig: Rig | None = None,
        spans: tuple[float, float] = SPANS,
        matt: float = 0.0,
    ) -> None:
        self.seed, self.device, self.side, self.rays, self.rig = seed, device, side, rays, rig
        self._scenes = partial(draw_scenes, spans=spans, matt=matt)
        drawn = draw_textures(textures, np.random.default_rng((*seed, 1)))
        self._textures = wp.array(drawn, dtype=wp.vec3f, device=device)
        for index in range(textures // 2, textures):  # pictures of generated scenes are textures, too
            self._picture(index)

    def draw(self, number: int, scenes: int) -> Batch:
        """Make batch `number` of `scenes` light fields."""
        rng = np.random.default_rng((*self.seed, 2, number))
        offsets = draw_array(rng) if self.rig is None else self.rig.draw_array(rng)
        order, starts = order_of_sectors(offsets)
        offsets = offsets[order]
        limits = None if self.rig is None else self.rig.limits
        tables = self._scenes(scenes, self.side, rng, textures=self._textures.shape[0], limits=limits)
        everywhere = np.concatenate([offsets, np.zeros((1, 2))])
        gains = 1 + 0.01 * rng.standard_normal((scenes, len(everywhere))) * (rng.random((scenes, 1)) < 0.25)
        shifts = 0.05 * rng.standard_normal((scenes, len(everywhere), 2)) * (rng.random((scenes, 1, 1)) < 0.2)
        shifts[:, -1] = 0
        if self.rig is not None:
            alone = slice(-1, None)
            seen = self._cast(tables, everywhere[alone], gains[:, alone], shifts[:, alone], 0, self.side, 0)
            self.rig.expose(tables[2], seen.mean((1, 2, 3, 4)).cpu().numpy(), rng)
        views = self._cast(tables, everywhere, gains, shifts, int(rng.integers(1 << 30)), self.side, self.margin)
        truth = torch.empty((scenes, self.side, self.side), device=self.device)
        with warp_stream(self.device):
            wp.launch(
                casting.truth_kernel,
                dim=tuple(truth.shape),
                inputs=[wp.array(tables[0], dtype=casting.Shape, device=self.device), self._textures],
                outputs=[wp.from_torch(truth)],
                device=self.device,
            )
        if self.rig is not None and self.rig.is_grey:
            views = views.mean(-1, keepdim=True).expand_as(views)
        inside = slice(self.margin, self.margin + self.side)
        return Batch(views[:, :-1], views[:, -1, inside, inside].contiguous(), truth, offsets, starts, self.margin)

    def _cast(
        self, tables: Tables, offsets: Float64Array, gains: Float64Array, shifts: Float64Array, seed: int, side: int,
        margin: int,
    ) -> torch.Tensor:  # fmt: skip
        """Make the views float32 [b, n, y, x, 3] at `offsets` [n, 2] of the scenes in `tables`."""
        whole = side + 2 * margin
        views = torch.empty((len(tables[0]), len(offsets), whole, whole, 3), device=self.device)
        structs = casting.Shape, casting.Look, casting.Light, wp.vec2f, float, wp.vec2f
        values = (*tables, *(x.astype(np.float32) for x in (offsets, gains, shifts)))
        with warp_stream(self.device):
            arrays = [wp.array(x, dtype=t, device=self.device) for x, t in zip(values, structs, strict=True)]
            wp.launch(
                casting.views_kernel,
                dim=tuple(views.shape[:4]),
                inputs=[*arrays[:3], self._textures, *arrays[3:], self.rays, margin, seed],
                outputs=[wp.from_torch(views, dtype=wp.vec3f)],
                device=self.device,
            )
        return views

    def _picture(self, index: int) -> None:
        """Make a picture of a generated scene a texture."""
        rng = np.random.default_rng((*self.seed, 3, index))
        tables = draw_scenes(1, SIDE, rng, textures=self._textures.shape[0] // 2)
        picture = self._cast(tables, np.zeros((1, 2)), np.ones((1, 1)), np.zeros((1, 1, 2)), index, SIDE, 0)
        level = picture.mean()
        wp.to_torch(self._textures)[index] = (picture[0, 0] - level) * (0.2 / (picture.std() + 0.02)) + 0.5
