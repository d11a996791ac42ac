"""The names of what a batch writes, besides the maps."""

from __future__ import annotations

from lfgpu.io.names import REPORT_FILE

MANIFEST_FILE = "manifest.jsonl"
LOCK_FILE = ".batch.lock"
VIEW_FILE, PREVIEW_FILE, ERROR_FILE = "view.jpg", "preview.png", "error.png"
"""Pictures of an item for the page: the reference view, the map, and its error where there is ground truth."""
OWN = (MANIFEST_FILE, LOCK_FILE, REPORT_FILE)
"""The files that lie beside the folders of the items."""
