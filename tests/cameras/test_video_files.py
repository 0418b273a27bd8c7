"""A video's frames have the right colors and stand upright; what is no video, or is damaged, gets a clear message."""

import shutil
import wave
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from blender_nep.cameras.video import video_file
from blender_nep.cameras.video.taken_frames import TakenFrames, take_frames
from blender_nep.cameras.video.video_file import opened_video
from blender_nep.errors import CaptureError
from support.films import pan, write_color, write_film

MOVING = np.linspace(0, 60, 48)
"""Places of a slow pan: 0.3 widths in a second"""
QUICK = np.linspace(0, 120, 24)


def taken(film: Path, most: int = 6) -> TakenFrames:
    return take_frames(film, most, film.with_name(f"frames of {film.name}"), lambda step, steps: None, threads=1)


def codes(frames: TakenFrames) -> set[str]:
    return {message.code for message in frames.warnings}


def refused(film: Path) -> CaptureError:
    with pytest.raises(CaptureError) as caught:
        taken(film)
    assert caught.value.code == 3
    return caught.value


def color_of(film: Path) -> np.ndarray:
    """The color [3] in 0..1 that the program gives the middle of the first frame."""
    from blender_nep.cameras.video.frame_color import encoding_of_frame, upright_pixels

    with opened_video(film, 1) as opened:
        frame = next(opened.frames())
        return upright_pixels(frame, encoding_of_frame(frame, film), 1.0)[30, 40] / 255


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("full", [False, True], ids=["limited", "full"])
@pytest.mark.parametrize("matrix", ["709", "601"])
def test_colors_are_those_that_were_filmed(tmp_path, matrix, full, bits):
    rgb = (0.8, 0.3, 0.1)
    film = write_color(tmp_path / "a.mp4", rgb, matrix, full=full, bits=bits)
    # the file names BT.601's primaries, too: they differ a little from sRGB's
    assert color_of(film) == pytest.approx(rgb, abs=0.012 if matrix == "709" else 0.05)


def test_frames_without_a_told_matrix_have_that_of_their_size(tmp_path):
    film = write_color(tmp_path / "a.mp4", (0.8, 0.3, 0.1), "601", full=False, bits=8, told=False)
    assert color_of(film) == pytest.approx((0.8, 0.3, 0.1), abs=0.012)


def test_the_cameras_curve_of_bt709_is_undone(tmp_path):
    film = write_color(tmp_path / "a.mp4", (0.5, 0.5, 0.5), "709", full=False, bits=8, transfer=1)
    linear = ((0.5 + 0.099) / 1.099) ** (1 / 0.45)
    assert color_of(film) == pytest.approx([1.055 * linear ** (1 / 2.4) - 0.055] * 3, abs=0.012)


def test_hlg_is_undone(tmp_path):
    """The scene's light 1/12 has the value 1/2 (ITU-R BT.2100, table 5)."""
    film = write_color(tmp_path / "a.mp4", (0.5, 0.5, 0.5), "2020", full=False, bits=10, transfer=18)
    assert color_of(film) == pytest.approx([1.055 * (1 / 12) ** (1 / 2.4) - 0.055] * 3, abs=0.012)


def test_primaries_of_bt2020_become_those_of_srgb(tmp_path):
    gray = write_color(tmp_path / "gray.mp4", (0.6, 0.6, 0.6), "2020", full=False, bits=10)
    assert color_of(gray) == pytest.approx([0.6] * 3, abs=0.012)
    green = color_of(write_color(tmp_path / "green.mp4", (0.3, 0.6, 0.3), "2020", full=False, bits=10))
    assert green[1] - green[0] > 0.35, "the same numbers mean a purer green there"


def test_pq_is_refused(tmp_path):
    film = write_color(tmp_path / "a.mp4", (0.5, 0.5, 0.5), "2020", full=False, bits=10, transfer=16)
    error = refused(film)
    assert error.name == "capture.video_colors" and "HDR" in error.message and "Film without HDR" in error.hint


def turned_by_header(film: Path, matrix: tuple[int, ...]) -> Path:
    """The file with another display matrix a, b, c, d in its track header (ISO/IEC 14496-12, 8.3.2), by its bytes."""
    data = bytearray(film.read_bytes())
    at = data.index(b"tkhd") + 4 + 40
    for place, value in zip((0, 4, 12, 16), matrix, strict=True):
        data[at + place : at + place + 4] = (value << 16).to_bytes(4, "big", signed=True)
    turned = film.with_name(f"turned_{film.name}")
    turned.write_bytes(data)
    return turned


@pytest.mark.parametrize(
    ("matrix", "corner"), [((0, 1, -1, 0), (0, -1)), ((-1, 0, 0, -1), (-1, -1)), ((0, -1, 1, 0), (-1, 0))]
)
def test_frames_stand_upright(tmp_path, matrix, corner):
    """A stored point (x, y) is shown at (a x + c y, b x + d y): the stored top left corner is bright."""
    frames = [np.tile(frame[:, :, None] // 2, 3) for frame in pan(MOVING)]
    for frame in frames:
        frame[:40, :40] = 255
    film = turned_by_header(write_film(tmp_path / "a.mp4", frames), matrix)
    shown = np.asarray(Image.open(taken(film).paths[0]).convert("L")).astype(float)
    assert shown.shape == ((128, 96) if matrix[0] == 0 else (96, 128))
    corners = {(y, x): shown[y * 8 : y * 8 + 8 or None, x * 8 : x * 8 + 8 or None].mean() for y in (0, -1) for x in (0, -1)}
    assert max(corners, key=corners.get) == corner and corners[corner] > 240


def test_pixels_that_are_no_squares_become_squares(tmp_path):
    def wide(stream):
        stream.sample_aspect_ratio = stream.codec_context.sample_aspect_ratio = Fraction(4, 3)

    film = write_film(tmp_path / "a.mp4", pan(MOVING), prepare=wide)
    assert Image.open(taken(film).paths[0]).size == (171, 96)


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.fixture
def film(tmp_path):
    return write_film(tmp_path / "real.mp4", pan(MOVING))


@pytest.mark.parametrize("ending", ["m3u8", "mp4", "sdp", "mpd"])
def test_lists_of_other_files_and_addresses_are_not_followed(tmp_path, film, ending):
    address = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=a\nc=IN IP4 127.0.0.1\nt=0 0\n"
    schema = 'xmlns="urn:mpeg:dash:schema:mpd:2011"'
    lists = {
        "hls": f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{film}\n#EXT-X-ENDLIST\n",
        "concat": f"ffconcat version 1.0\nfile '{film}'\n",
        "sdp": f"{address}m=video 9 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
        "dash": f'<?xml version="1.0"?><MPD {schema}><Period><BaseURL>{film}</BaseURL></Period></MPD>',
    }
    for name, text in lists.items():
        error = refused(written(tmp_path / f"{name}.{ending}", text))
        assert error.name == "capture.video_unreadable" and "MP4, MOV" in error.hint


def test_what_is_no_video_is_said(tmp_path):
    Image.new("RGB", (100, 100)).save(tmp_path / "picture.gif")
    Image.new("RGB", (100, 100)).save(tmp_path / "picture.mp4", "PNG")
    with wave.open(str(tmp_path / "sound.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(1600))
    for name, said in (("picture.gif", "format"), ("picture.mp4", "format"), ("sound.wav", "format")):
        assert said in refused(tmp_path / name).message
    assert "the file is empty" in refused(written(tmp_path / "empty.mp4", "")).message
    assert "No such file" in refused(tmp_path / "none.mp4").message
    assert "no file on a disk" in refused(tmp_path).message


def test_sound_alone_is_no_video(tmp_path):
    with av.open(str(tmp_path / "sound.m4a"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 44100
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    assert refused(tmp_path / "sound.m4a").name == "capture.no_video_stream"


def test_frames_that_are_too_large_are_not_decoded(tmp_path, film, monkeypatch):
    monkeypatch.setattr(video_file, "LARGEST_SIDE", 100)
    error = refused(film)
    assert error.name in ("capture.video_size", "capture.video_unreadable"), "the decoder itself may refuse it"


def test_a_film_that_was_not_copied_to_its_end(tmp_path, film):
    whole = film.read_bytes()
    mark = whole.index(b"mdat")
    torn = written(tmp_path / "torn.mp4", whole[: mark + (len(whole) - mark) // 2])
    frames = taken(torn)
    assert 3 <= len(frames.paths) and codes(frames) == {"cameras.video_damaged"}
    assert refused(written(tmp_path / "head.mp4", whole[:40])).name == "capture.video_unreadable"
    assert refused(written(tmp_path / "bare.mp4", whole[: mark + 8])).name == "capture.video_without_frames"


def test_damaged_frames_are_left_out(tmp_path, film):
    data = bytearray(film.read_bytes())
    mark = data.index(b"mdat")
    rng = np.random.default_rng(0)
    for place in rng.integers(mark + 3000, len(data), 60):
        data[place] = int(rng.integers(256))
    try:
        frames = taken(written(tmp_path / "spoilt.mp4", bytes(data)))
    except CaptureError as error:
        assert error.code == 3
    else:
        assert 3 <= len(frames.paths) <= 6


def test_a_camera_that_stands_still_is_said(tmp_path):
    assert refused(write_film(tmp_path / "still.mp4", pan([4.0] * 30))).name == "capture.video_too_still"


def test_a_quick_pan_is_warned_of_and_a_slow_one_is_not(tmp_path, film):
    assert codes(taken(film)) == set(), "1.3 of 128 pixels in a frame"
    quick = taken(write_film(tmp_path / "quick.mp4", pan(QUICK)))
    assert codes(quick) == {"cameras.video_fast"}
    assert quick.warnings[0].values["percent"] == pytest.approx(100 * 30 * 120 / 23 / 128, rel=0.1)


def test_an_interlaced_film_is_told(tmp_path):
    film = write_film(tmp_path / "a.mp4", pan(np.linspace(0, 30, 30)), flags="+ildct+ilme")
    assert codes(taken(film)) == {"cameras.video_interlaced"}


def test_frames_are_photos_with_losses_and_numbers(tmp_path, film):
    frames = taken(film, most=6)
    assert [path.suffix for path in frames.paths] == [".jpg"] * 6
    numbers = [int(path.stem.removeprefix("frame_")) for path in frames.paths]
    assert numbers == sorted(numbers) and numbers[-1] < len(MOVING)
    (said,) = frames.said
    assert said.values == {"count": 6, "frames": len(MOVING), "video": "real.mp4"}
    true = pan(MOVING)
    for number, path in zip(numbers, frames.paths, strict=True):
        shown = np.asarray(Image.open(path).convert("L")).astype(float)
        assert np.abs(shown - true[number]).mean() < 6, "the frame that its name says"
    assert not Image.open(frames.paths[0]).getexif()


@pytest.mark.parametrize("ending", ["mkv", "avi", "mov", "mts"])
def test_other_containers(tmp_path, ending):
    name = {"mts": "ts"}.get(ending, ending)
    film = write_film(tmp_path / f"a.{name}", pan(MOVING))
    shutil.move(film, tmp_path / f"b.{ending}")
    assert len(taken(tmp_path / f"b.{ending}").paths) == 6
