"""A video of light fields: everything is allocated once, and each frame goes in as it comes.

python examples/live_stream.py            # prints the rate
python examples/live_stream.py --view     # and shows the maps in the browser; needs lfgpu[viewer]
"""

import sys
from time import perf_counter

import numpy as np

import lfgpu
from lfgpu import scenes


def main(frames: int = 20, size: tuple[int, int] = (96, 128), view: bool = False) -> list[np.ndarray]:
    recording = scenes.sequence("moving", frames=frames, grid=(5, 5), size=size)
    first = next(iter(scenes.sequence("moving", frames=1, grid=(5, 5), size=size)))
    pipeline = lfgpu.DepthPipeline(first, config="fast", disparity_range=(-2, 2))
    viewer = lfgpu.Viewer(first) if view else None
    if viewer:
        input(f"Open {viewer.url}, then press Enter. ")
    maps, start = [], perf_counter()
    for frame in recording:
        pipeline.upload(frame.views)
        pipeline.run()
        maps.append(pipeline.disparity())
        if viewer:
            viewer.update(maps[-1], views=frame.views)
    print(f"{len(maps)} frames, {len(maps) / (perf_counter() - start):.1f} a second")
    if viewer:
        input("Press Enter to end. ")
        viewer.close()
    return maps


if __name__ == "__main__":
    main(view="--view" in sys.argv[1:])
