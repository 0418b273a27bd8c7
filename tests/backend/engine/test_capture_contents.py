"""Blender's side counts photos and recognizes captures as the engine does."""

import importlib
import pkgutil

import pytest

from backend.engine.results.capture_contents import (
    LEAST_PHOTOS,
    OTHER_ENDINGS,
    PLAIN_ENDINGS,
    VIDEO_ENDINGS,
    has_cameras,
    photo_count,
    transforms_time,
    video_count,
)
from blender_nep.cameras.photo_folder import _photo_files
from blender_nep.capture import formats, without_cameras
from blender_nep.capture.formats import peers
from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.capture.photos.photo_files import SUFFIXES

METASHAPE = '<?xml version="1.0" encoding="UTF-8"?>\n<document version="1.2.0">\n  <chunk label="a"/>\n</document>\n'
BUNDLER = "# Bundle file v0.3\n0 0\n"
FILES = {
    "transforms": [{"transforms.json": "{}"}],
    "nerf_synthetic": [{"transforms_train.json": "{}"}],
    "colmap": [
        {f"{place}cameras.{ending}": "", f"{place}images.{ending}": ""}
        for place in (
            *("", "sparse/", "sparse/0/", "colmap/sparse/", "colmap/sparse/0/", "sparse/1/", "dense/sparse/"),
            *("dense/0/sparse/", "dense/0/sparse/0/", "dense/sparse/0/", "undistorted/sparse/", "undistorted/sparse/0/"),
            *("distorted/sparse/", "distorted/sparse/0/", "colmap_sparse/", "colmap_sparse/0/", "colmap_text/"),
        )
        for ending in ("bin", "txt")
    ],
    "llff": [{"poses_bounds.npy": ""}],
    "cameras_sphere": [{"cameras_sphere.npz": ""}, {"cameras.npz": ""}],
    "metashape": [{"export.xml": METASHAPE}],
    "realityscan": [{"cameras.csv": "#cameras 0\n#name,x,y,alt,heading,pitch,roll,f\n"}],
    "realityscan_xmp": [{f"{place}a.xmp": "<xcr:Rotation>"} for place in ("", "images/")],
    "openmvg": [{"sfm_data.json": '{"sfm_data_version": "0.3"}'}],
    "record3d": [{"metadata.json": '{"poses": []}', "rgb/0.jpg": ""}],
    "sdfstudio": [{"meta_data.json": '{"camtoworld": 1}'}],
    "mvsnet": [{"cams/00000000_cam.txt": "extrinsic\nintrinsic\n"}],
    "nero": [{"0-camera.pkl": ""}],
    "gaussians": [{"cameras.json": '[{"img_name": "a"}]'}],
    "meshroom": [{"cameras.sfm": '{"version": ["1", "2", "6"]}'}],
    "opensfm": [{f"{place}reconstruction.json": '[{"cameras": {}}]'} for place in ("", "opensfm/")],
    "visualsfm": [{"model.nvm": "NVM_V3\n"}],
    "polycam": [
        {f"{place}/1.json": '{"t_00": 1}'}
        for place in ("keyframes/cameras", "keyframes/corrected_cameras", "cameras", "corrected_cameras")
    ],
    "bundler": [{"scene.out": BUNDLER}, {"bundle/bundle.out": BUNDLER}],
}
"""{format: folders of it, {file: its text}}"""
NO_CAMERAS = [
    {"metadata.json": '{"poses": []}'},
    {"a.xmp": "<xcr:FocalLength35mm>"},
    {"cameras.json": "{}"},
    {"flight.csv": "#name,x,y,alt,yaw,pitch,roll\n"},
    {"prices.csv": "name,x,y,alt"},
    {"a.sfm": "{}"},
    {"reconstruction.json": "[]"},
    {"a.nvm": "NVM"},
    {"keyframes/cameras/1.json": "{}"},
    {},
    {"notes.xml": "<video><clip/></video>"},
    {"torn.xml": "<document"},
    {"a.out": "#"},
    {"cameras.bin": ""},
]


def written(folder, files: dict[str, str]):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def modules() -> dict[str, object]:
    """The engine's formats by their names."""
    found = {
        name: importlib.import_module(f"{package.__name__}.{name}")
        for package in (formats, peers)
        for _, name, _ in pkgutil.iter_modules(package.__path__)
    }
    return {name: module for name, module in found.items() if hasattr(module, "recognizes")}


def test_a_folder_of_each_format_is_known_here():
    assert set(modules()) <= set(FILES), "a new format: backend/engine/results/capture_contents.py must recognize it, too"


@pytest.mark.parametrize("name", sorted(modules()))
def test_both_sides_recognize_the_same_folders(name, tmp_path):
    for number, files in enumerate(FILES[name]):
        folder = written(tmp_path / str(number), files)
        assert modules()[name].recognizes(folder) and has_cameras(folder), files
        assert (transforms_time(folder) > 0) == (name == "transforms")


@pytest.mark.parametrize("files", NO_CAMERAS, ids=lambda files: " ".join(files) or "nothing")
def test_other_files_are_no_cameras(files, tmp_path):
    folder = written(tmp_path, files)
    assert not has_cameras(folder) and not any(module.recognizes(folder) for module in modules().values())
    assert not has_cameras(tmp_path / "none")


def test_both_sides_count_the_same_photos(tmp_path):
    assert LEAST_PHOTOS == MINIMUM_VIEWS and {*PLAIN_ENDINGS, *OTHER_ENDINGS} == set(SUFFIXES)
    for number, ending in enumerate(SUFFIXES):
        (tmp_path / f"{number}{ending.upper()}").touch()
    for name in ("a.jpg", "a.png", "a.NEF", "b.dng", "b.tif", ".hidden.jpg", "notes.txt", "c.jpg.part"):
        (tmp_path / name).touch()
    (tmp_path / "folder.jpg").mkdir()
    assert photo_count(tmp_path) == len(_photo_files(tmp_path)) == len(SUFFIXES) + 3


def test_both_sides_know_the_same_videos(tmp_path):
    assert VIDEO_ENDINGS == without_cameras._VIDEOS and video_count(tmp_path / "none") == 0
    for name in ("a.MP4", "b.mov", ".hidden.mp4", "c.mp4.part"):
        (tmp_path / name).touch()
    assert video_count(tmp_path) == len(without_cameras.videos_in(tmp_path)) == 2


def test_photos_may_lie_in_the_folder_images(tmp_path):
    assert photo_count(tmp_path) == photo_count(tmp_path / "none") == 0
    written(tmp_path / "images", {"a.jpg": "", "b.jpg": ""})
    assert photo_count(tmp_path) == 2
    (tmp_path / "c.jpg").touch()
    assert photo_count(tmp_path) == 1
