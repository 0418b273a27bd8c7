"""The objects of a batch in a scene: a row of assets with pictures and a catalog, each object once."""

import itertools
import json
import os
import shutil
import sys
import uuid
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from backend.engine.results.batch_file import read_batch
from support.batch_folder import write_batch
from support.own_process import in_blender

SCALES = {"vase": 1.0, "cup": 0.25, "bowl": 3.0}


@pytest.fixture
def shelf(asset, tmp_path) -> Path:
    """A batch of three objects that are done, in different sizes and at different places, and a fourth that is not."""
    folder = write_batch(tmp_path / "my shelf", [entry(name) for name in SCALES] + [entry("late", state="running")])
    for place, (name, scale) in enumerate(SCALES.items()):
        copy(asset, folder / name, scale, 5.0 * place)
    pictures(folder)
    return folder


def entry(name: str, **keys) -> dict:
    return {"name": name, "capture": f"/captures/{name}"} | keys


def copy(asset: Path, target: Path, scale: float, place: float) -> None:
    """Copy an asset, with its mesh scaled and then moved."""
    shutil.copytree(asset, target)
    lines = (target / "mesh.obj").read_text().splitlines()
    for number, line in enumerate(lines):
        if line.startswith("v "):
            lines[number] = " ".join(["v", *(str(scale * float(value) + place) for value in line.split()[1:])])
    (target / "mesh.obj").write_text("\n".join(lines) + "\n")
    learned = {"roughness": 0.1, "metallic": 1.0}
    material = {"share": 1.0, "albedo": [1, 1, 1], "roughness": 0.1, "metallic": 1.0, "learned": learned}
    (target / "report.json").write_text(json.dumps({"materials": [material]}))


def pictures(folder: Path) -> None:
    """A turntable whose first frame is red for vase, a preview whose right half is green for cup, none for bowl."""
    strip = np.zeros((16, 128, 3), np.uint8)
    strip[:, :16] = (255, 0, 0)
    Image.fromarray(strip).save(folder / "vase" / "turntable.png")
    both = np.zeros((20, 40, 3), np.uint8)
    both[:, 20:] = (0, 255, 0)
    Image.fromarray(both).save(folder / "cup" / "preview.png")


def test_objects_become_a_row_of_assets_each_once(shelf):
    in_blender(check_row, shelf)


def check_row(folder):
    import bpy

    from backend.shelf.bring_in import bring_in, shelf_collection, shelf_objects

    scene = bpy.context.scene
    found = bring_in(read_batch(folder), scene)
    assert [item.name for item in found.items] == list(SCALES) and not found.refused
    boxes = check_no_overlap(bpy, found.items)
    gaps = [boxes[1][0][0] - boxes[0][1][0], boxes[2][0][0] - boxes[1][1][0]]
    assert boxes[0][0][0] == pytest.approx(0, abs=1e-4) and gaps[0] == pytest.approx(gaps[1], abs=1e-4) and gaps[0] > 0.1
    sizes = [high - low for low, high in boxes]
    np.testing.assert_allclose(sizes[0] * 3, sizes[2], rtol=1e-4)
    for item, (low, high) in zip(found.items, boxes, strict=True):
        assert low[2] == pytest.approx(0, abs=1e-4) and (low[1] + high[1]) / 2 == pytest.approx(0, abs=1e-4)
        about = item.asset_data
        assert about.author == "" and "metal of roughness 0.10" in about.description
        assert [tag.name for tag in about.tags] == ["metal", "mirror-like"] and uuid.UUID(about.catalog_id).version == 5
        assert all(node.image.packed_file for node in item.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE")
    vase, cup, bowl = found.items
    for item, size, color in ((vase, 16, (1, 0, 0, 1)), (cup, 20, (0, 1, 0, 1))):
        pixels = np.array(item.preview.image_pixels_float).reshape(-1, 4)
        assert tuple(item.preview.image_size) == (size, size) and np.allclose(pixels, color, atol=0.01)
    assert bowl.asset_data and (bowl.preview is None or not bowl.preview.image_size[0])

    assert not bring_in(read_batch(folder), scene).items, "each only once"
    content = json.loads((Path(folder) / "batch.json").read_text())
    content["objects"][3]["state"] = "done"
    content["objects"].append(entry("gone") | {"state": "done"})
    (Path(folder) / "batch.json").write_text(json.dumps(content))
    shutil.copytree(Path(folder) / "cup", Path(folder) / "late")
    vase.location.x += 20  # an artist moves what is there: the row goes on beside it
    found = bring_in(read_batch(folder), scene)
    assert [item.name for item in found.items] == ["late"] and "no folder" in found.refused["gone"]
    collection = shelf_collection(Path(folder), scene)
    assert collection.name == "Shelf: my shelf" and len(shelf_objects(collection)) == 4
    boxes = check_no_overlap(bpy, [cup, bowl, vase, found.items[0]])
    assert boxes[3][0][0] > boxes[2][1][0]
    scene.collection.objects.link(cup.copy())
    bpy.data.objects.remove(cup)
    assert [item.name for item in bring_in(read_batch(folder), scene).items] == ["cup"], "a copy is not it"
    check_two_shelves(bpy, Path(folder), scene)


def check_two_shelves(bpy, folder, scene):
    """The objects of a second batch go on with the row, in a collection of their own."""
    from backend.shelf.bring_in import bring_in, shelf_objects

    before = shelf_objects(scene)
    shutil.copytree(folder, folder.with_name("other"))
    found = bring_in(read_batch(folder.with_name("other")), scene)
    assert len(found.items) == 4 and found.items[0].users_collection[0].name == "Shelf: other"
    bpy.context.view_layer.update()
    right = max((item.matrix_world @ vertex.co).x for item in before for vertex in item.data.vertices)
    assert check_no_overlap(bpy, found.items)[0][0][0] > right
    assert len({item.asset_data.catalog_id for item in before + found.items}) == 2


def test_an_object_made_anew_takes_the_place_of_the_old_one(shelf, asset):
    in_blender(check_made_anew, shelf, asset)


def check_made_anew(folder, asset):
    import bpy

    from backend.shelf.bring_in import MADE, bring_in, not_in_scene

    folder, scene = Path(folder), bpy.context.scene
    vase, cup, bowl = bring_in(read_batch(folder), scene).items
    elsewhere = bpy.data.collections.new("elsewhere")
    scene.collection.children.link(elsewhere)
    elsewhere.objects.link(cup)
    bpy.data.collections["Shelf: my shelf"].objects.unlink(cup)
    twin = cup.copy()  # shares the mesh
    scene.collection.objects.link(twin)
    cup.name, cup.location, cup.scale = "my cup", (7, 8, 9), (2, 2, 2)
    cup.asset_data.tags.new("kitchen")
    cup.asset_data.author = "me"
    bpy.context.view_layer.update()
    place, counts = cup.matrix_world.copy(), data_blocks(bpy)

    for path in folder.glob("*/report.json"):
        os.utime(path, (1, 1))  # a copy of the shelf on another drive has other times
    assert not not_in_scene(read_batch(folder), scene)
    for name in ("cup", "bowl"):
        shutil.rmtree(folder / name)
        copy(asset, folder / name, 2.0, 0.0)
        learned = {"roughness": 0.9, "metallic": 0.0}
        material = {"share": 1.0, "albedo": [1, 1, 1], "roughness": 0.9, "metallic": 0.0, "learned": learned}
        (folder / name / "report.json").write_text(json.dumps({"materials": [material]}))
    del bowl[MADE]  # an object of an older version
    assert [one.name for one in not_in_scene(read_batch(folder), scene)] == ["cup"]
    found = bring_in(read_batch(folder), scene)
    assert found.renewed == [cup] and not found.items and not found.refused and not not_in_scene(read_batch(folder), scene)
    bpy.context.view_layer.update()
    assert cup.name == "my cup" and cup.matrix_world == place and list(cup.users_collection) == [elsewhere]
    assert cup.data == twin.data and cup.data.name == cup.data.materials[0].name == "cup"
    assert cup.dimensions.x == pytest.approx(4 * vase.dimensions.x, rel=1e-4), "twice as large, and scaled"
    assert min(vertex.co.z for vertex in cup.data.vertices) == pytest.approx(0, abs=1e-4)
    assert data_blocks(bpy) == counts, "what nobody uses any more is removed"
    about = cup.asset_data
    assert [tag.name for tag in about.tags] == ["kitchen", "not metal", "matte"] and about.author == "me"
    assert "roughness 0.90" in about.description

    curve = bpy.data.objects.new("line", bpy.data.curves.new("line", "CURVE"))
    scene.collection.objects.link(curve)
    curve.asset_mark()
    curve["nep_shelf_asset"], curve[MADE] = vase["nep_shelf_asset"], "before"
    assert "no mesh any more" in bring_in(read_batch(folder), scene).refused["vase"] and data_blocks(bpy)[0] == counts[0] + 1


def data_blocks(bpy) -> list[int]:
    return [len(kind) for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.images)]


def test_an_object_linked_from_a_library_is_not_in_the_scene(shelf, tmp_path):
    in_blender(check_linked, shelf, tmp_path / "library.blend")


def check_linked(folder, library):
    import bpy

    from backend.shelf.bring_in import bring_in, not_in_scene

    scene, batch = bpy.context.scene, read_batch(folder)
    bring_in(batch, scene)
    bpy.ops.wm.save_as_mainfile(filepath=library)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(library, link=True) as (there, linked):
        linked.objects = list(SCALES)
        linked.collections = [next(name for name in there.collections if name.startswith("Shelf"))]
    scene = bpy.context.scene
    scene.collection.children.link(linked.collections[0])
    for item in linked.objects:
        scene.collection.objects.link(item)
    assert [one.name for one in not_in_scene(batch, scene)] == list(SCALES), "a library would name itself as its source"
    assert len(bring_in(batch, scene).items) == 3


def check_no_overlap(bpy, items):
    """The boxes of the objects in the world, which must lie one after the other along X."""
    bpy.context.view_layer.update()
    boxes = []
    for item in items:
        points = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
        boxes.append((points.min(axis=0), points.max(axis=0)))
    assert all(after[0][0] > before[1][0] for before, after in itertools.pairwise(boxes))
    return boxes


def test_the_catalog_file_keeps_its_format_and_what_is_in_it(shelf, tmp_path):
    in_blender(check_catalogs, shelf, tmp_path / "library")


def check_catalogs(folder, library):
    from backend.shelf import catalogs

    library = Path(library)
    library.mkdir()
    batch = read_batch(folder)
    catalog = catalogs.catalog_of(batch)
    assert catalog == catalogs.catalog_of(read_batch(folder)) and catalog.path == "my shelf"
    catalogs.add_catalogs(library, [catalog])
    lines = [line for line in (library / catalogs.FILE).read_text().splitlines() if line and not line.startswith("#")]
    assert lines == ["VERSION 1", f"{catalog.identifier}:my shelf:my shelf"]
    own = f"# mine\nVERSION 1\n{uuid.uuid4()}:Cups/Old:Cups-Old\n"
    (library / catalogs.FILE).write_text(own)
    catalogs.add_catalogs(library, [catalog])
    catalogs.add_catalogs(library, [catalog])
    assert (library / catalogs.FILE).read_text() == own + catalog.line + "\n"
    assert [path.name for path in library.iterdir()] == [catalogs.FILE]

    (library / catalogs.FILE).write_text("VERSION 2\n")
    with pytest.raises(ValueError, match="not known"):
        catalogs.add_catalogs(library, [catalog])
    (library / catalogs.FILE).write_text(own)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", fail_to_replace)
        with pytest.raises(OSError, match="the disk is full"):
            catalogs.add_catalogs(library, [catalog])
    assert (library / catalogs.FILE).read_text() == own and len(list(library.iterdir())) == 1

    other = catalogs.Catalog(str(uuid.uuid4()), "my shelf")
    catalogs.add_catalogs(Path(folder), [other])
    assert catalogs.catalog_of(batch) == other, "a catalog of this name that is there is used"


def fail_to_replace(*_arguments):
    raise OSError("the disk is full")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
