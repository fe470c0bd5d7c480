"""Shared stages give the bytes of a separate measurement, for any varied field."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config import vary
from twin.pipeline import Memory, measure

# Values around the base for fields that every stage looks at, and for some that none does.
FIELDS = {
    "coating.base_albedo": [0.3, 0.6],
    "coating.flake_fraction": [0.0, 0.4],
    "coating.binder_ior": [1.0, 1.4],
    "coating.texture": [None, {"rms_um": 10.0, "correlation_mm": 0.2}],
    "elastomer.shore_a": [8.0, 12.0],
    "elastomer.thickness_mm": [2.0, 3.0],
    "elastomer.young_modulus_kpa": [None, 300.0],
    "press.depth_mm": [0.5, 0.75],
    "press.back_pressure_kpa": [0.0, 2.0],
    "specimen.separation_mm": [8.0, 8.5],
    "patterns.period_px": [18.0, 24.0],
    "patterns.steps": [3, 4],
    "projector.blur_px": [0.7, 1.5],
    "projector.contrast": [400.0, 800.0],
    "projector.aperture_mm": [0.0, 4.0],
    "projector.pose.polar_deg": [25.0, 32.0],
    "projector.flux_mw": [100.0, 150.0],
    "camera.pose.standoff_mm": [214.0, 220.0],
    "camera.exposure_ms": ["auto", 5.0],
    "camera.read_noise_e": [2.0, 10.0],
    "camera.noise": [True, False],
    "render.samples": [1, 4],
    "render.bounces": [None, 1],
    "decode.filter_taps": [0, 8],
    "decode.use": ["column", "both"],
    "score.roi_radius_mm": [1.0, 1.5],
    "seed": [1, 2],
}


def bytes_of(done):
    """Everything a case can show, as bytes by name."""
    arrays = {
        "pressure": done.pressed.pressure_kpa,
        "face": done.pressed.face_z_mm,
        "stack": done.fringes.capture.stack,
        "radiance": np.stack(done.fringes.frames),
        "truth": done.truth.points_world_mm,
        "points": done.points.world_mm,
        "sigma": done.points.sigma_z_mm,
    }
    return {"figures": repr(done.metrics)} | {name: a.tobytes() for name, a in arrays.items()}


def test_random_walk_gives_the_same_bytes(mi, base):
    """Setup: from case to case one or two fields, chosen at random, change their value.

    Expected: every case equals `measure` on its own, to the last bit of every array.
    Why: the fields that a stage reads are recorded while it runs, so no field can be forgotten; a
    stage that looked at something unseen (a global, a cache) would show here.
    """
    rng = np.random.default_rng(20261121)
    memory, experiment = Memory(), base
    for _ in range(9):
        for path in rng.choice(list(FIELDS), rng.integers(1, 3), replace=False):
            value = FIELDS[path][rng.integers(len(FIELDS[path]))]
            experiment = vary(experiment, {path: value})
        assert bytes_of(measure(experiment, memory=memory)) == bytes_of(measure(experiment))
    recalled = {name: times for name, _, times, _ in memory.stages()}
    assert recalled["shape"] + recalled["press"] >= 3
    assert recalled["geometry"] >= 2


# Each in turn is changed and changed back; the stages computed again, in their order.
BARE = {
    "coating.base_albedo": (0.3, ""),
    "camera.exposure_ms": (5.0, "capture reconstruction"),
    "patterns.period_px": (24.0, "tables frames capture reconstruction"),
    "render.photons": (2000, "photons frames capture reconstruction"),
    "projector.pose.polar_deg": (30.0, "view trace photons frames capture reconstruction"),
    "stage.albedo": (0.6, "geometry view trace photons frames capture reconstruction"),
}


def test_a_bare_specimen_shares_its_stages(mi, base):
    """Expected: the bytes of a separate measurement; no stage repeats without a changed field."""
    steel = base.specimen.material.model_dump()
    ball = {"kind": "ball", "diameter_mm": 8.0, "material": steel}
    size = {"camera.width_px": 160, "camera.height_px": 120, "modality": "direct_fpp"}
    size |= {"specimen": ball}
    bare, memory = vary(base, size | {"render.bounces": 0, "render.photons": 1000}), Memory()
    measure(bare, memory=memory)
    for path, (value, expected) in BARE.items():
        before = {name: computed for name, computed, _, _ in memory.stages()}
        case = vary(bare, {path: value})
        shared, alone = measure(case, memory=memory), measure(case)
        assert shared.fringes.capture.stack.tobytes() == alone.fringes.capture.stack.tobytes()
        repeated = [name for name, computed, _, _ in memory.stages() if computed > before[name]]
        assert repeated == expected.split(), path
        measure(bare, memory=memory)


@pytest.fixture(scope="module")
def counted(mi, base):
    """Count the results that each stage computes over a grid, sorted as the engine sorts it."""

    def count(fields):
        import itertools

        from twin.study.cases import Case
        from twin.study.order import in_sharing_order

        memory = Memory()
        cases = [
            vary(base, dict(zip(fields, values, strict=True)))
            for values in itertools.product(*fields.values())
        ]
        measure(cases[0], memory=memory)
        reads = tuple(paths for _, _, _, paths in memory.stages())
        counts = [Case({}, case, str(i)) for i, case in enumerate(cases)]
        for _, case in in_sharing_order(counts, reads):
            measure(case.experiment, memory=memory)
        return {name: computed for name, computed, _, _ in memory.stages()}

    return count


def test_each_stage_runs_once_per_difference(counted):
    """2 coats x 2 periods x 2 exposures: 1 press, 1 scene, 2 traces, 4 lit stacks, 8 captures."""
    counts = counted(
        {
            "camera.exposure_ms": [5.0, 6.0],
            "patterns.period_px": [18.0, 24.0],
            "coating.base_albedo": [0.3, 0.5],
        }
    )
    assert (counts["shape"], counts["press"], counts["geometry"], counts["view"]) == (1, 0, 1, 1)
    # The first case is computed twice: it scouts, and is in the grid again here.
    assert (counts["trace"], counts["frames"], counts["capture"]) == (2, 4, 8)


def test_hardness_is_free_under_depth_control(counted):
    """At a given depth the shape does not depend on the modulus: one press, one capture."""
    counts = counted({"elastomer.shore_a": [6.0, 10.0, 14.0]})
    assert counts["shape"] == counts["capture"] == counts["reconstruction"] == 1
    assert counts["press"] == 0


def test_a_texture_is_laid_on_one_press(counted, base):
    """Two coats, three seeds: the slow press runs once, each coat's texture once per seed."""
    textures = [{"rms_um": rms, "correlation_mm": 0.2} for rms in (6.0, 12.0)]
    counts = counted({"coating.texture": textures, "seed": [1, 2, 3]})
    assert (counts["shape"], counts["press"]) == (1, 0)
    # The scout's texture is in the grid again.
    assert counts["texture"] == counts["geometry"] == 6


def test_hardness_stays_free_under_a_texture(counted):
    """The modulus moves the last digit of the coat's displacement, not the rendered image."""
    texture = {"rms_um": 10.0, "correlation_mm": 0.2}
    counts = counted({"coating.texture": [texture], "elastomer.shore_a": [6.0, 10.0, 14.0]})
    assert counts["texture"] == 3
    assert counts["geometry"] == counts["capture"] == 1


def test_hardness_needs_presses_under_force_control(mi, base):
    forced = vary(base, {"press.control": "force", "press.depth_mm": None, "press.force_n": 0.2})
    memory = Memory()
    depths = [
        measure(vary(forced, {"elastomer.shore_a": shore}), memory=memory).pressed.depth_mm
        for shore in (8.0, 14.0)
    ]
    assert depths[0] > 1.2 * depths[1]
    assert {name: computed for name, computed, _, _ in memory.stages()}["press"] == 2


def test_a_refusal_is_shared_too(mi, base):
    """A press that fails is not tried again for every coat; the reason remains the same."""
    memory = Memory()
    deep = vary(base, {"elastomer.thickness_mm": 1.2, "press.depth_mm": 1.5})
    reasons = set()
    for albedo in (0.3, 0.5):
        with pytest.raises(InputError) as caught:
            measure(vary(deep, {"coating.base_albedo": albedo}), memory=memory)
        reasons.add(str(caught.value))
    assert len(reasons) == 1
    assert {name: computed for name, computed, _, _ in memory.stages()}["shape"] == 1
