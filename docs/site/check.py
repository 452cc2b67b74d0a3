"""Checks the links of the built site: within it each must lead somewhere, its anchor included.

An external link fails only where its server says that there is nothing (404, 410). Those that no answer came
from, as where there is no network, are counted.

python docs/site/check.py build/site
"""

from __future__ import annotations

import sys
import urllib.error
import urllib.request
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

SECONDS = 10.0
GONE = (404, 410)
APART = ("_downloads", "_modules")
"""Files of the repository, and source code that viewcode links to names which have no entry."""


class Page(HTMLParser):
    """Links of a page, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take ``href``, ``src`` and ``id``."""
        for name, value in attrs:
            if value and name in ("href", "src"):
                self.links.add(value)
            elif value and name == "id":
                self.anchors.add(value)


def broken(site: Path, pages: dict[Path, Page]) -> list[str]:
    """Links within the site that lead nowhere, each with its page."""
    found = []
    for path, page in pages.items():
        for link in page.links:
            target, anchor = urldefrag(link)
            if ":" in target.partition("/")[0]:
                continue
            name = unquote(target.partition("?")[0])  # Sphinx marks its own files by ?v=
            there = (path.parent / name).resolve() if name else path
            if not there.exists() or (
                anchor and there in pages and unquote(anchor) not in pages[there].anchors
            ):
                found.append(f"{path.relative_to(site)}: {link}")
    return sorted(found)


def answer(url: str) -> int | None:
    """Status that the server gives; None where no server answered."""
    request = urllib.request.Request(url, headers={"User-Agent": "calstudy-docs"})
    try:
        with urllib.request.urlopen(request, timeout=SECONDS) as reply:
            return int(reply.status)
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return None


def main(site: Path) -> int:
    """Print what is broken; 1 if anything is."""
    site = site.resolve()
    pages = {
        path: Page(path.read_text())
        for path in sorted(site.rglob("*.html"))
        if path.relative_to(site).parts[0] not in APART
    }
    wrong = broken(site, pages)
    outside: dict[str, str] = defaultdict(str)
    for path, page in pages.items():
        outside |= {urldefrag(u)[0]: str(path.relative_to(site)) for u in page.links if u.startswith("http")}
    with ThreadPoolExecutor(8) as pool:
        answers = dict(zip(outside, pool.map(answer, outside), strict=True))
    wrong += [f"{outside[url]}: {url} answers {code}" for url, code in answers.items() if code in GONE]
    print("\n".join(wrong))
    silent = sum(code is None for code in answers.values())
    print(
        f"{len(pages)} pages, {len(outside)} external links ({silent} without an answer), {len(wrong)} broken"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
