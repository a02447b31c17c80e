"""How ``make docs`` builds the pages: no network, numbers from ``paper/tables`` at build time."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.errors import ConfigError

ABSENT = [name for name in ("myst_nb", "furo", "latex2mathml") if find_spec(name) is None]
if ABSENT:
    raise ConfigError(f"not installed: {', '.join(ABSENT)}; run: pip install 'bayes-sensor[docs]'")

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]


import bayes_sensor  # noqa: E402

project = "bayes_sensor"
author = "bayes_sensor contributors"
copyright = author
version = release = bayes_sensor.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "gallery",
    "mathml",
    "study_table",
]
# the notebooks lie beside the pages, and are run whenever their page is made
NOTEBOOKS = HERE / "notebooks"
if not NOTEBOOKS.exists():
    NOTEBOOKS.symlink_to(Path("..") / "notebooks", target_is_directory=True)
nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
# formulas become MathML, which browsers draw themselves; MathJax would be fetched from elsewhere
html_math_renderer = "mathml"
math_number_all = False
math_eqref_format = "({number})"

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
add_module_names = False
napoleon_numpy_docstring = True
napoleon_google_docstring = False

exclude_patterns = ["_build", "**/.ipynb_checkpoints"]
html_theme = "furo"
html_title = f"bayes_sensor {release}"
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_show_sphinx = False
html_copy_source = False


_kept: dict[str, list[str]] = {}


def _keep(_app: Sphinx, what: str, name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    # before napoleon, which takes the words before a colon for a type: here they are prose
    if what in ("attribute", "property"):
        _kept[name] = list(lines)


def _restore(
    _app: Sphinx, _what: str, name: str, _obj: Any, _options: Any, lines: list[str]
) -> None:
    lines[:] = _kept.pop(name, lines)


def _signature(
    _app: Sphinx, _what: str, _name: str, _obj: Any, _options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    # a dataclass shows "<factory>" for a default made anew, which is no Python
    return (signature.replace("<factory>", "..."), returns) if signature else None


def setup(app: Sphinx) -> None:
    """What autodoc's text goes through on its way to the page."""
    app.connect("autodoc-process-docstring", _keep, priority=400)
    app.connect("autodoc-process-docstring", _restore, priority=600)
    app.connect("autodoc-process-signature", _signature)
