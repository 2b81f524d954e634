"""Say which links of a built site lead nowhere: ``python docs/check_links.py build/docs/html``.

Files, pages, pictures and places within pages are looked for; other sites are not asked.
"""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
import sys
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The links of a page, and the places in it that links may lead to."""

    def __init__(self, path: Path):
        super().__init__()
        self.links: list[str] = []
        self.places = {''}
        self.feed(path.read_text(encoding='utf-8'))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take what a tag links to, and its name."""
        self.links += [value for name, value in attrs if name in ('href', 'src') and value]
        self.places |= {value for name, value in attrs if name in ('id', 'name') and value}


def broken_links(site: Path) -> Iterator[str]:
    """Yield each link of a site that leads nowhere, with its page."""
    pages = {path.resolve(): Page(path) for path in site.rglob('*.html')
             if '_static' not in path.parts}
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            there = target in pages and unquote(parts.fragment) in pages[target].places
            if not there and (target in pages or not target.exists()):
                yield f'{path.relative_to(site.resolve())}: {link}'


if __name__ == '__main__':
    found = sorted(set(broken_links(Path(sys.argv[1]))))
    print(*found, f'{len(found)} links lead nowhere', sep='\n')
    sys.exit(bool(found))
