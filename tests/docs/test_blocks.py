"""Every fenced block of README and documentation is executed and its statement is tested."""

import contextlib
import io
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import twin
from reconstruction.capture.description import read_sequence
from reconstruction.patterns import PatternSet
from tests.docs.documents import DOCS, PAGES, ROOT, Block, blocks, command_lines
from tests.optics.measured_tables import matte_table
from twin.assets import list_assets
from twin.cli import run
from twin.cli.app import settings_of
from twin.cli.calibration import with_repeated_options
from twin.cli.commands import app
from twin.cli.plugins import without_plugins
from twin.cli.talk import choose_level
from twin.config import load_experiment
from twin.config.models import Experiment
from twin.config.schema import experiment_keys
from twin.config.sensor_layer import load_sensor_layer
from twin.optics.checks import check_renderable
from twin.optics.frame_times import frame_times_s

_COMMANDS = "test_blocks.py::test_each_command_is_accepted"
_TUTORIAL = "test_tutorials.py::test_a_tutorial_runs_with_the_printed_output"
_OWN = "test_bring_your_own.py"
_OWN_KIND = f"{_OWN}::test_another_kind_by_a_dotted_key"
_OWN_RELIEF = f"{_OWN}::test_a_height_map_is_the_same_in_each_format"
_OWN_DECODER = f"{_OWN}::test_own_decoder_own_calibration_and_normals"
_OWN_TABLES = "../plugins/test_own_settings.py::test_the_table_of_a_model_is_used_and_written"
_DEMO = "../paper/test_demo.py::test_the_folder_has_all_measurements_and_their_page"
_VIEW = "../viewer/test_server.py::test_object_devices_and_section_are_in_the_scene"
_SETUP = "../packaging/test_run.py::test_first_call_sets_up_then_runs_where_the_user_is"
_RIG_FILE = "../cli/test_real_rig.py::test_listed_columns_only_give_the_heights_of_the_example"
_MINIMAL = "test_first_examples.py::test_the_minimal_experiment_of_the_readme_reads_its_ball"
_DATASETS = "../dataset/test_document.py"
_GAUGES = "../cli/test_evaluation_document.py::test_figures_of_the_document"
JUDGES = {
    "README.md: ./run demo": _DEMO,
    "README.md: name =": _MINIMAL,
    "README.md: twin init": "test_blocks.py::test_first_commands_of_the_readme",
    "README.md: import twin": "test_blocks.py::test_python_example_of_the_readme",
    "CONTRIBUTING.md: ./run setup": _SETUP,
    "docs/bring_your_own.md: import imageio": _OWN_RELIEF,
    "docs/bring_your_own.md: name =": _OWN_RELIEF,
    "docs/bring_your_own.md: twin press my.toml": _OWN_RELIEF,
    "docs/bring_your_own.md: twin press examples": _OWN_KIND,
    "docs/bring_your_own.md: import twin": _OWN_KIND,
    "docs/bring_your_own.md: [coating]": f"{_OWN}::test_a_measured_coat_of_the_page",
    "docs/bring_your_own.md: def shot": f"{_OWN}::test_own_noise_is_in_the_images",
    "docs/bring_your_own.md: import numpy": _OWN_DECODER,
    "docs/bring_your_own.md: import cv2": _OWN_DECODER,
    "docs/bring_your_own.md: twin import-calibration": _OWN_DECODER,
    "docs/bring_your_own.md: normals": _OWN_DECODER,
    "docs/coatings.md: [coating]": "test_blocks.py::test_a_measured_coat",
    "docs/coatings.md: [coating.glints]": "test_blocks.py::test_the_glints_of_a_coat",
    "docs/coatings.md: [coating.texture]": "test_blocks.py::test_the_texture_of_a_coat",
    "docs/compensation.md: # layer.toml": "test_blocks.py::test_layer_file",
    "docs/compensation.md: fitted =": "test_blocks.py::test_layer_file",
    "docs/motion.md: name": "test_blocks.py::test_the_tables_of_a_motion",
    "docs/datasets.md: name =": f"{_DATASETS}::test_the_recipe_of_the_page",
    "docs/datasets.md: import io": f"{_DATASETS}::test_a_bare_process_reads_each_format",
    "docs/datasets.md: import h5py": f"{_DATASETS}::test_a_bare_process_reads_each_format",
    "docs/datasets.md: from pyarrow": f"{_DATASETS}::test_a_bare_process_reads_each_format",
    "docs/datasets.md: import webdataset": f"{_DATASETS}::test_loaders_of_other_packages",
    "docs/datasets.md: import datasets": f"{_DATASETS}::test_loaders_of_other_packages",
    "docs/decoding.md: [patterns]": "test_blocks.py::test_patterns_table",
    "docs/evaluation.md: import h5netcdf": _GAUGES,
    "docs/evaluation.md: from reconstruction.evaluate": _GAUGES,
    "docs/extend.md: [project.entry-points": "test_blocks.py::test_entry_point",
    "docs/extend.md: [mechanics]": _OWN_TABLES,
    "docs/extend.md: [camera.noise_model]": _OWN_TABLES,
    "docs/extend.md: def shot_and_row_noise": "test_blocks.py::test_own_noise_function",
    "docs/getting_started.md: ./run demo": _DEMO,
    "docs/getting_started.md: name =": _TUTORIAL,
    "docs/getting_started.md: twin measure": _TUTORIAL,
    "docs/getting_started.md: import twin": _TUTORIAL,
    "docs/getting_started.md: twin view": _VIEW,
    "docs/install.md: ./run demo": _DEMO,
    "docs/install.md: python3.11": "test_blocks.py::test_extras_of_an_installation",
    "docs/optics.md: ": "test_tutorials.py::test_the_page_on_field_lens_and_distance_runs",
    "docs/paper.md: twin paper": _COMMANDS,
    "docs/physics/slab.md: [elastomer.relaxation]": "test_blocks.py::test_a_press_that_relaxes",
    "docs/physics/slab.md: [elastomer]": "test_blocks.py::test_a_slide_of_a_press",
    "docs/real_rig.md: format =": _RIG_FILE,
    "docs/sheet.md: [elastomer]": "test_blocks.py::test_tables_of_a_thin_sheet",
    "docs/sheet.md: [elastomer.thickness_field]": "test_blocks.py::test_the_thickness_of_a_sheet",
    "docs/troubleshooting.md: twin doctor": _COMMANDS,
    "docs/tutorial_design.md: ": _TUTORIAL,
}
"""Test of each block, file and name, by page and first characters of the block."""


def one(page: str, start: str) -> Block:
    """Return the block of a page that starts with given characters."""
    (block,) = (some for some in blocks(ROOT / page) if some.text.startswith(start))
    return block


def judge_of(block: Block) -> str:
    return next((JUDGES[start] for start in JUDGES if block.name.startswith(start)), "")


def test_every_block_has_a_judge():
    """A new block needs a test of its statement, and a line of `JUDGES`."""
    every = [block for page in PAGES for block in blocks(page)]
    assert len(every) > 35
    assert [block.name for block in every if not judge_of(block)] == []
    names = [block.name for block in every]
    assert [start for start in JUDGES if not any(name.startswith(start) for name in names)] == []


@pytest.mark.parametrize("judge", sorted({*JUDGES.values()}))
def test_each_judge_exists(judge):
    file, _, test = judge.partition("::")
    text = (Path(__file__).parent / file).read_text(encoding="utf-8")
    assert f"\ndef {test}(" in text


def words_of(command: list[str]) -> list[str]:
    return with_repeated_options(without_plugins(choose_level(command))[0])


@pytest.mark.parametrize("page", [page.relative_to(ROOT).as_posix() for page in PAGES])
def test_each_command_is_accepted(page):
    """Command, options and values; settings are valid for the shipped experiment they change."""
    for of, command in command_lines():
        if of == page and not {"--help", "-h"} & {*command}:
            _, bound, _ = app.parse_args(words_of(command), print_error=False, exit_on_error=False)
            shipped = str(bound.arguments.get("experiment", ""))
            if shipped in list_assets("scenes"):
                load_experiment(shipped, settings_of(bound.arguments.get("settings")))


def test_the_pages_name_many_commands():
    named = {command[0] for _, command in command_lines()}
    assert {"init", "measure", "paper", "sweep", "adopt", "compensate", "doctor"} <= named


def test_first_commands_of_the_readme(tmp_path, monkeypatch, capsys):
    """Expected: a commented starter that is valid, and every key with its default and meaning."""
    monkeypatch.chdir(tmp_path)
    lines = one("README.md", "twin init").text.splitlines()
    for line in lines[:2]:
        assert run(line.partition("#")[0].split()[1:]) == 0
    starter = (tmp_path / "my.toml").read_text(encoding="utf-8")
    assert starter.count("#") > 10
    assert load_experiment("my.toml").measurand
    keys = capsys.readouterr().out
    assert [key.path for key in experiment_keys() if key.path not in keys] == []
    measured = [line for line in lines if line.startswith("twin measure")]
    assert len(measured) == 2
    changed = load_experiment("my.toml", settings_of(re.findall(r"-s (\S+)", measured[1])))
    assert (changed.coating.base_albedo, changed.camera.binning) == (0.2, 2)


def test_python_example_of_the_readme(mi):
    """As printed, on a sixteenth of the pixels, with coarse cells and a thicker sheet.

    Expected: the radius of the object, 4 mm, within its U under each coat; the brighter the coat,
    the smaller the error of z.
    """
    few = {"camera.binning": 4, "camera.width_px": 968, "camera.height_px": 732}
    coarse = {"press.cell_mm": 0.5, "elastomer.thickness_mm": 0.145, "press.depth_mm": 0.35}
    settings = repr(few | coarse | {"press.relief_pitch_mm": 0.05})
    text = one("README.md", "import twin").text
    assert text.count('{"camera.binning": 2}') == 1
    printed, variables = io.StringIO(), dict[str, object]()
    with contextlib.redirect_stdout(printed):
        exec(text.replace('{"camera.binning": 2}', settings), variables)
    rows = np.array([line.split() for line in printed.getvalue().splitlines()], float)
    albedo, value_mm, expanded_um, error_um = rows.T
    assert list(albedo) == [0.1, 0.4, 0.8]
    assert np.all(1e3 * np.abs(value_mm - 4.0) < expanded_um)
    assert np.all(expanded_um < 60.0)
    assert np.all(np.diff(error_um) < 0)
    points_mm = variables["points_mm"]
    assert points_mm.shape == (183, 242, 3)


def experiment_with(tmp_path: Path, name: str, text: str) -> Experiment:
    """Return the example of the name with the tables of a block, read from a file."""
    file = tmp_path / "experiment.toml"
    file.write_text(f'name = "block"\nuse = "scenes/examples/{name}"\n{text}', encoding="utf-8")
    return load_experiment(file)


def test_a_measured_coat(mi, tmp_path):
    """Expected: the file is next to the experiment, the wavelength is that of the projector."""
    table = matte_table(tmp_path / "my_coat_spec.bsdf")
    text = one("docs/coatings.md", "[coating]").text
    experiment = experiment_with(tmp_path, "slab_ball", text)
    assert Path(experiment.coating.file) == table
    assert experiment.coating.wavelength_nm == experiment.projector.wavelength_nm
    assert experiment.coating.bsdf()


def test_the_texture_of_a_coat(tmp_path):
    """Expected: RMS and correlation length as stated, within the scatter of one sample."""
    from twin.mechanics.texture import texture_figures

    text = one("docs/coatings.md", "[coating.texture]").text
    experiment = experiment_with(tmp_path, "slab_ball", text)
    coarse = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.2}
    figures = texture_figures(twin.press(twin.vary(experiment, coarse)))
    assert figures["texture_rms_um"] == pytest.approx(12.0, rel=0.05)
    assert figures["texture_correlation_mm"] == pytest.approx(0.15, rel=0.1)
    shipped = load_experiment("examples/airbrushed").coating.texture
    assert experiment.coating.texture.skewness == shipped.skewness == 0.0


def test_the_glints_of_a_coat(tmp_path):
    """Expected: the numbers of the shipped coat, and flakes over its share of the area."""
    text = one("docs/coatings.md", "[coating.glints]").text
    stated = experiment_with(tmp_path, "slab_ball", text).coating
    use = '[coating]\nuse = "materials/coatings/glinting_flake"\n'
    assert stated == experiment_with(tmp_path, "slab_ball", use).coating
    assert stated.facets().share == stated.flake_fraction


def test_layer_file(tmp_path):
    """Expected: each value and its sigma are in the layer; the second block adds the form."""
    file, texts = tmp_path / "layer.toml", [one("docs/compensation.md", "# layer.toml").text]
    texts += [one("docs/compensation.md", "fitted").text]
    stated = [tomllib.loads(text) for text in texts]
    file.write_text(texts[0], encoding="utf-8")
    layer = load_sensor_layer(file)
    assert {table: stated[0][table] for table in ("press", "sigma")} == {
        "press": layer.press.model_dump(include={*stated[0]["press"]}),
        "sigma": layer.sigma.model_dump(include={*stated[0]["sigma"]}),
    }
    assert layer.elastomer.thickness_mm == 0.2
    assert [item.width_mm for item in layer.bar] == [4.8]
    slab = '[elastomer]\nuse = "materials/elastomers/silicone_c"\nthickness_mm = 3.0\n'
    slab += "length_x_mm = 24.0\nlength_y_mm = 20.0\n"
    file.write_text(f"{texts[1]}\n{slab}[press]\ndepth_mm = 1.0\n", encoding="utf-8")
    assert list(load_sensor_layer(file).fitted) == stated[1]["fitted"]
    assert load_sensor_layer(file).specimen.diameter_mm == 7.5


def test_patterns_table(tmp_path):
    """Expected: valid in an experiment and in patterns.toml; the default is what is stated."""
    text = one("docs/decoding.md", "[patterns]").text
    patterns = experiment_with(tmp_path, "slab_ball", text).patterns
    manifest = tmp_path / "patterns.toml"
    head = 'format = "fringe-patterns"\nversion = 1\n'
    manifest.write_text(f"{head}{text}width_px = 1280\nheight_px = 720\n", encoding="utf-8")
    sequence = read_sequence(manifest, {})
    for item in (patterns, sequence):
        assert (item.period_px, item.steps, item.code) == (18.0, 8, "complementary_gray")
    assert PatternSet.code == "complementary_gray"


def test_the_tables_of_a_motion(tmp_path):
    """Expected: the moving experiment is renderable, with the stated rate of the frames."""
    file = tmp_path / "moving.toml"
    file.write_text(one("docs/motion.md", 'name = "moving"').text, encoding="utf-8")
    experiment = load_experiment(file)
    check_renderable(experiment)
    assert experiment.motion.vibration.amplitude_um == 5.0
    start_s, _ = frame_times_s(experiment)
    assert start_s[1] - start_s[0] == pytest.approx(0.02)


def test_entry_point():
    """Expected: group, module and class of the entry point are those of the shipped example."""
    from twin.config.specimen_base import SPECIMENS

    text = one("docs/extend.md", "  [project.entry-points").text
    ((group, points),) = tomllib.loads(text)["project"]["entry-points"].items()
    assert group == f"fringe_twin.{SPECIMENS.seam}"
    ((name, target),) = points.items()
    source = (DOCS / "extend" / f"{target.partition(':')[0]}.py").read_text(encoding="utf-8")
    assert f"class {target.partition(':')[2]}(" in source
    assert f'kind: Literal["{name}"]' in source


def test_own_noise_function(mi):
    """Expected: noise that is equal in each row, 5 electrons, added to shot noise."""
    text = one("docs/extend.md", "def shot_and_row_noise").text
    few = {"camera.binning": 2, "camera.width_px": 160, "camera.height_px": 120}
    coarse = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.2}
    experiment = load_experiment("examples/slab_ball", few | coarse)
    variables: dict[str, object] = {"twin": twin, "experiment": experiment}
    exec(text, variables)
    noise = variables["shot_and_row_noise"]
    electrons = noise(np.full((4000, 50), 100.0), np.random.default_rng(1))
    assert electrons.mean(axis=1).std() == pytest.approx(np.hypot(5.0, 10.0 / 50**0.5), rel=0.05)
    within = electrons - electrons.mean(axis=1, keepdims=True)
    assert within.std() == pytest.approx(10.0 * (1 - 1 / 50) ** 0.5, rel=0.02)


def test_extras_of_an_installation():
    """Expected: the extras and the group of the command lines are those of pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    text = one("docs/install.md", "python3.11").text
    extras = {name for some in re.findall(r"\.\[([\w,]+)\]", text) for name in some.split(",")}
    assert extras <= {"sweep", "fast", "view"}
    assert "fast" in extras
    assert extras <= {*project["project"]["optional-dependencies"]}
    assert {*re.findall(r"--group (\w+)", text)} <= {*project["dependency-groups"]}
    least = project["project"]["requires-python"].removeprefix(">=")
    assert f"python{least} -m venv" in text
    assert sys.version_info >= tuple(map(int, least.split(".")))


def test_the_thickness_of_a_sheet(tmp_path, monkeypatch):
    """Expected: the sum of waves, a wedge that gets thicker along y, and the map."""
    from twin.mechanics.sheet.thickness import sheet_thickness

    monkeypatch.chdir(tmp_path)
    X, Y = np.meshgrid((np.arange(300) - 149.5) * 0.1, (np.arange(250) - 124.5) * 0.1)
    np.save("thickness.npy", 0.2 + 1e-3 * X)
    text = one("docs/sheet.md", "[elastomer.thickness_field]").text
    elastomer = experiment_with(tmp_path, "wrapped_balls", text).elastomer
    on_sheet = (abs(X) <= elastomer.length_x_mm / 2) & (abs(Y) <= elastomer.length_y_mm / 2)
    field_um = 1e3 * sheet_thickness(elastomer).deviation_mm(X[on_sheet], Y[on_sheet])
    waves_um = field_um - X[on_sheet] - 0.5 * Y[on_sheet]
    assert waves_um.std() == pytest.approx(2.0, rel=0.02)
    assert field_um.mean() == pytest.approx(0.0, abs=0.05)


def test_tables_of_a_thin_sheet(tmp_path):
    """Expected: the defaults in the comments, and tack makes the sheet stick."""
    text = one("docs/sheet.md", "[elastomer]").text
    experiment = experiment_with(tmp_path, "wrapped_balls", text)
    elastomer, press = experiment.elastomer, experiment.press
    assert (elastomer.thickness_mm, elastomer.sticks) == (0.2, True)
    plain = twin.vary(experiment, {"elastomer.tack_j_m2": 0.0})
    assert not plain.elastomer.sticks
    coarse = {"press.relief_pitch_mm": 0.05, "press.cell_mm": 0.4, "mechanics.model": "auto"}
    pressed = twin.press(twin.vary(plain, coarse))
    assert pressed.model == experiment.mechanics.model == "sheet"
    assert pressed.depth_mm == press.depth_mm == 1.0


def test_a_press_that_relaxes(tmp_path):
    """Expected: force control lets the ball sink on; the default times are those of a step."""
    text = one("docs/physics/slab.md", "[elastomer.relaxation]").text
    experiment = experiment_with(tmp_path, "gel_on_window", text)
    coarse = {"press.solver_pitch_mm": 0.25, "press.relief_pitch_mm": 0.05}
    held = twin.press(twin.vary(experiment, coarse))
    at_once = twin.press(twin.vary(experiment, coarse | {"press.hold_s": 0.0}))
    assert held.depth_mm > at_once.depth_mm
    assert held.force_n == pytest.approx(held.initial_force_n, rel=1e-9)
    defaults = experiment_with(tmp_path, "gel_on_window", "").press
    assert (defaults.hold_s, defaults.ramp_s) == (0.0, 0.0)


def test_a_slide_of_a_press(tmp_path):
    """Expected: the ball drags the gel along x, with less than the limit of friction."""
    text = one("docs/physics/slab.md", "[elastomer]\n").text
    experiment = experiment_with(tmp_path, "gel_on_window", text)
    coarse = {"press.solver_pitch_mm": 0.25, "press.relief_pitch_mm": 0.05}
    shear = twin.press(twin.vary(experiment, coarse)).shear
    limit_n = experiment.elastomer.friction_coefficient * experiment.press.force_n
    assert 0.1 * limit_n < shear.force_x_n < limit_n
    assert abs(shear.force_y_n) < 1e-3 * limit_n
