"""The paper's figures from folders of cases: files, panels without a measurement, errors."""

import numpy as np
import pytest
from PIL import Image

from reconstruction.errors import InputError
from twin.mechanics.hardness import gent_modulus_kpa
from twin.paper.plan import RODS


@pytest.fixture(scope="module")
def cases(rod, ball, tmp_path_factory):
    """A folder of cases in which only one rod and one ball were measured."""
    folder = tmp_path_factory.mktemp("all") / "cases"
    for measured, name, method in (
        (rod, RODS[0], "contact_fpp"),
        (ball, "two_balls", "photometric_stereo"),
        (rod, "nut", "contact_fpp"),
        (rod, "nut", "direct_fpp"),
    ):
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / method).symlink_to(measured, target_is_directory=True)
    return folder


@pytest.fixture(scope="module")
def quick():
    """One painted pixel per pixel of a relief."""
    from twin.report import relief

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(relief, "FINER", 1)
        yield


@pytest.mark.parametrize(
    "name", ["direct_and_contact", "missing", "rods", "grid", "sphere_fit", "hardness"]
)
def test_every_figure_is_drawn_as_png_and_pdf(name, cases, quick, tmp_path):
    """Views, which need no case, are drawn in test_views."""
    from twin.paper.figures import draw_figure

    draw_figure(name, cases, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.png", f"{name}.pdf"}
    assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    with Image.open(tmp_path / f"{name}.png") as image:
        assert image.info["dpi"] == pytest.approx((200, 200), abs=0.1)
        assert np.asarray(image.convert("L")).std() > 10


def test_figures_are_drawn_without_any_case(quick, tmp_path, mi):
    """An interrupted or partly failed run draws figures with the cases it has: here none."""
    from twin.paper.figures import draw_figure

    draw_figure("sphere_fit", tmp_path / "none", tmp_path)
    assert (tmp_path / "sphere_fit.png").is_file()


def test_the_registry_covers_the_papers_figures_and_names_their_cases(mi):
    from twin.assets import asset_path
    from twin.paper.figures import FIGURES

    assert set(FIGURES) == {
        "concept", "hardness", "setup", "direct_and_contact", "missing", "rods", "grid",
        "ridges", "sphere_fit",
    }  # fmt: skip
    for figure in FIGURES.values():
        assert figure.title
        assert figure.caption.endswith(".")
        for name, method in figure.cases:
            assert asset_path("scenes", f"paper/{name}").is_file()
            assert method in ("direct_fpp", "contact_fpp", "photometric_stereo")


def test_an_unknown_figure_is_an_error_with_the_known_names(tmp_path, mi):
    from twin.paper.figures import draw_figure

    with pytest.raises(InputError, match=r"found 'rod', allowed: concept, .*sphere_fit"):
        draw_figure("rod", tmp_path, tmp_path)


def test_a_case_without_panels_is_an_error_with_the_remedy(tmp_path, mi):
    from twin.paper.figure_panels import panels_of

    (tmp_path / "nut" / "direct_fpp").mkdir(parents=True)
    with pytest.raises(InputError, match="found no panels; measure the case again"):
        panels_of(tmp_path, "nut", "direct_fpp")


def test_hardness_is_that_of_the_materials(mi):
    """The paper states Shore A 20 at 1 : 1; the source of the others states that it is assumed."""
    from twin.paper.hardness import mixes

    first, second, third = mixes()
    assert (first.ratio, first.shore_a) == (1.0, 20.0)
    assert first.source.startswith("paper")
    assert first.shore_a > second.shore_a > third.shore_a
    assert second.source.startswith("assumed")
    assert third.source.startswith("assumed")
    for mix in mixes():
        assert mix.low_shore_a < mix.shore_a < mix.high_shore_a
        assert mix.modulus.best_kpa == pytest.approx(gent_modulus_kpa(mix.shore_a))
        assert mix.modulus.low_kpa < mix.modulus.best_kpa < mix.modulus.high_kpa


def test_panel_letters_increase_along_the_rows(mi, tmp_path):
    from twin.paper.figure_panels import Grid
    from twin.report.canvas import printing

    grid = Grid(2, 3, 1.0, 0.8)
    with printing(tmp_path / "grid", *grid.size_in) as figure:
        axes = grid.cell(figure, 1, 0)
        place = axes.get_position()
    assert axes.texts[0].get_text() == "(d)"
    width, height = grid.size_in
    assert place.x0 * width == pytest.approx(grid.left_in)
    assert place.y0 * height == pytest.approx(grid.bottom_in)
