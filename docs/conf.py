"""How Sphinx builds these pages: `make docs`. Nothing is fetched, and the pages themselves fetch nothing."""

from __future__ import annotations

import re
from importlib.metadata import version as installed_version
from typing import TYPE_CHECKING, Any

from docutils.utils.math.latex2mathml import tex2mathml

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

project = "synchronizar"
author = "the synchronizar authors"
version = release = installed_version("synchronizar").partition("+")[0]
html_title = f"synchronizar {release}"
html_theme = "furo"
html_show_copyright = False
html_show_sourcelink = False

extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "Indices", "Mask")}
autodoc_default_options = {"members": True}
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True
add_module_names = False

# A docstring's backticks are code, whatever they name.
default_role = "literal"
nitpicky = True
# Types of other packages, whose own pages are not at hand, and of private parts of this one.
nitpick_ignore_regex = [("py:.*", r"(?!synchronizar\.[A-Z]).*")]


def setup(app: Sphinx) -> None:
    """Math as MathML, which browsers draw by themselves; docstrings as the plain text that they are."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_display_math, None))
    app.connect("autodoc-process-docstring", _as_plain_text)
    app.connect("autodoc-process-signature", _readable)


def _inline_math(writer: HTML5Translator, node: nodes.math) -> None:
    writer.body.append(tex2mathml(node.astext()))
    _skip()


def _display_math(writer: HTML5Translator, node: nodes.math_block) -> None:
    tex = node.astext()
    if "\\\\" in tex and "\\begin" not in tex:
        tex = rf"\begin{{aligned}}{tex}\end{{aligned}}"
    writer.body.append(f'<div style="overflow: auto hidden; padding: 0.3em">{tex2mathml(tex, as_block=True)}</div>')
    _skip()


def _skip() -> None:
    from docutils.nodes import SkipNode

    raise SkipNode


def _as_plain_text(_app: Sphinx, _what: str, _name: str, _of: Any, _options: Any, lines: list[str]) -> None:
    """Escape what reStructuredText would take for markup, but for what stands in backticks."""
    for n, line in enumerate(lines):
        parts = line.split("`")
        if len(parts) % 2:
            parts[::2] = [re.sub(r"([*|\\]|_\b)", r"\\\1", part) for part in parts[::2]]
            parts[0] = re.sub(r"^(\s*\w+)([.)]\s)", r"\1\\\2", parts[0])  # "m. ..." begins no list
            lines[n] = "`".join(parts)


def _readable(
    _app: Sphinx, what: str, name: str, _of: Any, _options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """A signature with `Array` where Sphinx would print how it keeps an alias inside of another type."""
    if what == "class" and name.startswith("synchronizar.parameters."):  # each default stands beside what it means
        return "", None

    def named(text: str | None) -> str | None:
        return text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text)

    return named(arguments), named(returns)
