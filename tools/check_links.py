"""Check that every link between the pages of a folder leads to a page, a picture or a place in one; nothing is fetched.

`python tools/check_links.py build/docs` prints one line for each that does not, and exits with 1 if there are any.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """The links of one page, with their lines, and the places that links can lead to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[tuple[int, str]] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what a tag links to and what it is called."""
        for name, value in attrs:
            if value is None:
                continue
            if name in ("href", "src"):
                self.links.append((self.getpos()[0], value))
            elif name == "id" or (name == "name" and tag == "a"):
                self.places.add(value)


def broken_links(folder: Path) -> list[str]:
    """A line for each link that leads nowhere: where it stands and what it says."""
    pages = {file.resolve(): _Page(file.read_text(encoding="utf-8")) for file in sorted(folder.rglob("*.html"))}
    out = []
    for file, page in pages.items():
        for line, link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            place = unquote(parts.fragment)
            if not target.exists():
                out.append(f"{file}:{line}: {link}: there is no such file")
            elif place and target in pages and place not in pages[target].places:
                out.append(f"{file}:{line}: {link}: the page has no such place")
    return out


def main() -> int:
    """Exit status 0 where all links lead somewhere, 1 where some do not, 2 where there are no pages."""
    folder = Path(sys.argv[1])
    if not any(folder.rglob("*.html")):
        print(f"{folder}: has no pages", file=sys.stderr)
        return 2
    broken = broken_links(folder)
    print("\n".join([*broken, f"{len(broken)} broken links"]))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
