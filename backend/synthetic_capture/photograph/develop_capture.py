"""Develops the photos of a capture that is there: the same cameras, masks and ground truth, without rendering again."""

import json
import os
import shutil
from pathlib import Path

from ...scene_io.image_files import load_pixels, write_whole
from .session import Camera, write_description

COPIED = ("test", "test_masks", "gt", "masks")
METERED = 8
"""The exposure is found on so many photos."""


def develop_capture(source: Path, out: Path, effects: frozenset[str], seed: int) -> None:
    """Write a capture with developed photos. The files of `source` that stay the same are copied.

    transforms.json is written last. Raises ValueError where `source` is no capture with photos of linear radiance and
    masks, or is `out` itself, and OSError.
    """
    try:
        meta = json.loads((source / "transforms.json").read_text(encoding="utf-8"))
        frames, sources = meta["frames"], [source / frame["file_path"] for frame in meta["frames"]]
        focal_length = meta["fl_x"] / meta["w"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{source}: no capture that synthetic.py has written ({type(error).__name__}: {error})") from error
    if meta.get("color_space") != "linear":
        raise ValueError(f"{source}: its photos hold no linear radiance, so they cannot be developed")
    if out.resolve() == source.resolve():
        raise ValueError(f"{out}: a capture cannot be developed into its own folder: give another --out")
    (out / "images").mkdir(parents=True, exist_ok=True)
    (out / "transforms.json").unlink(missing_ok=True)
    for old in (out / "images").iterdir():
        old.unlink()
    shutil.copyfile(source / "gt_mesh.ply", out / "gt_mesh.ply")
    for name in COPIED:
        shutil.rmtree(out / name, ignore_errors=True)
        shutil.copytree(source / name, out / name, copy_function=shutil.copyfile)
        os.chmod(out / name, 0o755)
    for name in ("transforms_test.json", "scene.json"):
        (out / name).unlink(missing_ok=True)
        if (source / name).is_file():
            shutil.copyfile(source / name, out / name)
    camera = Camera(effects, seed, len(frames), focal_length)
    step = max(1, len(frames) // METERED)
    camera.meter([(k, load_pixels(sources[k])[..., :3]) for k in range(0, len(frames), step)])
    taken = []
    for number, (frame, photo) in enumerate(zip(frames, sources, strict=True)):
        radiance = load_pixels(photo)[..., :3]
        frame["file_path"] = f"images/{photo.stem}.jpg"
        taken.append({"file_path": frame["file_path"]} | camera.take(out / frame["file_path"], radiance, number))
    write_description(out, camera, taken)
    text = json.dumps(meta | {"color_space": "srgb", "frames": frames}, indent=1) + "\n"
    write_whole(out / "transforms.json", text.encode())
