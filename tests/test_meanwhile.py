"""Modules that are imported in a thread of their own."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from lfgpu.cli.meanwhile import import_meanwhile


def test_modules_come_in_and_what_is_wrong_with_one_is_left_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "comes_in_meanwhile.py").write_text("import threading\nwhere = threading.current_thread()\n")
    (tmp_path / "is_broken.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    import_meanwhile("is_broken", "is_not_there", "comes_in_meanwhile")
    for thread in threading.enumerate():
        if thread.name == "lfgpu-import":
            thread.join()
    assert sys.modules["comes_in_meanwhile"].where is not threading.main_thread()
    assert "is_broken" not in sys.modules
    assert capfd.readouterr().err == ""
