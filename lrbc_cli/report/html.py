"""Small functions that build HTML: every text is escaped unless it is ``Markup``.

Why not jinja2 (tried on ``parts/provenance.py``): 95 lines, 70 of Python and 25 of template, instead of 103. Nearly all of a
part decides which rows and cells there are, so its few words do not become easier to find, and templates escape the type checker.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from urllib.parse import quote


class Markup(str):
    """Text that is already HTML and must not be escaped."""

    __slots__ = ()


_VOID = frozenset({"br", "meta", "link", "hr", "col", "input"})


def tag(element: str, *children: str | None, markup: str | None = None, **attributes: str | bool | None) -> Markup:
    """Return one HTML element.

    Parameters
    ----------
    element
        Name of the element.
    *children
        Plain text (escaped), `Markup` (kept) or None (left out).
    markup
        Attributes already written out and escaped.
    **attributes
        In names, underscores become hyphens, and one at the end is dropped. None and False omit the attribute, True gives it without value.
    """
    words: list[str] = [element] if markup is None else [element, markup]
    for key, value in attributes.items():
        name = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(name)
        elif value is not None and value is not False:
            words.append(f'{name}="{escape(value)}"')
    opening = f"<{' '.join(words)}>"
    return Markup(opening) if element in _VOID else Markup(f"{opening}{join(children)}</{element}>")


def join(children: Iterable[str | None], between: str = "") -> Markup:
    """Return the children one after another; plain text is escaped."""
    return Markup(between.join(child if isinstance(child, Markup) else escape(child) for child in children if child is not None))


class Cell:
    """A table cell with a class, a title or a number of columns that it spans."""

    def __init__(self, *content: str | None, class_: str | None = None, title: str | None = None, span: int | None = None) -> None:
        self.content = content
        self.class_ = class_
        self.title = title
        self.span = span


def table(
    caption: str, head: Sequence[str | Cell], rows: Iterable[Sequence[str | Cell]], *, class_: str | None = None, text_columns: int = 1
) -> Markup:
    """Return a table in a box that scrolls sideways; the first cell of each row is its header.

    Parameters
    ----------
    caption
        Text above the table, which screen readers read out.
    head
        Column headers.
    rows
        Cells of each row.
    class_
        CSS class of the table.
    text_columns
        Number of columns at the left with text; the others are aligned as numbers.
    """
    headers = [_cell("th", entry, scope="col", kind=None if index < text_columns else "n") for index, entry in enumerate(head)]
    lines = []
    for row in rows:
        cells = [_cell("th", row[0], scope="row", kind=None)]
        cells += [
            _cell("td", entry, scope=None, kind=None if index < text_columns else "n") for index, entry in enumerate(row[1:], start=1)
        ]
        lines.append(tag("tr", *cells))
    body = tag("table", tag("caption", tag("span", caption)), tag("thead", tag("tr", *headers)), tag("tbody", *lines), class_=class_)
    return tag("div", body, class_="scroll", tabindex="0", role="region", aria_label=caption)


def _cell(element: str, entry: str | Cell, *, scope: str | None, kind: str | None) -> Markup:
    cell = entry if isinstance(entry, Cell) else Cell(entry)
    classes = " ".join(part for part in (kind, cell.class_) if part) or None
    return tag(element, *cell.content, scope=scope, class_=classes, title=cell.title, colspan=None if cell.span is None else str(cell.span))


def details(summary: str, *content: str | None, **attributes: str | bool | None) -> Markup:
    """Return a part of the page that can be opened and closed."""
    return tag("details", tag("summary", summary), *content, markup=None, **attributes)


def beside(*places: tuple[str, str], text: str | None = None) -> Markup:
    """Return links to files (folder, empty for that of the page, and name); their text is `text` or the ending of the file."""
    links = []
    for folder, name in places:
        way = "/".join(quote(part) for part in (folder, name) if part)
        links.append(tag("a", text or name.rpartition(".")[2].upper(), href=way, aria_label=f"{text or 'file'} {folder} {name}"))
    return join(links, " ")


def figure(drawing: Markup, title: str, note: str, files: Markup | None = None, **attributes: str | bool | None) -> Markup:
    """Return a figure with its title, note and file links; it can be reached and scrolled by keyboard."""
    links = tag("span", files, class_="files") if files else None
    caption = tag("figcaption", tag("b", title), tag("span", note) if note else None, links)
    plot = tag("div", drawing, class_="plot", tabindex="0", role="group", aria_label=f"{title}, {note}" if note else title)
    return tag("figure", caption, plot, markup=None, **attributes)


def document(title: str, *body: Markup, colours: str, scripts: Sequence[str], pictures: bool = False) -> str:
    """Return a whole HTML page that contains its style sheet and scripts; its security policy forbids loading anything else.

    Parameters
    ----------
    title
        Title of the window.
    *body
        Content of the page.
    colours
        CSS before the style sheet of all pages.
    scripts
        Script files of this package, in the order in which they run.
    pictures
        Whether scripts may load pictures from beside the page.
    """
    script, sheet = "\n".join(map(resource, scripts)), colours + resource("page.css")
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'; base-uri 'none'; form-action 'none'"
    policy += "; img-src 'self' file:" if pictures else ""
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content_="width=device-width, initial-scale=1"),
        tag("meta", http_equiv="Content-Security-Policy", content_=policy),
        tag("title", title),
        tag("style", Markup(sheet)),
    )
    return "<!doctype html>\n" + tag("html", head, tag("body", *body, tag("script", Markup(script))), lang="en") + "\n"


def resource(name: str) -> str:
    """Return the text of a file of ``lrbc_cli.report``."""
    return files("lrbc_cli.report").joinpath(name).read_text(encoding="utf-8")
