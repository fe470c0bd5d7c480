"""Fenced blocks and command lines of README and documentation."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md")))
_FENCE = re.compile(r"(`{3,})(.*)")
_CAPTION = re.compile(r":caption: (\S+)\n")


@dataclass(frozen=True)
class Block:
    """One fenced block: its page, language, caption (a file name) and text."""

    page: str
    language: str
    caption: str
    text: str

    @property
    def name(self) -> str:
        """Page and first line, which identify the block."""
        return f"{self.page}: {self.text.splitlines()[0].strip()}"


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page, except the directives of Sphinx without own text."""
    blocks, fence, head, lines = [], "", "", list[str]()
    for line in page.read_text(encoding="utf-8").splitlines():
        opened = _FENCE.match(line.lstrip())
        if not fence and opened:
            fence, head, lines = opened[1], opened[2].strip(), []
        elif fence and line.strip() == fence:
            blocks.append(_block(page, head, "\n".join(lines) + "\n"))
            fence = ""
        elif fence:
            lines.append(line)
    return [block for block in blocks if not block.language.startswith("{")]


def _block(page: Path, head: str, text: str) -> Block:
    caption = _CAPTION.match(text)
    language = head.removeprefix("{code-block} ")
    name = page.relative_to(ROOT).as_posix()
    return Block(name, language, caption[1] if caption else "", _CAPTION.sub("", text, count=1))


def command_lines() -> Iterator[tuple[str, list[str]]]:
    """Yield page and words of each command line of `twin`, in fenced and in indented blocks."""
    for page in PAGES:
        lines = [line for block in blocks(page) for line in block.text.splitlines()]
        text = page.read_text(encoding="utf-8")
        lines += [line.strip() for line in text.splitlines() if line.startswith("    twin ")]
        for line in lines:
            if line.startswith("twin "):
                yield page.relative_to(ROOT).as_posix(), shlex.split(line, comments=True)[1:]
