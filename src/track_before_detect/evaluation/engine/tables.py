"""Tables as text and in Markdown."""

from collections.abc import Sequence

Rows = Sequence[Sequence[str]]


def aligned(rows: Rows, left: bool = False) -> list[str]:
    """Return the lines of a table whose columns end, or begin, below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    place = str.ljust if left else str.rjust
    return ['  '.join(map(place, row, widths)).rstrip() for row in rows]


def markdown_table(header: Sequence[str], rows: Rows) -> list[str]:
    """Return the lines of a table in Markdown; the first column to the left."""
    return ['| ' + ' | '.join(header) + ' |', '|---|' + '---:|' * (len(header) - 1),
            *('| ' + ' | '.join(row) + ' |' for row in rows)]
