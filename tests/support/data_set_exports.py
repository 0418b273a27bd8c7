"""Known cameras as data sets of research and the XMP files of RealityScan have them, and their own formulas.

As in `camera_exports.py`, a writer returns one formula a camera, from the numbers that stand in the file.
"""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from support.camera_exports import HEIGHT, NAMES, WIDTH, Formula, write_photos
from support.peer_exports import SIDE, axis_angle, brown, formula_of, round_lens, to_camera

STEMS = [Path(name).stem for name in NAMES]


def straight(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([x, y])


def of_projection(projection: np.ndarray) -> Formula:
    """The formula of a matrix [3, 4] that leads from the world to pixels."""

    def project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, d = projection @ np.vstack([points.T, np.ones(len(points))])
        return x / d, y / d

    return project


def matrices(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The pose [4, 4] from the world to OpenCV's axes, and the matrix K [3, 3]."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = to_camera(camera)
    k = np.array([[camera.fl_x, camera.lens.skew * camera.fl_x, camera.cx], [0, camera.fl_y, camera.cy], [0, 0, 1]])
    return pose, k


def write_realityscan_xmp(folder: Path, cameras: list[Camera], model: str = "brown4t2", place: str = "") -> list[Formula]:
    """The values are attributes, but for the pose, as in RealityScan's files. One more photo has no pose."""
    write_photos(folder / place, [*NAMES, "unplaced.png"])
    texts, formulas = {"unplaced": ("", "")}, []
    for stem, camera in zip(STEMS, cameras, strict=True):
        rotation, translation = to_camera(camera)
        focal, u, v = 36 * camera.fl_x / SIDE, (camera.cx - WIDTH / 2) / SIDE, (camera.cy - HEIGHT / 2) / SIDE
        lens = camera.lens
        k, t1, t2 = [lens.k1, lens.k2, lens.k3, lens.k4], lens.p2, lens.p1
        terms = " ".join(map(repr, [*k, t1, t2]))
        numbers = (" ".join(map(repr, map(float, values))) for values in (rotation.ravel(), camera.position))
        pose = "<xcr:Rotation>{}</xcr:Rotation><xcr:Position>{}</xcr:Position>".format(*numbers)
        said = f'FocalLength35mm="{focal!r}" xcr:PrincipalPointU="{u!r}" xcr:PrincipalPointV="{v!r}"'
        texts[stem] = f'{said} xcr:DistortionModel="{model}" xcr:DistortionCoeficients="{terms}"', pose

        def distort(x: np.ndarray, y: np.ndarray, k=k, t1=t1, t2=t2) -> np.ndarray:
            return brown(x, y, k, to_x=t1, to_y=t2)

        scale, center = focal * SIDE / 36, (WIDTH / 2 + u * SIDE, HEIGHT / 2 + v * SIDE)
        formulas.append(formula_of(rotation, translation, distort, scale, scale, *center))
    for stem, (said, pose) in texts.items():
        said = said or 'FocalLength35mm="30"'
        (folder / place / f"{stem}.xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
            '<rdf:Description xcr:Version="3" xcr:Skew="0" xcr:AspectRatio="1" '
            f'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:{said}>{pose}</rdf:Description>\n'
            "</rdf:RDF></x:xmpmeta>\n"
        )
    return formulas


def write_openmvg(folder: Path, cameras: list[Camera], kind: str = "disto_t2", newer: bool = False) -> list[Formula]:
    """`kind`: disto_k3, disto_t2, fisheye, or empty. `newer`: a part of the intrinsics stands in `value0`."""
    write_photos(folder / "images")
    terms = {
        "": (),
        "disto_k3": ("k1", "k2", "k3"),
        "disto_t2": ("k1", "k2", "k3", "p1", "p2"),
        "fisheye": ("k1", "k2", "k3", "k4"),
    }
    scene: dict = {"sfm_data_version": "0.3", "root_path": "/home/other/photos"}
    scene |= {"views": [], "intrinsics": [], "extrinsics": []}
    formulas = []

    def wrapped(data: dict) -> dict:
        return {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 2147483649, "data": data}}

    for i, (name, camera) in enumerate(zip([*NAMES, "unplaced.png"], [*cameras, cameras[0]], strict=True)):
        view = {"local_path": "/", "filename": name, "width": WIDTH, "height": HEIGHT, "id_view": i, "id_intrinsic": i}
        scene["views"].append({"key": i, "value": wrapped(view | {"id_pose": i})})
        if i == len(cameras):
            break
        rotation, translation = to_camera(camera)
        params = [getattr(camera.lens, term) for term in terms[kind]]
        data: dict = {
            "width": WIDTH,
            "height": HEIGHT,
            "focal_length": camera.fl_x,
            "principal_point": [camera.cx, camera.cy],
        }
        data = ({"value0": data} if newer else data) | ({kind: params} if kind else {})
        scene["intrinsics"].append({"key": i, "value": wrapped(data)})
        pose = {"rotation": rotation.tolist(), "center": camera.position.tolist()}
        scene["extrinsics"].append({"key": i, "value": pose})

        def distort(x: np.ndarray, y: np.ndarray, params=params) -> np.ndarray:
            if kind == "fisheye":
                return round_lens(x, y, params)
            t1, t2 = params[3:] or (0.0, 0.0)
            return brown(x, y, params[:3], to_x=t2, to_y=t1)

        formulas.append(formula_of(rotation, translation, distort, camera.fl_x, camera.fl_x, camera.cx, camera.cy))
    (folder / "sfm_data.json").write_text(json.dumps(scene))
    return formulas


def write_record3d(folder: Path, cameras: list[Camera], each: bool = True) -> list[Formula]:
    """`each`: every photo has intrinsics of its own; else the first camera's K counts for all."""
    write_photos(folder / "rgb", [f"{i}.jpg" for i in range(len(cameras))])
    poses, formulas = [], []
    for camera in cameras:
        matrix = camera.camera_to_world[[1, 2, 0]]  # ARKit: y is up. Our x, y, z are its z, x, y.
        vector = axis_angle(matrix[:, :3])
        half = np.linalg.norm(vector) / 2
        poses.append([*(np.sin(half) * vector / (2 * half)), np.cos(half), *matrix[:, 3]])
        inner = camera if each else cameras[0]

        def project(points: np.ndarray, matrix=matrix, inner=inner) -> tuple[np.ndarray, np.ndarray]:
            x, y, z = matrix[:, :3].T @ (points[:, [1, 2, 0]] - matrix[:, 3]).T
            return inner.cx - inner.fl_x * x / z, inner.cy + inner.fl_y * y / z

        formulas.append(project)
    said = {"w": WIDTH, "h": HEIGHT, "K": matrices(cameras[0])[1].ravel(order="F").tolist(), "fps": 60, "poses": poses}
    if each:
        said["perFrameIntrinsicCoeffs"] = [[camera.fl_x, camera.fl_y, camera.cx, camera.cy] for camera in cameras]
    (folder / "metadata.json").write_text(json.dumps(said))
    return formulas


def write_sdfstudio(folder: Path, cameras: list[Camera]) -> list[Formula]:
    write_photos(folder)
    frames, formulas = [], []
    for name, camera in zip(NAMES, cameras, strict=True):
        pose, k = matrices(camera)
        inner = np.eye(4)
        inner[:3, :3] = k
        frames.append({"rgb_path": name, "camtoworld": np.linalg.inv(pose).tolist(), "intrinsics": inner.tolist()})
        formulas.append(of_projection(k @ pose[:3]))
    said = {"camera_model": "OPENCV", "height": HEIGHT, "width": WIDTH, "frames": frames, "worldtogt": np.eye(4).tolist()}
    (folder / "meta_data.json").write_text(json.dumps(said))
    return formulas


def write_mvsnet(folder: Path, cameras: list[Camera]) -> list[Formula]:
    write_photos(folder / "blended_images", [f"{stem}.jpg" for stem in STEMS] + [f"{stem}_masked.jpg" for stem in STEMS])
    (folder / "cams").mkdir()
    (folder / "cams" / "pair.txt").write_text("1\n0\n1 1 0.5\n")
    formulas = []
    for stem, camera in zip(STEMS, cameras, strict=True):
        pose, k = matrices(camera)
        parts = ["\n".join(" ".join(map(repr, map(float, row))) for row in matrix) for matrix in (pose, k)]
        text = f"extrinsic\n{parts[0]}\n\nintrinsic\n{parts[1]}\n\n0.5 0.01 128 2.0\n"
        (folder / "cams" / f"{stem}_cam.txt").write_text(text)
        formulas.append(of_projection(k @ pose[:3]))
    return formulas


def write_nero(folder: Path, cameras: list[Camera], protocol: int = 4) -> list[Formula]:
    write_photos(folder, [f"{stem}.png" for stem in STEMS] + [f"{stem}-depth.png" for stem in STEMS])
    formulas = []
    for stem, camera in zip(STEMS, cameras, strict=True):
        pose, k = matrices(camera)
        (folder / f"{stem}-camera.pkl").write_bytes(pickle.dumps((pose[:3], k), protocol))
        formulas.append(of_projection(k @ pose[:3]))
    return formulas


def write_gaussians(folder: Path, cameras: list[Camera]) -> list[Formula]:
    write_photos(folder / "images")
    entries, formulas = [], []
    for i, (stem, camera) in enumerate(zip(STEMS, cameras, strict=True)):
        rotation, translation = to_camera(camera)
        pose = {"position": camera.position.tolist(), "rotation": rotation.T.tolist()}
        size = {"width": WIDTH, "height": HEIGHT, "fx": camera.fl_x, "fy": camera.fl_y}
        entries.append({"id": i, "img_name": stem, **pose, **size})
        center = WIDTH / 2, HEIGHT / 2
        formulas.append(formula_of(rotation, translation, straight, camera.fl_x, camera.fl_y, *center))
    (folder / "cameras.json").write_text(json.dumps(entries))
    return formulas
