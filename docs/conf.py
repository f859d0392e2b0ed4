"""How Sphinx makes the site (`make docs`): guides, public names, and the examples and notebooks, which run.

The source folder is the repository's root, so that links between pages are those that work in the repository.
"""

import os
import tempfile
from pathlib import Path

project = "gelgap"
author = "The gelgap authors"
copyright = author
root_doc = "docs/index"
html_theme = "furo"
html_title = "gelgap"
html_show_copyright = False

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
include_patterns = [
    "docs/**",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "assets/reference/README.md",
    "assets/reference/losses/README.md",
]
# The gallery's scripts and notebooks are there to be downloaded.
exclude_patterns = ["docs/gallery/*.ipynb", "docs/gallery/*.py", "docs/gallery/*.md5"]

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 1800
nb_execution_in_temp = True

# PyPI's pages answer programs with a challenge for browsers.
linkcheck_ignore = [r"https://pypi\.org/project/"]
linkcheck_timeout = 10

default_role = "literal"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_ivar = True

# Examples write their data sets here, in their quickest form, and share its solves with the notebooks.
root = Path(__file__).parents[1]
work = Path(tempfile.gettempdir()) / "gelgap-docs"
os.environ.setdefault("GELGAP_CACHE", str(work / "cache"))
# What each example is run with; those of `own_method` are the domains that `own_gap` has made.
ARGUMENTS = {
    "own_gap": [work / "own-gap", "smoke", "draft"],
    "own_method": [work / "own-gap/wmb0i0", work / "own-gap/harder-slippery-redder"],
    "own_sensor": [root / "examples/own_sensor.toml", work / "own-sensor.png", "draft"],
}


def arguments(_: dict, script: dict) -> list[str]:
    """Return the command-line arguments of an example."""
    work.mkdir(exist_ok=True)
    return [str(word) for word in ARGUMENTS[Path(script["src_file"]).stem]]


# The gallery's function above cannot be kept between builds; nothing depends on it.
suppress_warnings = ["config.cache"]
sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "docs/gallery",
    # `own_backbone` would run before the domains are there; tests/test_examples.py runs it.
    "filename_pattern": r"/own_(?!backbone)",
    # A method needs the domains of the gap.
    "within_subsection_order": "FileNameSortKey",
    "reset_argv": arguments,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 3600,
}
