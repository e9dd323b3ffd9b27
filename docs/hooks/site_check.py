"""The built site from the disk: links and pictures lead somewhere, nothing is of a network, the search knows all.

`python -m docs.hooks.site_check site` prints what is wrong, a line each, and ends with 1 where something is.
"""

import json
import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src"}
"""What a browser fetches of itself to show a page."""
_REMOTE = re.compile(r"url\(\s*['\"]?(?:https?:)?//|@import\s+['\"](?:https?:)?//")


class _Page(HTMLParser):
    """The ids of a page, and what it refers to: (tag, address)."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.references: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.ids |= {value for value in (given.get("id"), given.get("name")) if value}
        address = given.get("href" if tag == "a" else LOADED.get(tag, ""))
        if address:
            self.references.append((tag, address))


def problems(site: Path) -> Iterator[str]:
    """What is wrong with a built site, a line each."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    if len(pages) < 2:
        yield f"{site}: no site; build it with `make docs`"
        return
    for path, page in pages.items():
        if path.name == "404.html":  # of a server, with addresses from its root
            continue
        for tag, address in page.references:
            wrong = _wrong(path, tag, address, pages)
            if wrong:
                yield f"{path.relative_to(site)}: {address}: {wrong}"
    for path in site.rglob("*.css"):
        if _REMOTE.search(path.read_text(encoding="utf-8")):
            yield f"{path.relative_to(site)}: loads from a network"
    yield from _unsearched(site, pages)


def _wrong(path: Path, tag: str, address: str, pages: dict[Path, _Page]) -> str:
    parts = urlsplit(address)
    if parts.scheme in ("http", "https") or parts.netloc:
        return "loaded from a network" if tag in LOADED else ""
    if parts.scheme:
        return ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if not target.exists():
        return "there is no such file"
    anchor = unquote(parts.fragment)
    if anchor and not anchor.startswith("__") and target in pages and anchor not in pages[target].ids:
        return "there is no such place on the page"
    return ""


def _unsearched(site: Path, pages: dict[Path, _Page]) -> Iterator[str]:
    index = json.loads((site / "search/search_index.json").read_text(encoding="utf-8"))
    if not (site / "search/search_index.js").exists():
        yield "search/search_index.js: is missing, so that the search does not work from the disk"
    known = {entry["location"].partition("#")[0] for entry in index["docs"]}
    for path in pages:
        name = path.relative_to(site).as_posix()
        if name != "404.html" and name not in known:
            yield f"{name}: the search does not know it"


def main(site: str = "site") -> int:
    """Prints the problems; 1 where there are any."""
    found = list(problems(Path(site).resolve()))
    print("\n".join(found) or f"{site}: all links and pictures lead somewhere, and nothing is loaded from a network")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
