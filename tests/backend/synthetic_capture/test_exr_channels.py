"""Files of named channels: the package OpenEXR reads what is written here, and the other way round."""

import re

import numpy as np
import OpenEXR
import pytest

from backend.synthetic_capture.files.exr_channels import read_channels, write_channels


def make_channels() -> dict[str, np.ndarray]:
    """Half and full floats, some of which compress well."""
    rng = np.random.default_rng(0)
    return {
        "albedo.R": rng.random((37, 21)).astype(np.float16),
        "mask.V": np.ones((37, 21), np.float16),
        "Depth.V": np.linspace(0, 9, 37 * 21, dtype=np.float32).reshape(37, 21),
    }


def test_openexr_reads_what_is_written(tmp_path):
    write_channels(tmp_path / "a.exr", make_channels())
    found = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).channels()
    for name, expected in make_channels().items():
        assert found[name].pixels.dtype == expected.dtype
        np.testing.assert_array_equal(found[name].pixels, expected)
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.parametrize("compression", ["NO_COMPRESSION", "ZIPS_COMPRESSION", "ZIP_COMPRESSION"])
def test_what_openexr_writes_is_read(tmp_path, compression):
    header = {"compression": getattr(OpenEXR, compression), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, make_channels()).write(str(tmp_path / "a.exr"))
    found = read_channels(tmp_path / "a.exr")
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
    with pytest.raises(ValueError, match=re.escape(str(tmp_path / "a.exr"))):
        read_channels(tmp_path / "a.exr")
