"""Self-contained HTML pages: elements with escaped text, tables, and the style of a page."""

import html
from collections.abc import Sequence

VOID = frozenset({"img", "meta", "br"})
#: no external resources are loaded
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --card: #f4f6f8; --ink: #1f2933; --soft: #52606d; --rule: #d5dbe1;
  --c0: #b4540a; --c1: #a0740a; --c2: #1f62b8; --c3: #0b8a63; }
@media (prefers-color-scheme: dark) { :root { --paper: #14181d; --card: #1e242b; --ink: #e6eaee; --soft: #a3afbb;
  --rule: #3a444f; --c0: #ff9a52; --c1: #e8c040; --c2: #6cb0ff; --c3: #4fd0a2; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto,
  "Helvetica Neue", Arial, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .5rem; } h2 { font-size: 1.3rem; margin: 2.8rem 0 .4rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; }
p { max-width: 46rem; margin: .5rem 0; } .soft, figcaption, caption { color: var(--soft); font-size: .9rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(15rem, 1fr)); gap: 1rem; margin: 1.5rem 0; }
.card { background: var(--card); border-radius: .6rem; padding: 1rem 1.2rem; }
.card strong { display: block; font-size: 1.55rem; line-height: 1.25; font-variant-numeric: tabular-nums; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); gap: 1.2rem; }
figure { margin: 0; } figure.single { max-width: 38rem; } figure img { width: 100%; height: auto; display: block; } .wide { overflow-x: auto; }
figcaption { text-align: center; } figcaption b { color: var(--ink); }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding-bottom: .4rem; caption-side: top; }
th, td { padding: .35rem .8rem; border-bottom: 1px solid var(--rule); text-align: right; vertical-align: bottom; }
th:first-child, .words { text-align: left; } thead th { font-size: .85rem; color: var(--soft); font-weight: 600; }
tbody th { font-weight: 600; white-space: nowrap; } td.words { overflow-wrap: anywhere; }
ul.legend { list-style: none; display: flex; flex-wrap: wrap; gap: .3rem 1.4rem; margin: .8rem 0; padding: 0; font-size: .9rem; }
ul.legend svg { width: 2rem; height: .7rem; margin-right: .4rem; vertical-align: middle; }
svg.chart { width: 100%; height: auto; display: block; } svg text { fill: var(--soft); font-size: 13px; }
svg .axis { stroke: var(--rule); stroke-width: 1; } svg .line { fill: none; stroke-width: 2; stroke-linejoin: round; }
svg .thin { stroke-width: 1.2; } svg .dashed { stroke-dasharray: 6 4; }
.c0 { stroke: var(--c0); } .c1 { stroke: var(--c1); } .c2 { stroke: var(--c2); } .c3 { stroke: var(--c3); }
.scale { max-width: 26rem; margin: .8rem auto; font-size: .9rem; color: var(--soft); }
.scale .bar { height: .8rem; border-radius: .2rem; }
.scale .ends { display: flex; justify-content: space-between; font-variant-numeric: tabular-nums; }
details { margin: 1rem 0; } summary { cursor: pointer; }
@media print { main { max-width: none; } .card { border: 1px solid var(--rule); } }
"""


class Markup(str):
    """Text that is already HTML."""


def element(tag: str, *children: str, **attributes: object) -> Markup:
    """Build an element; children that are not `Markup` and attributes are escaped.

    In attribute names, trailing underscores are removed and others become hyphens. An attribute that is None
    is omitted.
    """
    attributes_text = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{html.escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in VOID:
        return Markup(f"<{tag}{attributes_text}>")
    return Markup(f"<{tag}{attributes_text}>{join_markup(*children)}</{tag}>")


def join_markup(*children: str) -> Markup:
    """Concatenate children, escaped if they are not `Markup`."""
    return Markup("".join(x if isinstance(x, Markup) else html.escape(x) for x in children))


def table(
    caption: str, head: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[int] = ()
) -> Markup:
    """Build a table whose first column and first row are headers; columns in `words` hold text, the others
    numbers."""
    look = ["words" if i in words else None for i in range(len(head))]
    top = element(
        "tr", *(element("th", cell, scope="col", class_=x) for cell, x in zip(head, look, strict=True))
    )
    body = [
        element(
            "tr",
            element("th", row[0], scope="row"),
            *(element("td", cell, class_=x) for cell, x in zip(row[1:], look[1:], strict=True)),
        )
        for row in rows
    ]
    whole = element("table", element("caption", caption), element("thead", top), element("tbody", *body))
    # a table wider than a small screen scrolls by itself, also from the keyboard
    return element("div", whole, class_="wide", tabindex=0, role="region", aria_label=caption)


def section(title: str, *children: str) -> Markup:
    """Build a section with a heading and its contents."""
    return element("section", element("h2", title), *children)


def page(title: str, *children: str) -> str:
    """Build a whole page, in the reader's light or dark colour scheme."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("title", title),
        element("style", Markup(STYLE)),
    )
    whole = element("html", head, element("body", element("main", *children)), lang="en-GB")
    return f"<!DOCTYPE html>\n{whole}\n"
