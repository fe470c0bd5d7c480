"""Draw the picture of `twin press` or `twin render` from its result folder."""

from pathlib import Path

from reconstruction.capture.folder import read_capture
from reconstruction.reading import read_json
from twin.config import load_experiment
from twin.mechanics import read_press
from twin.output import EXPERIMENT_FILE, RESULT_FILE

PRESS_PICTURE, FRAMES_PICTURE = "press.png", "frames.png"
PICTURES = {"press": PRESS_PICTURE, "render": FRAMES_PICTURE}
"""Name of the picture file, by the command that writes it."""


def picture_of(folder: Path) -> str | None:
    """Return the file name of the picture of a result folder.

    Returns None if the folder has no result.json, or if its command writes a report, not a picture.
    """
    path = folder / RESULT_FILE
    return PICTURES.get(str(read_json(path).get("command"))) if path.is_file() else None


def draw_picture(folder: Path, into: Path) -> Path:
    """Draw the picture of the result in `folder` into another folder, and return its path.

    Raises
    ------
    InputError : a file is missing or damaged
    """
    if picture_of(folder) == PRESS_PICTURE:
        from twin.report.press import draw_press

        experiment = load_experiment(folder / EXPERIMENT_FILE)
        draw_press(into / PRESS_PICTURE, experiment, read_press(folder / "press.nc"))
        return into / PRESS_PICTURE
    from twin.report.camera_images import draw_frames

    draw_frames(into / FRAMES_PICTURE, read_capture(folder))
    return into / FRAMES_PICTURE
