"""Reconstruct or decode captures of fringes, rendered or real; needs no renderer."""

from collections.abc import Callable, Mapping
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from reconstruction.arrays import ReasonImage
from reconstruction.capture.folder import read_capture, read_uncalibrated
from reconstruction.capture.period_search import best_period
from reconstruction.colouring import Intensity
from reconstruction.decoding import PhaseReference
from reconstruction.decoding.continuity import DOUBTFUL_SHARE, jump_share
from reconstruction.decoding.decode import Decoded, DecodeOptions, Reason
from reconstruction.decoding.decode import decode as decode_stack
from reconstruction.errors import CaptureError
from reconstruction.evaluate.surface import write_surface
from reconstruction.machine import run_side_by_side
from reconstruction.patterns import AXES, PatternSet
from reconstruction.pipeline import (
    Reconstruction,
    ReconstructOptions,
    filter_bias,
    reconstruct,
    write_decoded,
    write_reconstruction,
)
from reconstruction.triangulation import Use
from reconstruction.writing import write_text
from twin.config.digest import content_digest
from twin.config.models import Decode
from twin.output import EXPERIMENT_FILE, output_folder, write_outcome
from twin.pipeline.progress import ProgressCallback, no_progress


def reconstruct_capture(
    capture_folder: Path, out: Path, decode: Decode, watch: ProgressCallback = no_progress
) -> dict[str, Any]:
    """Reconstruct a capture, and write the result folder `out`; return the figures of result.json.

    Raises
    ------
    InputError : the capture is incomplete or damaged, no pixel gives a point, or `out` cannot be
        written
    """
    with output_folder(out, [capture_folder]) as folder:
        watch("read", 0.0)
        capture = read_capture(capture_folder)
        watch("read", 1.0)
        watch("reconstruct", 0.0)
        result = reconstruct(capture, options_of(decode))
        require_points(capture_folder, result.point_map.mask_reason, partial(best_period, capture))
        watch("reconstruct", 1.0)
        axes = result.decoded.axes
        figures = reconstruction_metrics(result, decode.use if len(axes) == 2 else axes[0])
        figures |= continuity_metrics(result.decoded, capture.patterns)
        figures |= light_metrics(result.decoded)
        maps = folder / "reconstruction.nc", result.decoded, result.point_map, result.motion
        intensity = Intensity(result.decoded.intensity_dn, result.point_map.valid)
        digests: list[str] = []
        run_side_by_side(
            [
                lambda: write_surface(folder, result.point_map, intensity=intensity),
                lambda: write_reconstruction(*maps),
                lambda: digests.append(content_digest(decode, capture)),
            ]
        )
        settings = tomli_w.dumps({"decode": decode.model_dump(mode="json")})
        write_text(folder / EXPERIMENT_FILE, settings)
        write_outcome(folder, "reconstruct", figures, digest=digests[0])
    return figures


JUMPS = "_jump_share"
ISLANDS = "_islands"
LIKELY_CAUSES = {
    Reason.DARK: "white and black do not differ: check the projector's light, which images are"
    " white and black, and the noise in [sensor]",
    Reason.LOW_MODULATION: "the fringe contrast is too small for its noise: check exposure, which"
    " images are phase steps, and the noise in [sensor]",
    Reason.SATURATED: "phase frames are clipped or lost: shorten the exposure, check saturation_dn",
    Reason.ORDER_UNCERTAIN: "the fringe orders contradict the phase or are uncertain: check order"
    " and axis of the Gray frames, period_px, shift_deg, sign; with code 'spatial' the reference",
    Reason.OUTSIDE_PROJECTOR: "coordinates are outside the projector: check its width_px and"
    " height_px, period_px and the number of bits",
    Reason.EDGE: "all pixels are next to one without light: check the exposure",
    Reason.EPIPOLAR_MISMATCH: "columns and rows belong to no common point: check period_px of"
    " the fringes and the axes of the frames, and that the calibration is that of this rig",
    Reason.NO_POINT: "the rays do not meet in front of both devices: check that the calibration is"
    " that of this rig, sign and shift_deg",
    Reason.MOTION: "the phase frames are not those of a fringe at rest: check the order of the"
    " frames and the noise in [sensor], or raise decode.max_residual_sigmas",
}


_GEOMETRIC = (Reason.EPIPOLAR_MISMATCH, Reason.NO_POINT)


def require_points(
    capture: Path, reasons: ReasonImage, explain: Callable[[], str] = lambda: ""
) -> None:
    """Raise CaptureError, with the most frequent reason code, if no pixel is valid.

    Parameters
    ----------
    reasons : (row, col) reason codes
    explain : returns the result of trials with other periods and axes, as text; called only if the
        most frequent reason is one of the geometry
    """
    if np.any(reasons == Reason.VALID):
        return
    codes, counts = np.unique(reasons, return_counts=True)
    main = Reason(int(codes[np.argmax(counts)]))
    shares = ", ".join(
        f"{Reason(int(code)).name.lower().replace('_', ' ')} {count / reasons.size:.0%}"
        for code, count in sorted(zip(codes, counts, strict=True), key=lambda item: -item[1])
    )
    tried = explain() if main in _GEOMETRIC else ""
    cause = "; ".join(filter(None, [LIKELY_CAUSES[main], tried]))
    raise CaptureError(f"{capture}: no pixel gives a point ({shares}); {cause}")


def options_of(decode: Decode) -> ReconstructOptions:
    """Return the options of the reconstruction for the table [decode] of an experiment."""
    return ReconstructOptions(
        decode=DecodeOptions(
            filter_taps=decode.filter_taps,
            filter_sigma_px=decode.filter_sigma_px,
            weights=decode.weights,
            frame_gains=decode.frame_gains,
            max_residual_sigmas=decode.max_residual_sigmas,
            reference=_reference_of(decode),
        ),
        use=decode.use,
        through_layers=decode.through_layers,
        motion_error=decode.motion_error,
    )


def _reference_of(decode: Decode) -> PhaseReference | None:
    if not decode.reference_pixels and decode.reference_z_mm is None:
        return None
    return PhaseReference(
        decode.reference_pixels, decode.reference_z_mm, decode.reference_sigma_mm, decode.islands
    )


def reconstruction_metrics(result: Reconstruction, use: Use) -> dict[str, Any]:
    """Return number and uncertainty of the valid points, and the masked pixels per reason.

    Parameters
    ----------
    use : projector axes from which the points were triangulated
    """
    reasons = result.point_map.mask_reason
    figures: dict[str, Any] = {
        "points": int(result.point_map.valid.sum()),
        "valid_share": float(result.point_map.valid.mean()),
    }
    if figures["points"]:
        sigma = result.point_map.sigma_z_mm[result.point_map.valid]
        figures["sigma_z_median_um"] = float(1e3 * np.median(sigma))
        bias_um, bias_share = filter_bias(result, use, result.point_map.valid, sigma)
        figures |= {"filter_bias_um": bias_um, "filter_bias_share": bias_share}
    return figures | masked_by_reason(reasons, Reason)


def decode_capture(
    capture_folder: Path, out: Path, decode: Decode, watch: ProgressCallback = no_progress
) -> dict[str, Any]:
    """Decode a capture without a calibration, and write the result folder `out`.

    Returns the figures of result.json.
    The files of `out` are decoded.nc, decoded.png, experiment.toml and result.json.

    Raises
    ------
    InputError : the capture is incomplete or damaged, no pixel has a coordinate, or `out` cannot be
        written
    """
    from reconstruction.decoding.pictures import draw_decoded

    with output_folder(out, [capture_folder]) as folder:
        watch("read", 0.0)
        capture = read_uncalibrated(capture_folder)
        watch("read", 1.0)
        watch("decode", 0.0)
        options = options_of(decode).decode
        result = decode_stack(
            capture.stack,
            capture.patterns,
            capture.sensor,
            options,
            capture.scale,
            response=capture.response,
        )
        require_points(capture_folder, result.mask_reason)
        watch("decode", 1.0)
        figures = decoding_metrics(result) | continuity_metrics(result, capture.patterns)
        figures |= light_metrics(result)
        write_decoded(folder / "decoded.nc", result)
        draw_decoded(folder / "decoded.png", result)
        settings = tomli_w.dumps({"decode": decode.model_dump(mode="json")})
        write_text(folder / EXPERIMENT_FILE, settings)
        write_outcome(folder, "decode", figures, digest=content_digest(decode, capture))
    return figures


def decoding_metrics(decoded: Decoded) -> dict[str, Any]:
    """Return number, coordinate range and sigma of valid pixels, and masked pixels per reason."""
    figures: dict[str, Any] = {
        "pixels": int(decoded.valid.sum()),
        "valid_share": float(decoded.valid.mean()),
    }
    for name in decoded.axes if figures["pixels"] else ():
        axis = decoded.row if name == "row" else decoded.column
        coordinate_px = axis.coordinate_px[decoded.valid]
        figures |= {
            f"{name}_lowest_px": float(coordinate_px.min()),
            f"{name}_highest_px": float(coordinate_px.max()),
            f"sigma_{name}_median_px": float(np.median(axis.sigma_px[decoded.valid])),
            f"modulation_{name}_median_dn": float(np.median(axis.modulation_dn[decoded.valid])),
        }
    return figures | masked_by_reason(decoded.mask_reason, Reason)


def continuity_metrics(decoded: Decoded, patterns: PatternSet) -> dict[str, float]:
    """Return the share of jumps of the projector coordinate, by figure name, see `jump_share`."""
    return {
        f"{name}{JUMPS}": jump_share(
            (decoded.row if name == "row" else decoded.column).coordinate_px,
            decoded.valid,
            patterns.period_along(name),
            is_word=patterns.steps == 0,
        )
        for name in decoded.axes
    } | _island_metrics(decoded)


def _island_metrics(decoded: Decoded) -> dict[str, float]:
    """Return number and masked share of the islands along each axis; {} without islands."""
    if decoded.islands is None:
        return {}
    figures: dict[str, float] = {}
    for name in decoded.axes:
        islands = decoded.islands[AXES.index(name)]
        inside = islands > 0
        shown = decoded.mask_reason == Reason.ORDER_UNCERTAIN
        figures[f"{name}{ISLANDS}"] = int(islands.max())
        figures[f"{name}{ISLANDS}_masked_share"] = float(np.mean(shown[inside]))
    return figures


def light_metrics(decoded: Decoded) -> dict[str, float]:
    """Return the range of the light of the phase frames of one period, percent, the largest.

    It is 0 if the decoder has not divided the levels by the light.
    """
    gains = decoded.gains
    ranges = 0.0 if gains is None else np.ptp(gains.relative, axis=-1)
    return {"phase_light_range_percent": 100.0 * float(np.max(ranges))}


def order_doubts(figures: Mapping[str, Any]) -> list[str]:
    """Return a warning for each axis with too many jumps of its coordinate between pixels.

    Parameters
    ----------
    figures : with those of `continuity_metrics`
    """
    shares = {axis: figures.get(f"{axis}{JUMPS}", 0.0) for axis in AXES}
    return [
        f"the {axis} coordinate jumps at {share:.0%} of the places where it should pass from one"
        " cell of the projector to the next; fringe orders are probably wrong: check the order of"
        f" the Gray frames along {axis}, period_px and shift_deg"
        for axis, share in shares.items()
        if share > DOUBTFUL_SHARE
    ] + _island_doubts(figures)


def _island_doubts(figures: Mapping[str, Any]) -> list[str]:
    return [
        f"the {axis} phase has {figures[f'{axis}{ISLANDS}']} islands separated by jumps;"
        f" {figures[f'{axis}{ISLANDS}_masked_share']:.0%} of their pixels have no known fringe"
        " order and are masked: give reference_pixels in each, or state islands"
        for axis in AXES
        if figures.get(f"{axis}{ISLANDS}", 0) > 1
    ]


def masked_by_reason(reasons_image: ReasonImage, codes: type[IntEnum]) -> dict[str, int]:
    """Return the number of pixels per reason code, except VALID, by figure name.

    Parameters
    ----------
    reasons_image : (row, col) reason codes
    codes : all reason codes
    """
    reasons = (code for code in codes if code.name != "VALID")
    return {f"masked_{code.name.lower()}": int((reasons_image == code).sum()) for code in reasons}
