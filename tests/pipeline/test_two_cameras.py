"""Two rendered cameras with one projector, merged, against the true surface."""

from benchmarks.reality_two_cameras import reality_two_cameras


def test_merged_points_are_better_and_have_fewer_shadows():
    """Expected: error 1/sqrt(2) of that of one camera for independent errors; 0.80 measured."""
    figures = reality_two_cameras(quick=True)
    assert figures["merged_over_alone"] < 0.9
    assert figures["shadow_ratio"] < 0.5
    assert 0.7 < figures["merged_error_over_sigma"] < 1.4
