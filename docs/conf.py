"""Sphinx builds the documentation site from this folder; `make docs` calls it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "site"))  # our extension and what the gallery needs

import twinct  # noqa: E402 - engines must see its settings before Sphinx's extensions load them

project = "twinct"
author = "The twinct authors"
copyright = "The twinct authors"  # noqa: A001 - Sphinx reads this name
release = version = twinct.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "generated_pages",
    "example_links",
    "gallery_folder",
    "moved_pages",
    "search_words",
]
root_doc = "index"
exclude_patterns = ["site", "**/sg_execution_times.rst"]
nitpicky = False  # docstrings name types of other libraries, whose inventories need a network

# Pages --------------------------------------------------------------------------------------------
source_suffix = {".rst": "restructuredtext", ".md": "markdown"}
myst_enable_extensions = ["colon_fence", "deflist", "fieldlist", "attrs_inline"]
myst_heading_anchors = 4  # the anchors that GitHub makes, so that links hold in both places

# Docstrings ---------------------------------------------------------------------------------------
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_class_signature = "separated"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

# Tutorials and gallery: programs that run when the site is built ----------------------------------
sphinx_gallery_conf = {
    "examples_dirs": ["../examples/tutorials", "../examples/gallery"],
    "gallery_dirs": ["tutorials", "gallery"],
    "filename_pattern": "",  # each program is executed
    "within_subsection_order": "FileNameSortKey",
    "capture_repr": ("_repr_html_",),
    "image_scrapers": ("matplotlib", "gallery_folder.pictures"),
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "plot_gallery": os.environ.get("TWINCT_DOCS_EXECUTE", "1") == "1",
}

# Looks --------------------------------------------------------------------------------------------
html_theme = "pydata_sphinx_theme"
html_title = "twinct"
html_favicon = "site/static/twinct.svg"
html_context = {"default_mode": "auto"}
html_static_path = ["site/static"]
html_css_files = ["twinct.css"]
html_search_scorer = str(HERE / "site" / "search_scorer.js")
html_extra_path = ["site/root"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {
        "image_light": "site/static/twinct.svg",
        "image_dark": "site/static/twinct.svg",
        "text": "twinct",
    },
    "header_links_before_dropdown": 7,
    "navbar_start": ["navbar-logo"],
    "navbar_end": ["version-switcher", "theme-switcher"],
    "navbar_persistent": ["search-button"],
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    # All versions of the published site share the list in the folder above them.
    "switcher": {
        "json_url": "../switcher.json",
        "version_match": os.environ.get("TWINCT_DOCS_VERSION", "dev"),
    },
    "check_switcher": False,
}
html_sidebars = {"index": []}
