"""Parts of the reports' HTML pages; pictures lie inside the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape


def table(
    head: Sequence[str], rows: Sequence[Sequence[str]], first_bold: bool = False
) -> str:
    """A table; without a head line if all of ``head`` is empty."""

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)

    lines = [f"<tr>{cells(head, 'th')}</tr>"] if any(head) else []
    for index, row in enumerate(rows):
        style = " class=ours" if first_bold and index == 0 else ""
        lines.append(f"<tr{style}>{cells(row, 'td')}</tr>")
    return f"<table>{''.join(lines)}</table>"


def picture(data: bytes, alt: str, kind: str = "png") -> str:
    """A picture as part of the page; ``kind``: png or jpeg."""
    text = base64.b64encode(data).decode()
    return f'<img alt="{escape(alt)}" src="data:image/{kind};base64,{text}">'


def page(title: str, parts: Sequence[str], *, wide: bool = False) -> str:
    """The whole page; ``parts`` are HTML already, the title is not.

    Args:
        title: of the browser's window.
        parts: one after the other.
        wide: for tables of many columns, the last of which is text.
    """
    body, kind = "\n".join(parts), " class=wide" if wide else ""
    return _SKELETON.format(title=escape(title), kind=kind, body=body)


_SKELETON = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 900px; margin: 2rem auto;
  padding: 0 1rem; color: #1f2328; }}
h1 {{ font-size: 1.6rem; }} h2 {{ font-size: 1.15rem; margin-top: 2rem; }}
table {{ border-collapse: collapse; width: 100%; margin: 1rem 0; font-size: 13px; }}
th, td {{ text-align: right; padding: .3rem .6rem; border-bottom: 1px solid #d1d9e0; }}
th:first-child, td:first-child {{ text-align: left; }}
.wide {{ max-width: 1150px; }} .wide th:last-child, .wide td:last-child {{
  text-align: left; }}
.ours {{ font-weight: 600; background: #ddf4ff; }}
.small {{ color: #59636e; font-size: 13px; }}
.note {{ border-left: 3px solid #d1242f; padding-left: .7rem; }}
img, video {{ max-width: 100%; height: auto; }} video {{ width: 640px; }}
</style></head><body{kind}>
{body}
</body></html>
"""
