"""Makes tiny captures for the stress tests with numpy alone: analytic shapes, lit by a few analytic lamps.

A `Case` describes a capture and the job on it. `write_capture` makes the capture's folder, `Case.settings` the settings of
the job. The same case gives the same files. Shapes are sphere-traced, so that the truth needs no mesh. The shading makes one
prefiltered look-up for each lobe. It is no reference: it only gives plausible photos of mirrors, of chalk, and of materials
between them.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from blender_nep.color import linear_to_srgb
from blender_nep.job.runner import Settings
from blender_nep.presets import PRESETS, EnvironmentPreset, FieldsPreset, MaterialPreset, Preset, SurfacePreset

FOCAL = 1.3
"""Focal length over the image's width, for cameras at 2.5 radii. Other cameras have a longer or shorter lens, in proportion
to their distance, so that the object keeps its size in the photo. `Case.zoom` turns that off."""


@dataclass(frozen=True)
class Case:
    """One stress case. The defaults describe a harmless scene. Every field is a quantity that the campaign varies."""

    shape: str = "sphere"
    """sphere, box, plate (0.03 thick), ring, holes (a plate with two holes), nothing"""
    albedo: float = 0.6
    roughness: float = 0.3
    metallic: float = 1.0
    light: str = "lamps"
    """lamps, blinding (one lamp 1e4 times brighter), uniform, dark (1e-4)"""
    views: int = 10
    size: int = 24
    suffix: str = ".exr"
    masks: str = "none"
    """none, files, alpha, wrong (everything but the object)"""
    bounds: str = "given"
    """given, estimated, large (3 radii), small (0.2), elsewhere, zero"""
    scale: float = 1.0
    offset: float = 0.0
    distance: float = 2.5
    """Distance of the cameras, in object radii"""
    zoom: bool = True
    """Whether the lens follows the distance (see FOCAL)"""
    duplicates: str = "none"
    """Cameras at the same place: none, some (the second photo three times), pairs (each twice), all (one place for all)"""
    turntable: str = "none"
    """none; told: the object turns before a still camera, at two heights, and transforms.json says so; untold: it does not;
    walk: transforms.json says so of a walk around the object"""
    roll: float = 0.0
    """Turn of the cameras about their optical axis, in radians. Every other camera is turned the other way."""
    shift: float = 0.0
    """Distance of the principal point from the center, in image widths"""
    pixels: str = "fine"
    """fine, black, white, saturated, nan, inf, negative, huge, one_black, one_nan, most_nan, noise, flat"""
    mesh: str = "none"
    """Mesh that is given to the job: none, true, soup (loose triangles, some degenerate), inside_out"""
    told: str = "auto"
    """What the job is told about the object being metal: auto, yes, no"""
    materials: int = 1
    """Most materials that the palette may hold"""
    explanation: bool = False
    """Whether the job may refuse a sphere that seems empty"""
    threads: int = 1
    bfloat16: bool = False
    """Whether the job runs under torch's autocast to bfloat16"""
    seed: int = 0
    stop: str = "none"
    """stage:step at which the job is stopped, and resumed from disk"""

    def settings(self, capture: Path, out: Path, **changes) -> Settings:
        """The settings of the job that makes the asset `out` from `capture`."""
        preset = tiny_preset()
        metallic = {"auto": (0.0, 1.0), "yes": (1.0,), "no": (0.0,)}[self.told]
        material = replace(preset.material, metallic=metallic, most_materials=self.materials)
        preset = replace(preset, material=material)
        if self.explanation:
            preset = replace(
                preset, fields=replace(preset.fields, least_explanation_ratio=FieldsPreset().least_explanation_ratio)
            )
        mesh = None if self.mesh == "none" else capture / "mesh.obj"
        return Settings(capture, out, preset, device="cpu", seed=self.seed, mesh=mesh, threads=self.threads, **changes)


def tiny_preset() -> Preset:
    """A preset with which a whole job takes about a second: every stage has few steps and coarse grids.

    The job learns little, but it runs all the code.
    """
    preview = PRESETS["preview"]
    return replace(
        preview,
        name="tiny",
        environment_height=16,
        max_pixels_per_photo=900,
        fields=replace(
            FieldsPreset(),
            background_steps=6,
            steps=24,
            colors_first_steps=2,
            object_rays=160,
            sphere_rays=96,
            outside_rays=96,
            coarsest_cells=8,
            first_levels=2,
            last_levels=3,
            head_width=16,
            first_samples=16,
            samples=8,
            validate_every=0.1,
            least_explanation_ratio=0.0,
        ),
        environment=replace(
            EnvironmentPreset(detail_step=2),
            resolutions=((8, 12), (10, 16)),
            refine_at=(0.3,),
            coverage_rays=2000,
            rays_per_step=256,
            steps=30,
        ),
        surface=replace(SurfacePreset(), grid=40, unwrapped_faces=300, faces=600, atlas_texels=128, padding_texels=2),
        material=replace(
            MaterialPreset(),
            samples=250,
            roughness_levels=(0.04, 0.15, 0.4, 1.0),
            irradiance_cones=8,
            terminal_steps=8,
            unseen_rows=8,
            unseen_samples=150,
            unseen_steps=6,
            candidates=6,
            region=0.4,
            rounds=1,
            most_texels=64,
        ),
    )


def signed_distance(shape: str, p: np.ndarray) -> np.ndarray:
    """Signed distances [n] of points [n, 3] to the shape, in a frame where the object's sphere has radius 1."""
    if shape == "sphere":
        return np.linalg.norm(p, axis=-1) - 0.6
    if shape == "ring":
        return np.hypot(np.hypot(p[..., 0], p[..., 1]) - 0.5, p[..., 2]) - 0.16
    half = np.array({"box": (0.45, 0.35, 0.5), "plate": (0.55, 0.015, 0.55), "holes": (0.55, 0.06, 0.55)}[shape])
    q = np.abs(p) - half
    distance = np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(-1), 0)
    if shape == "holes":
        for x in (-0.25, 0.25):
            distance = np.maximum(distance, 0.15 - np.hypot(p[..., 0] - x, p[..., 2]))
    return distance


def trace(shape: str, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays [n, 3] meet the shape, by sphere tracing: (distances [n], outward normals [n, 3]).

    The distance of a ray that meets nothing is infinite.
    """
    along = -(origins * directions).sum(-1)
    miss = np.linalg.norm(origins + along[:, None] * directions, axis=-1) > 1
    t = np.maximum(along - 1, 0)
    if shape == "nothing":
        return np.full(len(t), np.inf), np.zeros_like(origins)
    for _ in range(60):
        t = t + signed_distance(shape, origins + t[:, None] * directions)
    points = origins + t[:, None] * directions
    hit = ~miss & (np.abs(signed_distance(shape, points)) < 1e-3) & (t > 0)
    step = 1e-4 * np.eye(3)
    normal = np.stack([signed_distance(shape, points + e) - signed_distance(shape, points - e) for e in step], -1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return np.where(hit, t, np.inf), normal


def light_from(kind: str, directions: np.ndarray, blur: float) -> np.ndarray:
    """The radiance [n, 3] that comes from unit directions [n, 3], averaged over lobes of about `blur` radians."""
    if kind == "uniform":
        return np.full_like(directions, 0.5)
    rng = np.random.default_rng(5)
    axes = rng.normal(size=(6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    color, sharpness = rng.uniform(0.4, 3.0, (6, 3)), np.array([4, 8, 12, 20, 40, 80.0])
    if kind == "blinding":
        color[5] *= 1e4
    variance = 1 / sharpness + blur**2 / 4
    lobes = 1 / sharpness / variance * np.exp((directions @ axes.T - 1) / variance)
    radiance = 0.15 + 0.1 * directions[:, 2:] + lobes @ color
    return 1e-4 * radiance if kind == "dark" else radiance


def shade(case: Case, normal: np.ndarray, to_eye: np.ndarray) -> np.ndarray:
    """The radiance [n, 3] of the surface: a reflection, blurred by the roughness, plus a diffuse part.

    `normal` [n, 3] and `to_eye` [n, 3] are in the room's frame.
    """
    cosine = np.clip((normal * to_eye).sum(-1, keepdims=True), 0, 1)
    base = case.albedo * np.array([1.0, 0.75, 0.45])
    f0 = case.metallic * base + (1 - case.metallic) * 0.04
    fresnel = f0 + (1 - f0) * (1 - cosine) ** 5 * (1 - case.roughness)
    mirror = light_from(case.light, 2 * cosine * normal - to_eye, 2 * case.roughness**2)
    return fresnel * mirror + (1 - case.metallic) * base * light_from(case.light, normal, 1.5)


def turns(case: Case) -> np.ndarray:
    """The rotations [views, 3, 3] of the object in the room, about the upright axis; the identity where it stands still."""
    matrices = np.tile(np.eye(3), (case.views, 1, 1))
    if case.turntable in ("told", "untold"):
        # the second row begins where the first one began
        angle = 2 * np.pi * np.arange(case.views) / max(1, case.views // 2)
        matrices[:, :2, :2] = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    return matrices[_taken(case)]


def poses(case: Case) -> list[np.ndarray]:
    """The camera-to-world matrices [4, 4] of all views, in the frame of the object's sphere."""
    matrices = []
    for i in range(case.views):
        turn, rise = 2.39996 * i, math.asin(0.85 * math.sin(1.7 * i))
        if case.turntable in ("told", "untold"):
            turn, rise = -2 * math.pi * i / max(1, case.views // 2), 0.2 if i < case.views // 2 else 0.7
        position = case.distance * np.array(
            [math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)]
        )
        back = position / np.linalg.norm(position)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        up = np.cross(back, right)
        roll = case.roll * (-1) ** i
        right, up = math.cos(roll) * right + math.sin(roll) * up, math.cos(roll) * up - math.sin(roll) * right
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, up, back, position], 1)
        matrices.append(matrix)
    return [matrices[i] for i in _taken(case)]


def _taken(case: Case) -> list[int]:
    """For each view, the number of the view whose camera it has."""
    views = range(case.views)
    if case.duplicates == "some":
        return [1 if i in (2, 3) else i for i in views]
    if case.duplicates == "pairs":
        return [i - i % 2 for i in views]
    return [0 if case.duplicates == "all" else i for i in views]


def spoil(case: Case, photo: np.ndarray, view: int) -> np.ndarray:
    """The photo [h, w, 3] with the defect `case.pixels`."""
    rng = np.random.default_rng(1000 + view)
    some = rng.random(photo.shape[:2]) < 0.05
    kind = case.pixels
    if kind == "black":
        return np.zeros_like(photo)
    if kind == "white":
        return np.ones_like(photo)
    if kind == "flat":
        return np.full_like(photo, 0.18)
    if kind == "saturated":
        return np.minimum(8 * photo, 1)
    if kind == "noise":
        return photo * rng.gamma(0.3, 1 / 0.3, photo.shape)
    if kind == "one_black":
        return np.zeros_like(photo) if view == 1 else photo
    if kind == "one_nan":
        return np.full_like(photo, np.nan) if view == 1 else photo
    if kind == "most_nan":
        return np.where((rng.random(photo.shape[:2]) < 0.9)[..., None], np.nan, photo)
    value = {"nan": np.nan, "inf": np.inf, "negative": -3.0, "huge": 1e30}.get(kind)
    return photo if value is None else np.where(some[..., None], value, photo)


def write_capture(case: Case, folder: Path) -> None:
    """Write the capture of a case into `folder`: transforms.json and images/, and masks/ and mesh.obj where it has them."""
    (folder / "images").mkdir(parents=True)
    (folder / "masks").mkdir()
    n = case.size
    focal = FOCAL * n * (case.distance / 2.5 if case.zoom else 1.0)
    cx, cy = n * (0.5 + case.shift), n * (0.5 - 0.5 * case.shift)
    # The object is not at the world's origin. The scale multiplies its place, and the offset moves everything.
    center = case.scale * np.array([0.3, -0.2, 0.5]) + case.offset * np.array([1.0, -0.5, 0.25])
    meta = {"w": n, "h": n, "fl_x": focal, "fl_y": focal, "cx": cx, "cy": cy, "frames": []}
    bounds = {
        "given": (center, 1.0),
        "large": (center, 3.0),
        "small": (center, 0.2),
        "zero": (center, 0.0),
        "elsewhere": (center + 1.5 * case.scale, 0.3),
    }.get(case.bounds)
    if bounds is not None:
        meta |= {"object_center": bounds[0].tolist(), "object_radius": bounds[1] * case.scale}
    y, x = np.mgrid[:n, :n] + 0.5
    local = np.stack([(x - cx) / focal, -(y - cy) / focal, -np.ones_like(x)], -1).reshape(-1, 3)
    if case.turntable in ("told", "walk"):
        meta["turntable"] = True
    for i, (matrix, turn) in enumerate(zip(poses(case), turns(case), strict=True)):
        directions = local @ matrix[:3, :3].T
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        t, normal = trace(case.shape, np.broadcast_to(matrix[:3, 3], directions.shape), directions)
        covered = np.isfinite(t)
        photo = light_from(case.light, directions @ turn.T, 0.0)
        photo[covered] = shade(case, normal[covered] @ turn.T, -directions[covered] @ turn.T)
        photo, coverage = spoil(case, photo.reshape(n, n, 3), i), covered.reshape(n, n).astype(np.float64)
        frame = {"file_path": f"images/{i:03d}{case.suffix}"}
        world = matrix.copy()
        world[:3, 3] = matrix[:3, 3] * case.scale + center
        frame["transform_matrix"] = world.tolist()
        if case.masks == "alpha":
            photo = np.concatenate([photo * coverage[..., None], coverage[..., None]], -1)
        _write_photo(folder / frame["file_path"], photo)
        if case.masks in ("files", "wrong"):
            frame["mask_path"] = f"masks/{i:03d}.png"
            mask = coverage if case.masks == "files" else 1 - coverage
            Image.fromarray(np.round(255 * mask).astype(np.uint8)).save(folder / frame["mask_path"])
        meta["frames"].append(frame)
    (folder / "transforms.json").write_text(json.dumps(meta))
    if case.mesh != "none":
        _write_mesh(case, folder / "mesh.obj", center)


def _write_photo(path: Path, photo: np.ndarray) -> None:
    if path.suffix == ".exr":
        # The channels are float, not half, so that 1e30 does not become infinite.
        channels = {"RGBA"[: photo.shape[-1]]: np.ascontiguousarray(photo, np.float32)}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(str(path))
        return
    photo = np.nan_to_num(photo, posinf=1.0)
    encoded = (
        linear_to_srgb(photo[..., :3])
        if photo.shape[-1] == 3
        else np.concatenate([linear_to_srgb(photo[..., :3]), photo[..., 3:]], -1)
    )
    Image.fromarray(np.round(255 * encoded).astype(np.uint8)).save(path)


def _write_mesh(case: Case, path: Path, center: np.ndarray) -> None:
    from skimage.measure import marching_cubes

    axis = np.linspace(-1, 1, 40)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    shape = "sphere" if case.shape in ("nothing", "plate") else case.shape
    vertices, faces, _, _ = marching_cubes(signed_distance(shape, grid), 0.0)
    vertices = vertices * (2 / 39) - 1
    if case.mesh == "soup":
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
        vertices[:30] = vertices[0]
        faces = np.concatenate([faces, faces[::7, ::-1], faces[:5] * 0])
    if case.mesh == "inside_out":
        faces = faces[:, ::-1]
    vertices = vertices * case.scale + center
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n")
