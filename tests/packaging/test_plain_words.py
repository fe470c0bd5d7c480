"""The rate of everyday words in the prose is at most 3 per 1000 and rises in no folder.

Prose is docstrings, comments, messages and Markdown. In the prose of scipy, xarray, dask,
scikit-learn, optuna, trimesh, scikit-fem and matplotlib the rate of these words is 0.98 per 1000.
`python -m tests.packaging.test_plain_words` records the rates, rounded up, at least 1.
"""

import json
import math
import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
RECORD = Path(__file__).with_name("everyday_words.json")
MOST_PER_1000 = 3.0
LEAST_WORDS = 300  # of a folder that is judged: in fewer words one occurrence decides
SPARE_WORDS = 2  # more than the recorded rate allows: a word such as "nothing" may be the right one
STRING = r"'{3}.*?'{3}" r'|"""(?:[^\\]|\\.)*?"""|"(?:[^"\\\n]|\\.)*"' r"|'(?:[^'\\\n]|\\.)*'"
PARTS = re.compile(rf"#[^\n]*|\bf(?:{STRING})|{STRING}", re.DOTALL)
"""Comments and strings of Python: a string ends at the first quote without a backslash."""


def prose(path: Path) -> str:
    """Return the prose of a file: of Python its comments and strings of four words and more."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return "\n".join(_strings_and_comments(text)) if path.suffix == ".py" else text


def _strings_and_comments(text: str) -> Iterator[str]:
    """Yield them without escapes and replacement fields: ast and tokenize take 30 times as long."""
    for part in PARTS.findall(text):
        fields = r"\\.|\{[^{}]*\}" if part.startswith("f") else r"\\."
        plain = re.sub(fields, " ", part)
        if plain.startswith("#") or plain.count(" ") >= 3:
            yield plain


def words_of(text: str) -> list[str]:
    """Return the words outside code, formulas and addresses."""
    plain = re.sub(r"`[^`\n]*`|\$[^$\n]*\$|https?\S+", " ", text.lower())
    return re.findall(r"[a-z]+(?:'[a-z]+)?", plain)


def folder_of(name: str) -> str:
    """Return the folder that a file is counted in: two levels deep."""
    parts = name.split("/")[:-1]
    return "/".join(parts[:2]) or "."


@cache
def record() -> dict[str, Any]:
    """Return the everyday words, and the largest rate allowed in each folder."""
    return dict(json.loads(RECORD.read_text(encoding="utf-8")))


@cache
def everyday_words() -> frozenset[str]:
    """Return the words that are counted."""
    return frozenset(record()["words"])


@cache
def counts() -> dict[str, tuple[int, int]]:
    """Return everyday words and all words of each folder under version control."""
    command = ["git", "ls-files", "*.py", "*.md", "*.toml"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no version control on this machine: files of the project are not listed")
    everyday: Counter[str] = Counter()
    words: Counter[str] = Counter()
    for name in listed.stdout.split():
        if (ROOT / name).is_file() and not name.endswith(Path(__file__).name):
            text = words_of(prose(ROOT / name))
            words[folder_of(name)] += len(text)
            everyday[folder_of(name)] += sum(word in everyday_words() for word in text)
    return {folder: (everyday[folder], words[folder]) for folder in words}


def rates() -> dict[str, float]:
    """Return everyday words per 1000 words of each folder that has enough words."""
    return {
        folder: 1000 * everyday / words
        for folder, (everyday, words) in sorted(counts().items())
        if words >= LEAST_WORDS
    }


def test_everyday_words_are_rare():
    everyday, words = (sum(count) for count in zip(*counts().values(), strict=True))
    assert 1000 * everyday / words <= MOST_PER_1000


def test_no_folder_gets_more_everyday_words():
    for folder, rate in rates().items():
        everyday, words = counts()[folder]
        most = record()["most_per_1000"].get(folder, MOST_PER_1000)
        message = f"{folder}: found {rate:.2f} per 1000 words, allowed {most}"
        assert everyday <= most * words / 1000 + SPARE_WORDS, message


def test_words_are_counted_outside_code_only():
    assert words_of("What `lies` is $told$: nothing.") == ["what", "is", "nothing"]
    text = '"""Return what lies beside it."""\nname = "told"  # nothing else\n'
    words = [word for part in _strings_and_comments(text) for word in words_of(part)]
    assert [word for word in words if word in everyday_words()] == [
        "what",
        "lies",
        "beside",
        "nothing",
    ]


if __name__ == "__main__":
    bounds = {folder: max(1.0, math.ceil(10 * rate) / 10) for folder, rate in rates().items()}
    content = record() | {"most_per_1000": bounds}
    RECORD.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
