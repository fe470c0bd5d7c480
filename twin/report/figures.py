"""All figures of a report: drawn into the result's `figures` folder, with their captions."""

from twin.report.balls import BallView, ball_views, draw_ball
from twin.report.decoding import draw_decoding
from twin.report.frames import draw_frames
from twin.report.html import Plate
from twin.report.press import draw_press
from twin.report.relief import draw_height_map, draw_relief_view, z_enlargement
from twin.report.rig import draw_rig
from twin.report.truth_error import draw_truth_error
from twin.report.world_map import pixel_on_face_mm
from twin.results.record import Measurement

_SHEET_MAPS = (
    " Below: how thick the sheet is where it lies, how far it is stretched, and how steep the coat "
    "is. Where the sheet touches, the specimen lies one local thickness behind the coat, along its "
    "normal."
)


def plates(measured: Measurement) -> list[Plate]:
    """Return all figures in the order of the report; without points there is no surface to show."""
    if not measured.score.against_truth.points:
        return [_rig(measured), *images(measured), _press(measured)]
    balls = [_ball(measured, view.ball.number, view) for view in ball_views(measured)]
    return [_rig(measured), *images(measured), *_surfaces(measured), *balls, _press(measured)]


def _rig(measured: Measurement) -> Plate:
    return Plate(
        "rig",
        lambda path: draw_rig(path, measured.experiment),
        "side view of the rig",
        "Camera and projector with what they cover; lengths in mm, to scale. The slab should lie "
        "where both fans meet, within the projector's.",
    )


def images(measured: Measurement) -> list[Plate]:
    """Return the figures of frames and decoder maps; they say nothing of what is measured."""
    return [
        Plate(
            "frames",
            lambda path: draw_frames(path, measured.fringes.capture),
            "contact sheet of camera frames",
            "Frames in digital numbers (DN), all on one scale: black is 0, white is saturation. "
            "Look for fringes without breaks, for Gray edges that are sharp against a period, and "
            "for peaks that stay below the dashed saturation line.",
        ),
        Plate(
            "decoding",
            lambda path: draw_decoding(
                path, measured.fringes.reconstruction, measured.fringes.capture.patterns
            ),
            "maps of phase, fringe order, modulation and mask",
            "Axes in camera pixels; pale gray has no value. Phase runs once through the cyclic "
            "scale per period; orders must step by one exactly where the phase wraps; masked "
            "pixels should keep to edges and shadows.",
        ),
    ]


def _surfaces(measured: Measurement) -> list[Plate]:
    points, pixel_mm = (
        measured.points,
        pixel_on_face_mm(measured.experiment),
    )
    enlarged = z_enlargement(points)
    shown = "in true proportion" if enlarged == 1 else f"with z enlarged {enlarged:g} times"
    return [
        Plate(
            "relief",
            lambda path: draw_relief_view(path, points, pixel_mm),
            "shaded 3-D view of the measured relief",
            f"Measured coated face {shown}, lengths in mm, colour is z. "
            "Spikes or steps of a constant height would be wrong fringe orders.",
        ),
        Plate(
            "height_map",
            lambda path: draw_height_map(path, points, pixel_mm),
            "shaded height map of the measured relief",
            f"Measured heights from above, lengths in mm, lit from the upper left ({shown} for the "
            "shading), with contours. Stripes along or across the fringes would be phase errors.",
        ),
        Plate(
            "truth_error",
            lambda path: draw_truth_error(
                path, measured.fringes.reconstruction, measured.truth, pixel_mm
            ),
            "map and histogram of the z error",
            "Measured minus true z in µm, colour scale symmetric about 0; the predicted standard "
            "deviation from camera noise; and both compared. A good measurement looks like noise, "
            "without stripes or outlines, and its histogram fills the red curve.",
        ),
    ]


def _ball(measured: Measurement, number: int, view: BallView) -> Plate:
    radius_mm = measured.experiment.score.roi_radius_mm
    return Plate(
        f"ball_{number}",
        lambda path: draw_ball(path, view),
        f"residuals and sections of ball {number}",
        f"Ball {number}: points within {radius_mm:g} mm of the apex. Radial residuals in µm on a "
        f"scale of ± {view.limit_um:g} µm, the same for all balls. Pattern in the map is the form "
        "of the face; the blue points should follow the green line of the true face. The dashed "
        "cap is what a camera that saw the ball itself would measure.",
    )


def _press(measured: Measurement) -> Plate:
    pressed = measured.pressed
    assert pressed is not None
    kind = "slab" if pressed.sheet is None else "sheet"
    return Plate(
        "press",
        lambda path: draw_press(path, measured.experiment, pressed),
        f"relief, pressure and section of the pressed {kind}",
        "Relief of the coated face in mm, contact pressure in kPa, and the section along the "
        "dashed line. The more the coated face follows the dashed outline of the specimen, the "
        "more of its shape the sensor can measure."
        + ("" if pressed.sheet is None else _SHEET_MAPS),
    )
