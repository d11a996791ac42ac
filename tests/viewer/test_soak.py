"""The soak of the viewer, short: `python -m tests.viewer.soak` is the long one."""

from typing import Any

import pytest

from tests.viewer.soak import Sample, flat, soak


@pytest.mark.thorough
def test_tabs_that_close_leave_nothing_behind(browser: Any) -> None:
    found = soak(browser, 0, 32)
    assert flat(found) == "", found


def test_what_grows_is_told() -> None:
    steady = [Sample(300 + k % 3, 40, 20) for k in range(16)]
    assert flat(steady) == ""
    growing = [Sample(300 + 10 * k, 40 + k, 20 + k) for k in range(16)]
    assert flat(growing) == "memory +80.0 MiB, descriptors +8, threads +8"
