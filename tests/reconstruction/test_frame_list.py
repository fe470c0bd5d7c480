"""Lists of frames: the pattern of each image, in layouts of public sets and programs.

Oracle: the frames of a `PatternSet` written under foreign names in a foreign order; the list must
give back that set, and every image in its place.
"""

import numpy as np
import pytest

from reconstruction.capture.frame_list import read_listed
from reconstruction.errors import CaptureError
from reconstruction.patterns import PatternSet
from tests.reconstruction.conftest import LIST_HEAD

SIZE = {"width_px": 160, "height_px": 96}


def listed(folder, names, groups, top=""):
    """Write images (content: position of the name) and the list; return the order found."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    text = LIST_HEAD.format(top=top) + "".join(f"\n[[frames]]\n{group}\n" for group in groups)
    (folder / "capture.toml").write_text(text)
    return read_listed(folder / "capture.toml").recorded(folder)


def names_of(result, folder):
    return [[path.relative_to(folder).as_posix() for path in files] for files in result.files]


def test_three_steps_and_plain_gray_along_columns_only(tmp_path):
    """Names as of many public sets: 1.bmp to 3.bmp are the fringes, then the bits, no white."""
    names = [f"{n}.bmp" for n in range(1, 8)]
    result = listed(tmp_path, names, [
        'files = "{1..3}.bmp"\nkind = "phase"\naxis = "column"\nperiod_px = 16\nshift_deg = -120.0',
        'files = "{4..7}.bmp"\nkind = "gray"\naxis = "column"',
    ])  # fmt: skip
    expected = PatternSet(**SIZE, period_px=16.0, steps=3, code="gray", axes=("column",),
                          uniform=False)  # fmt: skip
    assert result.patterns == expected
    # The shifts were -120, 0 and 120 degrees: the second image is step 0.
    assert names_of(result, tmp_path) == [
        ["2.bmp", "3.bmp", "1.bmp", "4.bmp", "5.bmp", "6.bmp", "7.bmp"]
    ]


def test_pairs_of_gray_frames_one_after_the_other(tmp_path):
    """Names as OpenCV's structured_light module numbers them: bit, inverse, bit, ..., then rows."""
    names = [f"pattern_cam1_im{n}.png" for n in range(1, 33)]
    result = listed(tmp_path, names, [
        'files = "pattern_cam1_im{1..16}.png"\nkind = "gray_and_inverse"\naxis = "column"\n'
        "period_px = 1",
        'files = "pattern_cam1_im{17..30}.png"\nkind = "gray_and_inverse"\naxis = "row"\n'
        "period_px = 1",
        'files = "pattern_cam1_im31.png"\nkind = "white"',
        'files = "pattern_cam1_im32.png"\nkind = "black"',
    ])  # fmt: skip
    assert result.patterns == PatternSet(**SIZE, steps=0, period_px=1.0, code="gray", inverse=True)
    column = [f"pattern_cam1_im{n}.png" for n in (*range(1, 17, 2), *range(2, 17, 2))]
    row = [f"pattern_cam1_im{n}.png" for n in (*range(17, 31, 2), *range(18, 31, 2))]
    uniform = ["pattern_cam1_im31.png", "pattern_cam1_im32.png"]
    assert names_of(result, tmp_path) == [[*column, *row, *uniform]]


def test_bits_finer_than_the_fringes_need_are_left_out(tmp_path):
    """Eight bits down to one pixel with fringes of 16 px: five number the half-periods safely."""
    names = [f"ph{n}.tif" for n in range(4)] + [f"g{n}.tif" for n in range(8)]
    result = listed(tmp_path, names, [
        'files = "ph?.tif"\nkind = "phase"\naxis = "column"\nperiod_px = 16',
        'files = "g?.tif"\nkind = "gray"\naxis = "column"\nperiod_px = 1\nbits = "fine_first"',
    ])  # fmt: skip
    assert result.patterns.code == "complementary_gray"
    gray = [f"g{n}.tif" for n in (7, 6, 5, 4, 3)]
    assert names_of(result, tmp_path)[0][4:] == gray


def test_coarse_bits_of_a_larger_image_are_left_out(tmp_path):
    names = [f"g{n}.png" for n in range(11)] + ["w.png", "b.png"]
    result = listed(tmp_path, names, [
        'files = "g*.png"\nkind = "gray"\naxis = "column"\nperiod_px = 1',
        'files = "w.png"\nkind = "white"',
        'files = "b.png"\nkind = "black"',
    ])  # fmt: skip
    assert names_of(result, tmp_path)[0] == [f"g{n}.png" for n in range(3, 11)] + ["w.png", "b.png"]


def test_three_frequencies_in_folders_and_a_period_per_axis(tmp_path):
    """Falling periods, shifts that are subtracted, rows finer than columns."""
    periods = {"column": (200.0, 50.0, 20.0), "row": (100.0, 40.0, 12.0)}
    groups, names = [], []
    for axis, values in periods.items():
        for k, period in enumerate(values):
            names += [f"{axis}/freq{k}/I_{n}.png" for n in range(1, 5)]
            groups.append(
                f'files = "{axis}/freq{k}/I_*.png"\nkind = "phase"\naxis = "{axis}"\n'
                f"period_px = {period}\nsign = -1"
            )
    result = listed(tmp_path, names, groups)
    assert result.patterns == PatternSet(
        **SIZE, period_px=20.0, steps=4, code="hierarchical", further_periods_px=(50.0, 200.0),
        row_periods_px=(12.0, 40.0, 100.0), uniform=False,
    )  # fmt: skip
    # Backwards: -0, -90, -180, -270 degrees; sorted: 0, 90 (the last), 180, 270.
    assert names_of(result, tmp_path)[0][:4] == [f"column/freq2/I_{n}.png" for n in (1, 4, 3, 2)]


def test_two_near_periods_are_heterodyne(tmp_path):
    names = [f"{k}_{n}.png" for k in (15, 14) for n in range(3)]
    result = listed(tmp_path, names, [
        f'files = "{k}_?.png"\nkind = "phase"\naxis = "row"\nperiod_px = {k}' for k in (15, 14)
    ])  # fmt: skip
    assert result.patterns.code == "heterodyne"
    assert result.patterns.periods_px == (14.0, 15.0)


def test_single_images_of_near_periods_are_micro_phase_shifting(tmp_path):
    """Of one period three steps, of the others one each with a shift of its own, in any order."""
    names = [f"m{k}.png" for k in range(6)]
    result = listed(tmp_path, names, [
        'files = "m0.png"\nkind = "phase"\naxis = "column"\nperiod_px = 20.4\nshift_deg = 90',
        'files = "m{1..3}.png"\nkind = "phase"\naxis = "column"\nperiod_px = 18',
        'files = "m4.png"\nkind = "phase"\naxis = "column"\nperiod_px = 16.45',
        'files = "m5.png"\nkind = "phase"\naxis = "column"\nperiod_px = 15.5',
    ])  # fmt: skip
    assert result.patterns == PatternSet(
        **SIZE, period_px=18.0, steps=3, code="micro", further_periods_px=(15.5, 16.45, 20.4),
        axes=("column",), uniform=False, first_shifts_deg=(0.0, 0.0, 0.0, 90.0),
    )  # fmt: skip
    assert names_of(result, tmp_path) == [
        ["m1.png", "m2.png", "m3.png", "m5.png", "m4.png", "m0.png"]
    ]


def test_stated_shifts_in_any_order_and_a_sine(tmp_path):
    """sin(a + s) = cos(a + s - 90): three steps keep a first shift of 30 degrees."""
    names = [f"p{n}.png" for n in range(3)]
    result = listed(tmp_path, names, [
        'files = "p?.png"\nkind = "phase"\naxis = "row"\nperiod_px = 96\n'
        "shift_deg = [150.0, 30.0, -90.0]",
    ])  # fmt: skip
    assert result.patterns.first_shifts_deg == (30.0,)
    assert names_of(result, tmp_path) == [["p1.png", "p0.png", "p2.png"]]
    np.testing.assert_allclose(result.patterns.shifts("row", 0), [1 / 12, 5 / 12, 9 / 12])


def test_both_words_of_the_shifted_code(tmp_path):
    expected = PatternSet(**SIZE, period_px=16.0, steps=3, code="shifted_gray", axes=("column",))
    names = [f"{frame.name}.png" for frame in expected.frames]
    result = listed(tmp_path, names, [
        'files = "phase*.png"\nkind = "phase"\naxis = "column"\nperiod_px = 16',
        'files = "gray_column_{00..03}.png"\nkind = "gray"\naxis = "column"',
        'files = "gray_column_{04..07}.png"\nkind = "gray"\naxis = "column"\nshifted = true',
        'files = "white.png"\nkind = "white"',
        'files = "black.png"\nkind = "black"',
    ])  # fmt: skip
    assert result.patterns == expected
    assert names_of(result, tmp_path) == [names]


def test_exposures_are_sets_of_their_own(tmp_path):
    names = [f"{ms}ms_{n}.png" for ms in (2, 8) for n in range(3)]
    result = listed(tmp_path, names, [
        f'files = "{ms}ms_?.png"\nkind = "phase"\naxis = "column"\nperiod_px = 160\n'
        f"exposure_ms = {ms}" for ms in (8, 2)
    ])  # fmt: skip
    assert result.exposures_ms == (2.0, 8.0)
    assert names_of(result, tmp_path) == [names[:3], names[3:]]


FRINGES = 'files = "p*.png"\nkind = "phase"\naxis = "column"\nperiod_px = 16'
BITS = 'files = "g*.png"\nkind = "gray"\naxis = "column"'
NAMES = [f"p{n}.png" for n in range(4)] + [f"g{n}.png" for n in range(4)]


@pytest.mark.parametrize(
    ("names", "groups", "message"),
    [
        (NAMES[1:], [FRINGES + "\nsteps = 4", BITS], "finds 3 phase images, stated are 4 steps"),
        (NAMES[:-2], [FRINGES, BITS], "there are 2 Gray frames; fringes of 16 px need 4, or 5"),
        (NAMES, [FRINGES, BITS.replace("g*", "g{0..4}")], "1 of 5 gray images are missing: g4.png"),
        (NAMES, [FRINGES, BITS.replace("g*", "h*")], "finds 0 images"),
        (NAMES, [FRINGES], "without a word or period that numbers its fringes"),
        (NAMES, [FRINGES, BITS, BITS.replace("gray", "inverse")], "g0.png is listed twice"),
        (NAMES, [FRINGES, BITS, FRINGES.replace("p*", "g?")], "both listed as phase along column"),
        (NAMES, [FRINGES + "\nshift_deg = [0, 90, 180, 190]", BITS], "no 4 equal steps"),
        (NAMES, [FRINGES + "\nshift_deg = [0, 90]", BITS], "stated are 2 shifts"),
        (NAMES, [FRINGES, BITS + "\nperiod_px = 24"], "words must be as wide as a fringe"),
        (NAMES[:6], [FRINGES, BITS + "\nperiod_px = 16"], "the 160 px need 4 frames"),
        (NAMES, [FRINGES, BITS + "\nbit = [0, 1, 3, 4]"], r"bits \[2\] are missing"),
        (NAMES, [FRINGES, BITS + "\nbit = 2"], "finds 4 bits, bit names 1"),
        (NAMES[:7], [FRINGES, BITS.replace('"gray"', '"gray_and_inverse"')], "an odd number"),
        (NAMES, [FRINGES.replace("column", "row"), BITS], "there are 0 fringe periods"),
        (NAMES, [FRINGES.replace('axis = "column"', ""), BITS], "allowed are column and row"),
        (NAMES, [FRINGES.replace("period_px = 16", ""), BITS], "period_px .* is missing"),
        (NAMES, [BITS], "period_px of the Gray frames along column is missing"),
        (NAMES, [BITS + "\nperiod_px = 16"], "nothing to compare the bits with"),
        (NAMES, [FRINGES + "\nsign = 2", BITS], "allowed are 1 and -1"),
        (NAMES, [FRINGES, BITS + "\nperiod_px = 1e-300"], "period_px is 1e-300"),
        (NAMES, [FRINGES, BITS + "\nperiod_px = true"], "period_px is True"),
        (NAMES, [FRINGES + '\nshift_deg = "none"', BITS], "shift_deg is 'none'"),
        (NAMES, [FRINGES, BITS + "\nbit = [[1], 2, 3, 4]"], "bit is"),
        (NAMES, [FRINGES.replace('"p*.png"', "[3]"), BITS], "give a name or a list of names"),
        (NAMES, [FRINGES.replace('"phase"', "['phase']"), BITS], "kind is"),
        (NAMES, [FRINGES.replace('"column"', "3"), BITS], "axis of kind 'phase' is 3"),
        (NAMES, [FRINGES + "\nsteps = 4\nstep = 1", BITS], "unknown key step"),
        (NAMES, [FRINGES.replace("p*", "../p*"), BITS], r"without \.\. or \*\*"),
        (NAMES, [FRINGES.replace("p*", "{0..9999999}"), BITS], "give up to 4096"),
        (NAMES, ['files = "p0.png"\nkind = "white"'], "no frame along column or row"),
        (NAMES, [FRINGES, BITS, 'files = "g*.png"\nkind = "black"'], "finds 4 black images"),
    ],
)
def test_mistakes_are_one_line(tmp_path, names, groups, message):
    with pytest.raises(CaptureError, match=message) as caught:
        listed(tmp_path, names, groups)
    assert "\n" not in str(caught.value)
    assert "capture.toml" in str(caught.value)


def test_one_shifted_word_numbers_fringes(tmp_path):
    """Shown as a word displaced by half a period; without fringes there is no half to speak of."""
    patterns = PatternSet(**SIZE, period_px=20, steps=3, code="displaced_gray", axes=("column",),
                          uniform=False)  # fmt: skip
    assert patterns.word_bits("column") == 3
    names = [f"{frame.name}.png" for frame in patterns.frames]
    bits = 'files = "gray_*"\nkind = "gray"\naxis = "column"\nshifted = true\nperiod_px = 20'
    fringes = 'files = "phase_*"\nkind = "phase"\naxis = "column"\nperiod_px = 20'
    result = listed(tmp_path, names, [fringes, bits])
    assert result.patterns == patterns
    assert [path.name for path in result.files[0]] == names
    with pytest.raises(CaptureError, match="no words as wide as the fringes"):
        listed(tmp_path, names, [bits])


@pytest.mark.parametrize(
    ("top", "message"),
    [
        ('channel = "cyan"', "channel is 'cyan'"),
        ('word = "grey"', "word is 'grey'"),
        ('files = "*.png"', "unknown key files"),
    ],
)
def test_mistakes_outside_the_list_are_one_line(tmp_path, top, message):
    with pytest.raises(CaptureError, match=message):
        listed(tmp_path, NAMES, [FRINGES, BITS], top)


@pytest.mark.parametrize(
    ("find", "replace", "message"),
    [
        ("width_px = 160", 'width_px = "wide"', "width_px is 'wide'"),
        ("width_px = 160", "width_px = 0", "width_px is 0"),
        ("height_px = 96", "", "missing in projector: height_px"),
        ("[projector]", "frames = []\n[projector]", "no list of tables"),
        ("[projector]", "frames = [1]\n[projector]", "no list of tables"),
        ("saturation_dn = 255.0", "saturation_dn = 300.0", "8 bits end at 255"),
    ],
)
def test_damaged_lists_are_one_line(tmp_path, find, replace, message):
    text = LIST_HEAD.format(top="").replace(find, replace)
    text += "" if "frames" in replace else f"\n[[frames]]\n{FRINGES}\n"
    (tmp_path / "capture.toml").write_text(text)
    with pytest.raises(CaptureError, match=message) as caught:
        read_listed(tmp_path / "capture.toml")
    assert "\n" not in str(caught.value)
