"""Scores an asset by photos that it was not learned from, without a truth: Cycles renders it in its own recovered light.

    blender-nep reconstruct CAPTURE --out ASSET --hold-out 8
    python -m benchmarks.scoring.held_out CAPTURE ASSET

prints one JSON row. The held-out photos are those of the job, or the test photos where the capture has some and the job
learned from all others. The light is `environment.exr`, which lies at infinity. So an asset whose surroundings are near
scores lower here than in its own report, where its light comes from all of F_e. Blender's cameras have no lens distortion.
The surroundings are scored where the asset still has the checkpoint of stage 1. This file needs the extra `bpy`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import bpy
import numpy as np
import torch

from backend.rendering.relight import RelitScene
from backend.scene_io.capture_files import Frame
from backend.scene_io.result import import_result
from benchmarks.row_files import read_row
from benchmarks.scoring.environment import response_of
from benchmarks.scoring.geometry import load_test_views
from blender_nep.asset.photo_score import PhotoScore, photo_score
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.capture import Capture
from blender_nep.capture.held_out import split
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.checkpoints import load_state
from blender_nep.errors import UsageError
from blender_nep.fields.fields import Fields
from blender_nep.job.stage_names import StageName
from blender_nep.job.stages import surface_result
from blender_nep.materials.explained_photos import behind, shows_support
from blender_nep.presets import preset
from blender_nep.support.plane import Support

PIXELS, SAMPLES = 40_000, 16
"""Most pixels of a photo, and Cycles samples a pixel. Renderings are denoised."""
_WHOLE, _NONE = 0.98, 0.02
"""A pixel shows the object if it is covered at least so much, and its surroundings if at most so much."""


def held_out_photos(folder: Path, report: dict) -> Capture:
    """The photos of the capture in `folder` that the job of this report did not learn from, in its unit frame.

    Raises UsageError where there are none.
    """
    capture, every = load_capture(folder), report["explained"]["hold_out"] if "explained" in report else None
    if every is not None:
        held = split(capture, every)[1]
    elif (folder / "transforms_test.json").is_file():
        held = load_test_views(folder, capture)
    else:
        raise UsageError(f"the asset was learned from all photos of {folder}", "Make it again with --hold-out 8.")
    learned = report["capture"]
    held.object_center, held.object_radius = np.array(learned["object_center"]), learned["object_radius"]
    return held


def score(folder: Path, asset: Path, photos: int | None = None, samples: int = SAMPLES) -> dict:
    """PSNR (dB) and hue (degrees) of the asset on the object's pixels, and of F_e beside it, over the held-out photos.

    The pixels of the object are those of the masks, where each photo has one, else those of the asset's silhouette. Each
    photo has one gain. `photos` is the number of photos that are rendered, spread over all (None: all). Raises UsageError,
    CaptureError, and OSError where the asset cannot be read.
    """
    report = read_row(asset / "report.json")
    held = held_out_photos(folder, report)
    if photos is not None:
        chosen = np.unique(np.linspace(0, len(held.views) - 1, min(photos, len(held.views))).round().astype(int))
        held.views = [held.views[number] for number in chosen]
    rays = PixelRays.from_capture(held, PIXELS, report["capture"]["masks"] or bool(held.views[0].mask_path))
    fields, support = _learned(asset, report["preset"])
    exposure, response = report["capture"]["exposure"], response_of(report)
    curve = report["capture"].get("camera_curve")  # F_e and the renderings are light then, and the photos are not
    files = None if curve is None or held.color_space == "linear" else ResponseCurve.of_files(curve)
    shown, rendered, numbers, kinds, surroundings = [], [], [], [], []
    for number, picture in enumerate(_render(asset, held, rays, samples)):
        index = torch.arange(rays.offset[number], rays.offset[number + 1])
        covered = picture.reshape(-1, 4)[:, 3]
        around = np.zeros((len(index), 3), np.float32)
        if fields is not None:
            around = behind(fields.environment, rays, index) / exposure
        usable = rays.valid[index].numpy() & ~rays.burnt_out(index).cpu().numpy()
        mask = covered if rays.mask is None else rays.mask[index].numpy() / 255
        beside = usable & (mask <= _NONE) & (covered <= _NONE)
        if support is not None:
            origins, directions, _ = (x.numpy() for x in rays.rays(index))
            beside &= ~shows_support(support, origins, directions)
        shown.append(rays.photo(index).numpy())
        of_asset = picture.reshape(-1, 4)[:, :3]
        if response is not None and held.color_space == "linear":  # test photos, which lack the curve that F_e has
            around = response.light(torch.from_numpy(exposure * around)).numpy() / exposure
        elif response is not None:  # the renderings lack the camera's curve, which photos and F_e have
            full = of_asset / covered.clip(1e-3, 1)[:, None]
            of_asset = covered[:, None] * response.photo(torch.from_numpy(exposure * full)).numpy() / exposure
        light = of_asset + (1 - covered[:, None]) * around
        rendered.append(light if files is None else files.photo(torch.from_numpy(light)).numpy())
        numbers.append(np.full(len(index), number))
        kinds.append(usable & (mask >= _WHOLE))
        surroundings.append(beside)
    pixels, ours, photo = (np.concatenate(parts) for parts in (shown, rendered, numbers))
    of_object, beside = np.concatenate(kinds), np.concatenate(surroundings)
    row: dict = {"photos": len(held.views), "hold_out": report.get("explained", {}).get("hold_out"), "samples": samples}
    row |= _facts("object", photo_score(pixels[of_object], ours[of_object], photo[of_object]), held)
    if fields is not None:
        row |= _facts("surroundings", photo_score(pixels[beside], ours[beside], photo[beside]), held)
    return row


def _learned(asset: Path, name: str) -> tuple[Fields | None, Support | None]:
    """F_o and F_e of the asset and its support plane, as far as checkpoints are there."""
    fields_file, surface_file = (
        asset / "checkpoints" / f"{stage}.done.pt" for stage in (StageName.FIELDS_LEARNING, StageName.SURFACE)
    )
    if not fields_file.is_file():
        return None, None
    fields = Fields.from_state(load_state(fields_file)["result"], preset(name), torch.device("cpu"))
    plane = surface_result(load_state(surface_file)["result"]).support if surface_file.is_file() else None
    return fields, plane or fields.support


def _render(asset: Path, held: Capture, rays: PixelRays, samples: int) -> list[np.ndarray]:
    """The asset in its own light from the camera of each photo: radiance and coverage [h, w, 4], as large as in `rays`."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item, world = import_result(asset, bpy.context.scene.collection)
    pictures = []
    with RelitScene(item, *rays.size[0][::-1], samples) as relit:
        relit.scene.render.threads_mode, relit.scene.render.threads = "FIXED", torch.get_num_threads()
        for view, (height, width) in zip(held.views, rays.size, strict=True):
            camera = view.camera
            factor = camera.width // width
            pinhole = (value / factor for value in (camera.fl_x, camera.fl_y, camera.cx, camera.cy))
            relit.set_size(width, height)
            frame = Frame(view.image_path, width, height, *pinhole, camera.camera_to_world, "linear")
            pictures.append(relit.render_cut_out(frame, world))
    return pictures


def _facts(name: str, found: PhotoScore | None, held: Capture) -> dict:
    if found is None:
        return {f"{name}_psnr": None}
    worst = min(found.psnr_of_photos, key=found.psnr_of_photos.__getitem__)
    return {
        f"{name}_psnr": round(found.psnr, 2),
        f"{name}_hue_deg": None if found.hue_deg is None else round(found.hue_deg, 2),
        f"{name}_gains": [round(gain, 3) for gain in found.gains.values()],
        f"{name}_worst_photo": [held.views[worst].name, round(found.psnr_of_photos[worst], 2)],
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="the folder with the photos")
    parser.add_argument("asset", type=Path, help="the folder of the asset")
    parser.add_argument("--photos", type=int, metavar="N", help="held-out photos that are rendered (all)")
    parser.add_argument("--samples", type=int, default=SAMPLES, help="Cycles samples a pixel (%(default)s)")
    options = parser.parse_args()
    print(json.dumps(score(options.capture, options.asset, options.photos, options.samples)))
