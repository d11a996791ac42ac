"""Fixtures of the tests of readers."""

from __future__ import annotations

import pytest
from fields import scene

from lfgpu.data.lightfield import LightField


@pytest.fixture(scope="session")
def true() -> LightField:
    """The light field that samples of all formats are written from."""
    return scene()
