"""A soak of the viewer: tabs are opened, used and closed again, while memory, descriptors and threads stay flat.

python -m tests.viewer.soak --minutes 30 --reopenings 200
"""

import argparse
import gc
import os
import threading
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple

import numpy as np

from lfgpu import scenes
from lfgpu.data import DisparityMap
from lfgpu.viewer import Viewer
from tests.browser import chromium
from tests.viewer.page import Page

SLACK = 48.0
"""Megabytes by which the memory of the last quarter may be above that of the second one."""

_CLOSING = 10  # seconds that a browser under load takes to close the connections of a tab, at most


class Sample(NamedTuple):
    """What the process of the viewer holds while no tab is open."""

    megabytes: float
    descriptors: int
    threads: int


def sample() -> Sample:
    """Look at this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    held = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return Sample(held, len(list(Path("/proc/self/fd").iterdir())), threading.active_count())


def settled(before: list[Sample]) -> Sample:
    """Look at this process when it holds no more than ever before, or later: connections are closed by and by."""
    end, most = monotonic() + _CLOSING, np.max(before or [(np.inf,) * 3], axis=0)
    while (np.array(found := sample()) > most)[1:].any() and monotonic() < end:
        sleep(0.1)
    return found


def use(page: Page, number: int) -> None:
    """Look at views, pixels and maps, and at every fifth opening at the points in space."""
    page.shown("map", "disparity")
    page.tab.keyboard.press(("ArrowRight", "o", "a", "l")[number % 4])
    page.click("map", 5 + number % 30, 8 + number % 20)
    page.choose("quantity", ("error", "confidence")[number % 2])
    if number % 5 == 0:
        page.tab.keyboard.press("d")
        page.has_points()
    page.tab.wait_for_timeout(200)


def soak(browser: Any, seconds: float, reopenings: int) -> list[Sample]:
    """Open and close tabs, evenly over some seconds, while frames of a stream come; a sample after each."""
    lf = scenes.make("boxes", grid=(5, 5), size=(40, 48))
    truth = lf.reference_truth()
    found = []
    with Viewer(lf, DisparityMap(truth.disparity, np.full(lf.size, 0.8, np.float32)), port=0) as viewer:
        begin = monotonic()
        for number in range(reopenings):
            viewer.update(truth.disparity + np.float32(0.001 * number), np.full(lf.size, 0.5, np.float32))
            page = Page(browser, viewer)
            use(page, number)
            page.close()
            until = begin + seconds * (number + 1) / reopenings
            while viewer._server.tabs or monotonic() < until:
                sleep(0.05)
            found.append(settled(found))
    return found


def flat(found: list[Sample]) -> str:
    """Compare the last quarter with the second one; returns what has grown, "" if nothing has."""
    quarter = len(found) // 4
    before, after = (np.median(part, axis=0) for part in (found[quarter : 2 * quarter], found[-quarter:]))
    grown = after - before
    words = (f"memory {grown[0]:+.1f} MiB", f"descriptors {grown[1]:+.0f}", f"threads {grown[2]:+.0f}")
    return ", ".join(word for word, by, most in zip(words, grown, (SLACK, 2, 2), strict=True) if by > most)


def main() -> None:
    """Run a soak and print every tenth sample."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--reopenings", type=int, default=200)
    options = parser.parse_args()
    with chromium() as browser:
        begin = monotonic()
        found = soak(browser, 60 * options.minutes, options.reopenings)
    print("opened  MiB  descriptors  threads")
    for number in sorted({*range(0, len(found), max(1, len(found) // 20)), len(found) - 1}):
        one = found[number]
        print(f"{number + 1:6d} {one.megabytes:5.0f} {one.descriptors:11d} {one.threads:8d}")
    print(f"{len(found)} reopenings in {(monotonic() - begin) / 60:.1f} minutes: {flat(found) or 'flat'}")


if __name__ == "__main__":
    main()
