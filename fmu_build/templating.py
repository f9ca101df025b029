"""Jinja2 templates of the package: C tables, model description and documentation."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from typing import Any

import jinja2
from markupsafe import Markup, escape

from flexfmu.fmu_build.errors import ModelError


def render(template: str, **values: Any) -> str:
    """Render a template from ``templates/``; values are escaped in XML and HTML, not in C."""
    return _environment().get_template(template).render(**values)


def c_string(text: str) -> str:
    """A C string literal of ``text`` in UTF-8: printable ASCII unchanged, all else (and quotes, backslashes, ``?``) as octal escapes."""
    plain = {byte for byte in range(0x20, 0x7F) if chr(byte) not in '"\\?'}
    return '"' + "".join(chr(byte) if byte in plain else f"\\{byte:03o}" for byte in text.encode()) + '"'


def c_double(value: float | None, missing: str = "0.0") -> str:
    """A C literal that reads back as exactly ``value``; ``missing`` for None.

    Raises:
        ModelError: the number is infinite or not a number.
    """
    if value is None:
        return missing
    if value - value != 0.0:
        raise ModelError(f"a table of the generated C must hold finite numbers, got {value}")
    return repr(float(value))


def subscripts(formula: str) -> Markup:
    """A formula for HTML: ``K_kk`` becomes K with the subscript kk."""
    return Markup(re.sub(r"_([A-Za-z0-9]+)", r"<sub>\1</sub>", str(escape(formula))))


@cache
def _environment() -> jinja2.Environment:
    """The templates; each is compiled once, since that takes longer than filling it."""
    folder = files("flexfmu.fmu_build") / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
        autoescape=jinja2.select_autoescape(("xml.j2", "html.j2")),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"c_string": c_string, "c_double": c_double, "subscripts": subscripts}
    return environment
