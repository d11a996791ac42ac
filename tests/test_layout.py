"""Layouts of views: what a light field is without its pixels."""

from dataclasses import replace

import numpy as np
import pytest

from lfgpu import LightField, LightFieldError, scenes
from lfgpu.data.layout import PATTERNS


@pytest.fixture(scope="module")
def lf() -> LightField:
    made = scenes.make("boxes", grid=(5, 4), size=(16, 20), reference=(1, 2), dtype=np.uint16)
    valid = np.random.default_rng(1).random(made.views.shape[:3]) < 0.9
    return replace(made, valid=valid, white=4095)


def test_a_layout_is_the_light_field_without_its_pixels(lf: LightField) -> None:
    layout = lf.layout
    assert (layout.shape, layout.dtype, layout.scale) == (lf.views.shape, lf.views.dtype, 1 / 4095)
    assert (layout.count, layout.size, layout.channels, layout.name) == (20, lf.size, 3, lf.name)
    assert (layout.reference, layout.farthest) == (lf.reference_index, 3.0)
    assert np.array_equal(layout.offsets, lf.offsets)
    assert layout.masks is not None
    assert np.array_equal(np.stack(layout.masks), lf.valid)


@pytest.mark.parametrize("which", [*PATTERNS, [0, 3, 7, 19]])
def test_its_subset_is_the_layout_of_the_subset(lf: LightField, which: str | list[int]) -> None:
    ours, theirs = lf.layout.subset(which), lf.subset(which).layout
    assert np.array_equal(ours.offsets, theirs.offsets)
    assert (ours.reference, ours.shape) == (theirs.reference, theirs.shape)
    assert ours.masks is not None
    assert theirs.masks is not None
    assert np.array_equal(ours.masks, theirs.masks)


def test_its_subset_copies_no_mask(lf: LightField) -> None:
    masks = lf.layout.subset("cross").masks
    assert masks is not None
    assert all(mask.base is lf.valid for mask in masks)


def test_a_subset_needs_a_second_view(lf: LightField) -> None:
    with pytest.raises(LightFieldError, match="leaves the reference view alone"):
        lf.layout.subset([lf.reference_index])
