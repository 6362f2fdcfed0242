"""One HTML file that needs no other: headings, tables, pictures inside."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ruffini.files import write_whole

STYLE = """body{font:15px/1.45 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:.6em 0}td,th{border-bottom:1px solid #ccc;padding:.25em .8em;text-align:left;
vertical-align:top}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%}
.ok{color:#17692b}.bad{color:#b00020;font-weight:600}.open{color:#777}
.verdict{font-size:1.3em;padding:.6em 1em;border-left:6px solid}"""


class Page:
    """Collects what is shown, then writes it."""

    def __init__(self, title: str) -> None:
        self._title, self._parts = title, [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """A section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str, kind: str = "") -> None:
        """A paragraph; kind is a class of STYLE."""
        self._parts.append(f'<p class="{kind}">{html.escape(text)}</p>')

    def link(self, target: str, text: str) -> None:
        """To a page beside this one."""
        self._parts.append(f'<p><a href="{html.escape(target)}">{html.escape(text)}</a></p>')

    def verdict(self, text: str, *, is_good: bool) -> None:
        """What all of it comes to."""
        self.text(text, f"verdict {'ok' if is_good else 'bad'}")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[Any]], kinds: Sequence[str] = ()) -> None:
        """Rows of text and numbers; kinds: a class for each row."""
        is_number = [any(isinstance(row[i], float) for row in rows) for i in range(len(head))]
        cells = (f"<th{' class=n' * n}>{html.escape(h)}</th>" for h, n in zip(head, is_number, strict=True))
        lines = [f"<table><tr>{''.join(cells)}</tr>"]
        for i, row in enumerate(rows):
            line = "".join(
                f'<td class="n">{cell:.4g}</td>' if isinstance(cell, float) else f"<td>{html.escape(str(cell))}</td>"
                for cell in row
            )
            lines.append(f'<tr class="{kinds[i] if kinds else ""}">{line}</tr>')
        self._parts.append("\n".join(lines) + "</table>")

    def picture(self, figure: Any, what: str) -> None:
        """A matplotlib figure, inside the file; `what` stands in for those who do not see it."""
        import matplotlib.pyplot as plt

        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=100, bbox_inches="tight")
        plt.close(figure)
        data = base64.b64encode(stream.getvalue()).decode()
        self._parts.append(f'<img alt="{html.escape(what)}" src="data:image/png;base64,{data}">')

    def write(self, path: Path) -> None:
        """The file, whole or not at all."""
        head = f'<meta charset="utf-8"><title>{html.escape(self._title)}</title><style>{STYLE}</style>'
        body = "\n".join(self._parts)
        write_whole(
            path, f"<!doctype html>\n<html lang=en><head>{head}</head>\n<body>\n{body}\n</body></html>\n".encode()
        )
