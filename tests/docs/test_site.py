"""The documentation: built without a warning, no dead link, and readable in a browser."""

import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.browser import WIDTHS, Browser, browser

ROOT = Path(__file__).parents[2]

ELSEWHERE = {"https://github.com/pradyunsg/furo"}
"""Links to other sites: the theme names itself."""


class Links(HTMLParser):
    """Links of a page, files that it loads, and its link targets."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.loads: list[str] = []
        self.names: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {key: value for key, value in attrs if value is not None}
        self.names |= {attributes[key] for key in ("id", "name") if key in attributes}
        if tag == "a" and "href" in attributes:
            self.targets.append(attributes["href"])
        else:
            self.loads += [attributes[key] for key in ("src", "href") if key in attributes]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site, built as `./run docs` builds it."""
    built = tmp_path_factory.mktemp("site")
    line = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", ROOT / "docs", built]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return built


@pytest.fixture(scope="module")
def pages(site) -> dict[Path, Links]:
    return {page: Links(page) for page in sorted(site.rglob("*.html"))}


def test_no_line_of_a_page_is_a_comment_by_mistake():
    """MyST leaves out lines that begin with a per cent sign, as text wrapped after a number may."""
    pages = [path for path in (ROOT / "docs").rglob("*.md") if path.is_file()]
    lines = [(page.name, line) for page in pages for line in page.read_text("utf-8").splitlines()]
    assert [line for line in lines if line[1].startswith("%")] == []


def test_no_field_of_a_docstring_is_left_as_text(site):
    """A section that Sphinx does not understand is printed with its field names, as ":raises X"."""
    fields = re.compile(r":(raises|param|type|returns|rtype|var|ivar)\b")
    pages = [*(site / "api").glob("*.html")]
    assert len(pages) > 5
    left = [page.name for page in pages if fields.search(page.read_text(encoding="utf-8"))]
    assert left == []


def test_every_document_is_a_page(site):
    documents = {
        page.relative_to(ROOT / "docs").with_suffix("")
        for page in (ROOT / "docs").rglob("*.md")
        if "example_capture" not in page.parts
    }
    assert len(documents) > 40
    built = {page.relative_to(site).with_suffix("") for page in site.rglob("*.html")}
    assert documents <= built


def test_no_link_is_dead(pages):
    """Every address on a page is a file of the site, and a place in it where one is named."""
    dead = [
        f"{page.name}: {address}"
        for page, links in pages.items()
        for address in (*links.targets, *links.loads)
        if not arrives(page, address, pages)
    ]
    assert dead == []


def arrives(page: Path, address: str, pages: dict[Path, Links]) -> bool:
    """Return True if the target of an address exists."""
    parts = urlsplit(address)
    if parts.scheme in ("http", "https"):
        return address in ELSEWHERE
    if parts.scheme == "data":
        return True
    target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if not target.is_file():
        return False
    name = unquote(parts.fragment)
    return not name or target not in pages or name in pages[target].names


def test_pages_load_no_file_of_other_hosts(site, pages):
    """No script, style, font or picture is loaded from another host."""
    loads = [item for links in pages.values() for item in links.loads]
    assert loads
    assert [item for item in loads if urlsplit(item).netloc] == []
    for style in site.rglob("*.css"):
        text = style.read_text(encoding="utf-8")
        assert not [item for item in ("url(http", "url(//", "@import") if item in text], style


@pytest.fixture(scope="module")
def tab(tmp_path_factory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as started:
        yield started


def test_a_browser_opens_every_page(site, pages, tab):
    """No error, no request to another host, no element wider than the window."""
    for page in pages:
        tab.open(page.as_uri())
        for width in WIDTHS:
            tab.resize(width)
            assert tab.overflow() == [], f"{page.relative_to(site)} at {width}"
        assert tab.activity.errors == [], page
        assert {urlsplit(item).scheme for item in tab.activity.requests} <= {"file", "data"}, page


@pytest.mark.parametrize("width", WIDTHS)
def test_names_of_keys_are_not_broken(site, tab, width):
    """Expected: each name on one line; a table that continues at the right has a shadow there."""
    tab.open((site / "keys.html").as_uri(), width)
    names = "[...document.querySelectorAll('article td:first-child code')]"
    heights = tab.evaluate(f"{names}.map(name => name.getBoundingClientRect().height)")
    assert len(heights) > 200
    assert max(heights) < 30
    tables = "[...document.querySelectorAll('.table-wrapper')]"
    wide = f"{tables}.filter(e => e.scrollWidth > e.clientWidth)"
    shadows = tab.evaluate(f"{wide}.map(e => getComputedStyle(e).backgroundImage)")
    assert shadows or width > 1000
    assert all("linear-gradient" in shadow for shadow in shadows)


def test_equations_are_drawn(site, tab):
    """MathML of the sheet's energy takes room: the browser has laid it out."""
    tab.open((site / "physics" / "sheet.html").as_uri())
    box = "document.querySelector('.equation math').getBoundingClientRect()"
    assert tab.evaluate(f"{box}.width") > 200
    assert tab.evaluate(f"{box}.height") > 30
