"""What tests of files share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture
def _permissions_count(tmp_path: Path) -> None:
    closed = tmp_path / "closed.txt"
    closed.touch(mode=0)
    if os.access(closed, os.R_OK):
        pytest.skip("this user may read and write everything (root)")
    closed.unlink()
