"""The site: `make docs` builds it into build/site, with warnings as errors."""

from __future__ import annotations

import importlib.metadata
import os
import sys
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path[:0] = [str(DOCS / "_ext"), str(ROOT)]
os.environ.setdefault("LFGPU_THREADS", "2")  # pictures are small
os.environ["LFGPU_DOCS"] = str(DOCS)  # for pictures that run the code of a page

project = "lfgpu"
author = "The lfgpu developers"
copyright = "2026, The lfgpu developers"  # noqa: A001  # Sphinx's name
version = release = importlib.metadata.version("lfgpu")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "matplotlib.sphinxext.plot_directive",
    "sphinx-mathjax-offline",  # pages look right without a network
    "outside",
    "generated",
    "typed",
]
templates_path = ["_templates"]
exclude_patterns = ["_ext", "_templates", "gallery/README.rst", "gallery/*.py", "**/.ipynb_checkpoints"]
nitpicky = False
suppress_warnings = [
    "myst.header",  # pages that are put together from parts begin them where they will
    "config.cache",  # the settings of the gallery hold functions
]

# --- Markdown ---

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "attrs_block", "attrs_inline", "substitution"]
myst_heading_anchors = 4
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True

# --- reference from docstrings ---

autosummary_generate = True
autosummary_imported_members = True
autodoc_default_options = {"members": True, "member-order": "groupwise", "inherited-members": "BaseException,Enum,int"}
autodoc_typehints = "none"  # types stand in the lists of parameters (`typed`)
python_maximum_signature_line_length = 80
numpydoc_show_class_members = False  # _templates has a table of methods
numpydoc_xref_param_type = False
default_role = "code"  # docstrings put names into single backquotes

# --- pictures ---

plot_html_show_formats = False
plot_html_show_source_link = True
plot_formats = [("png", 160)]
plot_rcparams = {"savefig.bbox": "tight"}
sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "made/gallery",
    "filename_pattern": r"/plot_",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "abort_on_example_error": True,
    "within_subsection_order": "FileNameSortKey",
    "remove_config_comments": True,
    "image_scrapers": ("matplotlib",),
    "thumbnail_size": (640, 440),
    "reset_modules": ("matplotlib",),
}

# --- looks ---

html_theme = "pydata_sphinx_theme"
html_title = "lfgpu"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/favicon.svg"
html_search_scorer = str(DOCS / "_static" / "scorer.js")
html_show_sourcelink = False
html_context = {"default_mode": "auto"}
html_sidebars = {"start": [], "made/changes": [], "index": []}
html_theme_options = {
    "logo": {"text": "lfgpu", "image_light": "_static/favicon.svg", "image_dark": "_static/favicon.svg"},
    "header_links_before_dropdown": 8,
    "navbar_align": "left",
    "show_toc_level": 2,
    "show_prev_next": True,
    "secondary_sidebar_items": {"**": ["page-toc"], "index": [], "formats": [], "paper": []},  # these have wide tables
    "icon_links": [
        {"name": "Source", "url": "https://github.com/lfgpu/lfgpu", "icon": "fa-brands fa-github"},
    ],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
}
