"""Known cameras, written as RealityScan, Meshroom, OpenSfM, VisualSFM and Polycam write them, and their own formulas.

As in `camera_exports.py`, a writer returns one formula a camera, from the numbers that stand in the file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from support.camera_exports import HEIGHT, NAMES, WIDTH, Formula, write_photos

SIDE = max(WIDTH, HEIGHT)
REALITYSCAN = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"
NEWER_REALITYSCAN = "#name,x,y,alt,yaw,pitch,roll,f_35mm,px_norm,py_norm,k1,k2,k3,k4,t1,t2"


def to_camera(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The rotation [3, 3] and translation [3] from the world to OpenCV's axes."""
    rotation = (camera.camera_to_world[:3, :3] * [1, -1, -1]).T
    return rotation, -rotation @ camera.position


def brown(x: np.ndarray, y: np.ndarray, k: list[float], to_x: float = 0.0, to_y: float = 0.0) -> np.ndarray:
    """Brown's distortion. `to_x` is the term that has r^2 + 2 x^2 in x, `to_y` the one that has r^2 + 2 y^2 in y."""
    s = x * x + y * y
    radial = 1 + sum(term * s ** (n + 1) for n, term in enumerate(k))
    return np.stack(
        [
            x * radial + to_x * (s + 2 * x * x) + 2 * to_y * x * y,
            y * radial + to_y * (s + 2 * y * y) + 2 * to_x * x * y,
        ]
    )


def round_lens(x: np.ndarray, y: np.ndarray, k: list[float]) -> np.ndarray:
    """The distortion of a fisheye: theta (1 + k1 theta^2 + ...) from the middle."""
    radius = np.hypot(x, y)
    theta = np.arctan(radius)
    return np.stack([x, y]) / radius * theta * (1 + sum(term * theta ** (2 * n + 2) for n, term in enumerate(k)))


def formula_of(
    rotation: np.ndarray,
    translation: np.ndarray,
    distort: Callable[..., np.ndarray],
    fx: float,
    fy: float,
    cx: float,
    cy: float,
) -> Formula:
    def project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = rotation @ points.T + translation[:, None]
        u, v = distort(x / z, y / z)
        return cx + fx * u, cy + fy * v

    return project


def write_realityscan(folder: Path, cameras: list[Camera], header: str = REALITYSCAN, shift: float = 0.0) -> list[Formula]:
    """The formula is that of Epic's FromYPR, with the angles yaw, pitch and roll of an aircraft: north, east, down."""
    write_photos(folder)
    lines, formulas = ["#cameras 4", header], []
    for name, camera in zip(NAMES, cameras, strict=True):
        # World to camera at angles 0: x to the east, y of the photo to the south, z down.
        rotation, _ = to_camera(camera)
        pitch = np.arcsin(-rotation[1, 2])
        roll = np.arctan2(-rotation[0, 2], -rotation[2, 2])
        yaw = np.arctan2(-rotation[1, 0], -rotation[1, 1])
        cx, cy, sx, sy = np.cos(roll), np.cos(pitch), np.sin(roll), np.sin(pitch)
        cz, sz = np.cos(yaw), np.sin(yaw)
        euler = np.array(
            [
                [cx * cz + sx * sy * sz, -cx * sz + cz * sx * sy, -cy * sx],
                [-cy * sz, -cy * cz, -sy],
                [cx * sy * sz - cz * sx, cx * cz * sy + sx * sz, -cx * cy],
            ]
        )
        lens = camera.lens
        focal, px, py = 36 * camera.fl_x / SIDE, (camera.cx - WIDTH / 2) / SIDE, (camera.cy - HEIGHT / 2) / SIDE
        t1, t2 = lens.p2, lens.p1
        k = [lens.k1, lens.k2, lens.k3, lens.k4]
        place = camera.position + np.array([shift, 2 * shift, 0])
        values = [*place, *np.degrees([yaw, pitch, roll]), focal, px, py, *k, t1, t2]
        lines.append(",".join([name, *(repr(float(value)) for value in values)]))

        def distort(x: np.ndarray, y: np.ndarray, k=k, t1=t1, t2=t2) -> np.ndarray:
            return brown(x, y, k, to_x=t1, to_y=t2)

        scale = focal / 36 * SIDE
        center = WIDTH / 2 + px * SIDE, HEIGHT / 2 + py * SIDE
        formulas.append(formula_of(euler, -euler @ camera.position, distort, scale, scale, *center))
    (folder / "export.csv").write_text("\n".join(lines) + "\n")
    return formulas


def write_meshroom(
    folder: Path, cameras: list[Camera], kind: str = "brown", version: tuple[int, int, int] = (1, 2, 6)
) -> list[Formula]:
    """`kind`: radial3, brown or fisheye. All numbers are text, as boost's property trees have them."""
    write_photos(folder / "images")
    terms = {"radial3": ("k1", "k2", "k3"), "brown": ("k1", "k2", "k3", "p1", "p2"), "fisheye": ("k1", "k2", "k3", "k4")}
    views, intrinsics, poses, formulas = [], [], [], []
    for i, (name, camera) in enumerate(zip(NAMES, cameras, strict=True)):
        rotation, translation = to_camera(camera)
        offset = [0.0, 0.0] if version >= (1, 2, 1) else [WIDTH / 2, HEIGHT / 2]
        params = [getattr(camera.lens, term) for term in terms[kind]]
        entry = {
            "intrinsicId": str(70 + i),
            "width": str(WIDTH),
            "height": str(HEIGHT),
            "type": kind,
            "principalPoint": [str(camera.cx - WIDTH / 2 + offset[0]), str(camera.cy - HEIGHT / 2 + offset[1])],
            "distortionParams": [repr(value) for value in params],
        }
        if version < (1, 2, 0):
            entry["pxFocalLength"] = repr(camera.fl_x)
        elif version < (1, 2, 2):
            entry["pxFocalLength"] = [repr(camera.fl_x), repr(camera.fl_y)]
        else:
            ratio = camera.fl_x / camera.fl_y
            entry |= {"sensorWidth": "23.5", "focalLength": repr(23.5 * camera.fl_x / WIDTH)}
            entry["pixelRatio"] = repr(ratio if version < (1, 2, 5) else 1 / ratio)
        intrinsics.append(entry)
        views.append({"viewId": str(i), "poseId": str(i), "intrinsicId": str(70 + i), "path": f"D:/scan/{name}"})
        columns = [repr(float(value)) for value in rotation.ravel(order="F")]
        center = [repr(float(value)) for value in camera.position]
        transform = {"rotation": columns, "center": center}
        poses.append({"poseId": str(i), "pose": {"transform": transform, "locked": "0"}})

        def distort(x: np.ndarray, y: np.ndarray, params=params) -> np.ndarray:
            if kind == "fisheye":
                return round_lens(x, y, params)
            t1, t2 = params[3:] or (0.0, 0.0)
            return brown(x, y, params[:3], to_x=t2, to_y=t1)

        formulas.append(formula_of(rotation, translation, distort, camera.fl_x, camera.fl_y, camera.cx, camera.cy))
    views.append({"viewId": "9", "poseId": "9", "intrinsicId": "70", "path": "D:/scan/unplaced.png"})
    scene = {"version": [str(part) for part in version], "views": views, "intrinsics": intrinsics, "poses": poses}
    (folder / "cameras.sfm").write_text(json.dumps(scene))
    return formulas


def axis_angle(rotation: np.ndarray) -> np.ndarray:
    """The axis of a rotation [3, 3], as long as its angle in radians: the eigenvector of the eigenvalue 1."""
    values, vectors = np.linalg.eig(rotation)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    sine = axis @ [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]] / 2
    return axis * np.arctan2(sine, (np.trace(rotation) - 1) / 2)


def write_opensfm(folder: Path, cameras: list[Camera], kind: str = "brown", place: str = "") -> list[Formula]:
    """`kind`: perspective, brown, fisheye or fisheye_opencv. A second, smaller reconstruction has one more photo."""
    write_photos(folder / "images")
    terms = {
        "perspective": ("k1", "k2"),
        "brown": ("k1", "k2", "k3", "p1", "p2"),
        "fisheye": ("k1", "k2"),
        "fisheye_opencv": ("k1", "k2", "k3", "k4"),
    }
    models, shots, formulas = {}, {}, []
    for name, camera in zip(NAMES, cameras, strict=True):
        rotation, translation = to_camera(camera)
        said = {term: getattr(camera.lens, term) for term in terms[kind]}
        model = {"projection_type": kind, "width": WIDTH, "height": HEIGHT, **said}
        if kind in ("perspective", "fisheye"):
            model["focal"] = camera.fl_x / SIDE
        else:
            model |= {"focal_x": camera.fl_x / SIDE, "focal_y": camera.fl_y / SIDE}
            model |= {"c_x": (camera.cx - WIDTH / 2) / SIDE, "c_y": (camera.cy - HEIGHT / 2) / SIDE}
        models[f"v2 {name}"] = model
        vector = axis_angle(rotation)
        shots[name] = {"rotation": vector.tolist(), "translation": translation.tolist(), "camera": f"v2 {name}"}

        def distort(x: np.ndarray, y: np.ndarray, said=said) -> np.ndarray:
            k = [value for term, value in said.items() if term[0] == "k"]
            if "fisheye" in kind:
                return round_lens(x, y, k)
            return brown(x, y, k, to_x=said.get("p2", 0.0), to_y=said.get("p1", 0.0))

        formulas.append(formula_of(rotation, translation, distort, camera.fl_x, camera.fl_y, camera.cx, camera.cy))
    other = {"cameras": models, "shots": {"lost.png": shots[NAMES[0]]}, "points": {}}
    (folder / place).mkdir(parents=True, exist_ok=True)
    path = folder / place / "reconstruction.json"
    path.write_text(json.dumps([other, {"cameras": models, "shots": shots, "points": {}}]))
    return formulas


def write_visualsfm(folder: Path, cameras: list[Camera], radial: float = 0.0, fixed: bool = False) -> list[Formula]:
    """`fixed`: the first line has the intrinsics, which all cameras must share. One point is written, too."""
    write_photos(folder)
    first = cameras[0]
    intrinsics = f" FixedK {first.fl_x!r} {first.cx!r} {first.fl_y!r} {first.cy!r} 0" if fixed else ""
    lines, formulas = [f"NVM_V3{intrinsics}", "", str(len(cameras))], []
    for name, camera in zip(NAMES, cameras, strict=True):
        rotation, translation = to_camera(camera)
        vector = axis_angle(rotation)
        half = np.linalg.norm(vector) / 2
        quaternion = [np.cos(half), *(np.sin(half) * vector / (2 * half))]
        values = [camera.fl_x, *quaternion, *camera.position, radial, 0]
        lines.append(" ".join([name.replace(" ", '"'), *(repr(float(value)) for value in values)]))

        def distort(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            """The place u with u (1 + radial |u|^2) = (x, y), by halving."""
            ray = np.hypot(x, y)
            low, high = np.zeros_like(ray), np.full_like(ray, 1.0)
            for _ in range(60):
                middle = (low + high) / 2
                short = middle * (1 + radial * middle**2) < ray
                low, high = np.where(short, middle, low), np.where(short, high, middle)
            return np.stack([x, y]) / ray * low

        formulas.append(formula_of(rotation, translation, distort, camera.fl_x, camera.fl_y, camera.cx, camera.cy))
    lines += ["", "1", "0 0 0 200 10 10 1 0 17 1.5 -2.5", "", "1", "lost.png 100 1 0 0 0 0 0 0 0 0", "0", "0"]
    (folder / "model.nvm").write_text("\n".join(lines) + "\n")
    return formulas


def write_polycam(folder: Path, cameras: list[Camera], corrected: bool = True) -> list[Formula]:
    """`corrected`: Polycam has improved the cameras, and those that the phone measured are others."""
    stems = [Path(name).stem for name in NAMES]
    for name in ("corrected_images", "images") if corrected else ("images",):
        write_photos(folder / "keyframes" / name, [f"{stem}.jpg" for stem in stems])
    formulas = []
    for stem, camera in zip(stems, cameras, strict=True):
        # ARKit: y is up. Our x, y, z are its z, x, y.
        matrix = camera.camera_to_world[[1, 2, 0]]
        rows = {f"t_{row}{column}": matrix[row, column] for row in range(3) for column in range(4)}
        inner = {"fx": camera.fl_x, "fy": camera.fl_y, "cx": camera.cx, "cy": camera.cy, "width": WIDTH, "height": HEIGHT}
        moved = rows | {"t_03": rows["t_03"] + 0.5}
        for name in ("corrected_cameras", "cameras") if corrected else ("cameras",):
            path = folder / "keyframes" / name / f"{stem}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps((moved if corrected and name == "cameras" else rows) | inner))

        def project(points: np.ndarray, matrix=matrix, camera=camera) -> tuple[np.ndarray, np.ndarray]:
            """ARKit's camera: x right, y up, looking along -z, in a world whose y is up."""
            x, y, z = matrix[:, :3].T @ (points[:, [1, 2, 0]] - matrix[:, 3]).T
            return camera.cx - camera.fl_x * x / z, camera.cy + camera.fl_y * y / z

        formulas.append(project)
    return formulas
