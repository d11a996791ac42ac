"""A producer of frames for `lfgpu live ring:FILE`: here of test pictures; yours come from cameras.

python examples/ring_producer.py /dev/shm/rig 3x3 480x640 600 60   # 600 frames, 60 a second; 0: as fast as possible
lfgpu live ring:/dev/shm/rig --disparity-range=-2,2                # at the same time
"""

import sys
import time

from lfgpu.io.ring import RingWriter


def main(path: str, grid: str, size: str, frames: int, rate: float) -> int:
    (rows, columns), (height, width) = (map(int, pair.split("x")) for pair in (grid, size))
    positions = [(u, v) for v in range(rows) for u in range(columns)]  # u to the right, v down, in view steps
    start = time.perf_counter()
    with RingWriter(path, positions, (height, width), reference=rows * columns // 2) as ring:
        for number in range(1, frames + 1):
            if rate > 0:
                time.sleep(max(0.0, start + number / rate - time.perf_counter()))
            ring.begin()[:] = number % 251  # [n, y, x, c]: here all of one value
            ring.publish()
        time.sleep(0.1)  # the last frame can be read
    return frames


if __name__ == "__main__":
    if len(sys.argv) != 6:
        sys.exit("usage: ring_producer.py FILE ROWSxCOLUMNS HEIGHTxWIDTH FRAMES RATE")
    main(*sys.argv[1:4], int(sys.argv[4]), float(sys.argv[5]))
