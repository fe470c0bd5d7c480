import imageio.v3 as imageio
import numpy as np
import pytest

from reconstruction.capture.description import file_names, read_manifest, write_patterns
from reconstruction.errors import CaptureError
from reconstruction.patterns import PatternSet

SETS = [
    PatternSet(64, 36),
    PatternSet(64, 36, period_px=8.0, steps=3, code="shifted_gray", low_level=9),
    PatternSet(64, 36, 9.3, 4, code="hierarchical", further_periods_px=(70.0,)),
]


@pytest.mark.parametrize("patterns", SETS, ids=lambda patterns: patterns.code)
def test_images_and_manifest_are_the_pattern_set(tmp_path, patterns):
    """Expected: the files are the images of the decoder, in the order of projection."""
    write_patterns(tmp_path, patterns)
    assert read_manifest(tmp_path) == read_manifest(tmp_path / "patterns.toml") == patterns
    result = sorted(path.name for path in tmp_path.glob("*.png"))
    assert tuple(result) == file_names(patterns)
    for name, frame in zip(result, patterns.frames, strict=True):
        image = imageio.imread(tmp_path / name)
        assert image.dtype == np.uint8
        np.testing.assert_array_equal(image, patterns.image(frame))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"fringe-patterns"', '"other"', "this program reads"),
        ("steps = 18", "steps = 17", "do not name the 41 images"),
        ("steps = 18", "stepps = 18", "stepps"),
        ("[patterns]", "[pattern]", "missing"),
        ("[patterns]", "[patterns", "TOML"),
    ],
)
def test_damaged_manifests_are_rejected(tmp_path, old, new, message):
    write_patterns(tmp_path, SETS[0])
    path = tmp_path / "patterns.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(CaptureError, match=message):
        read_manifest(path)
