"""The parts of synthetic.py: what it refuses and how it says so, its renderer, and files that are written whole."""

import contextlib
import io
import math
import sys
from pathlib import Path

import numpy as np

from support.own_process import in_blender


def test_options_without_effect_and_no_seeds_are_refused():
    in_blender(check_options)


def check_options():
    from backend import synthetic

    for words, message in (
        ("--random 3 --seed 5", "--seed has no effect with --random"),
        ("--random 3 --seed 0", "--seed has no effect with --random"),
        ("--random 3 --fast", "--fast has no effect with --random"),
        ("--random 3 --snapshots", "--snapshots has no effect with --random"),
        ("--random 3 --material gold", "--material has no effect with --random"),
        ("--meshes a.ply", "--meshes has no effect without --random"),
        ("--photograph room --snapshots", "give one of them"),
        ("--photograph fog", "invalid choice: 'fog'"),
        ("--develop a", "--develop does not render anything: give --photograph with some of jpeg, exposure, noise, curve"),
        ("--develop a --photograph all", "--develop does not render aperture, framing"),
        ("--develop a --photograph noise --test-views 3", "--test-views has no effect with --develop"),
        ("--walk", "--walk has no effect without --turntable"),
        ("--printed", "--printed has no effect without --turntable"),
        ("--random 3 --turntable 2", "--turntable has no effect with --random"),
        ("--turntable 9", "invalid choice: 9"),
        ("--turntable 1 --photograph framing two_days", "--photograph framing two_days does not"),
        ("--random abc", "'abc' is no whole number"),
        ("--random 2147483648", "2147483648 is above 2147483647"),
        ("--seed -1", "-1 is below 0"),
    ):
        said = io.StringIO()
        with contextlib.redirect_stderr(said):
            try:
                found = synthetic.parse(["--out", "x", *words.split()])
            except SystemExit as ended:
                found = ended.code
        assert found == 2 and message in said.getvalue(), (words, found, said.getvalue())
    assert synthetic.parse(["--out", "x", "--random", "2147483647", "--meshes", "a.ply"]).random == 2**31 - 1
    assert synthetic.parse(["--out", "x", "--seed", "7"]).seed == 7 and synthetic.parse(["--out", "x"]).seed == 0


def test_fast_changes_how_the_scene_is_rendered(tmp_path):
    in_blender(check_fast, tmp_path)


def check_fast(folder):
    import bpy

    from backend import synthetic

    rendered_with = []

    def settings(*_):
        cycles = bpy.context.scene.cycles
        rendered_with.append((cycles.denoising_prefilter, cycles.use_light_tree))

    synthetic.write_capture = settings
    for options in ([], ["--fast"], ["--photograph", "room", "--fast"]):
        assert synthetic.main(["--scene", "box", "--views", "3", "--out", str(Path(folder) / "none"), *options]) == 0
    assert rendered_with == [("ACCURATE", True), ("FAST", False), ("FAST", False)]


def test_a_mesh_file_that_cannot_be_used_is_told_with_its_path(tmp_path):
    files = {
        "garbage.stl": b"no mesh",
        "garbage.ply": b"ply\nformat nonsense\n",
        "garbage.glb": b"no mesh",
        "point.obj": b"v 1 2 3\nv 1 2 3\nv 1 2 3\nf 1 2 3\n",
        "cloud.obj": b"v 1 2 3\nv 4 2 3\nv 1 5 3\n",
        "words.txt": b"no mesh",
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    in_blender(check_meshes, tmp_path)


def check_meshes(folder):
    import bpy

    from backend.synthetic_capture.scenes import mesh_file

    for name, message in (
        ("garbage.stl", ""),
        ("garbage.ply", ""),
        ("garbage.glb", ""),
        ("point.obj", "all points of the mesh coincide"),
        ("cloud.obj", ""),
        ("words.txt", "nor a mesh file"),
        ("missing.obj", "there is no such file"),
    ):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        try:
            mesh_file(Path(folder) / name)
        except ValueError as error:
            assert name in str(error) and message in str(error) and "\n" not in str(error), error
        else:
            raise AssertionError(f"{name} is taken for a mesh")


def test_a_scene_without_a_place_for_a_camera_says_what_helps():
    in_blender(check_places)


def check_places():
    from backend.synthetic_capture.viewpoints import Layout, Surroundings, choose_viewpoints

    try:
        choose_viewpoints(1, Surroundings([]), np.random.default_rng(0), Layout(heights=(9.0, 9.1)))
    except ValueError as error:
        assert "another seed" in str(error) and "--" not in str(error)
    else:
        raise AssertionError("a camera stands nowhere")


def test_two_renderers_share_a_camera_and_depths_fit_half_floats():
    in_blender(check_renderers)


def check_renderers():
    import bpy
    from mathutils import Matrix

    from backend.synthetic_capture.ground_truth import FARTHEST, ViewRenderer

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=2, location=(-1, 0, -2))
    ViewRenderer(scene, 16, 1, math.radians(30), 0)
    second = ViewRenderer(scene, 8, 1, math.radians(60), 0)
    assert len(bpy.data.cameras) == 1 and scene.camera == second.camera
    assert sorted(aov.name for aov in second.layer.aovs) == ["albedo", "mask", "metallic", "roughness"]
    assert abs(second.camera.data.angle - math.radians(60)) < 1e-6
    photo, truth = second.render(Matrix.Identity(4))
    depth = truth["Depth.V"]
    assert photo.shape == (8, 8, 3) and np.isfinite(depth.astype(np.float16)).all()
    assert (depth[3:5, 1:3] < 2.01).all() and (depth[:, 6:] == FARTHEST).all(), depth


def test_files_that_cannot_be_written_leave_the_old_ones(tmp_path):
    in_blender(check_whole_files, tmp_path)


def check_whole_files(folder):
    from types import SimpleNamespace

    from backend import synthetic
    from backend.synthetic_capture.snapshots import Phone

    folder, taken = Path(folder), np.full((32, 32, 3), 0.2, np.float32)
    render = SimpleNamespace(resolution_x=8)
    renderer = SimpleNamespace(scene=SimpleNamespace(render=render), focal_length=9.0)
    writers = {
        "a.ply": lambda: synthetic.write_ply(folder / "a.ply", np.zeros((3, 3)), np.array([[0, 1, 2]])),
        "a.jpg": lambda: Phone(32, 0.7).take(folder / "a.jpg", taken, 1.0),
        "transforms_test.json": lambda: synthetic.write_transforms(folder, renderer, "linear", {"test": [], "train": []}),
    }
    whole = {name: getattr(Path, name) for name in ("write_bytes", "write_text")}

    def half_written(path, data, *_, **__):
        whole["write_bytes"](path, (data.encode() if isinstance(data, str) else data)[: len(data) // 2])
        raise OSError(28, "No space left on device")

    for name in writers:
        (folder / name).write_bytes(b"old")
    for name, write in writers.items():
        Path.write_bytes = Path.write_text = half_written
        try:
            write()
        except OSError:
            pass
        else:
            raise AssertionError(f"the full disk is not told of {name}")
        finally:
            Path.write_bytes, Path.write_text = whole["write_bytes"], whole["write_text"]
        assert (folder / name).read_bytes() == b"old", name
    assert sorted(path.name for path in folder.iterdir()) == sorted(writers)
    for name, write in writers.items():
        write()
        assert (folder / name).read_bytes() != b"old", name
    assert (folder / "a.jpg").read_bytes()[:4] == b"\xff\xd8\xff\xe1" and (folder / "transforms.json").is_file()


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
