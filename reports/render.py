"""The page as one self-contained file: template, style and script filled in, nothing fetched."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from reports.bronchoscope import make_bronchoscope_page
from reports.cohort import make_cohort_page
from reports.comparison import make_comparison_page
from reports.matrix import make_matrix_page
from reports.needle import make_needle_page
from reports.needle_ct import Surroundings
from reports.reach import make_reach_page
from reports.rigid import make_rigid_page
from reports.views import make_page
from segmentation.anatomy.nasal import NasalScene
from segmentation.errors import TubeplanError
from segmentation.mesh import Surface
from tubeplan_viz.endoluminal import Still
from tubeplan_viz.result import Comparison, Review


class ReportError(TubeplanError):
    """A run of which no report can be made or written."""


@cache
def _part(*names: str) -> str:
    """The text of one of the package's own files."""
    return files("reports").joinpath(*names).read_text(encoding="utf-8")


@cache
def _environment() -> jinja2.Environment:
    # autoescape=True and not select_autoescape(): that one leaves *.html.j2 unescaped.
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: _part("templates", name)),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["css_string"] = css_string
    return environment


def css_string(text: str) -> Markup:
    """Text between the quotes of a string in a style sheet: all but plain letters, figures and spaces as code points.

    Examples
    --------
    >>> print(css_string("neck-2"))
    neck\\2d 2
    """
    return Markup("".join(c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):x} " for c in text))


def policy(script: str) -> str:
    """The content security policy: nothing from outside, and only this script by its hash."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    allowed = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return f"{allowed}; script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"


def embedded(value: Mapping[str, Any]) -> Markup:
    """JSON for a script element; no text in it can end the element.

    Raises
    ------
    ReportError
        If a number is not finite.
    """
    try:
        text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise ReportError(
            f"the result cannot be put into the report: {error}; expected finite numbers only, plan the case again"
        ) from error
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def render_report(review: Review) -> str:
    """The report of one run as HTML.

    Parameters
    ----------
    review : Review
        The finished run; whatever it lacks (CT, surface, path, optional keys of the
        result) is left out of the page.

    Returns
    -------
    str
        One HTML document without outside references.

    Raises
    ------
    ReportError
        If the result holds numbers that are not finite.
    """
    page = make_page(review)
    return _filled(
        "report.html.j2",
        script=_part("scene", "dist", "report.js"),
        style=_style(),
        page=page,
        result_json=embedded(page.result),
        scene_json=embedded(page.scene),
    )


def render_comparison(comparison: Comparison) -> str:
    """The page of several runs side by side as HTML, without outside references.

    Raises
    ------
    ReportError
        If a result holds numbers that are not finite.
    """
    page = make_comparison_page(comparison)
    return _filled(
        "compare.html.j2",
        script=_part("scene", "dist", "report.js"),
        style=_style() + _part("templates", "compare.css"),
        page=page,
        compare_json=embedded(page.document),
        scene_json=embedded(page.scene),
    )


def render_matrix(document: Mapping[str, Any], surface: Surface) -> str:
    """The page of instruments against targets as HTML, from the content of matrix.json.

    Raises
    ------
    ReportError
        If the document holds numbers that are not finite.
    """
    page = make_matrix_page(document, surface)
    return _filled(
        "matrix.html.j2",
        script=_plain(),
        style=_style() + _part("templates", "matrix.css"),
        page=page,
        matrix_json=embedded(page.document),
    )


def render_cohort(document: Mapping[str, Any]) -> str:
    """The page of a cohort as HTML, from the content of cohort.json; links lead to the pages of its cases beside it.

    Raises
    ------
    ReportError
        If the document holds numbers that are not finite.
    """
    page = make_cohort_page(document)
    return _filled(
        "cohort.html.j2",
        script=_plain() + _part("templates", "cohort.js"),
        style=_style() + _part("templates", "cohort.css"),
        page=page,
        cohort_json=embedded(page.document),
    )


def render_needle(case_id: str, result: Mapping[str, Any], around: Surroundings) -> str:
    """The report of one needle run as HTML, without outside references.

    Parameters
    ----------
    case_id : str
    result : mapping
        The content of result.json.
    around : Surroundings
        CT and obstacles, for pictures.

    Raises
    ------
    ReportError
        If the result holds numbers that are not finite.
    """
    page = make_needle_page(case_id, result, around)
    return _filled(
        "needle.html.j2",
        script=_plain() if page.space is None else _part("scene", "dist", "report.js"),
        style=_style(),
        page=page,
        result_json=embedded(result),
        scene_json=embedded({} if page.space is None else page.space.scene),
    )


def render_bronchoscope(case_id: str, result: Mapping[str, Any], surface: Surface, stills: Sequence[Still] = ()) -> str:
    """The report of one run of the bronchoscope robot as HTML, without outside references.

    Raises
    ------
    ReportError
        If the result holds numbers that are not finite.
    """
    page = make_bronchoscope_page(case_id, result, surface, stills)
    return _filled(
        "bronchoscope.html.j2",
        script=_part("scene", "dist", "report.js") if page.profiles else _plain(),
        style=_style(),
        page=page,
        result_json=embedded(result),
        scene_json=embedded(page.scene),
    )


def render_reach(document: Mapping[str, Any], surface: Surface) -> str:
    """The page of a reach map as HTML, from the content of reach.json.

    Raises
    ------
    ReportError
        If the document holds numbers that are not finite.
    """
    page = make_reach_page(document, surface)
    told = {key: document[key] for key in document if key != "branches"}
    return _filled(
        "reach.html.j2",
        script=_plain(),
        style=_style() + _part("templates", "reach.css"),
        page=page,
        reach_json=embedded(told),
    )


def render_rigid(case_id: str, result: Mapping[str, Any], head: NasalScene) -> str:
    """The report of one rigid run as HTML, without outside references; parameters as `make_rigid_page`.

    Raises
    ------
    ReportError
        If the result holds numbers that are not finite.
    """
    page = make_rigid_page(case_id, result, head)
    return _filled(
        "rigid.html.j2",
        script=_part("scene", "dist", "report.js"),
        style=_style(),
        page=page,
        result_json=embedded(result),
        scene_json=embedded(page.scene),
    )


def _plain() -> str:
    """The script of pages whose pictures stand still: the switch of colours, folds that open for print."""
    return _part("scene", "dist", "plain.js")


def _style() -> str:
    """Tokens and parts that all pages share."""
    return _part("templates", "style.css").replace("/*DARK*/", _part("templates", "dark.css"))


def _filled(template: str, *, script: str, style: str, **values: Any) -> str:
    made = {"policy": Markup(policy(script)), "style": Markup(style), "script": Markup(script)}
    return _environment().get_template(template).render(**made, **values)


def write_page(page: str, path: Path) -> None:
    """Write a page that one of the `render` functions made; readable by its owner only, on the disk when this returns.

    Raises
    ------
    ReportError
        If the file cannot be written.
    """
    data = page.encode("utf-8")
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(handle, "wb") as file:
            os.fchmod(file.fileno(), 0o600)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise ReportError(f"{path.name} cannot be written: {error.strerror}; free space or choose another folder") from error
