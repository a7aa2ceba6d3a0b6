"""Whether every link inside the built site leads somewhere."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """The links of a page, and the places in it that can be linked to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.places: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, _: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what an element links to, and its name."""
        for name, value in attrs:
            if value and name in ("href", "src"):
                self.links.add(value)
            elif value and name in ("id", "name"):
                self.places.add(value)


def dead_links(site: Path) -> Iterator[str]:
    """Yield a line about each link to a file or a place that is not there.

    Pages of others and the replays, which are Meshcat's, are not read.
    """
    pages = {
        path.resolve(): _Page(path)
        for path in sorted(site.rglob("*.html"))
        if path.parent.name not in ("replays", "_static")
    }
    for path, page in pages.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = path
            if parts.path:
                target = (path.parent / unquote(parts.path)).resolve()
            place = unquote(parts.fragment)
            if not target.exists():
                yield f"{path.relative_to(site.resolve())}: no file for {link}"
            elif place and target in pages and place not in pages[target].places:
                yield f"{path.relative_to(site.resolve())}: no place for {link}"
