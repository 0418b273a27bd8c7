"""Known cameras, written as other programs write them, and each format's own formula of projection.

A writer returns formulas, one a camera: `formula(points)` gives the image positions u, v [n] of points [n, 3], from the
numbers that stand in the file. They are in pixels, with the center of the first one at 0.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import NO_DISTORTION, Lens
from support.captures import look_at

Formula = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
WIDTH, HEIGHT = 64, 48
NAMES = ["a.png", "b 2.png", "c.png", "d.png"]
TARGET = np.array([0.4, -0.3, 0.2])


def known_cameras(lens: Lens = NO_DISTORTION, *, centered: bool = False, square: bool = True) -> list[Camera]:
    """Four cameras around TARGET, each rolled and with a focal length of its own. `centered`: cx, cy are the middle."""
    cameras = []
    for i in range(len(NAMES)):
        turn, roll = 1.4 * i, 0.3 + 0.5 * i
        matrix = look_at(TARGET + np.array([3 * np.cos(turn), 3 * np.sin(turn), 0.4 + 0.5 * i]), TARGET)
        c, s = np.cos(roll), np.sin(roll)
        matrix[:3, :3] = matrix[:3, :3] @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        cx, cy = (WIDTH / 2, HEIGHT / 2) if centered else (WIDTH / 2 + 1.7, HEIGHT / 2 - 2.3)
        focal = 70.0 + 3 * i
        cameras.append(Camera(WIDTH, HEIGHT, focal if square else focal + 1.5, focal, cx, cy, matrix, lens))
    return cameras


def write_photos(folder: Path, names: list[str] = NAMES, size: tuple[int, int] = (WIDTH, HEIGHT)) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", size).save(path)


def write_llff(folder: Path, cameras: list[Camera]) -> list[Formula]:
    write_photos(folder / "images")
    rows = []
    for camera in cameras:
        right, up, back, position = camera.camera_to_world[:3].T
        hwf = np.array([camera.height, camera.width, camera.fl_x])
        rows.append([*np.stack([-up, right, back, position, hwf], 1).ravel(), 1.0, 9.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))

    def formula(row: list[float]) -> Formula:
        def project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            down, right, backwards, position, (height, width, focal) = np.reshape(row[:15], (3, 5)).T
            seen = points - position
            depth = -(seen @ backwards)
            return width / 2 + focal * (seen @ right) / depth, height / 2 + focal * (seen @ down) / depth

        return project

    return [formula(row) for row in rows]


def write_cameras_sphere(
    folder: Path, cameras: list[Camera], file: str = "cameras_sphere.npz", sphere: bool = True, skew: float = 0.0
) -> list[Formula]:
    """The object's sphere is around TARGET, with radius 0.7. `skew` in focal lengths, beside that of the lens."""
    write_photos(folder / "image")
    stored, formulas = {}, []
    for i, camera in enumerate(cameras):
        intrinsics = np.array(
            [
                [camera.fl_x, (skew + camera.lens.skew) * camera.fl_x, camera.cx - 0.5],
                [0, camera.fl_y, camera.cy - 0.5],
                [0, 0, 1],
            ]
        )
        world = np.eye(4)
        world[:3] = intrinsics @ np.linalg.inv(camera.camera_to_world @ np.diag([1, -1, -1, 1]))[:3]
        stored[f"world_mat_{i}"], stored[f"world_mat_inv_{i}"] = world, np.linalg.inv(world)
        if sphere:
            stored[f"scale_mat_{i}"] = np.diag([0.7, 0.7, 0.7, 1])
            stored[f"scale_mat_{i}"][:3, 3] = TARGET

        def formula(points: np.ndarray, world: np.ndarray = world) -> tuple[np.ndarray, np.ndarray]:
            x, y, d = world[:3] @ np.vstack([points.T, np.ones(len(points))])
            return x / d + 0.5, y / d + 0.5

        formulas.append(formula)
    np.savez(folder / file, **stored)
    return formulas


def write_bundler(folder: Path, cameras: list[Camera], names: list[str] = NAMES, flip: float = 1.0) -> list[Formula]:
    """With 50 points. `flip` -1: the axes y and z are turned around, as in RealityScan's export with positive z."""
    write_photos(folder, names)
    rng = np.random.default_rng(2)
    points = TARGET + rng.uniform(-0.5, 0.5, (50, 3))
    lines, formulas = ["# Bundle file v0.3", f"{len(cameras)} {len(points)}"], []
    for camera in cameras:
        rotation = (camera.camera_to_world[:3, :3] * [1, flip, flip]).T
        translation = -rotation @ camera.position
        f, k1, k2 = camera.fl_x, camera.lens.k1, camera.lens.k2
        lines += [" ".join(map(repr, map(float, row))) for row in ([f, k1, k2], *rotation, translation)]

        def formula(
            points: np.ndarray, f=f, k1=k1, k2=k2, rotation=rotation, translation=translation
        ) -> tuple[np.ndarray, np.ndarray]:
            at = points @ rotation.T + translation
            p = -at[:, :2] / at[:, 2:]
            squared = (p**2).sum(1)
            pixels = f * (1.0 + k1 * squared + k2 * squared**2)[:, None] * p
            return WIDTH / 2 + pixels[:, 0], HEIGHT / 2 - pixels[:, 1]

        formulas.append(formula)
    for point in points:
        lines += [" ".join(map(str, point)), "200 10 10", "2 0 17 1.5 -2.5 2 18 0.5 0.25"]
    (folder / "bundle.out").write_text("\n".join(lines) + "\n")
    (folder / "list.txt").write_text("\n".join(names) + "\n")
    return formulas


def similarity(seed: int, distance: float = 2.0) -> tuple[np.ndarray, np.ndarray, float]:
    """A rotation, a translation and a scale."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return turn * np.sign(np.linalg.det(turn)), distance * rng.normal(size=3), float(rng.uniform(0.5, 2))


def write_metashape(
    folder: Path,
    cameras: list[Camera],
    *,
    transform: tuple[np.ndarray, np.ndarray, float] | None = None,
    of_component: bool = False,
    reference: str = "",
    kind: str = "frame",
    terms: str = "",
    more_cameras: str = "",
) -> list[Formula]:
    """Every camera has a sensor of its own. `transform` is that of the chunk or component. `terms` go to all sensors."""
    write_photos(folder / "images")
    turn, shift, scale = transform or (np.eye(3), np.zeros(3), 1.0)
    part = "" if transform is None else _transform_text(turn, shift, scale)
    sensors, entries, formulas = [], [], []
    for i, camera in enumerate(cameras):
        # P1 and P2 are swapped in `lens`, but not in the formula below, which is the manual's.
        lens = replace(camera.lens, p1=camera.lens.p2, p2=camera.lens.p1)
        numbers = {name: getattr(lens, name) for name in ("k1", "k2", "k3", "k4", "p1", "p2")}
        numbers |= {"f": camera.fl_y, "b1": camera.fl_x - camera.fl_y, "cx": camera.cx - WIDTH / 2}
        numbers |= {"cy": camera.cy - HEIGHT / 2, "b2": camera.lens.skew * camera.fl_x}
        sensors.append(
            f'<sensor id="{i}" label="lens {i}" type="{kind}"><resolution width="{WIDTH}" height="{HEIGHT}"/>'
            f'<calibration type="{kind}" class="initial"><f>1</f></calibration><calibration type="{kind}" class="adjusted">'
            f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
            + "".join(f"<{name}>{value!r}</{name}>" for name, value in numbers.items() if value or name == "f")
            + f"{terms}</calibration></sensor>"
        )
        matrix = np.eye(4)
        matrix[:3, :3] = turn.T @ camera.camera_to_world[:3, :3] * [1, -1, -1]
        matrix[:3, 3] = turn.T @ (camera.position - shift) / scale
        text = " ".join(map(repr, map(float, matrix.ravel())))
        label = NAMES[i] if i % 2 else Path(NAMES[i]).stem
        entries.append(
            f'<camera id="{i}" sensor_id="{i}" component_id="0" label="{label}"><transform>{text}</transform></camera>'
        )
        formulas.append(_metashape_formula(matrix, numbers, kind, (turn, shift, scale)))
    (folder / "cameras.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1" enabled="true">'
        f'<sensors next_id="9">{"".join(sensors)}</sensors>\n<components next_id="1"><component id="0">'
        f'{part if of_component else ""}</component></components>\n<cameras next_id="9">{entries[0]}{more_cameras}'
        f'<group id="0" label="Group 1">{"".join(entries[1:])}</group></cameras>\n<reference>{reference}</reference>'
        f"{'' if of_component else part}</chunk></document>\n"
    )
    return formulas


def _transform_text(turn: np.ndarray, shift: np.ndarray, scale: float) -> str:
    rotation, translation = (" ".join(map(repr, map(float, values.ravel()))) for values in (turn, shift))
    return (
        f'<transform><rotation locked="true">{rotation}</rotation><translation locked="true">{translation}</translation>'
        f'<scale locked="true">{scale!r}</scale></transform>'
    )


def _metashape_formula(
    matrix: np.ndarray, numbers: dict[str, float], kind: str, transform: tuple[np.ndarray, np.ndarray, float]
) -> Formula:
    """The formulas of the manual's appendix on camera models, for frame and equidistant fisheye cameras."""

    def project(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn, shift, scale = transform
        in_chunk = np.hstack([(points - shift) @ turn / scale, np.ones((len(points), 1))])
        X, Y, Z, _ = np.linalg.inv(matrix) @ in_chunk.T
        x, y = X / Z, Y / Z
        if kind != "frame":
            r0 = np.sqrt(x**2 + y**2)
            x, y = x * np.arctan(r0) / r0, y * np.arctan(r0) / r0
        f, b1, b2, cx, cy, k1, k2, k3, k4, p1, p2 = (
            numbers[name] for name in ("f", "b1", "b2", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")
        )
        r = np.sqrt(x**2 + y**2)
        radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6 + k4 * r**8
        x_, y_ = (
            x * radial + (p1 * (r**2 + 2 * x**2) + 2 * p2 * x * y),
            y * radial + (p2 * (r**2 + 2 * y**2) + 2 * p1 * x * y),
        )
        return WIDTH * 0.5 + cx + x_ * f + x_ * b1 + y_ * b2, HEIGHT * 0.5 + cy + y_ * f

    return project
