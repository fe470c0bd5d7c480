"""Configuration of the documentation: `./run docs` builds it into out/docs, `./run test` as well.

Sphinx with MyST (pages in Markdown) and Furo. The pages load nothing from elsewhere: fonts are the
reader's own, equations are MathML, which browsers draw themselves.
"""

import gc
import sys
from importlib import metadata
from pathlib import Path

# A quarter of the build: its millions of nodes live to its end.
gc.disable()
sys.path.insert(0, str(Path(__file__).parent))

project = "fringe-twin"
version = release = metadata.version("fringe-twin")
html_title = "fringe-twin"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "extensions.equations",
    "extensions.docstrings",
    "extensions.shipped_data",
    "extensions.public_names",
]
exclude_patterns = ["example_capture"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nitpicky = True
# Docstrings have shapes and units where Sphinx looks for the names of types.
nitpick_ignore_regex = [("py:.*", ".*")]
suppress_warnings = ["ref.python"]

autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
