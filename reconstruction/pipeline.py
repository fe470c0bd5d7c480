"""Reconstruct a capture: decode and triangulate; write and read the maps over camera pixels.

The maps are netCDF files. Point clouds are written by `reconstruction.ply`.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, Reason, at_pixels
from reconstruction.capture.folder import Capture
from reconstruction.codes import Unwrap
from reconstruction.decoding.decode import AxisDecode, Decoded, DecodeOptions, decode
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.motion.prediction import MeasuredSurface, PredictedMotion, of_residuals
from reconstruction.netcdf import (
    PIXELS,
    LabelledArrays,
    pixel_coordinates,
    read_arrays,
    write_arrays,
)
from reconstruction.patterns import AXES
from reconstruction.triangulation import EpipolarTolerance, PointMap, Use, triangulate
from reconstruction.triangulation.reference import expect_by_rig


@dataclass(frozen=True)
class ReconstructOptions:
    """Options of decoding and triangulation.

    Parameters
    ----------
    decode : options of decoding
    use : projector coordinate from which the depth is computed; "both": both of them, weighted by
        1 / sigma^2. It has no effect if only one axis was decoded
    tolerance : largest allowed difference, px, between a decoded coordinate and the projection of
        the triangulated point, see `EpipolarTolerance`
    through_layers : refract the rays at the calibration's plane layers; False: triangulate as if
        there were only air above the surface, like software without a layer model
    motion_error : predict the error of each point by motion from the residuals of the phase frames
    """

    decode: DecodeOptions = field(default_factory=DecodeOptions)
    use: Use = "column"
    tolerance: EpipolarTolerance = field(default_factory=EpipolarTolerance)
    through_layers: bool = True
    motion_error: bool = False


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Result of decoding and triangulation.

    Parameters
    ----------
    decoded : projector coordinates, their sigma and a reason code of each camera pixel
    point_map : points in the world frame and their sigma
    motion : predicted errors by motion; None: not predicted
    """

    decoded: Decoded
    point_map: PointMap
    motion: PredictedMotion | None = None

    def __repr__(self) -> str:
        rows, cols = self.point_map.mask_reason.shape
        summary = ", ".join(f"{name} {value}" for name, value in self._in_short().items())
        return f"<Reconstruction: {rows} x {cols} pixels, {summary}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html("reconstruction", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        valid = self.point_map.valid
        shown = {"points": f"{100 * valid.mean():.1f} % of all pixels"}
        if valid.any():
            sigma_um = 1e3 * float(np.median(at_pixels(self.point_map.sigma_z_mm, valid)))
            shown["median sigma of z"] = f"{sigma_um:.3g} um"
        return shown

    def plot(self) -> "Drawing":
        """Draw the heights, their predicted standard deviation and a section as one figure.

        Raises
        ------
        InputError : no pixel has a point
        """
        from reconstruction.drawing import Drawing, draw_cells, draw_section, gridded

        valid = self.point_map.valid
        if not valid.any():
            raise InputError("plot: found no valid point; inspect the mask's reasons")
        points_mm = at_pixels(self.point_map.points_world_mm, valid).astype(np.float64)
        sigma_um = 1e3 * at_pixels(self.point_map.sigma_z_mm, valid)
        drawing = Drawing(3)
        panels = drawing.subplots(1, 3)
        relief = gridded(points_mm, points_mm[:, 2])
        draw_cells(panels[0], relief, "measured heights", "z (mm)")
        draw_cells(panels[1], gridded(points_mm, sigma_um), "predicted sigma of z", "um")
        draw_section(panels[2], {"measured": relief})
        return drawing

    def to_xarray(self) -> "xarray.Dataset":
        """Return all maps, (row, col) of the camera, as they are stored in reconstruction.nc."""
        return reconstruction_arrays(self.decoded, self.point_map, self.motion).to_xarray()


def reconstruct(
    capture: Capture, options: ReconstructOptions | None = None, *, unwrap: Unwrap | None = None
) -> Reconstruction:
    """Decode and triangulate a capture.

    Parameters
    ----------
    unwrap : user's function that numbers the fringes; None: the pattern code of the capture does.
        It is called once for each projector axis with the wrapped phases
        (`reconstruction.codes.Wrapped`). It returns the absolute projector coordinates
        (row, col) float, px, NaN where unknown. Masks, noise and filter are as for a pattern code;
        the noise is that of the phase of the measuring period

    Raises
    ------
    InputError : stack, patterns, calibration and stage are inconsistent, `unwrap` returns
        coordinates of another shape, or the residuals of the patterns contain no motion to predict
    """
    chosen = options or ReconstructOptions()
    rig, stack = capture.calibration, capture.stack
    if capture.stage is not None:
        from reconstruction.motion.stage import hold_still

        stack = hold_still(
            stack, capture.patterns, capture.sensor, rig, capture.stage, scale=capture.scale
        )
    decoded = decode(
        stack,
        capture.patterns,
        capture.sensor,
        chosen.decode,
        capture.scale,
        response=capture.response,
        unwrap=unwrap,
        expect=expect_by_rig(chosen.decode.reference, rig),
    )
    model = rig if chosen.through_layers else replace(rig, layers=None)
    use: Use = chosen.use if len(decoded.axes) == 2 else decoded.axes[0]
    point_map = triangulate(decoded, model, use, chosen.tolerance)
    motion = None
    if chosen.motion_error:
        measured = MeasuredSurface(decoded, point_map, model, use)
        motion = of_residuals(measured, capture.patterns, stack, capture.sensor)
    return Reconstruction(decoded, point_map, motion)


def filter_bias(
    reconstruction: Reconstruction, use: Use, where: BoolImage, sigma_z_mm: NDArray[np.floating]
) -> tuple[float, float]:
    """Estimate the bias of world z that the spatial filter causes, without a known true shape.

    Parameters
    ----------
    use : projector coordinate from which the depth was computed; for "both" the larger of the two
        bias shares is used
    where : (row, col) bool, True at the valid points to include, at least one
    sigma_z_mm : (point,) standard deviation of world z of these points; it includes noise and bias

    Returns
    -------
    RMS of the predicted bias of world z, um, and the share of the points with a predicted bias
    larger than the predicted noise
    """
    axes = (reconstruction.decoded.column, reconstruction.decoded.row)
    chosen = axes if use == "both" else (axes[use == "row"],)
    share = np.max([at_pixels(axis.bias_share, where) for axis in chosen], axis=0)
    sigma_um = 1e3 * sigma_z_mm.astype(np.float64)
    variance_um2 = float(np.einsum("i,i,i->", sigma_um, sigma_um, share)) / len(share)
    return float(np.sqrt(variance_um2)), float(np.mean(share > 0.5))


if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing

POSE = "T_world_from_cam"
UNITS = {"mm": "mm", "px": "px", "rad": "rad", "dn": "DN"}
Maps = dict[str, NDArray[Any]]
_LONG_NAMES = {
    "x_mm": "world x of the point",
    "y_mm": "world y of the point",
    "z_mm": "world z of the point",
    "sigma_x_mm": "standard uncertainty of world x",
    "sigma_y_mm": "standard uncertainty of world y",
    "sigma_z_mm": "standard uncertainty of world z",
    "normal_x": "x of the measured unit normal towards the camera; 0, 0, 0: not known",
    "normal_y": "y of the measured unit normal towards the camera; 0, 0, 0: not known",
    "normal_z": "z of the measured unit normal towards the camera; 0, 0, 0: not known",
    "mask_reason": "reason why there is no point; 0: there is one",
    "column_px": "projector column",
    "row_px": "projector row",
    "sigma_column_px": "standard uncertainty of the projector column",
    "sigma_row_px": "standard uncertainty of the projector row",
    "phase_column": "wrapped phase of the fringes along the projector column",
    "phase_row": "wrapped phase of the fringes along the projector row",
    "order_error_column": "probability that the fringe order of the column is wrong",
    "order_error_row": "probability that the fringe order of the row is wrong",
    "order_column": "fringe order of the column",
    "order_row": "fringe order of the row",
    "islands": "number of the island of continuous phase, 1 for the largest; 0: none",
    "mean": "mean pixel value over the phase frames",
    "modulation": "amplitude of the fringes",
    "residual": "residual of the phase fit",
    "bias_share_column": "share of the filter's bias in the variance of the column",
    "bias_share_row": "share of the filter's bias in the variance of the row",
    "phase_rate_": "change of the phase from frame to frame by motion",
    "motion_error_": "predicted error by motion during the phase frames",
    "motion_lag_": "predicted displacement by motion from the reference time to the phase frames",
}


def write_reconstruction(
    path: Path | str,
    decoded: Decoded,
    point_map: PointMap,
    motion: PredictedMotion | None = None,
) -> None:
    """Write all maps of a reconstruction as a netCDF-4 file, each as a variable (row, col)."""
    write_arrays(path, reconstruction_arrays(decoded, point_map, motion))


def write_decoded(path: Path | str, decoded: Decoded) -> None:
    """Write the maps of a decoded capture as a netCDF-4 file, each as a variable (row, col)."""
    maps = {"mask_reason": decoded.mask_reason} | _decoded_variables(decoded)
    write_arrays(path, _labelled(maps, {"frame": "projector: integer = centre of a pixel"}))


def reconstruction_arrays(
    decoded: Decoded, point_map: PointMap, motion: PredictedMotion | None = None
) -> LabelledArrays:
    """Return all maps of a reconstruction, (row, col) of the camera, with units and long names."""
    frame = "world: z = 0 is the undeformed coated face, z up; row 0 at the top"
    pose = point_map.T_world_from_cam.ravel()
    maps = _variables(decoded, point_map) | ({} if motion is None else motion.maps())
    return _labelled(maps, {"frame": frame, POSE: pose})


def _labelled(maps: Maps, attributes: dict[str, Any]) -> LabelledArrays:
    variables: dict[str, dict[str, Any]] = {}
    for name in maps:
        units = UNITS.get(name.rsplit("_", 1)[-1], "1")
        variables[name] = {"units": units, "long_name": _long_name(name)}
    # Files without pixels in motion keep the bytes that they had before this reason existed.
    has_motion = bool(np.any(maps["mask_reason"] == Reason.MOTION))
    flags = [reason for reason in Reason if has_motion or reason is not Reason.MOTION]
    variables["mask_reason"].update(
        comment="where it is not 0, points and their sigmas are 0 and no values",
        flag_values=np.array([int(reason) for reason in flags], np.uint8),
        flag_meanings=" ".join(reason.name for reason in flags),
    )
    return LabelledArrays(
        {name: (PIXELS, values, variables[name]) for name, values in maps.items()},
        coords=pixel_coordinates(*maps["mask_reason"].shape),
        attrs=attributes,
    )


def read_reconstruction(path: Path | str) -> Reconstruction:
    """Read the reconstruction from a file that `write_reconstruction` wrote.

    Raises
    ------
    CaptureError : the file is missing or damaged, or a map is missing in it
    """
    stored = read_maps(path)
    maps = {name: values for name, (_, values, _) in stored.variables.items()}
    if POSE in stored.attrs:
        maps[POSE] = np.asarray(stored.attrs[POSE], dtype=np.float64).reshape(4, 4)
    try:
        return _from_variables(maps)
    except KeyError as error:
        raise CaptureError(f"{path}: the map {error} is missing") from error


def read_maps(path: Path | str) -> LabelledArrays:
    """Read all arrays and attributes of a netCDF-4 file, or raise CaptureError."""
    try:
        return read_arrays(path)
    except OSError as error:
        raise CaptureError(f"{path}: is no complete netCDF-4 file ({one_line(error)})") from error


def _variables(decoded: Decoded, point_map: PointMap) -> Maps:
    maps: Maps = {f"{name}_mm": point_map.points_world_mm[..., i] for i, name in enumerate("xyz")}
    sigma_mm = point_map.sigma_xyz_mm
    maps |= {f"sigma_{name}_mm": sigma_mm[..., i] for i, name in enumerate("xyz")}
    normals = point_map.normals_world
    maps |= {f"normal_{name}": normals[..., i] for i, name in enumerate("xyz")}
    maps |= {"mask_reason": point_map.mask_reason}
    return maps | _decoded_variables(decoded)


def _decoded_variables(decoded: Decoded) -> Maps:
    maps: Maps = {}
    for axis in decoded.axes:
        data = decoded.row if axis == "row" else decoded.column
        maps |= {name: getattr(data, field) for field, name in _axis_names(axis).items()}
        if decoded.islands is not None:
            maps[f"islands_{axis}"] = decoded.islands[AXES.index(axis)]
    return maps


def _axis_names(axis: str) -> dict[str, str]:
    """Return the netCDF variable name of each field of AxisDecode for one projector axis."""
    suffix = "" if axis == "column" else f"_{axis}"
    return {
        "coordinate_px": f"{axis}_px",
        "sigma_px": f"sigma_{axis}_px",
        "phase_rad": f"phase_{axis}_rad",
        "order": f"order_{axis}",
        "mean_dn": f"mean{suffix}_dn",
        "modulation_dn": f"modulation{suffix}_dn",
        "residual_dn": f"residual{suffix}_dn",
        "order_error": f"order_error_{axis}",
        "bias_share": f"bias_share_{axis}",
    }


def _from_variables(maps: Maps) -> Reconstruction:
    axes = tuple(axis for axis in AXES if f"{axis}_px" in maps) or AXES
    blank: NDArray[Any] = np.zeros(maps["mask_reason"].shape, np.float32)
    column, row = (
        AxisDecode(
            **{
                field: maps[name] if axis in axes else blank
                for field, name in _axis_names(axis).items()
            }
        )
        for axis in AXES
    )
    reason = maps["mask_reason"].astype(np.uint8)
    # These two reasons are set in triangulation: such a pixel was decoded.
    was_decoded = np.isin(reason, (Reason.EPIPOLAR_MISMATCH, Reason.NO_POINT))
    decoded_reason = np.where(was_decoded, 0, reason).astype(np.uint8)
    points, sigma = (
        np.stack([maps[f"{before}{name}_mm"] for name in "xyz"], axis=-1).astype(np.float32)
        for before in ("", "sigma_")
    )
    point_map = PointMap(points, sigma, reason, maps[POSE])
    decoded = Decoded(column, row, decoded_reason, axes)
    return Reconstruction(decoded, point_map, PredictedMotion.from_maps(maps))


def _long_name(name: str) -> str:
    """Return the long name of a map; a name that ends with "_row_dn" is of horizontal fringes."""
    text = next(text for start, text in _LONG_NAMES.items() if name.startswith(start))
    return f"{text}, horizontal fringes" if name.endswith("_row_dn") else text
