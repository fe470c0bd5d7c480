"""Metadata of the package: one version, known classifiers, no licence without a decision."""

import tomllib
from importlib import metadata
from pathlib import Path

import trove_classifiers
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


def test_one_version_everywhere():
    assert PROJECT["version"] == CITATION["version"] == metadata.version("fringe-twin")


def test_one_set_of_keywords():
    assert PROJECT["keywords"] == CITATION["keywords"]


def test_classifiers_exist():
    assert set(PROJECT["classifiers"]) <= trove_classifiers.classifiers


def test_no_licence_is_invented():
    """The owner has chosen none: README states that, and no other file names a licence."""
    assert "license" not in PROJECT
    assert "license" not in CITATION
    assert not any(item.startswith("License") for item in PROJECT["classifiers"])
    assert "**Licence: none has been chosen by the owner yet.**" in (ROOT / "README.md").read_text()
    assert not list(ROOT.glob("LICEN[CS]E*"))


def test_the_paper_is_cited_by_its_title():
    """As scenes/paper/targets.toml names it."""
    (paper,) = CITATION["references"]
    comment = (ROOT / "scenes" / "paper" / "targets.toml").read_text(encoding="utf-8")
    words = " ".join(line.removeprefix("#").strip() for line in comment.splitlines()[:3])
    assert paper["title"] in words
    assert f"({', '.join(item['family-names'] for item in paper['authors'])})" in words
