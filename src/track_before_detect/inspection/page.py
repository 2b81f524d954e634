"""One page that holds an inspection, with its pictures inside."""

import base64
from collections.abc import Iterable, Sequence
import html

STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; color: #1b1f24; background: #fff;
  margin: 0 auto; padding: 1rem; max-width: 84rem; }
h1 { font-size: 1.4rem; margin: 0 0 .3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.1rem; margin: 1.6rem 0 .5rem; border-bottom: 1px solid #d0d7de; }
.pictures { display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 23rem), 1fr)); }
figure { margin: 0; } figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .85rem; color: #57606a; }
.wrong { background: #fff4e5; border-left: 4px solid #d9541e; padding: .4rem 1.6rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; }
th, td { padding: .2rem .6rem; border-bottom: 1px solid #e4e8ec; text-align: left;
  white-space: nowrap; font-variant-numeric: tabular-nums; }
"""

Rows = Sequence[Sequence[str]]


def page(title: str, sections: Iterable[tuple[str, str]]) -> str:
    """Return a page of sections, each a heading and what is below it as HTML."""
    body = '\n'.join(f'<section><h2>{html.escape(heading)}</h2>\n{content}</section>'
                     for heading, content in sections)
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n'
            f'<body>\n<h1>{html.escape(title)}</h1>\n{body}\n</body>\n</html>\n')


def sentences(texts: Sequence[str], otherwise: str, kind: str = '') -> str:
    """Return a list of sentences, or what is said instead of none."""
    if not texts:
        return f'<p>{html.escape(otherwise)}</p>'
    items = ''.join(f'<li>{html.escape(text)}</li>' for text in texts)
    return f'<ul{kind and f" class={chr(34)}{kind}{chr(34)}"}>{items}</ul>'


def table(rows: Rows, otherwise: str) -> str:
    """Return a table with its header in the first row, or what is said of one without rows."""
    if len(rows) < 2:
        return f'<p>{html.escape(otherwise)}</p>'
    header, *lines = [[html.escape(cell) for cell in row] for row in rows]
    return ('<div class="scroll"><table><tr>' + ''.join(f'<th>{cell}</th>' for cell in header)
            + '</tr>\n' + '\n'.join(
                '<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>' for row in lines)
            + '</table></div>')


def pictures(drawn: Iterable[tuple[str, str, bytes]]) -> str:
    """Return figures of a name, a caption and a PNG each, which becomes a part of the page."""
    return '<div class="pictures">' + '\n'.join(
        f'<figure><img alt="{html.escape(name)}" '
        f'src="data:image/png;base64,{base64.b64encode(content).decode()}">'
        f'<figcaption><b>{html.escape(name)}.</b> {html.escape(caption)}</figcaption></figure>'
        for name, caption, content in drawn) + '</div>'
