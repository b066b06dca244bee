"""Settings of the documentation's site: ``make docs`` builds it into ``out/docs``."""

import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numba

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
# Circuits are built here, compiled, and kept in the cache: below it would take a minute for each.
BUILD = (
    "from pcs_racing.track import loading, maps;"
    "[loading.load_track(name) for name in maps.list_tracks()]"
)
subprocess.run([sys.executable, "-c", BUILD], cwd=HERE.parent, check=True)
# Compiled functions are then functions, with their signatures. Notebooks run in processes of their
# own, compiled.
numba.config.DISABLE_JIT = True

import site_pages  # noqa: E402

project = "pcs-racing"
author = "the founders of pcs-racing"
copyright = f"2026, {author}"  # noqa: A001
release = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "version"
]
version = release

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build", "images", "colab", "__pycache__"]
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence", "deflist"]
suppress_warnings = ["myst.header"]  # a page's only heading may be any level

# The notebooks hold no outputs: they are run when the site is built, and again when a notebook has
# changed.
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE.parent / "out" / "notebooks")
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_output_stderr = "remove"  # notes on compilation and progress

autodoc_member_order = "bysource"
autodoc_mock_imports = [name for name in ("stable_baselines3", "torch") if find_spec(name) is None]
autodoc_typehints = "signature"  # docstrings add shapes and units
autodoc_typehints_format = "short"
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"pcs-racing {release}"
html_static_path = ["static"]
html_js_files = ["access.js"]
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
copybutton_exclude = ".linenos, .gp, .go"
pygments_style = "a11y-high-contrast-light"  # of accessible-pygments, which furo brings
pygments_dark_style = "a11y-high-contrast-dark"

site_pages.write(HERE)


def setup(app):
    """Connect the functions that change pages and docstrings."""
    app.connect("source-read", site_pages.mend_page)
    # napoleon: 500
    app.connect("autodoc-process-docstring", site_pages.mend_docstring, priority=400)
    app.connect("autodoc-process-signature", site_pages.shorten_signature)
    app.connect("autodoc-skip-member", site_pages.skip_settings)
