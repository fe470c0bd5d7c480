"""Calibrations in the layouts of other programs, byte-true: names, number formats, conventions.

Each writer takes a folder and a rig, writes the files that the program would, and returns their
paths. The layouts follow the programs' own sources and published files.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from tests.corpus.rigs import RIG, Content, Rig, matrix


def stored(path: Path, **values: Any) -> Path:
    """Write as cv2.FileStorage does; XML or YAML by the suffix, YAML with OpenCV 4's first line."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return written(path, path.read_text("utf-8").replace("%YAML 1.2", "%YAML:1.0", 1))


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def of_opencv(home: Path, rig: Rig = RIG) -> list[Path]:
    """Two files with the names of OpenCV's sample stereo_calib, rectification among them."""
    extrinsic = {"R": rig.rotation, "T": rig.translation_mm.reshape(3, 1)}
    more = {"R1": np.eye(3), "R2": np.eye(3), "P1": np.eye(3, 4), "P2": np.eye(3, 4)}
    inside = {
        "M1": matrix(rig.camera), "D1": np.array([rig.camera.distortion]),
        "M2": matrix(rig.projector), "D2": np.array([rig.projector.distortion]),
    }  # fmt: skip
    return [
        stored(home / "intrinsics.yml", **inside),
        stored(home / "extrinsics.yml", **extrinsic, **more, Q=np.eye(4)),
    ]


def of_scanner(home: Path, rig: Rig = RIG) -> list[Path]:
    """The names of scan3d-capture."""
    result = {
        "cam_K": matrix(rig.camera), "cam_kc": np.array([rig.camera.distortion]).T,
        "proj_K": matrix(rig.projector), "proj_kc": np.array([rig.projector.distortion]).T,
        "R": rig.rotation, "T": rig.translation_mm.reshape(3, 1),
        "cam_error": np.array([[0.1]]), "proj_error": np.array([[0.2]]),
    }  # fmt: skip
    return [stored(home / "calibration.yml", **result)]


def of_xml(home: Path, rig: Rig = RIG) -> list[Path]:
    """XML with long names, a rotation vector, and sizes."""
    result: dict[str, Any] = {
        "rvec": cv2.Rodrigues(rig.rotation)[0], "tvec": rig.translation_mm.reshape(3, 1)
    }  # fmt: skip
    for side, device in (("left", rig.camera), ("right", rig.projector)):
        result |= {
            f"camera_matrix_{side}": matrix(device),
            f"dist_coeffs_{side}": np.array([device.distortion]),
            f"width_{side}": device.width_px,
            f"height_{side}": device.height_px,
        }
    return [stored(home / "stereo.xml", **result)]


def of_two_calibrations(home: Path, rig: Rig = RIG) -> list[Path]:
    """One file per device of OpenCV's sample calibration.cpp, and R and T in a third."""
    files = []
    for name, device in rig.devices:
        result = {
            "calibration_time": "Fri Nov 27 10:00:00 2026", "image_width": device.width_px,
            "image_height": device.height_px, "camera_matrix": matrix(device),
            "distortion_coefficients": np.array([device.distortion]).T,
            "avg_reprojection_error": 0.2,
            "image_points": np.arange(24, dtype=np.float32).reshape(3, 4, 2),
        }  # fmt: skip
        files.append(stored(home / f"{name}_out.xml", **result))
    pose = stored(home / "stereo.yml", R=rig.rotation, T=rig.translation_mm.reshape(3, 1))
    # The names of the files, not their order, decide which device is the camera.
    return [files[1], files[0], pose]


def of_toolbox(home: Path, rig: Rig = RIG) -> list[Path]:
    """Calib_Results_stereo.mat of the Camera Calibration Toolbox for MATLAB."""
    result: dict[str, object] = {
        "om": cv2.Rodrigues(rig.rotation)[0], "T": rig.translation_mm[:, None]
    }  # fmt: skip
    for side, device in (("left", rig.camera), ("right", rig.projector)):
        result |= {
            f"fc_{side}": np.array([[device.fx_px], [device.fy_px]]),
            f"cc_{side}": np.array([[device.cx_px], [device.cy_px]]),
            f"kc_{side}": np.array([device.distortion]).T,
            f"alpha_c_{side}": 0.0,
        }
    savemat(home / "Calib_Results_stereo.mat", result)
    return [home / "Calib_Results_stereo.mat"]


def of_calibrator(home: Path, rig: Rig = RIG) -> list[Path]:
    """A structure of MATLAB's stereoParameters: rows times matrices, the first pixel is (1, 1)."""
    result: dict[str, object] = {
        "RotationOfCamera2": rig.rotation.T, "TranslationOfCamera2": rig.translation_mm[None]
    }  # fmt: skip
    for number, device in ((1, rig.camera), (2, rig.projector)):
        k1, k2, p1, p2, k3 = device.distortion
        from_one = matrix(device) + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        result[f"CameraParameters{number}"] = {
            "IntrinsicMatrix": from_one.T,
            "RadialDistortion": np.array([k1, k2, k3]),
            "TangentialDistortion": np.array([p1, p2]),
            "ImageSize": np.array([device.height_px, device.width_px]),
        }
    savemat(home / "stereo.mat", result)
    return [home / "stereo.mat"]


def of_slstudio(home: Path, rig: Rig = RIG) -> list[Path]:
    """SLStudio's calibration.xml: single precision, names that differ by case only."""
    result: dict[str, Any] = {}
    for letter, device in (("c", rig.camera), ("p", rig.projector)):
        result |= {
            f"K{letter}": matrix(device).astype(np.float32),
            f"k{letter}": np.array([device.distortion], np.float32).T,
        }
    result |= {
        "Rp": rig.rotation.astype(np.float32),
        "Tp": rig.translation_mm.astype(np.float32).reshape(3, 1),
        "cam_error": 0.28, "proj_error": 0.46, "stereo_error": 0.42,
        "frameWidth": rig.camera.width_px, "frameHeight": rig.camera.height_px,
        "screenResX": rig.projector.width_px, "screenResY": rig.projector.height_px,
    }  # fmt: skip
    return [stored(home / "calibration.xml", **result)]


def of_slcalib(home: Path, rig: Rig = RIG) -> list[Path]:
    """SLStudio's text: a name, then its rows with six decimals; no image sizes."""
    blocks = ["#V1.0 SLStudio calibration\n#Calibration time: \n"]
    for letter, device in (("c", rig.camera), ("p", rig.projector)):
        blocks.append(_rows(f"K{letter}", matrix(device)))
        blocks.append(_rows(f"k{letter}", np.array([device.distortion])))
    blocks += [_rows("Rp", rig.rotation), _rows("Tp", rig.translation_mm[None])]
    blocks += ["cam_error: 0.280000\n", "proj_error: 0.460000\n", "stereo_error: 0.420000\n"]
    return [written(home / "calibration.slcalib", "\n".join(blocks))]


def _rows(name: str, values: np.ndarray) -> str:
    return "\n".join([name, *(" ".join(f"{value:f}" for value in row) for row in values), ""])


def of_slmaster(home: Path, rig: Rig = RIG) -> list[Path]:
    """SLMaster's caliInfo.yml of one camera (1) and the projector (4)."""
    size = np.array([[rig.camera.width_px], [rig.camera.height_px]], float)
    result = {
        "M1": matrix(rig.camera), "D1": np.array([rig.camera.distortion]), "S": size,
        "M4": matrix(rig.projector), "D4": np.array([rig.projector.distortion]),
        "Rlp": rig.rotation, "Tlp": rig.translation_mm.reshape(3, 1),
    }  # fmt: skip
    return [stored(home / "caliInfo.yml", **result)]


def of_procam(home: Path, rig: Rig = RIG) -> list[Path]:
    """The calibration_result.xml of procam-calibration, with its spelling of rotation."""
    result = {
        "img_shape": np.array([[rig.camera.height_px], [rig.camera.width_px]], float), "rms": 0.85,
        "cam_int": matrix(rig.camera), "cam_dist": np.array([rig.camera.distortion]),
        "proj_int": matrix(rig.projector), "proj_dist": np.array([rig.projector.distortion]),
        "roration": rig.rotation, "translation": rig.translation_mm.reshape(3, 1),
    }  # fmt: skip
    return [stored(home / "calibration_result.xml", **result)]


def of_scanner_sim(home: Path, rig: Rig = RIG) -> list[Path]:
    """scanner-sim's two JSON files; the first projector pixel's centre is (0.5, 0.5)."""
    files = []
    for name, device in rig.devices:
        first_px = 0.5 if name == "projector" else 0.0
        K = matrix(device) + np.array([[0, 0, first_px], [0, 0, first_px], [0, 0, 0]])
        result: dict[str, Any] = {
            "mtx": K.tolist(), "dist": list(device.distortion),
            "new_mtx": (0.98 * K).tolist(), "roi": [14, 18, 600, 400],
        }  # fmt: skip
        if name == "projector":
            result["origin"] = (-rig.rotation.T @ rig.translation_mm).tolist()
            result["basis"] = rig.rotation.tolist()
        result |= {
            "mean_projection_error, pixels": 0.6,
            "image_width, pixels": device.width_px, "image_height, pixels": device.height_px,
        }  # fmt: skip
        files.append(written(home / f"{name}_geometry.json", json.dumps(result, indent=4)))
    return files


def of_json(home: Path, rig: Rig = RIG) -> list[Path]:
    """A script's JSON: objects of both devices, matrices as lists of rows."""
    result: dict[str, Any] = {
        name: {
            "camera_matrix": matrix(device).tolist(), "dist": [list(device.distortion)],
            "width": device.width_px, "height": device.height_px,
        }
        for name, device in rig.devices
    }  # fmt: skip
    result |= {"R": rig.rotation.tolist(), "T": [[value] for value in rig.translation_mm.tolist()]}
    return [written(home / "stereo.json", json.dumps(result))]


def of_yaml(home: Path, rig: Rig = RIG) -> list[Path]:
    """A script's YAML by yaml.dump, with the extrinsics as one 4 x 4 matrix."""
    result: dict[str, Any] = {"extrinsics": rig.motion.tolist()}
    for number, (_, device) in enumerate(rig.devices, 1):
        result |= {
            f"K{number}": matrix(device).tolist(), f"D{number}": list(device.distortion),
            f"size{number}": [device.width_px, device.height_px],
        }  # fmt: skip
    return [written(home / "rig.yaml", yaml.safe_dump(result))]


def of_numpy(home: Path, rig: Rig = RIG) -> list[Path]:
    """A script's arrays by np.savez."""
    lenses = {
        f"{name}{number}": values
        for number, (_, device) in enumerate(rig.devices, 1)
        for name, values in (("mtx", matrix(device)), ("dist", np.array([device.distortion])))
    }
    np.savez(home / "rig.npz", **lenses, R=rig.rotation, T=rig.translation_mm[:, None])
    return [home / "rig.npz"]


def of_ros(home: Path, rig: Rig = RIG) -> list[Path]:
    """Two files of ROS camera_calibration; the pose is in the rectification, in metres."""
    turns, projections = _rectified(rig)
    files = []
    for side, (_, device), R, P in zip(
        ("left", "right"), rig.devices, turns, projections, strict=True
    ):
        parts = [
            f"image_width: {device.width_px}\nimage_height: {device.height_px}",
            f"camera_name: narrow_stereo/{side}",
            _ros_matrix("camera_matrix", matrix(device)),
            "distortion_model: plumb_bob",
            _ros_matrix("distortion_coefficients", np.array([device.distortion])),
            _ros_matrix("rectification_matrix", R),
            _ros_matrix("projection_matrix", P),
        ]
        files.append(written(home / f"{side}.yaml", "\n".join([*parts, ""])))
    return files


def of_ros_topic(home: Path, rig: Rig = RIG) -> list[Path]:
    """Two echoed messages of sensor_msgs/CameraInfo with the separator that ends a message."""
    turns, projections = _rectified(rig)
    files = []
    for (name, device), R, P in zip(rig.devices, turns, projections, strict=True):
        lists = {"D": device.distortion, "K": matrix(device), "R": R, "P": P}
        parts = [
            'header: \n  seq: 12\n  stamp: \n    secs: 1\n    nsecs: 2\n  frame_id: "cam"',
            f'height: {device.height_px}\nwidth: {device.width_px}\ndistortion_model: "plumb_bob"',
            *(f"{key}: {np.ravel(values).tolist()}" for key, values in lists.items()),
            "binning_x: 0\nbinning_y: 0\nroi: \n  x_offset: 0\n  do_rectify: False\n---\n",
        ]
        files.append(written(home / f"{name}_info.yaml", "\n".join(parts)))
    return files


def _rectified(rig: Rig) -> tuple[list[np.ndarray], list[np.ndarray]]:
    size = (rig.camera.width_px, rig.camera.height_px)
    lenses = [
        part for _, device in rig.devices for part in (matrix(device), np.array(device.distortion))
    ]
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        *lenses, size, rig.rotation, rig.translation_mm[:, None] / 1e3
    )
    return [R1, R2], [P1, P2]


def _ros_matrix(name: str, values: np.ndarray) -> str:
    rows, cols = values.shape
    return f"{name}:\n  rows: {rows}\n  cols: {cols}\n  data: {values.ravel().tolist()}"


def of_kalibr(home: Path, rig: Rig = RIG) -> list[Path]:
    """Kalibr's camchain: four coefficients, metres, lists broken over lines."""
    chain: dict[str, Any] = {}
    for number, (_, device) in enumerate(rig.devices):
        chain[f"cam{number}"] = {
            "cam_overlaps": [1 - number], "camera_model": "pinhole",
            "distortion_coeffs": list(device.distortion[:4]), "distortion_model": "radtan",
            "intrinsics": [device.fx_px, device.fy_px, device.cx_px, device.cy_px],
            "resolution": [device.width_px, device.height_px],
            "rostopic": f"/cam{number}/image_raw",
        }  # fmt: skip
    motion = rig.motion
    motion[:3, 3] /= 1e3
    chain["cam1"]["T_cn_cnm1"] = motion.tolist()
    return [written(home / "camchain.yaml", yaml.safe_dump(chain, default_flow_style=None))]


def of_zivid(home: Path, rig: Rig = RIG) -> list[Path]:
    """Intrinsics as Zivid's SDK saves them, for both devices, and R and T in a third file."""
    files = []
    for name, device in rig.devices:
        k1, k2, p1, p2, k3 = device.distortion
        groups = {
            "CameraMatrix": {
                "CX": device.cx_px, "CY": device.cy_px, "FX": device.fx_px, "FY": device.fy_px
            },
            "Distortion": {"K1": k1, "K2": k2, "K3": k3, "P1": p1, "P2": p2},
        }  # fmt: skip
        lines = ["__version__: 7", "CameraIntrinsics:"]
        for group, values in groups.items():
            lines += [f"  {group}:", *(f"    {key}: {value}" for key, value in values.items())]
        files.append(written(home / f"{name}_intrinsics.yml", "\n".join([*lines, ""])))
    pose = stored(home / "stereo.yml", R=rig.rotation, T=rig.translation_mm.reshape(3, 1))
    return [*files, pose]


def of_scanner_text(home: Path, rig: Rig = RIG) -> list[Path]:
    """Text as scanner programs export it: headings, commas, brackets, an equals sign."""
    lines = ["// exported calibration", ""]
    for name, device in (("Camera", rig.camera), ("Projector", rig.projector)):
        lines += [
            f"[{name}Matrix]",
            *(", ".join(map(repr, row)) for row in matrix(device).tolist()),
        ]
        lines += [f"{name} Distortion = {list(device.distortion)}"]
        lines += [f"{name}Resolution: {device.width_px} {device.height_px}", ""]
    lines += ["RotationMatrix", *("\t".join(map(repr, row)) for row in rig.rotation.tolist())]
    lines += [f"TranslationVector: {'; '.join(map(repr, rig.translation_mm.tolist()))}"]
    return [written(home / "scanner.txt", "\n".join([*lines, ""]))]


def of_colmap(home: Path, rig: Rig = RIG) -> list[Path]:
    """COLMAP's cameras.txt and images.txt: first pixel at (0.5, 0.5), an arbitrary scale."""
    lines = [
        "# Camera list with one line of data per camera:",
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
        "# Number of cameras: 2",
    ]
    for number, (_, device) in zip((7, 3), rig.devices, strict=True):
        values = (device.fx_px, device.fy_px, device.cx_px + 0.5, device.cy_px + 0.5)
        numbers = " ".join(map(repr, (*values, *device.distortion, 0.0, 0.0, 0.0)))
        lines.append(f"{number} FULL_OPENCV {device.width_px} {device.height_px} {numbers}")
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.7]).as_matrix(), (3, -2, 5.0)
    scaled = rig.motion
    scaled[:3, 3] /= 37.0
    images = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
        "# Number of images: 2, mean observations per image: 1",
    ]
    poses = (("view 1.png", 7, world), ("projector.png", 3, scaled @ world))
    for number, (name, camera, pose) in enumerate(poses, 1):
        qx, qy, qz, qw = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        numbers = " ".join(map(repr, (qw, qx, qy, qz, *pose[:3, 3].tolist())))
        images += [f"{number} {numbers} {camera} {name}", "10.5 20.25 -1"]
    return [
        written(home / "cameras.txt", "\n".join([*lines, ""])),
        written(home / "images.txt", "\n".join([*images, ""])),
    ]


@dataclass(frozen=True)
class Layout:
    """Layout of a program's files.

    Attributes
    ----------
    write : writes the files of a rig into a folder and returns their paths
    content : content of the files
    """

    write: Callable[[Path, Rig], list[Path]]
    content: Content = field(default_factory=Content)


_SIZES = frozenset({"camera", "projector"})
_PROJECTOR = frozenset({"projector"})
LAYOUTS = {
    "opencv": Layout(of_opencv, Content(_SIZES)),
    "scan3d": Layout(of_scanner, Content(_SIZES)),
    "xml": Layout(of_xml),
    "two calibrations": Layout(of_two_calibrations),
    "toolbox": Layout(of_toolbox, Content(_SIZES)),
    "calibrator": Layout(of_calibrator),
    "slstudio": Layout(of_slstudio, Content(tolerance=1e-6)),
    "slcalib": Layout(of_slcalib, Content(_SIZES, tolerance=2e-6)),
    "slmaster": Layout(of_slmaster, Content(_PROJECTOR)),
    "procam": Layout(of_procam, Content(_PROJECTOR)),
    "scanner_sim": Layout(of_scanner_sim),
    "json": Layout(of_json),
    "yaml": Layout(of_yaml),
    "numpy": Layout(of_numpy, Content(_SIZES)),
    "ros": Layout(of_ros),
    "ros topic": Layout(of_ros_topic),
    "kalibr": Layout(of_kalibr, Content(coefficients=4)),
    "zivid": Layout(of_zivid, Content(_SIZES)),
    "scanner text": Layout(of_scanner_text),
    "colmap": Layout(of_colmap, Content(frozenset({"scale"}))),
}
"""Layouts by name."""
