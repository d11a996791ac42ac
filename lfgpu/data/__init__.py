"""Light fields, their geometry, and results. Imports no other package of lfgpu above it."""

from lfgpu.data.geometry import Geometry
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import GroundTruth, LightField, check_light_field
from lfgpu.data.points import PointCloud, point_cloud
from lfgpu.data.reading import Inside, Reading
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.data.views_result import ViewsResult
