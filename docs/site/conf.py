"""Settings of Sphinx for the documentation site: ``make docs``.

The source folder is the root of the repository: pages are rendered where they are, so that their links work on the site and in
the repository. The navigation is that of ``docs/index.md``: each heading is a section, and each link below it a page.
"""

import re
import sys
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any, Final

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

ROOT: Final = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from docs.tools import site  # noqa: E402  the path is set above

project = "shuttle_marl"
author = "the shuttle_marl authors"
project_copyright = "the shuttle_marl authors, MIT licence"
release = version = re.search(r'__version__ = "(.*)"', (ROOT / "shuttle_marl/__init__.py").read_text(encoding="utf-8"))[1]

extensions = ["myst_nb" if site.NOTEBOOKS.is_dir() else "myst_parser"]
if not tags.has("quick"):  # noqa: F821  Sphinx defines it; `-t quick` leaves out the reference
    extensions += ["autoapi.extension", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
root_doc = "docs/index"
include_patterns = [*site.PAGES, "docs/reference/**"]
exclude_patterns = ["docs/tools/**", "docs/site/**"]
suppress_warnings = [
    "ref.python",  # a name that several packages export
    "autoapi.python_import_resolution",  # modules without public names are not read
    "myst.header",  # pages that begin with a heading of the second level
]

myst_enable_extensions = ["html_image"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
nb_execution_mode = "off"  # docs.tools.notebooks has executed them

autoapi_dirs = [str(ROOT / "shuttle_marl")]
autoapi_root = "docs/reference"
autoapi_add_toctree_entry = False
autoapi_keep_files = False
autoapi_member_order = "groupwise"
autoapi_options = ["members", "imported-members", "show-inheritance", "show-module-summary"]
autoapi_ignore = site.unpublished()
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # an attribute in the docstring and the property of its name are one

html_theme = "furo"
html_title = f"shuttle_marl {release}"
html_extra_path = ["extra"]
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the navigation and the selection of public names."""
    app.add_lexer("mermaid", TextLexer)
    app.connect("source-read", site.add_navigation)
    app.connect("builder-inited", lambda app: app.env.settings.update(image_loading="lazy"))
    if "autoapi.extension" in extensions:
        site.read_lazy_imports()
        app.connect("autoapi-skip-member", site.is_private)
    return {"parallel_read_safe": True, "parallel_write_safe": True, "version": installed("sphinx")}
