"""Render a synthetic capture with ground truth: a glossy object among near surroundings.

    python backend/synthetic.py --scene suzanne --out DIR [--views 62] [--size 400] ...
    blender -b -P backend/synthetic.py -- --scene statue.obj --out DIR ...
    python backend/synthetic.py --random SEED --out DIR [--meshes FILE...]
    python backend/synthetic.py --scene suzanne --snapshots --out DIR
    python backend/synthetic.py --scene suzanne --photograph EFFECT... --out DIR
    python backend/synthetic.py --scene suzanne --turntable 2 --out DIR
    python backend/synthetic.py --develop CAPTURE --photograph EFFECT... --out DIR

DIR becomes a capture (transforms.json, images/NNN.exr, masks/NNN.png). The capture has test views (transforms_test.json,
test/, test_masks/), the ground truth of the test views (gt/NNN.exr) and the true mesh (gt_mesh.ply). transforms.json is
written last, so a folder that has one is complete.

`--random` draws a whole scene from a seed: the object, its materials, the surroundings, a support, the cameras, and how the
photos are exposed and stored. What was drawn is written as scene.json. The photos may be PNG files.

`--snapshots` writes photos as a phone takes them, to DIR/photos: JPEG files, a lens with distortion, an exposure that varies
by up to half a stop up or down, and nothing that tells the cameras. The surroundings have prints. DIR/with_cameras is a
capture of the same photos with the true cameras, test views, and ground truth.

`--photograph` gives the photos to learn from what photos of people have: the photographer in the reflections, a living room,
depth of field, a camera's tone curve and noise, and others (docs/photographs.md), which DIR/photographs.json tells. The test
views and the ground truth stay clean. `--develop` does the camera's part of it with the photos of a capture of linear
radiance, without rendering again.

`--turntable ROWS` turns the object on a plate, while the camera stands still, at one height for each row of photos. The
cameras are written in the frame of the object, as it stands in the first photo. turns.json has the true turns. In the test
views the object stands as in the first photo. `--walk` takes the same photos by walking around the object: the control.
`--printed` puts a print on the plate, so that cameras can be found from the photos alone. With `--snapshots` it has one.

The same arguments give the same capture in the same version of Blender, except for the last digits of the photos, because
Cycles adds in no fixed order. Blender 5 draws other Voronoi cells for the pattern `patches` than Blender 4.
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from backend.arguments import path_argument, script_arguments
from backend.engine.printed_text import one_line
from backend.scene_io.image_files import write_png, write_whole
from backend.synthetic_capture import scenes
from backend.synthetic_capture.files.exr_channels import write_channels
from backend.synthetic_capture.files.photo_files import BRIGHTNESS, ENDINGS, automatic_gain, gain_for, write_photo
from backend.synthetic_capture.ground_truth import ViewRenderer
from backend.synthetic_capture.photograph.develop_capture import develop_capture
from backend.synthetic_capture.photograph.effects import (
    DEVELOPMENT,
    EFFECTS,
    FRAMING,
    GROUPS,
    MATERIALS,
    ROOM,
    SCENE,
    TWO_DAYS,
    Stage,
    chosen,
)
from backend.synthetic_capture.photograph.living_room import in_living_room
from backend.synthetic_capture.photograph.object_changes import SUBSTANCES
from backend.synthetic_capture.photograph.session import PHOTOGRAPHS, Camera, Session, write_description
from backend.synthetic_capture.random_scene import Photography, SceneDescription, draw_scene
from backend.synthetic_capture.scene_building import BuiltScene, build_fixed_scene, build_random_scene
from backend.synthetic_capture.snapshots import Phone
from backend.synthetic_capture.turntable import (
    ELEVATIONS,
    LIGHT,
    LIGHT_ROWS,
    LIGHT_SAMPLES,
    TURNS,
    Turntable,
    turn_to,
    write_turns,
)
from backend.synthetic_capture.viewpoints import FIELD_OF_VIEW, Viewpoint

MARK = "gt_mesh.ply"
"""The first file of a capture that is written. It shows that the folder is ours."""
WITH_CAMERAS = "with_cameras"
"""The folder of the capture, beside that of a phone's photos"""
PARTS = ("images", "masks", "test", "test_masks", "gt")
"""The folders of a capture"""
METER_SIZE, METER_SAMPLES, METER_VIEWS = 48, 8, 8
"""Pixels, samples and photos of the small renders that the exposure of a random scene is found on."""
SCENE_OPTIONS = ("views", "test_views", "size", "samples", "threads", "fast")
UNUSED = {
    None: ("meshes",),
    "random": ("fast", "seed", "snapshots", "material", "turntable", "walk", "printed"),
    "develop": ("meshes", "snapshots", "material", "turntable", "walk", "printed", *SCENE_OPTIONS),
}
"""What is rendered, where it is no --scene -> options without effect"""
LARGEST_SEED = 2**31 - 1
"""Cycles keeps its seed as a signed number of 32 bits."""


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="synthetic.py", description=__doc__.split("\n\n")[0])
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--scene", default="suzanne", help="suzanne, box, or a mesh file (obj, ply, stl, glb, gltf)")
    what.add_argument("--random", type=_seed, metavar="SEED", help="draw the whole scene from this seed, 0 or more")
    what.add_argument("--develop", type=path_argument, metavar="CAPTURE", help="develop the photos of a capture; no render")
    parser.add_argument("--meshes", nargs="+", default=[], metavar="FILE", help="further objects that --random may draw")
    parser.add_argument("--out", type=path_argument, required=True, help="the capture folder to write")
    parser.add_argument("--views", type=int, help="photos to learn from; default: 62, or what --random draws")
    parser.add_argument("--test-views", type=int, default=8, help="further photos with ground truth")
    parser.add_argument("--size", type=int, default=400, help="width and height of a photo in pixels")
    parser.add_argument("--samples", type=int, default=20, help="Cycles samples a pixel (denoised where possible)")
    parser.add_argument("--threads", type=int, default=0, help="of Cycles; 0: one for each core")
    parser.add_argument("--fast", action="store_true", help="half the time, a little more noise; --random always does it")
    parser.add_argument("--seed", type=_seed, help="of the room, the cameras and the noise (0); not with --random")
    parser.add_argument(
        "--snapshots",
        action="store_true",
        help="photos as a phone takes them, in OUT/photos, which loses its IMG_*.jpg; not with --random",
    )
    parser.add_argument(
        "--photograph",
        nargs="+",
        default=[],
        choices=[*EFFECTS, *GROUPS],
        metavar="EFFECT",
        help=f"photos as people take them: {', '.join(EFFECTS)}; camera (the last four); object; all",
    )
    parser.add_argument(
        "--turntable",
        type=int,
        default=0,
        choices=range(len(ELEVATIONS) + 1),
        metavar="ROWS",
        help=f"the object turns, for 1 to {len(ELEVATIONS)} heights of a still camera; not with --random",
    )
    parser.add_argument("--walk", action="store_true", help="with --turntable: walk around the object instead")
    parser.add_argument("--printed", action="store_true", help="with --turntable: a print on the plate")
    parser.add_argument(
        "--material", choices=sorted(scenes.MATERIALS), help="default: gold; the box: patches; not with --random"
    )
    options = parser.parse_args(arguments)
    named = next((name for name in ("random", "develop") if getattr(options, name) is not None), None)
    for name in UNUSED[named]:
        if getattr(options, name) != parser.get_default(name):
            option = f"--{name.replace('_', '-')}"
            parser.error(f"{option} has no effect {f'with --{named}' if named else 'without --random'}")
    options.photograph = chosen(options.photograph)
    if options.photograph and options.snapshots:
        parser.error("--photograph and --snapshots are two ways to take photos: give one of them")
    rendered = sorted(options.photograph.intersection(SCENE))
    if options.develop is not None and (rendered or not options.photograph):
        parser.error(
            f"--develop does not render {', '.join(rendered) or 'anything'}: give --photograph with some of "
            f"{', '.join(DEVELOPMENT)}"
        )
    for name in ("walk", "printed"):
        if getattr(options, name) and not options.turntable:
            parser.error(f"--{name} has no effect without --turntable")
    moving = sorted(options.photograph & {FRAMING, TWO_DAYS})
    if options.turntable and moving:
        parser.error(f"--turntable keeps the camera still, and --photograph {' '.join(moving)} does not")
    options.seed = options.seed or 0
    return options


def _seed(text: str) -> int:
    """The seed that a word of the command line names. Raises ArgumentTypeError."""
    try:
        seed = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None
    if seed < 0:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    if seed > LARGEST_SEED:
        raise argparse.ArgumentTypeError(f"{text} is above {LARGEST_SEED}")
    return seed


def main(arguments: list[str]) -> int:
    options = parse(arguments)
    try:
        refuse_foreign_files(options.out / WITH_CAMERAS if options.snapshots else options.out, options.snapshots)
    except (ValueError, OSError) as error:
        print(f"synthetic.py: {error}", file=sys.stderr)
        return 2
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if options.threads:
        bpy.context.scene.render.threads_mode, bpy.context.scene.render.threads = "FIXED", options.threads
    if options.fast:
        render_fast(bpy.context.scene)
    try:
        if options.develop is not None:
            develop_capture(options.develop, options.out, options.photograph, options.seed)
        elif options.random is None:
            views = (62 if options.views is None else options.views, options.test_views)
            drawn = (options.scene, options.material, options.seed)
            turntable = Turntable(options.turntable, options.walk, options.printed) if options.turntable else None
            built = build_fixed_scene(*drawn, views, options.snapshots, options.photograph, turntable)
            photographing = Photographing(session=session_of(options, FIELD_OF_VIEW, built.stage, len(built.train)))
            if options.snapshots:
                photographing = Photographing(phone=Phone(options.size, FIELD_OF_VIEW))
                options.out /= WITH_CAMERAS
                (options.out.parent / "photos").mkdir(parents=True, exist_ok=True)
            write_capture(options, built, photographing)
        else:
            write_random_capture(options)
    except (ValueError, OSError) as error:
        print(one_line(f"synthetic.py: {error}"), file=sys.stderr)
        return 2
    return 0


def refuse_foreign_files(out: Path, snapshots: bool) -> None:
    """Raises ValueError where files would be replaced or removed that no capture of ours has put there.

    out: the folder of the capture. snapshots: whether a phone's photos lie beside it.
    """
    if (out / MARK).is_file():
        return
    folders = [out / name for name in PARTS if (out / name).is_dir()]
    there = [f"{folder.name}/{path.name}" for folder in folders for path in sorted(folder.iterdir())[:1]]
    files = ("transforms.json", "transforms_test.json", "scene.json", PHOTOGRAPHS)
    there += [name for name in files if os.path.lexists(out / name)]
    there += [f"../photos/{path.name}" for path in _phone_photos(out)[:1]] if snapshots else []
    if there:
        raise ValueError(f"{out} holds {', '.join(there)}, which are of no synthetic capture: choose another --out")


def _phone_photos(out: Path) -> list[Path]:
    return sorted((out.parent / "photos").glob("IMG_*.jpg"))


def session_of(
    options: argparse.Namespace, field_of_view: float, stage: Stage, photos: int, brightness: float = BRIGHTNESS
) -> Session | None:
    """The session that takes the photographs; None without --photograph."""
    if not options.photograph:
        return None
    focal_length = 0.5 / math.tan(field_of_view / 2)
    camera = Camera(options.photograph, options.seed, photos, focal_length, brightness)
    return Session(camera, stage)


def write_random_capture(options: argparse.Namespace) -> None:
    """Draw a scene, build it, and write its capture folder with scene.json. Raises ValueError and OSError."""
    scene = draw_scene(options.random, options.meshes)
    if options.views is not None:
        scene = replace(scene, cameras=replace(scene.cameras, views=options.views))
    if ROOM in options.photograph:
        scene = in_living_room(scene)
    options.seed = scene.seed
    built = build_random_scene(scene, options.test_views, options.photograph)
    field_of_view = math.radians(scene.cameras.field_of_view)
    options.out.mkdir(parents=True, exist_ok=True)
    write_whole(options.out / "scene.json", (json.dumps(told(scene, options.photograph), indent=1) + "\n").encode())
    render_fast(bpy.context.scene)
    session = session_of(options, field_of_view, built.stage, len(built.train), scene.photography.brightness)
    photographing = Photographing(field_of_view, scene.photography, session=session)
    write_capture(options, built, photographing)


def render_fast(scene: bpy.types.Scene) -> None:
    """Let Cycles take half the time, where there are few lamps.

    The finer filter of the denoiser's guides takes as much time as eight samples. Without the light tree a sample takes 40 %
    less time, and a room has only a few lamps to choose from.
    """
    scene.cycles.denoising_prefilter, scene.cycles.use_light_tree = "FAST", False


def told(scene: SceneDescription, effects: frozenset[str]) -> dict:
    """The values for `scene.json`. The summary names the effects of photographs."""
    if MATERIALS in effects:
        scene = replace(scene, pattern="cells", substances=SUBSTANCES)
    values = scene.as_json()
    return values | ({"summary": f"{values['summary']}; photographs: {', '.join(sorted(effects))}"} if effects else {})


@dataclass(frozen=True)
class Photographing:
    """The camera, and how its photos are exposed and stored."""

    field_of_view: float = FIELD_OF_VIEW
    """radians"""
    photography: Photography | None = None
    """None: radiance as it is, as OpenEXR"""
    phone: Phone | None = None
    """Takes the photos to learn from as JPEG files instead. None: no phone"""
    session: Session | None = None
    """Takes the photos to learn from as people do. None: clean renders"""

    @property
    def develops(self) -> bool:
        """Whether the session's camera writes the photos to learn from."""
        return self.session is not None and self.session.develops

    @property
    def format(self) -> str:
        """The format of the photos that neither a phone nor the session's camera writes, one of photo_files.ENDINGS."""
        return self.photography.format if self.photography and not self.develops else "EXR half linear"

    def set_up(self, camera: bpy.types.Camera, viewpoint: Viewpoint, number: int | None) -> None:
        """Prepare the scene for the photo with this number, or for a test view (None)."""
        if self.session:
            self.session.set_up(camera, viewpoint.matrix, number)

    def meter(self, options: argparse.Namespace, train: Sequence[Viewpoint]) -> float:
        """The gain of all photos, found on small renders of some viewpoints; 1 where photos hold plain radiance.

        The session's camera finds the gains of its photos, too. The gain that is returned is that of its first day.

        The gain is approximate, because only every n-th viewpoint is rendered. Where the cameras stand on two rings and n is
        even, all these viewpoints are on one ring. The choice stays as it is, because the photos of recorded scenes depend
        on it.
        """
        if self.photography is None and self.phone is None and not self.develops:
            return 1.0
        renderer = ViewRenderer(bpy.context.scene, METER_SIZE, METER_SAMPLES, self.field_of_view, options.seed)
        photos = []
        for number in range(0, len(train), max(1, len(train) // METER_VIEWS)):
            self.set_up(renderer.camera.data, train[number], number)
            photos.append((number, renderer.render(train[number].matrix)[0]))
        if self.session and self.develops:
            self.session.camera.meter(photos)
            return self.session.camera.gains[0]
        return gain_for([photo for _, photo in photos], self.photography.brightness if self.photography else BRIGHTNESS)

    def exposed(self, photo: np.ndarray, gain: float) -> np.ndarray:
        """The photo [H,W,3] with the exposure that it is taken with. `gain` is that of `meter`."""
        if self.photography and self.photography.auto_exposure and not self.develops:
            gain = automatic_gain(photo, self.photography.brightness, gain)
        return photo * np.float32(gain)


def write_capture(options: argparse.Namespace, built: BuiltScene, photographing: Photographing) -> None:
    """Render every viewpoint and write the capture folder. Raises OSError where the folder cannot be written.

    A phone's photos of an earlier run are removed, because `photos` may hold no others than those of this capture.
    """
    out, train, test = options.out, built.train, built.test
    for name in PARTS:
        (out / name).mkdir(parents=True, exist_ok=True)
    write_ply(out / MARK, *scenes.triangles(built.target))
    for name in ("transforms.json", PHOTOGRAPHS, TURNS, LIGHT):
        (out / name).unlink(missing_ok=True)
    phone = photographing.phone
    for old in _phone_photos(out) if phone else ():
        old.unlink()
    gain = photographing.meter(options, train)  # with the object at its first turn
    size = phone.rendered_size if phone else options.size
    field_of_view = phone.rendered_field_of_view if phone else photographing.field_of_view
    renderer = ViewRenderer(bpy.context.scene, size, options.samples, field_of_view, options.seed)
    started, total = time.monotonic(), len(train) + len(test)
    frames, taken = {"test": [], "train": []}, []
    for number, viewpoint in enumerate(test + train):
        group = "test" if number < len(test) else "train"
        index = len(frames[group])
        images, masks = ("test", "test_masks") if group == "test" else ("images", "masks")
        renderer.scene.cycles.seed = (options.seed + number) % (LARGEST_SEED + 1)  # two photos must not have the same noise
        photographing.set_up(renderer.camera.data, viewpoint, index if group == "train" else None)
        turn_to(built.turning, viewpoint)
        photo, truth = renderer.render(viewpoint.matrix)
        frame = {
            "file_path": f"{images}/{index:03d}{ENDINGS[photographing.format]}",
            "mask_path": f"{masks}/{index:03d}.png",
            "transform_matrix": [list(row) for row in viewpoint.in_object],
        }
        if viewpoint.row is not None:
            frame["row"] = viewpoint.row
        frames[group].append(frame)
        if phone and group == "train":
            frame["file_path"] = f"../photos/IMG_{index + 1:04d}.jpg"
            truth["mask.V"] = phone.resampled(truth["mask.V"]).clip(0, 1)
            phone.take(out / frame["file_path"], phone.resampled(photo), gain)
        elif photographing.develops and group == "train":
            frame["file_path"] = f"{images}/{index:03d}.jpg"
            settings = photographing.session.camera.take(out / frame["file_path"], photo, index)
            taken.append({"file_path": frame["file_path"]} | settings)
        else:
            write_photo(out / frame["file_path"], photographing.exposed(photo, gain), photographing.format)
        write_png(out / frame["mask_path"], np.round(truth["mask.V"] * 255).astype(np.uint8))
        if group == "test":
            write_channels(out / "gt" / f"{index:03d}.exr", {name: x.astype(np.float16) for name, x in truth.items()})
        left = (time.monotonic() - started) / (number + 1) * (total - number - 1)
        print(f"view {number + 1}/{total}, {left:.0f} s left", file=sys.stderr, flush=True)
    color_space = "linear" if photographing.format.startswith("EXR") else "srgb"
    if photographing.session:
        write_description(out, photographing.session.camera, taken)
    own = phone.intrinsics if phone else {"color_space": "srgb"} if photographing.develops else {}
    if train[0].row is not None:
        own = own | {"turntable": True}
        write_turns(out, train)
    if built.turning:
        write_light(out / LIGHT, renderer, built.turning)
    write_transforms(out, renderer, color_space, frames, own)


def write_light(path: Path, renderer: ViewRenderer, turning: Sequence[bpy.types.Object]) -> None:
    """Write the light that comes to the middle of the object, as the room is without what turns. Raises OSError."""
    light = renderer.render_light(turning, LIGHT_ROWS, LIGHT_SAMPLES)
    write_channels(path, {channel: light[..., k] for k, channel in enumerate("RGB")})


def write_transforms(
    out: Path, renderer: ViewRenderer, color_space: str, frames: dict[str, list[dict]], own: dict | None = None
) -> None:
    """Write transforms_test.json and, last, transforms.json, some of whose keys have values of their `own`.

    `color_space` is that of the rendered photos.
    """
    size = renderer.scene.render.resolution_x
    shared = {
        "camera_model": "PINHOLE",
        "w": size,
        "h": size,
        "fl_x": renderer.focal_length,
        "fl_y": renderer.focal_length,
        "cx": size / 2,
        "cy": size / 2,
        "color_space": color_space,
        "object_center": [0.0, 0.0, 0.0],
        "object_radius": scenes.OBJECT_RADIUS,
    }
    for group, name, changed in (("test", "transforms_test.json", {}), ("train", "transforms.json", own or {})):
        text = json.dumps(shared | changed | {"frames": frames[group]}, indent=1) + "\n"
        write_whole(out / name, text.encode())


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a triangle mesh (vertices [V,3], faces [F,3]) as a binary PLY file.

    The file is written under a temporary name and then renamed. Raises OSError where it cannot be written.
    """
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, faces
    write_whole(path, header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


if __name__ == "__main__":
    sys.exit(main(script_arguments()))
