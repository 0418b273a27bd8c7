"""Scores relighting: Cycles renders an asset and the true object under HDRIs that no photo showed.

The capture's folder must hold `transforms_test.json`, `test_masks/` and `scene.blend`, whose object is named `target`. The
asset is the folder that `blender-nep reconstruct` wrote. The scores are PSNR (dB) and SSIM over the pixels of the true
object. Both renderings get the exposure that suits the true one, are clipped at white = 1 and are tone-mapped by
log(1 + 4x) / log 5. The picture has a row for each view; for each light it shows the true object, then the asset. This file
needs the extra `bpy`.

The literature (NeRFactor, TensoIR) multiplies the albedo by one factor a channel before it renders, because photos alone do
not tell a bright object in dim light from a dark object in bright light. Both scores are given: as the asset is, and with
the factors. LPIPS is left out, because the libraries lpips, piq and torchmetrics download the weights of its network.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from PIL import Image
from skimage.metrics import structural_similarity

from backend.rendering.comparison import exposure
from backend.rendering.relight import RelitScene
from backend.scene_io.asset_import import import_asset
from backend.scene_io.capture_files import Frame, read_frames, spread_frames
from backend.scene_io.srgb import linear_to_srgb
from backend.scene_io.world import blender_hdris, build_world
from blender_nep.safety.pictures import open_picture

WORLDS, VIEWS, PIXELS, SAMPLES = 3, 3, 256, 64
OBJECT = "target"


def tone(radiance: np.ndarray) -> np.ndarray:
    """Tone-map radiance x, clipped to 0..1, by log(1 + 4x) / log 5."""
    return np.log1p(4 * radiance.clip(0, 1)) / np.log(5)


def true_object(blend: Path):
    """Load the capture's own object with its material. The object is not linked to a scene yet."""
    with bpy.data.libraries.load(str(blend)) as (source, loaded):
        if OBJECT not in source.objects:
            raise OSError(f"{blend} has no object {OBJECT!r}: it holds {', '.join(source.objects)}")
        loaded.objects = [OBJECT]
    return loaded.objects[0]


def mask(folder: Path, frame: Frame, width: int, height: int) -> np.ndarray:
    """Which pixels lie wholly on the true object: [height, width] bool."""
    file = folder / "test_masks" / f"{frame.path.stem}.png"
    with open_picture(file) as image:
        return np.asarray(image.convert("L").resize((width, height), Image.Resampling.BOX)) > 250


def render(item, frames: list[Frame], lights: list, size: tuple[int, int], threads: int) -> np.ndarray:
    """Render an object from all frames under all lights: linear radiance [view, light, H, W, 3]."""
    with RelitScene(item, *size, SAMPLES) as relit:
        relit.scene.render.threads_mode, relit.scene.render.threads = "FIXED", threads
        return np.array([[relit.render(frame, light) for light in lights] for frame in frames], np.float32)


def truth_file(folder: Path, kept: Path) -> Path:
    """`kept` with a digest in its name: of the true object, the test cameras, the numbers of lights, views and samples."""
    digest = hashlib.sha256(repr((WORLDS, VIEWS, PIXELS, SAMPLES)).encode())
    for name in ("scene.blend", "transforms_test.json"):
        digest.update((folder / name).read_bytes())
    return kept.with_name(f"{kept.stem}-{digest.hexdigest()[:8]}{kept.suffix}")


def rendered_truth(
    folder: Path, frames: list[Frame], lights: list, size: tuple[int, int], threads: int, kept: Path
) -> np.ndarray:
    """What `render` returns for the true object.

    The result is stored in the file `truth_file(folder, kept)`, because all assets of a capture need it.
    """
    kept = truth_file(folder, kept)
    if not kept.is_file():
        images = render(true_object(folder / "scene.blend"), frames, lights, size, threads)
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(f".{os.getpid()}.part.npz")
        np.savez_compressed(part, images=images)
        part.replace(kept)
    return np.load(kept)["images"]


def exposed(true: np.ndarray, ours: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both renderings [H, W, 3], tone-mapped. Their exposure suits the true rendering of the pixels `inside` [H, W]."""
    gain = exposure(true[inside])
    return tone(gain * true), tone(gain * ours)


def exposed_pairs(truth: np.ndarray, ours: np.ndarray, inside: np.ndarray) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """The pairs [view][light] of `exposed` for renderings [view, light, H, W, 3] and pixels `inside` [view, H, W]."""
    return [
        [exposed(a, b, on) for a, b in zip(true, found, strict=True)]
        for true, found, on in zip(truth, ours, inside, strict=True)
    ]


def agreement(pairs: list[list[tuple[np.ndarray, np.ndarray]]], inside: np.ndarray) -> tuple[list[float], list[float]]:
    """(PSNR in dB for each light, SSIM for each light) of tone-mapped pairs [view][light].

    The pixels `inside` [view, H, W] count.
    """
    psnr, ssim = [], []
    for of_light in zip(*pairs, strict=True):
        error = [((a - b) ** 2)[on] for (a, b), on in zip(of_light, inside, strict=True)]
        alike = [
            structural_similarity(a, b, channel_axis=2, data_range=1.0, full=True)[1][on]
            for (a, b), on in zip(of_light, inside, strict=True)
        ]
        psnr.append(float(-10 * np.log10(max(np.concatenate(error).mean(), 1e-12))))
        ssim.append(float(np.concatenate(alike).mean()))
    return psnr, ssim


def scale_base_color(item: bpy.types.Object, factors: Sequence[float]) -> None:
    """Multiply what is linked to Base Color of the object's material by `factors` (red, green, blue; linear)."""
    tree = item.active_material.node_tree
    base = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED").inputs["Base Color"]
    source = base.links[0].from_socket
    product = tree.nodes.new("ShaderNodeMix")
    product.data_type, product.blend_type = "RGBA", "MULTIPLY"
    # Sockets of several types have the same name, so they are told apart by their identifiers.
    sockets = {socket.identifier: socket for socket in (*product.inputs, *product.outputs)}
    sockets["Factor_Float"].default_value = 1.0
    sockets["B_Color"].default_value = (*factors, 1.0)
    tree.links.new(source, sockets["A_Color"])
    tree.links.new(sockets["Result_Color"], base)


def compare(
    folder: Path, asset: Path, picture: Path, kept_truth: Path, threads: int, albedo_ratio: Sequence[float] | None = None
) -> dict:
    """PSNR and SSIM under each light and their means; {} where the capture has no `scene.blend`.

    The renderings are drawn into the file `picture`. With `albedo_ratio` (true albedo divided by the asset's, for each
    channel), `psnr_rescaled` and `ssim_rescaled` are the means for the asset whose albedo is multiplied by it.
    """
    if not (folder / "scene.blend").is_file():
        return {}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    frames = spread_frames(read_frames(folder, "transforms_test.json"), VIEWS)
    lights = [build_world(path, name=path.stem) for path in blender_hdris()[:WORLDS]]
    size = (PIXELS, round(PIXELS * frames[0].height / frames[0].width))
    truth = rendered_truth(folder, frames, lights, size, threads, kept_truth)
    item = import_asset(asset, bpy.context.scene.collection)
    names, inside = [light.name for light in lights], np.array([mask(folder, frame, *size) for frame in frames])
    pairs = exposed_pairs(truth, render(item, frames, lights, size, threads), inside)
    rows = [np.concatenate([linear_to_srgb(np.expm1(np.log(5) * x) / 4) for pair in row for x in pair], 1) for row in pairs]
    Image.fromarray(np.round(255 * np.concatenate(rows)).astype(np.uint8)).save(picture)
    psnr, ssim = agreement(pairs, inside)
    out = {
        "psnr": dict(zip(names, psnr, strict=True)),
        "ssim": dict(zip(names, ssim, strict=True)),
        "psnr_mean": float(np.mean(psnr)),
        "ssim_mean": float(np.mean(ssim)),
    }
    if albedo_ratio is not None:
        scale_base_color(item, albedo_ratio)
        psnr, ssim = agreement(exposed_pairs(truth, render(item, frames, lights, size, threads), inside), inside)
        out |= {"psnr_rescaled": float(np.mean(psnr)), "ssim_rescaled": float(np.mean(ssim))}
    return out
