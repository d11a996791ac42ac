"""The names of files that results are written to."""

from __future__ import annotations

RESULT_FILE = "result.npz"
"""Everything."""
DISPARITY_FILE = "disparity.pfm"
"""The disparity map by itself."""
DEPTH_FILE = "depth.pfm"
"""The metric depth by itself."""
VIEWS_FILE = "disparities.npz"
"""The maps of all views."""
REPORT_FILE = "report.html"
"""The page about a result, about a batch or about a comparison."""
