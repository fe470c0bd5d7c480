"""Every sequence of the decoder can be projected: frames from light tables are decoded again.

Setup: camera pixels at known projector coordinates with the light of the tables, gamma 1.
Oracle: the coordinate itself. the error of 8-bit levels is 0.3 of 190 levels, that of blur is less.
"""

from dataclasses import fields

import numpy as np
import pytest

from reconstruction.codes import CODES
from reconstruction.decoding import PhaseReference
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.patterns import PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise
from twin.config import load_experiment
from twin.config.digest import content_digest
from twin.config.models import Patterns
from twin.config.schema import validated
from twin.optics.light import OVERSAMPLING, along, light_tables, pattern_set
from twin.pipeline.fringes import decoding_warnings
from twin.results.bound import has_bound

FRINGES = {
    "heterodyne": {"period_px": 14.0, "further_periods_px": [15.0]},
    "hierarchical": {"period_px": 16.0, "further_periods_px": [64.0, 200.0]},
    "micro": {"period_px": 14.0, "further_periods_px": [12.1, 13.0, 15.9, 16.4]},
}
EXTRA = [
    {},
    {"row_periods_px": [12.0]},
    {"axes": ["column"]},
    {"axes": ["row"]},
    {"inverse": True},
    {"uniform": False},
    {"first_shifts_deg": [40.0, -75.0]},
    {"low_level": 40, "high_level": 230},
]
OF_GRAY = [
    {"word": "binary"},
    {"word": "xor_02"},
    {"word": "xor_04", "inverse": True},
    {"steps": 0, "period_px": 2.0},
    {"steps": 0, "period_px": 4.0, "word": "binary", "inverse": True, "uniform": False},
]


def fitting(code, extra):
    """Return an extra field for all periods of a code; None if the code has no such field."""
    periods = FRINGES.get(code, {"period_px": 16.0})
    count = 1 + len(periods.get("further_periods_px", []))
    if "inverse" in extra and (count > 1 or code == "spatial"):
        return None
    if "row_periods_px" in extra and count > 1:
        every = [periods["period_px"], *periods["further_periods_px"]]
        return {"row_periods_px": [0.9 * every[0], *every[1:]]} if code == "hierarchical" else None
    if "first_shifts_deg" in extra:
        return {"first_shifts_deg": (extra["first_shifts_deg"] * count)[: 2 * count]}
    return extra


CASES = [
    {"code": code, "steps": 4} | FRINGES.get(code, {"period_px": 16.0}) | chosen
    for code in CODES.names()
    for extra in EXTRA + (OF_GRAY if code == "gray" else [])
    if (chosen := fitting(code, extra)) is not None
]


@pytest.fixture(scope="module")
def projector():
    size = {"projector.width_px": 160, "projector.height_px": 100}
    sharp = {"projector.gamma": 1.0, "projector.blur_px": 0.4}
    return load_experiment("examples/slab_balls", size | sharp).projector


def frames_at(patterns, projector, column_px, row_px):
    """Return frames (frame, row, col) float32 DN of pixels at (row, col) coordinates."""
    tables = light_tables(projector, patterns)
    stack = np.zeros((len(patterns.frames), row_px.size, column_px.size), np.float32)
    for axis, table in tables.items():
        at_px = row_px[:, None] if axis == "row" else column_px[None, :]
        nodes_px = table.first_px + np.arange(len(table.profiles)) / OVERSAMPLING
        for place, k in enumerate(table.frames):
            light = np.interp(at_px, nodes_px, table.profiles[:, place].astype(np.float64))
            stack[k] = 200.0 * light
    assert {along(frame) for frame in patterns.frames} <= set(tables)
    return stack


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case.values())))
def test_projected_codes_are_decoded(projector, case):
    table = {"period_px": 16.0} | case
    patterns = pattern_set(projector, validated(Patterns, table))
    column_px, row_px = np.linspace(1.2, 158.1, 400), np.linspace(1.3, 98.2, 120)
    stack = frames_at(patterns, projector, column_px, row_px)
    marked = PhaseReference(((0.0, 0.0, column_px[0], row_px[0]),))
    reference = None if patterns.kind.numbers_pixels else marked
    options = DecodeOptions(filter_taps=0, max_order_error=0.5, reference=reference)
    decoded = decode(stack, patterns, SensorNoise(0.01, 0.0, 0.0, 255.0), options)
    # A word displaced by half a period in as few bits as possible has undecided ends.
    assert decoded.valid.mean() > 0.8
    width_px = 0.5 * patterns.period_px + 0.5 if patterns.steps == 0 else 0.05
    for axis, truth_px in (("column", column_px[None, :]), ("row", row_px[:, None])):
        if axis in patterns.axes:
            error_px = (getattr(decoded, axis).coordinate_px - truth_px)[decoded.valid]
            assert np.max(np.abs(error_px)) < width_px


@pytest.mark.parametrize(
    "case",
    [
        {"stepping": "quarter_pairs", "steps": 8},
        {"stepping": "cyclic", "steps": 6},
        {"stepping": "single", "steps": 1},
        {"waveform": "square", "steps": 4, "first_shifts_deg": (11.25, 11.25)},
    ],
    ids=lambda case: case.get("stepping", "square"),
)
def test_projected_steppings_are_decoded(projector, case):
    """Expected: 0.05 px, also for square fringes if blur and response are stated."""
    is_square = "waveform" in case
    blurred = projector.model_copy(update={"blur_px": 2.0 if is_square else 0.4})
    patterns = pattern_set(blurred, validated(Patterns, {"period_px": 16.0} | case))
    column_px, row_px = np.linspace(1.2, 158.1, 400), np.linspace(1.3, 98.2, 240)
    stack = frames_at(patterns, blurred, column_px, row_px)
    response = ProjectorResponse(1.0, 0.0, 2.0, 0.0) if is_square else None
    sensor = SensorNoise(0.01, 0.0, 0.0, 255.0)
    options = DecodeOptions(filter_taps=0, max_order_error=0.5)
    decoded = decode(stack, patterns, sensor, options, response=response)
    inside = np.s_[60:-60, 60:-60]  # 1.5 fringes of a single frame
    valid = decoded.valid[inside]
    assert valid.mean() > 0.95
    column_error = (decoded.column.coordinate_px - column_px[None, :])[inside][valid]
    row_error = (decoded.row.coordinate_px - row_px[:, None])[inside][valid]
    assert max(np.abs(column_error).max(), np.abs(row_error).max()) < 0.05


def test_reduced_frames_have_no_bound_and_a_single_frame_a_warning():
    """Why: the bound is that of the least squares of all frames, without loss of relief."""
    pairs, cyclic, single = (
        load_experiment("examples/slab_balls", {"patterns.stepping": name, "patterns.steps": steps})
        for name, steps in (("quarter_pairs", 8), ("cyclic", 6), ("single", 1))
    )
    assert [has_bound(experiment) for experiment in (pairs, cyclic, single)] == [True, False, False]
    assert decoding_warnings(pairs) == decoding_warnings(cyclic) == []
    assert "single frame smooths relief" in decoding_warnings(single)[0]


def test_later_fields_at_their_default_keep_the_digest_of_a_pattern_set():
    """Expected: the digest before `stepping` and `waveform` existed."""
    assert content_digest(PatternSet(160, 100, 16.0, 4)) == "55763f605d94836e"
    assert content_digest(PatternSet(160, 100, 16.0, 4, stepping="cyclic")) != "55763f605d94836e"


def test_configuration_and_decoder_have_the_same_fields():
    """Size and shape of the pixels are the projector's; all other defaults and names are one."""
    of_set = {item.name: item.default for item in fields(PatternSet)}
    for of_projector in ("width_px", "height_px", "pixel_ratio"):
        of_set.pop(of_projector)
    of_model = {name: field.default for name, field in Patterns.model_fields.items()}
    assert of_model.keys() == of_set.keys()
    required = {"period_px", "steps"}
    assert all(of_model[name] == of_set[name] for name in of_set.keys() - required)
    shown = PatternSet(160, 100, 16.0, 4, word="binary", code="gray", low_level=7)
    assert PatternSet(160, 100, **Patterns.of(shown).model_dump()) == shown


def test_fields_at_their_default_are_left_out():
    assert set(Patterns(period_px=18.0, steps=4).model_dump()) == {
        "period_px", "steps", "code", "further_periods_px",
    }  # fmt: skip
