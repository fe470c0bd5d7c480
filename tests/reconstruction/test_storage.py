"""OpenCV's YAML and XML without OpenCV: its files are read, errors name the line."""

import random

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.damage import damaged_bytes
from reconstruction.errors import CaptureError, InputError
from reconstruction.rig import storage
from reconstruction.rig.calibration import read_calibration, write_calibration
from reconstruction.rig.storage import XML, YAML, numbers_in, numbers_of_tree, parse_storage

NUMBERS = st.floats(-1e30, 1e30)


def written(**values) -> str:
    storage = cv2.FileStorage(".yaml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for name, value in values.items():
        storage.write(name, value)
    return storage.releaseAndGetString()


@settings(max_examples=60, derandomize=True, deadline=None)
@given(rows=st.integers(1, 6), cols=st.integers(1, 6), data=st.data())
def test_matrices_of_opencv_come_back_with_every_digit(rows, cols, data):
    numbers = data.draw(st.lists(NUMBERS, min_size=rows * cols, max_size=rows * cols))
    matrix = np.array(numbers).reshape(rows, cols)
    single = matrix.astype(np.float32)
    result = parse_storage(written(a=matrix, b=3, c=-0.5, d="two words", e=single))
    np.testing.assert_array_equal(result["a"], matrix, strict=True)
    assert (result["b"], result["c"], result["d"]) == (3, -0.5, "two words")
    np.testing.assert_array_equal(result["e"], single)


@pytest.mark.parametrize("loader", [storage._LOADER, yaml.BaseLoader])
def test_files_written_by_hand_are_read(loader, monkeypatch):
    monkeypatch.setattr(storage, "_LOADER", loader)
    result = parse_storage(
        "%YAML:1.0\r\n---\r\n# a comment\na:\n   - { x:1, y:2. }\n"
        "   -\n      x: 3\n      y: -4e-1\n"
        'b: [ 1, [ 2, "three" ],\n    4 ]\nc:\nd: "1.5"\ne: { }\nf: []\n...\n'
    )
    assert result["a"] == [{"x": 1, "y": 2.0}, {"x": 3, "y": -0.4}]
    assert result["b"] == [1, [2, "three"], 4]
    assert (result["c"], result["d"], result["e"], result["f"]) == (None, "1.5", {}, [])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a: " + "[" * 900, "line 3: nests deeper than 32"),
        ("a: " + "{ a:" * 200, "line 3: nests deeper than 32"),
        ("".join(" " * n + "a:\n" for n in range(40)), "line 36: nests deeper than 32"),
        ("a:\n   " + "- " * 100_000 + "1", "lines of up to 200004, allowed"),
        ("".join(" " * n + "a:\n" for n in range(2000)), "is no calibration: found 20050"),
        ("a: [ 1, 2", "line 4: is no YAML: "),
        ("a: [ 1, , 2 ]", "line 3: is no YAML: "),
        ("a: [ 1 ] ]", "line 3: is no YAML: "),
        ('a: [ "b ]', "line 4: is no YAML: "),
        ("a: \0", "is no YAML: unacceptable character"),
        ("a: 1\na: 2", "line 4: the key a is there twice"),
        ("a: 1\n   b: 2", "line 4: is no YAML: "),
        ("   a: 1\nb: 2", "line 4: is no YAML: "),
        ("a: 1\n---\nb: 2", "line 4: found a second document"),
        ("a: &b 1\nc: *b", "line 4: has an alias"),
        ("? [ 1 ]\n: 2", "line 3: is no entry KEY: VALUE"),
        ("abc", "found no key"),
        ("", "found no key"),
        ("- 1", "found no key"),
        ("a: !!opencv-matrix", "line 3: a matrix needs rows, cols, dt, data"),
    ],
)
@pytest.mark.parametrize("loader", [storage._LOADER, yaml.BaseLoader])
def test_text_that_is_no_storage_is_rejected_with_its_line(content, message, loader, monkeypatch):
    """With PyYAML's C library and without it."""
    monkeypatch.setattr(storage, "_LOADER", loader)
    with pytest.raises(InputError, match=message) as caught:
        parse_storage(f"%YAML:1.0\n---\n{content}\n")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("rows: 2", "rows: 3"), "a matrix of 3 rows and 2 cols holds 4 numbers"),
        (("rows: 2", "rows: -2"), "a matrix has -2 rows"),
        (("rows: 2", "rows: 2.5"), "a matrix has 2.5 rows"),
        (("dt: d", "dt: 3d"), "a matrix of 2 rows and 2 cols of dt 3d holds 4 numbers"),
        (("dt: d", "dt: u"), "a matrix is of dt: u; write d"),
        (("1., 2.", "1., two"), "data of a matrix is no list of finite numbers"),
        (("1., 2.", "1., .Nan"), "data of a matrix is no list of finite numbers"),
        (("1., 2.", "1., 1e999"), "data of a matrix is no list of finite numbers"),
        (("   cols: 2\n", ""), "a matrix needs rows, cols, dt, data"),
    ],
)
def test_a_damaged_matrix_is_rejected_with_its_line(change, message):
    text = written(a=np.array([[1.0, 2.0], [3.0, 4.0]]))
    assert change[0] in text
    with pytest.raises(InputError, match=f"line 3: {message}"):
        parse_storage(text.replace(*change))


def test_nested_brackets_of_opencv_are_read():
    """OpenCV writes no blank between the colon and a bracket or number in brackets."""
    text = '%YAML:1.0\n---\na: { x:1, s:[ 1, 2.5 ],\n    q:{ b:-2e-07, c:"x:1" } }\n'
    assert parse_storage(text)["a"] == {"x": 1, "s": [1, 2.5], "q": {"b": -2e-07, "c": "x:1"}}


def test_points_and_vectors_are_read():
    """Points have two numbers per element (dt: 2f); OpenCV 5 stores a vector by its sizes."""
    points = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    for end in (".yml", ".xml"):
        storage = cv2.FileStorage(end, cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
        storage.write("points", points)
        storage.write("t", np.array([1.0, 2.0, 3.0]))
        tree = parse_storage(storage.releaseAndGetString(), (YAML, XML))
        np.testing.assert_array_equal(tree["points"], points)
        np.testing.assert_array_equal(numbers_of_tree(tree)["t"].ravel(), [1.0, 2.0, 3.0])


def test_whole_numbers_of_whole_types_are_taken():
    text = written(a=np.array([[480, 640]], np.int32))
    np.testing.assert_array_equal(parse_storage(text)["a"], [[480.0, 640.0]])


@settings(max_examples=40, derandomize=True, deadline=None)
@given(numbers=st.lists(NUMBERS, min_size=1, max_size=12))
def test_xml_has_the_content_of_yaml(numbers):
    values = {"a": np.array([numbers]), "b": 3, "c": -0.5, "d": "word"}
    storage = cv2.FileStorage(".xml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    for name, value in values.items():
        storage.write(name, value)
    of_xml = parse_storage(storage.releaseAndGetString(), (XML,))
    of_yaml = parse_storage(written(**values))
    np.testing.assert_array_equal(of_xml.pop("a"), of_yaml.pop("a"), strict=True)
    assert of_xml == of_yaml


def test_every_number_is_found_by_its_path(tmp_path):
    (tmp_path / "x.yml").write_text("%YAML:1.0\n---\na:\n   b: 2\n   c: [ 1, 2.5 ]\nd: word\n")
    result = numbers_in(tmp_path / "x.yml")
    assert {name: values.tolist() for name, values in result.items()} == {
        "a/b": 2.0,
        "a/c": [1.0, 2.5],
    }


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<a>1", "is damaged XML: "),
        ("<s><a>1</a><a>2</a></s>", "element s: a name is there twice"),
        ("<a>" * 40 + "1" + "</a>" * 40, "elements nest deeper than 32"),
        ("<s><a type_id='opencv-matrix'><rows>1</rows></a></s>", "element a: a matrix needs rows"),
        (
            "<!DOCTYPE s [<!ENTITY a '&b;'><!ENTITY b '&a;'>]><s>&a;</s>",
            "is damaged XML: recursive",
        ),
        ("<s>1</s>", "found no key"),
    ],
)
def test_damaged_xml_is_rejected_in_one_line(content, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_storage(f'<?xml version="1.0"?>\n{content}\n', (YAML, XML))
    assert "\n" not in str(caught.value)


def test_entities_do_not_grow_without_end():
    entities = "".join(f"<!ENTITY e{i} '{f'&e{i - 1};' * 10}'>\n" for i in range(1, 12))
    text = (
        f'<?xml version="1.0"?>\n<!DOCTYPE s [<!ENTITY e0 "aaaaaaaaaa">\n{entities}]>\n<s>&e11;</s>'
    )
    with pytest.raises(InputError, match="is damaged XML: "):
        parse_storage(text, (XML,))


def test_a_damaged_calibration_is_read_or_rejected_without_opencv(
    tmp_path, calibration, monkeypatch
):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration)
    monkeypatch.setattr(cv2, "FileStorage", lambda *_: pytest.fail("OpenCV was asked"))
    whole, messages = path.read_bytes(), []
    for seed in range(400):
        path.write_bytes(damaged_bytes(whole, random.Random(seed))[0])
        try:
            read_calibration(path)
        except CaptureError as error:
            messages.append(str(error))
    assert len(messages) > 200
    assert all(line.startswith(str(path)) and "\n" not in line for line in messages)
