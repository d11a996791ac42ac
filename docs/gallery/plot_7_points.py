"""
Points in space
===============

The pixels of the reference view as points: x to the right, y down, z away, in metres where the cameras are known.
`lfgpu.save(result, "cloud.ply", image=...)` writes them for other programs.
"""

import matplotlib.pyplot as plt

import lfgpu
from lfgpu import scenes

lf = scenes.make("still_life", grid=(7, 7), size=(144, 192))
result = lfgpu.estimate_depth(lf)
cloud = lfgpu.point_cloud(result, image=lf.image(lf.reference_index))

figure = plt.figure(figsize=(7, 5), layout="constrained")
axis = figure.add_subplot(projection="3d")
axis.set_box_aspect((4, 4, 3), zoom=1.05)
axis.locator_params(nbins=5)
x, y, z = cloud.points.T
axis.scatter(x, z, -y, c=cloud.colors / 255, s=1.5)
axis.view_init(elev=18, azim=-65)
axis.set_xlabel("x, m")
axis.set_ylabel("z, m")
axis.set_zlabel("-y, m")
