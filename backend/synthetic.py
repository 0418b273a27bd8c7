"""Render a synthetic capture with ground truth: a glossy object among near surroundings.

    python backend/synthetic.py --scene suzanne --out DIR [--views 62] [--size 400] ...
    blender -b -P backend/synthetic.py -- --scene statue.obj --out DIR ...

DIR becomes a capture (transforms.json, images/NNN.exr, masks/NNN.png). The capture has test views (transforms_test.json,
test/, test_masks/), the ground truth of the test views (gt/NNN.exr) and the true mesh (gt_mesh.ply). transforms.json is
written last, so a folder that has one is complete. The same arguments give the same capture in the same version of Blender,
except for the last digits of the photos, because Cycles adds in no fixed order. Blender 5 draws other Voronoi cells for the
pattern `patches` than Blender 4.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import bpy
import numpy as np

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from backend.arguments import script_arguments
from backend.scene_io.image_files import write_half_exr, write_png
from backend.synthetic_capture import scenes
from backend.synthetic_capture.exr_channels import write_channels
from backend.synthetic_capture.ground_truth import ViewRenderer
from backend.synthetic_capture.viewpoints import FIELD_OF_VIEW, Surroundings, Viewpoint, choose_viewpoints


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="synthetic.py", description=__doc__.split("\n\n")[0])
    parser.add_argument("--scene", default="suzanne", help="suzanne, box, or a mesh file (obj, ply, stl, glb, gltf)")
    parser.add_argument("--out", type=Path, required=True, help="the capture folder to write")
    parser.add_argument("--views", type=int, default=62, help="photos to learn from")
    parser.add_argument("--test-views", type=int, default=8, help="further photos with ground truth")
    parser.add_argument("--size", type=int, default=400, help="width and height of a photo in pixels")
    parser.add_argument("--samples", type=int, default=20, help="Cycles samples a pixel (denoised where possible)")
    parser.add_argument("--seed", type=int, default=0, help="of the room, the cameras and the noise")
    parser.add_argument("--material", choices=sorted(scenes.MATERIALS), help="default: gold; the box: patches")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> int:
    options = parse(arguments)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rng = np.random.default_rng(options.seed)
    material = options.material or scenes.DEFAULT_MATERIAL.get(options.scene, "gold")
    try:
        target, obstacles = scenes.build_scene(options.scene, material, rng)
        surroundings = Surroundings(obstacles)
        train = choose_viewpoints(options.views, surroundings, rng)
        test = choose_viewpoints(options.test_views, surroundings, rng)
        write_capture(options, target, train, test)
    except (ValueError, OSError) as error:
        print(f"synthetic.py: {error}", file=sys.stderr)
        return 2
    return 0


def write_capture(
    options: argparse.Namespace, target: bpy.types.Object, train: list[Viewpoint], test: list[Viewpoint]
) -> None:
    """Render every viewpoint and write the capture folder. Raises OSError where the folder cannot be written."""
    out = options.out
    for name in ("images", "masks", "test", "test_masks", "gt"):
        (out / name).mkdir(parents=True, exist_ok=True)
    (out / "transforms.json").unlink(missing_ok=True)
    write_ply(out / "gt_mesh.ply", *scenes.triangles(target))
    renderer = ViewRenderer(bpy.context.scene, options.size, options.samples, FIELD_OF_VIEW, options.seed)
    started, total = time.monotonic(), len(train) + len(test)
    frames = {"test": [], "train": []}
    for number, viewpoint in enumerate(test + train):
        group = "test" if number < len(test) else "train"
        index = len(frames[group])
        images, masks = ("test", "test_masks") if group == "test" else ("images", "masks")
        renderer.scene.cycles.seed = options.seed + number  # two photos must not have the same noise
        photo, truth = renderer.render(viewpoint.matrix)
        frame = {
            "file_path": f"{images}/{index:03d}.exr",
            "mask_path": f"{masks}/{index:03d}.png",
            "transform_matrix": [list(row) for row in viewpoint.matrix],
        }
        frames[group].append(frame)
        write_half_exr(out / frame["file_path"], photo)
        write_png(out / frame["mask_path"], np.round(truth["mask.V"] * 255).astype(np.uint8))
        if group == "test":
            write_channels(out / "gt" / f"{index:03d}.exr", {name: x.astype(np.float16) for name, x in truth.items()})
        left = (time.monotonic() - started) / (number + 1) * (total - number - 1)
        print(f"view {number + 1}/{total}, {left:.0f} s left", file=sys.stderr, flush=True)
    shared = {
        "camera_model": "PINHOLE",
        "w": options.size,
        "h": options.size,
        "fl_x": renderer.focal_length,
        "fl_y": renderer.focal_length,
        "cx": options.size / 2,
        "cy": options.size / 2,
        "color_space": "linear",
        "object_center": [0.0, 0.0, 0.0],
        "object_radius": scenes.OBJECT_RADIUS,
    }
    for group, name in (("test", "transforms_test.json"), ("train", "transforms.json")):
        (out / name).write_text(json.dumps(shared | {"frames": frames[group]}, indent=1) + "\n")


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a triangle mesh (vertices [V,3], faces [F,3]) as a binary PLY file."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, faces
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


if __name__ == "__main__":
    sys.exit(main(script_arguments()))
