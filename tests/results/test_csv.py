"""Tables as CSV: values that a reader gets back, and cells that a spreadsheet must not run."""

import csv
import io

from twin.results.parts import csv_text, write_rows

ROWS = [
    {"pose": "a,b", "rms": 0.1 + 0.2, "left_out": 3},
    {"pose": 'he said "so"', "rms": None, "left_out": 0},
    {"pose": "=1+1", "rms": -0.5, "left_out": -2},
    {"pose": "two\nlines", "rms": 1e-9, "left_out": 1},
]
NAMES = ["pose", "rms", "left_out"]


def test_every_digit_and_every_sign_comes_back():
    head, *rows = csv.reader(io.StringIO(csv_text(NAMES, ROWS)))
    assert head == NAMES
    assert [row[0] for row in rows] == ["a,b", 'he said "so"', "'=1+1", "two\nlines"]
    assert [row[1] for row in rows] == ["0.30000000000000004", "", "-0.5", "1e-09"]
    assert [row[2] for row in rows] == ["3", "0", "-2", "1"]


def test_text_that_begins_like_a_formula_is_marked_numbers_are_not():
    texts = ["=a", "+a", "-a", "@a", "\ta", "\ra", "a\rb", "a=", "'=", ""]
    (_, *rows) = csv.reader(io.StringIO(csv_text(["x"], [{"x": text} for text in texts]), ""))
    assert [row[0] if row else "" for row in rows] == [
        *("'=a", "'+a", "'-a", "'@a", "'\ta", " a"),
        *("a b", "a=", "'=", ""),
    ]


def test_a_file_has_the_digits_asked_for(tmp_path):
    write_rows(tmp_path / "x.csv", ROWS[:1], 3)
    assert (tmp_path / "x.csv").read_bytes() == b'pose,rms,left_out\n"a,b",0.3,3\n'
