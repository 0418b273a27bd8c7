"""Blender's part: engine process, import, World, cameras, comparison. Whatever needs bpy runs in its own process."""

import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from backend.engine import engine
from backend.engine.command import ENGINE_PYTHON_VARIABLE, find_engine_python
from backend.engine.engine import Engine
from support.own_process import run_file
from support.paths import ROOT

BUNDLED = ROOT / "data" / "suzanne_small"
LIMIT_S = 120
VERTICES = np.array([[0.5, 0.25, 0.75], [-0.5, 0.3, 0.6], [0.1, -0.6, 0.2], [0.05, 0.1, -0.7]])

FAKE_ENGINE = """#!{python}
import json, os, pathlib, shutil, signal, sys, time
assert sys.argv[1:4] == ["-I", "-m", "blender_nep"], sys.argv
assert not [name for name in os.environ if name.startswith(("PYTHON", "BLENDER_"))], dict(os.environ)
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
def say(**event):
    print(json.dumps(event), flush=True)
def wait_for_stop():
    while line := sys.stdin.readline():
        if json.loads(line)["cmd"] == "stop":
            break
    (out / "checkpoint").write_text("saved")
    say(event="error", code=7, message="stopped; checkpoint written", hint="resume")
    sys.exit(7)
out.mkdir(parents=True, exist_ok=True)
(out / "arguments.json").write_text(json.dumps(sys.argv[4:]))
print("a stray line that is no JSON")
say(event="progress", stage="fields_learning", step=1, steps=2, fraction=0.5, eta_s=3, loss=0.1)
mode = os.environ["FAKE_ENGINE"]
if mode == "asset":
    shutil.copytree(os.environ["FAKE_ASSET"], out, dirs_exist_ok=True)
    say(event="done", asset=str(out))
elif mode == "refuse":
    say(event="error", code=3, message="image 004.png is missing", hint="Put it back.")
    sys.exit(3)
elif mode == "crash":
    print("segmentation of hopes", file=sys.stderr, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
elif mode == "wait":
    (out / "waiting").touch()
    wait_for_stop()
elif mode == "deaf":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    (out / "waiting").touch()
    time.sleep(600)
"""


@pytest.fixture
def fake_python(tmp_path) -> str:
    path = tmp_path / "fake-python"
    path.write_text(FAKE_ENGINE.replace("{python}", sys.executable))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def write_exr(path: Path, pixels: np.ndarray) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels.astype(np.float16)}).write(str(path))


@pytest.fixture
def asset(tmp_path) -> Path:
    """A hand-written asset: a tetrahedron, textures of one color each, a grey light."""
    folder = tmp_path / "asset"
    (folder / "textures").mkdir(parents=True)
    lines = [
        "mtllib mesh.mtl",
        *(f"v {x} {y} {z}" for x, y, z in VERTICES),
        "vt 0 0",
        "vt 1 0",
        "vt 0 1",
        "vt 1 1",
        "usemtl m",
        "f 1/1 2/2 3/3",
        "f 1/1 4/4 2/2",
        "f 2/2 4/4 3/3",
        "f 1/1 3/3 4/4",
    ]
    (folder / "mesh.obj").write_text("\n".join(lines) + "\n")
    (folder / "mesh.mtl").write_text("newmtl m\nmap_Kd textures/albedo.png\n")
    for name, color in (("albedo", (200, 120, 40)), ("roughness", 60), ("metallic", 255), ("confidence", 128)):
        pixels = np.broadcast_to(np.array(color, np.uint8), (8, 8, 3) if name == "albedo" else (8, 8))
        Image.fromarray(np.ascontiguousarray(pixels)).save(folder / "textures" / f"{name}.png")
        write_exr(folder / "textures" / f"{name}.exr", np.full((8, 8, 3), 0.5))
    write_exr(folder / "environment.exr", np.full((16, 32, 3), 0.5))
    (folder / "report.json").write_text("{}")
    return folder


def in_blender(function, *arguments) -> str:
    """Run a function of this file in a fresh process, so that no state of Blender leaks and a hang has a limit."""
    done = run_file(__file__, function.__name__, *arguments, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


# --- the engine process -------------------------------------------------------------------------------------------


def start_run(fake_python: str, mode: str, out: Path, *options: str, asset: Path | None = None) -> subprocess.Popen:
    variables = os.environ | {"FAKE_ENGINE": mode, "PYTHONPATH": "/nowhere", "BLENDER_USER_RESOURCES": str(out.parent)}
    if asset:
        variables["FAKE_ASSET"] = str(asset)
    return subprocess.Popen(
        [
            sys.executable,
            ROOT / "backend" / "run.py",
            "--capture",
            BUNDLED,
            "--out",
            out,
            "--engine-python",
            fake_python,
            *options,
        ],
        env=variables,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def until(path: Path, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not path.exists():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_engine_error_and_its_code_are_passed_on(fake_python, tmp_path):
    process = start_run(fake_python, "refuse", tmp_path / "out", "--preset", "preview", "--masks", "ignore")
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 3
    assert "image 004.png is missing" in told and "Put it back." in told and "Traceback" not in told
    given = json.loads((tmp_path / "out" / "arguments.json").read_text())
    assert given[:2] == ["reconstruct", str(BUNDLED)]
    assert given[given.index("--preset") + 1] == "preview" and given[given.index("--masks") + 1] == "ignore"


def test_a_killed_engine_is_reported(fake_python, tmp_path):
    process = start_run(fake_python, "crash", tmp_path / "out")
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 128 + 9
    assert "was killed" in told and "segmentation of hopes" in told


@pytest.mark.parametrize("how", ["SIGTERM", "closed stdin"])
def test_stopping_lets_the_engine_write_its_checkpoint(fake_python, tmp_path, how):
    process = start_run(fake_python, "wait", tmp_path / "out", "--watch-stdin")
    until(tmp_path / "out" / "waiting", process)
    if how == "SIGTERM":
        process.send_signal(signal.SIGTERM)
    else:
        process.stdin.close()
        process.stdin = None
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 7 and "checkpoint written" in told
    assert (tmp_path / "out" / "checkpoint").read_text() == "saved"


def test_an_engine_whose_parent_dies_leaves(fake_python, tmp_path):
    process = start_run(fake_python, "wait", tmp_path / "out")
    until(tmp_path / "out" / "waiting", process)
    process.kill()
    process.communicate(timeout=LIMIT_S)
    deadline = time.monotonic() + LIMIT_S
    while not (tmp_path / "out" / "checkpoint").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_deaf_engine_is_killed_in_the_end(fake_python, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_ENGINE", "deaf")
    monkeypatch.setattr(engine, "STOP_GRACE_S", 0.1)
    monkeypatch.setattr(engine, "TERMINATE_GRACE_S", 0.1)
    job = Engine.start(fake_python, ["reconstruct", "x", "--out", str(tmp_path / "out")])
    until(tmp_path / "out" / "waiting", job._process.process)
    job.request_stop()
    while not job.poll()[1]:
        time.sleep(0.02)
    assert job.outcome().code == 128 + 9
    job.close()


def test_the_engines_python_is_named_or_found(fake_python, monkeypatch):
    monkeypatch.delenv(ENGINE_PYTHON_VARIABLE, raising=False)
    assert find_engine_python(configured=fake_python) == fake_python
    monkeypatch.setenv(ENGINE_PYTHON_VARIABLE, "/from/the/variable")
    assert find_engine_python(configured=fake_python) == "/from/the/variable"
    assert find_engine_python("/named", fake_python) == "/named"


# --- Blender ------------------------------------------------------------------------------------------------------


def test_import_of_an_asset(asset):
    in_blender(check_import, asset)


def check_import(asset):
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(Path(asset), bpy.context.scene.collection, name="thing")
    world = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    np.testing.assert_allclose(world, VERTICES, atol=1e-6)
    assert all(polygon.use_smooth for polygon in item.data.polygons) and len(item.data.uv_layers) == 1
    assert len(bpy.data.materials) == 1 and len(item.data.materials) == 1 and item.name == "thing"
    nodes = item.data.materials[0].node_tree.nodes
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    for socket, name, space in (
        ("Base Color", "albedo", "sRGB"),
        ("Roughness", "roughness", "Non-Color"),
        ("Metallic", "metallic", "Non-Color"),
    ):
        (link,) = principled.inputs[socket].links
        assert link.from_node.name == name and link.from_node.image.colorspace_settings.name == space
    assert nodes["confidence"].image.colorspace_settings.name == "Non-Color"
    assert len(bpy.data.images) == 4 and all(image.packed_file for image in bpy.data.images)

    (Path(asset) / "textures" / "albedo.png").unlink()
    again = import_asset(Path(asset), bpy.context.scene.collection, name="from EXR")
    image = again.data.materials[0].node_tree.nodes["albedo"].image
    assert image.filepath.endswith(".exr") and image.colorspace_settings.name == "Linear Rec.709"
    (Path(asset) / "mesh.obj").unlink()
    try:
        import_asset(Path(asset), bpy.context.scene.collection)
    except OSError as error:
        assert "mesh.obj" in str(error)
    else:
        raise AssertionError("an asset without a mesh was imported")


def test_world_shines_from_where_the_environment_says(tmp_path):
    """A bright spot at direction d, placed in the image by the written formula, is seen by a camera that looks at d."""
    directions = np.array([[1, 0, 0], [-0.3, 0.9, 0.2], [0.2, -0.5, -0.8], [-0.7, -0.6, 0.5]])
    height = 128
    for index, (x, y, z) in enumerate(directions):
        u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
        v = 0.5 + np.arctan2(z, np.hypot(x, y)) / np.pi
        light = np.full((height, 2 * height, 3), 0.01)
        row, column = int((1 - v) * height), int(u * 2 * height) % (2 * height)
        light[max(row - 1, 0) : row + 2, [(column + k) % (2 * height) for k in (-1, 0, 1)]] = 10
        write_exr(tmp_path / f"{index}.exr", light)
    in_blender(check_world, tmp_path, json.dumps(directions.tolist()))


def check_world(folder, directions):
    import bpy
    from mathutils import Vector

    from backend.rendering.relight import RelitScene
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    relit = RelitScene(bpy.data.objects.new("nothing", None), 32, 32, samples=4)
    for index, direction in enumerate(json.loads(directions)):
        world = build_world(Path(folder) / f"{index}.exr", name=str(index))
        # the camera looks 12 degrees left of and below the spot, which must then be right of and above the middle
        turned = Vector(direction).to_track_quat("-Z", "Y").to_matrix()
        aside = turned @ Vector((-np.tan(np.radians(12)), -np.tan(np.radians(12)), -1))
        matrix = np.eye(4)
        matrix[:3, :3] = np.array(aside.to_track_quat("-Z", "Y").to_matrix())
        frame = Frame(Path("none"), 32, 32, 32.0, 32.0, 16.0, 16.0, matrix, "linear")
        seen = relit.render(frame, world).mean(axis=-1)
        row, column = np.unravel_index(seen.argmax(), seen.shape)
        local = np.linalg.inv(matrix[:3, :3]) @ (np.array(direction) / np.linalg.norm(direction))
        expected = 16 + 32 * local[0] / -local[2], 16 - 32 * local[1] / -local[2]
        assert expected[0] > 19 and expected[1] < 13, expected
        assert abs(column + 0.5 - expected[0]) < 2 and abs(row + 0.5 - expected[1]) < 2, (index, row, column, expected)
        assert seen.max() > 1 and np.median(seen) < 0.05


def test_photo_camera_has_the_captures_pinhole():
    in_blender(check_camera)


def check_camera():
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from backend.rendering.relight import add_camera
    from backend.scene_io.capture_files import Frame

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, rng = bpy.context.scene, np.random.default_rng(0)
    matrix = np.array(Vector((1, -2, 0.5)).to_track_quat("-Z", "Y").to_matrix().to_4x4())
    matrix[:3, 3] = 0.4, -1.0, 2.0
    for fl_y in (130.0, 110.0, 150.0):
        frame = Frame(Path("none"), 120, 90, 130.0, fl_y, 66.0, 40.0, matrix, "linear")
        camera = add_camera(frame, scene)
        scene.render.resolution_x, scene.render.resolution_y = frame.width, frame.height
        bpy.context.view_layer.update()
        for local in np.c_[rng.uniform(-1, 1, (20, 2)), rng.uniform(-6, -2, 20)]:
            point = matrix[:3, :3] @ local + matrix[:3, 3]
            x, y, _ = world_to_camera_view(scene, camera, Vector(point))
            expected = 66 + 130 * local[0] / -local[2], 40 - fl_y * local[1] / -local[2]
            np.testing.assert_allclose((x * 120, (1 - y) * 90), expected, atol=2e-3)


def test_image_files_round_trip(tmp_path):
    in_blender(check_image_files, tmp_path)
    found = OpenEXR.File(str(tmp_path / "ours.exr"), separate_channels=True).channels()
    expected = np.load(tmp_path / "expected.npz")
    for name in expected.files:
        np.testing.assert_array_equal(found[name].pixels, expected[name])
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "ours.png")), np.arange(35).reshape(5, 7))


def check_image_files(folder):
    from backend.scene_io.image_files import read_exr, write_exr, write_png

    rng = np.random.default_rng(0)
    channels = {
        "albedo.R": rng.random((37, 21)).astype(np.float16),
        "mask.V": np.ones((37, 21), np.float16),
        "Depth.V": np.linspace(0, 9, 37 * 21, dtype=np.float32).reshape(37, 21),
    }
    np.savez(Path(folder) / "expected.npz", **channels)
    write_exr(Path(folder) / "ours.exr", channels)
    back = read_exr(Path(folder) / "ours.exr")
    assert all((back[name] == channels[name]).all() for name in channels)
    write_png(Path(folder) / "ours.png", np.arange(35, dtype=np.uint8).reshape(5, 7))


def test_the_re_rendering_is_exposed_as_its_photo_was(tmp_path):
    write_exr(tmp_path / "grey.exr", np.full((4, 8, 3), 0.25))
    in_blender(check_exposure, tmp_path)


def check_exposure(folder):
    import bpy

    from backend.rendering import comparison
    from backend.scene_io.capture_files import Frame
    from backend.scene_io.world import build_world

    bpy.ops.wm.read_factory_settings(use_empty=True)
    seen = []
    comparison.draw_sheet, comparison.TILE_RANGE = lambda rows, *_: seen.append(rows[0]), (16, 16)
    grey = np.full((16, 16, 3), 0.25)
    Frame.photo = lambda frame: grey * np.array(frame.gain)
    world = build_world(Path(folder) / "grey.exr", name="grey")
    for gain in ((1.0, 1.0, 1.0), (2.0, 2.0, 1.5), (0.25, 0.3, 0.25)):
        frame = Frame(Path("none"), 16, 16, 16.0, 16.0, 8.0, 8.0, np.eye(4), "srgb", gain)
        comparison.compare(bpy.data.objects.new("nothing", None), [frame], world, [], samples=1)
    for photo, rendered in seen:
        np.testing.assert_allclose(photo.mean((0, 1)), rendered.mean((0, 1)), atol=0.01)  # single pixels are noisy
    assert seen[1][0].mean() > seen[0][0].mean() > seen[2][0].mean()


def test_resize_keeps_means_and_ramps():
    in_blender(check_resize)


def check_resize():
    from backend.rendering.comparison import resize

    image = np.random.default_rng(0).random((12, 18, 3))
    blocks = image.reshape(4, 3, 6, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resize(image, 6, 4), blocks)
    np.testing.assert_allclose(resize(image, 7, 5).mean(axis=(0, 1)), image.mean(axis=(0, 1)))
    ramp = np.broadcast_to(np.arange(10.0)[None, :, None], (4, 10, 3))
    np.testing.assert_allclose(resize(ramp, 20, 8)[3, 1:-1, 0], np.arange(1, 19) / 2 - 0.25)


def test_capture_to_relit_asset(fake_python, asset, tmp_path):
    """run.py from end to end: engine, import, World, comparison.png, asset.blend; then again without the engine."""
    out = tmp_path / "out"
    small = ("--relight", "1", "--photos", "1", "--samples", "2")
    process = start_run(fake_python, "asset", out, *small, asset=asset)
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, told
    assert "Learning shape and light" in told and "done:" in told
    sheet = np.asarray(Image.open(out / "comparison.png"), np.float32)
    assert sheet.shape[1] > 3 * 320 and sheet.shape[0] > 320
    tiles = [sheet[-200:-20, 6 + k * 326 : 6 + k * 326 + 320] for k in range(3)]
    assert all(tile.std() > 5 for tile in tiles)
    assert sheet[:58].max() > 200, "titles are drawn"
    in_blender(check_saved_file, out / "asset.blend")
    assert not [path for path in out.iterdir() if "partial" in path.name]

    process = start_run(fake_python, "refuse", out, "--resume", *small)
    assert process.wait(timeout=LIMIT_S) == 0, "a finished asset needs no engine"
    (out / "environment.exr").write_bytes(b"torn")
    process = start_run(fake_python, "refuse", out, "--resume", *small)
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 8 and "environment.exr" in told and "Traceback" not in told


def check_saved_file(path):
    import bpy

    bpy.ops.wm.open_mainfile(filepath=path)
    (scene,) = bpy.data.scenes
    assert scene.world.name == "recovered light" and scene.camera and scene.view_settings.view_transform == "Standard"
    assert len(bpy.data.worlds) == 2 and [item for item in scene.objects if item.type == "MESH"]
    used = [image for image in bpy.data.images if image.source == "FILE"]
    assert len(used) == 6 and all(image.packed_file for image in used)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
