"""Figures of a measurement by photometric stereo, with their captions, in the order of the page."""

import numpy as np

from twin.report.balls import BallView, draw_ball
from twin.report.canvas import symmetric_limit
from twin.report.html import Plate
from twin.report.photometric_maps import (
    MAP_NAMES,
    decoder_name,
    draw_errors,
    draw_heights,
    draw_images,
    draw_slopes,
    enlargement,
)
from twin.report.photometric_section import draw_sections
from twin.report.photometric_sensor import draw_sensor
from twin.report.press import draw_press
from twin.report.relief import draw_relief_view, z_enlargement
from twin.report.section import trace_through_apexes
from twin.results.record import Measurement


def photometric_plates(seen: Measurement) -> list[Plate]:
    """Return all figures in the order of the report."""
    balls = [_ball(seen, view) for view in ball_views(seen)]
    return [_sensor(seen), _images(seen), _slopes(seen), *_surfaces(seen), *balls, _press(seen)]


def ball_views(seen: Measurement) -> list[BallView]:
    """Return one view per ball, all on one residual scale so that they compare."""
    balls, points = seen.score.spheres, seen.points.world_mm
    limits = [symmetric_limit(1e3 * ball.measured.residuals_mm, 99.5) for ball in balls]
    return [
        BallView(
            ball=ball,
            measured_mm=points[ball.roi].astype(np.float64),
            true_mm=seen.truth.points_world_mm[ball.roi].astype(np.float64),
            trace=trace_through_apexes(seen.experiment),
            pixel_mm=seen.pixel_mm,
            limit_um=max(limits),
        )
        for ball in balls
    ]


def _sensor(seen: Measurement) -> Plate:
    return Plate(
        "sensor",
        lambda path: draw_sensor(path, seen.experiment),
        "lamps, gel and window of the sensor",
        "Lamps with the direction of their strongest light, and the layers the camera looks "
        "through; lengths in mm, to scale.",
    )


def _images(seen: Measurement) -> Plate:
    return Plate(
        "images",
        lambda path: draw_images(path, seen),
        "tactile image, background and their difference",
        "What the sensor's driver delivers: 8-bit colours after gamma, crop and resize. The dashed "
        "outline is the evaluated field. Red comes from the top, green from the right, blue from "
        "the bottom; the left has no lamp.",
    )


def _slopes(seen: Measurement) -> Plate:
    return Plate(
        "slopes",
        lambda path: draw_slopes(path, seen),
        "measured and true slopes of the coat, and their difference",
        f"Slopes in mm/mm by the {MAP_NAMES[seen.colours.own.colour_map]} map against the true "
        "coat at the same pixels. Beside a contact the coat is in shadow of one lamp or another, "
        "which no reference press taught. Everything after this figure is integration.",
    )


def _surfaces(seen: Measurement) -> list[Plate]:
    enlarged, points = enlargement(seen), seen.points
    view = z_enlargement(points)
    shown = "in true proportion" if view == 1 else f"with z enlarged {view:g} times"
    shading = "" if enlarged == 1 else f" (shading enlarges z {enlarged:g} times)"
    return [
        Plate(
            "relief",
            lambda path: draw_relief_view(path, points, seen.pixel_mm),
            "shaded 3-D view of the measured relief",
            f"Measured coat {shown}, lengths in mm, colour is z; {decoder_name(seen.colours.own)}.",
        ),
        Plate(
            "heights",
            lambda path: draw_heights(path, seen),
            "true heights and those of every decoder",
            f"The same image by every decoder, all on the scale of the true coat{shading}; white "
            "is no measurement. Lengths in mm.",
        ),
        Plate(
            "sections",
            lambda path: draw_sections(path, seen),
            "heights and height errors along the section",
            "Along the line through the apexes. The wider a shape, the more the vendor's "
            "integration flattens it.",
        ),
        Plate(
            "errors",
            lambda path: draw_errors(path, seen),
            "height error of every decoder",
            "Measured minus true z in the evaluated field, all on one scale, clipped at its ends. "
            "Nothing is shifted or scaled before comparing.",
        ),
    ]


def _ball(seen: Measurement, view: BallView) -> Plate:
    number, radius_mm = view.ball.number, seen.experiment.score.roi_radius_mm
    return Plate(
        f"ball_{number}",
        lambda path: draw_ball(path, view),
        f"residuals and sections of ball {number}",
        f"Ball {number}, {decoder_name(seen.colours.own)}: points within {radius_mm:g} mm of the "
        f"apex. Radial residuals in µm on a scale of ± {view.limit_um:g} µm, the same for all "
        "balls; green is the true coat.",
    )


def _press(seen: Measurement) -> Plate:
    return Plate(
        "press",
        lambda path: draw_press(path, seen.experiment, seen.press),
        "relief, pressure and section of the pressed gel",
        "Relief of the coat in mm, contact pressure in kPa, and the section along the dashed line: "
        "the gel between specimen and window. Where it touches, the coat has the specimen's shape.",
    )
