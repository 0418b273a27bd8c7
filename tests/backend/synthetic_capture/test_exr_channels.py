"""Files of named channels: the package OpenEXR reads what is written here, and the other way round."""

import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from support.own_process import in_blender


def make_channels() -> dict[str, np.ndarray]:
    """Half and full floats, some of which compress well."""
    rng = np.random.default_rng(0)
    return {
        "albedo.R": rng.random((37, 21)).astype(np.float16),
        "mask.V": np.ones((37, 21), np.float16),
        "Depth.V": np.linspace(0, 9, 37 * 21, dtype=np.float32).reshape(37, 21),
    }


def test_openexr_reads_what_is_written(tmp_path):
    in_blender(write_file, tmp_path / "a.exr")
    found = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    for name, expected in make_channels().items():
        assert found[name].pixels.dtype == expected.dtype
        np.testing.assert_array_equal(found[name].pixels, expected)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def write_file(path):
    from backend.synthetic_capture.exr_channels import write_channels

    write_channels(Path(path), make_channels())


@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "ZIPS_COMPRESSION", "ZIP_COMPRESSION"])
def test_what_openexr_writes_is_read(tmp_path, compression):
    header = {"compression": getattr(OpenEXR, compression), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, make_channels()).write(str(tmp_path / "a.exr"))
    in_blender(check_file, tmp_path / "a.exr")


def check_file(path):
    from backend.synthetic_capture.exr_channels import read_channels

    found = read_channels(Path(path))
    for name, expected in make_channels().items():
        assert found[name].dtype == np.float32
        np.testing.assert_array_equal(found[name], expected)


@pytest.mark.parametrize("kind", ["other compression", "no EXR file"])
def test_other_files_are_refused(tmp_path, kind):
    if kind == "other compression":
        header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, make_channels()).write(str(tmp_path / "a.exr"))
    else:
        (tmp_path / "a.exr").write_bytes(b"something else")
    in_blender(check_refused, tmp_path / "a.exr")


def check_refused(path):
    from backend.synthetic_capture.exr_channels import read_channels

    try:
        read_channels(Path(path))
    except ValueError as error:
        assert path in str(error)
    else:
        raise AssertionError("the file was read")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
