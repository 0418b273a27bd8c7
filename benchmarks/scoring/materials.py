"""Scores an asset's materials against a capture's `gt/NNN.exr` (albedo, roughness.V, metallic.V, mask.V)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import trimesh
from PIL import Image

from benchmarks.scoring.geometry import Body, camera_rays, true_mesh
from blender_nep.asset.export import TEXTURES
from blender_nep.capture.capture import Capture
from blender_nep.color import linear_to_srgb
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.uv_raster import look_up
from blender_nep.materials.training import Materials

CHANNELS = {"albedo": 3, "roughness": 1, "metallic": 1}


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """The channels of an OpenEXR file: {name: [H, W] or [H, W, C] float32}."""
    return {name: np.asarray(channel.pixels, np.float32) for name, channel in OpenEXR.File(str(path)).channels().items()}


def read_materials(asset: Path) -> Materials:
    """Read the textures of an asset."""
    return Materials(**{name: next(iter(read_channels(asset / "textures" / f"{name}.exr").values())) for name in TEXTURES})


def score(
    surface: Surface, materials: Materials, folder: Path, capture: Capture, test: Capture, picture: Path, shown: int = 3
) -> dict[str, float | list[float]]:
    """The mean squared errors of albedo, roughness and metallic, and the mean and deviation of the true roughness.

    `albedo_ratio` is, for each channel, the median of the true albedo divided by the learned one. The pixels of the test
    views that show both surfaces count. The first `shown` test views are drawn into the file `picture`, with the true values
    beside the learned ones.
    """
    ours, truth = Body(surface.vertices, surface.faces), true_mesh(folder, capture)
    errors: dict[str, list] = {name: [] for name in CHANNELS}
    rows, roughness, ratios = [], [], []
    for view in range(len(test.views)):
        origins, directions, size = camera_rays(test, view, 1)
        gt = read_channels(folder / "gt" / f"{view:03d}.exr")
        point, ray, face = ours.first_hits(origins, directions)
        on_truth = np.zeros(len(origins), bool)
        on_truth[truth.first_hits(origins, directions)[1]] = True
        keep = (gt["mask.V"].ravel()[ray] > 0.99) & on_truth[ray]
        point, ray, face = point[keep], ray[keep], face[keep]
        corners = surface.vertices[surface.faces[face]]
        barycentric = trimesh.triangles.points_to_barycentric(corners, point)
        uv = (surface.uv[surface.faces[face]] * barycentric[..., None]).sum(1)
        strip = []
        for name, channels in CHANNELS.items():
            true = gt[name if name == "albedo" else f"{name}.V"].reshape(len(origins), -1)[:, :channels]
            found = look_up(getattr(materials, name), uv).reshape(len(uv), channels)
            errors[name].append(((found - true[ray]) ** 2).mean(1))
            if name == "albedo":
                ratios.append(true[ray] / found.clip(1e-6))
            for values, at in ((true[ray], ray), (found, ray)):
                image = np.zeros((len(origins), 3), np.float32)
                image[at] = linear_to_srgb(values) if name == "albedo" else values
                strip.append(image.reshape(*size, 3))
        roughness.append(gt["roughness.V"].ravel()[ray])
        if view < shown:
            rows.append(np.concatenate(strip, 1))
    picture.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((np.concatenate(rows).clip(0, 1) * 255).astype(np.uint8)).save(picture)
    known = np.concatenate(roughness)
    return {f"mse_{name}": float(np.concatenate(values).mean()) for name, values in errors.items()} | {
        "albedo_ratio": [float(ratio) for ratio in np.median(np.concatenate(ratios), 0)],
        "true_roughness": float(known.mean()),
        "true_roughness_deviation": float(known.std()),
    }
