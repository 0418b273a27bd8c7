"""Photos of the printed room, and the ways in which people and machines break them."""

from __future__ import annotations

import errno
import json
import os
import shutil
import struct
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from blender_nep.cameras import structure_from_motion, written_capture
from blender_nep.cameras.found_cameras import FoundCameras
from blender_nep.cameras.photo_folder import Photo
from blender_nep.cameras.structure_from_motion import PlacedPhoto
from blender_nep.capture.cameras.camera import Camera
from blender_nep.stop_request import StopRequest
from support import printed_room
from support.printed_room import BALLS, HEIGHT, WIDTH

COUNT = 8
CENTER, RADIUS = np.array(BALLS[0][0]), 0.8
OTHER_SCENE = 7
LONG, WIDE = 1.5, 0.8
"""Focal lengths of two other lenses, as parts of the usual one"""
OTHER_LENSES = {LONG: (0, 2, 4, 6, 7), WIDE: (0, 2, 4, 6)}
"""{focal length: the photos that were also taken with such a lens}"""
_ORIENTATION, _FILM_LENGTH = 0x0112, 0xA405
_EXIF = 0x8769


@dataclass(frozen=True)
class Room:
    """What the cameras saw, before anything broke."""

    cameras: list[Camera]
    pictures: list[Image.Image]
    strangers: list[Image.Image]
    """Photos of another scene by the same cameras"""
    zoomed: dict[float, dict[int, Image.Image]]
    """{part of the focal length: {number of a photo: the photo by such a lens}}"""

    @classmethod
    def photographed(cls) -> Room:
        """Photograph half of a ring: neighbors are 22 degrees apart, so a gap of 203 degrees is left."""
        cameras = [printed_room.camera(number, 2 * COUNT) for number in range(COUNT)]

        def taken(seen_by: Camera, seed: int = 0) -> Image.Image:
            return printed_room.photograph(seen_by, seed, samples=2).convert("RGB")

        return cls(
            cameras,
            [taken(seen_by) for seen_by in cameras],
            [taken(seen_by, OTHER_SCENE) for seen_by in cameras[: COUNT // 2]],
            {part: {n: taken(zoomed(cameras[n], part)) for n in which} for part, which in OTHER_LENSES.items()},
        )


def zoomed(camera: Camera, part: float) -> Camera:
    """The camera with another focal length."""
    return replace(camera, fl_x=part * camera.fl_x, fl_y=part * camera.fl_y)


@dataclass
class Shoot:
    """The photos of one case on the disk. A way to break them is a function of a Shoot."""

    room: Room
    folder: Path
    """What the command is given"""
    spare: Path
    """A folder for what else the case needs"""
    patch: pytest.MonkeyPatch
    out: Path | None = None
    """What the command is given as --out"""
    files: list[Path] = field(default_factory=list)
    truth: list[Camera] = field(default_factory=list)
    """The true camera of each file"""
    stop: StopRequest = field(default_factory=StopRequest)
    stop_at: str = ""
    """Code of the progress note at which the user asks for a stop"""

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        self.truth = list(self.room.cameras)
        for number, picture in enumerate(self.room.pictures):
            self.files.append(self.folder / f"photo_{number:02d}.jpg")
            picture.save(self.files[-1], quality=95)

    def put(self, number: int, picture: Image.Image, ending: str = ".jpg", **options: object) -> None:
        """Write another picture as the photo `number`."""
        self.files[number].unlink()
        self.files[number] = self.files[number].with_suffix(ending)
        picture.save(self.files[number], **({"quality": 95} if ending == ".jpg" else {}), **options)

    def put_all(self, change: Callable[[Image.Image], Image.Image], ending: str = ".jpg", **options: object) -> None:
        """Change all photos."""
        for number, picture in enumerate(self.room.pictures):
            self.put(number, change(picture), ending, **options)

    def move(self, number: int, path: Path) -> None:
        """Give a photo another place or name."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self.files[number] = self.files[number].rename(path)

    def keep(self, kept: range) -> None:
        """Take out all other photos."""
        for path in set(self.files) - {self.files[number] for number in kept}:
            path.unlink()
        self.files, self.truth = [self.files[n] for n in kept], [self.truth[n] for n in kept]

    def mask(self, number: int, size: tuple[int, int] = (WIDTH, HEIGHT), value: int = 255) -> Path:
        """Write a mask of a photo."""
        path = self.folder / "masks" / f"{self.files[number].stem}.png"
        path.parent.mkdir(exist_ok=True)
        Image.new("L", size, value).save(path)
        return path

    def capture(self, cameras: list[Camera] | None = None, **changes: object) -> dict:
        """Write transforms.json with these cameras (the true ones) and the object's sphere, and return its content."""
        photos = [Photo(path, WIDTH, HEIGHT, None, ()) for path in self.files]
        placed = [PlacedPhoto(*pair, 0, 0.0) for pair in zip(photos, cameras or self.truth, strict=True)]
        found = replace(FoundCameras(placed, np.zeros((0, 3)), [], CENTER, RADIUS), **changes)
        return json.loads(written_capture.write_capture(found, self.folder).read_text())

    def fake_pycolmap(self, text: str) -> None:
        """Let the process that finds cameras import this text as pycolmap. For that, it is not isolated here."""
        (self.spare / "fake").mkdir()
        (self.spare / "fake" / "pycolmap.py").write_text(text)
        self.patch.setattr(structure_from_motion, "isolated_python", lambda: (sys.executable, "-P"))
        self.patch.setenv("PYTHONPATH", os.pathsep.join([str(self.spare / "fake"), os.environ.get("PYTHONPATH", "")]))


# files that are no photos, or no sound ones


def cut_at_half(shoot: Shoot) -> None:
    path = shoot.files[3]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty_file(shoot: Shoot) -> None:
    shoot.files[3].write_bytes(b"")


def text_file(shoot: Shoot) -> None:
    shoot.files[3].write_text("<html>404 not found</html>")


def three_photos(shoot: Shoot) -> None:
    shoot.keep(range(3))


def two_photos(shoot: Shoot) -> None:
    shoot.keep(range(2))


def other_files_beside(shoot: Shoot) -> None:
    for name in ("Thumbs.db", ".DS_Store", "._photo_00.jpg", "film.mp4", "notes.txt", "photo_00.xmp"):
        (shoot.folder / name).write_bytes(b"\0\5\26\7")
    (shoot.folder / "thumbnails").mkdir()
    (shoot.folder / "folder.jpg").mkdir()


# kinds of files


def kinds_of_pixels(shoot: Shoot) -> None:
    """CMYK, gray, a palette, one with transparency, alpha, gray with alpha, 16 bits in one channel, 16 bits in three."""
    pictures = shoot.room.pictures
    shoot.put(0, pictures[0].convert("CMYK"))
    shoot.put(1, pictures[1].convert("L"))
    shoot.put(2, pictures[2].quantize(64), ".png")
    shoot.put(3, pictures[3].quantize(64), ".png", transparency=3)
    shoot.put(4, with_alpha(pictures[4]), ".png")
    shoot.put(5, with_alpha(pictures[5]).convert("LA"), ".png")
    shoot.put(6, Image.fromarray(257 * np.asarray(pictures[6].convert("L")).astype(np.uint16)), ".png")
    shoot.put(7, pictures[7], ".png")
    write_png16(shoot.files[7], 257 * np.asarray(pictures[7]).astype(np.uint16))


def with_alpha(picture: Image.Image) -> Image.Image:
    picture = picture.convert("RGBA")
    picture.putalpha(200)
    return picture


def write_png16(path: Path, pixels: np.ndarray) -> None:
    """Write [H, W, 3] uint16, which Pillow cannot."""
    height, width, _ = pixels.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), pixels.astype(">u2").view(np.uint8).reshape(height, -1)], 1)
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ]
    written = (struct.pack(">I", len(d)) + name + d + struct.pack(">I", zlib.crc32(name + d)) for name, d in chunks)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(written))


# what EXIF says


def turned(camera: Camera, turns: int) -> Camera:
    """The camera of an image that was turned by quarter turns counterclockwise."""
    for _ in range(turns):
        matrix = camera.camera_to_world.copy()
        matrix[:3, 0], matrix[:3, 1] = -camera.camera_to_world[:3, 1], camera.camera_to_world[:3, 0]
        size, focal = (camera.height, camera.width), (camera.fl_y, camera.fl_x)
        camera = Camera(*size, *focal, camera.cy, camera.width - camera.cx, matrix, camera.lens)
    return camera


def all_orientations(shoot: Shoot) -> None:
    """The stored photos lie on their sides and stand on their heads. EXIF says so, four times as if they were mirrored."""
    for number, turns in enumerate((0, 0, 2, 2, 1, 1, 3, 3)):
        exif = Image.Exif()
        exif[_ORIENTATION] = number + 1
        shoot.put(number, shoot.room.pictures[number].rotate(90 * turns, expand=True), exif=exif)
        shoot.truth[number] = turned(shoot.truth[number], turns)


def two_mirrored(shoot: Shoot) -> None:
    for number in (0, 7):
        shoot.put(number, shoot.room.pictures[number].transpose(Image.Transpose.FLIP_LEFT_RIGHT))


def film_length(millimeters: float) -> Image.Exif:
    """EXIF with a focal length in 35 mm film."""
    exif = Image.Exif()
    exif.get_ifd(_EXIF)[_FILM_LENGTH] = millimeters
    return exif


def film(part: float) -> Image.Exif:
    """EXIF that tells `part` of the true focal length."""
    return film_length(round(part * printed_room.FOCAL / np.hypot(WIDTH, HEIGHT) * 43.2666))


def focal_length_too_long(shoot: Shoot) -> None:
    shoot.put_all(lambda picture: picture, exif=film(5))


def focal_length_zero(shoot: Shoot) -> None:
    shoot.put_all(lambda picture: picture, exif=film(0))


def nonsense_in_exif(shoot: Shoot) -> None:
    """One half begins as EXIF does, the other half does not."""
    for number in range(COUNT):
        if number % 2:
            shoot.put(number, shoot.room.pictures[number], exif=b"Exif\0\0II*\0\x08\0\0\0\xff\xff" + bytes(range(200)) * 2)
        else:
            shoot.put(number, shoot.room.pictures[number], ".png", exif=bytes(range(60)))


# sizes and lenses


def half_size(shoot: Shoot) -> None:
    for number in (1, 4, 6):
        shoot.put(number, shoot.room.pictures[number].resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX))
        shoot.truth[number] = shoot.truth[number].scaled(WIDTH // 2, HEIGHT // 2)


def two_lenses(shoot: Shoot) -> None:
    """Every second photo by a longer lens, without a word of it in EXIF."""
    for number in (0, 2, 4, 6):
        shoot.put(number, shoot.room.zoomed[LONG][number])
        shoot.truth[number] = zoomed(shoot.truth[number], LONG)


def one_zoomed(shoot: Shoot) -> None:
    shoot.put(7, shoot.room.zoomed[LONG][7])
    shoot.truth[7] = zoomed(shoot.truth[7], LONG)


def two_lenses_that_exif_tells(shoot: Shoot) -> None:
    shoot.put_all(lambda picture: picture, exif=film(1))
    for number in (0, 2, 4, 6):
        shoot.put(number, shoot.room.zoomed[WIDE][number], exif=film(WIDE))
        shoot.truth[number] = zoomed(shoot.truth[number], WIDE)


def one_cropped(shoot: Shoot) -> None:
    left, top, right, bottom = 60, 0, WIDTH, 200
    shoot.put(3, shoot.room.pictures[3].crop((left, top, right, bottom)))
    true = shoot.truth[3]
    shoot.truth[3] = replace(true, width=right - left, height=bottom - top, cx=true.cx - left, cy=true.cy - top)


# what the photos show


def one_stranger(shoot: Shoot) -> None:
    shoot.room.strangers[3].save(shoot.folder / "stranger.jpg", quality=95)


def half_strangers(shoot: Shoot) -> None:
    shoot.keep(range(5))
    for number, picture in enumerate(shoot.room.strangers):
        picture.save(shoot.folder / f"z_stranger_{number}.jpg", quality=95)


def one_twice(shoot: Shoot) -> None:
    shoot.files.append(shoot.folder / "photo_03 (copy).jpg")
    shutil.copy(shoot.files[3], shoot.files[-1])
    shoot.truth.append(shoot.truth[3])


def all_alike(shoot: Shoot) -> None:
    for path in shoot.files[1:]:
        shutil.copy(shoot.files[0], path)


def blank(shoot: Shoot) -> None:
    shoot.put_all(lambda picture: Image.new("RGB", picture.size, (200, 200, 200)))


def two_blurred(shoot: Shoot) -> None:
    for number in (0, 7):
        shoot.put(number, shoot.room.pictures[number].filter(ImageFilter.GaussianBlur(8)))


def exposures(shoot: Shoot) -> None:
    """Every second photo three f-stops darker than the others."""
    for number in range(0, COUNT, 2):
        shoot.put(number, shoot.room.pictures[number].point(lambda value: round(255 * (value / 255 / 2.6))))


def noise(shoot: Shoot) -> None:
    random = np.random.default_rng(0)
    shoot.put_all(
        lambda p: Image.fromarray((np.asarray(p) + random.normal(0, 8, (HEIGHT, WIDTH, 3))).clip(0, 255).astype("u1"))
    )


# names and places


def strange_names(shoot: Shoot) -> None:
    shoot.folder = shoot.folder.rename(shoot.folder.with_name("Bücher 'und' \"Vasen\" 花瓶 100%"))
    names = ("a b'ß'", 'say "hi" 花', "{x},#?é.tar")
    old = [shoot.folder / path.name for path in shoot.files]
    shoot.files = [path.rename(shoot.folder / f"{name}.jpg") for path, name in zip(old, names, strict=True)]


def name_that_is_no_unicode(shoot: Shoot) -> None:
    """Written by another system; and both bytes are letters there."""
    try:
        shoot.move(2, shoot.folder / os.fsdecode(b"photo_\xff\xe9.jpg"))
    except OSError as error:
        if error.errno not in (errno.EILSEQ, errno.EINVAL):
            raise
        pytest.skip(f"this file system has only names that are Unicode ({error})")


def long_path(shoot: Shoot) -> None:
    folder = shoot.folder / ("d" * 120) / ("e" * 120)
    for number in range(len(shoot.files)):
        shoot.move(number, folder / f"{'f' * 200}_{number}.jpg")
    shoot.folder = folder


def upper_case(shoot: Shoot) -> None:
    for number, path in enumerate(shoot.files):
        shoot.move(number, path.with_name(path.name.upper()))


def in_images(shoot: Shoot) -> None:
    for number, path in enumerate(shoot.files):
        shoot.move(number, shoot.folder / "images" / path.name)
    shoot.room.pictures[0].resize((64, 48)).save(shoot.folder / "cover.jpg")


def symbolic_link(shoot: Shoot) -> None:
    link = shoot.spare / "link"
    link.symlink_to(shoot.folder, target_is_directory=True)
    shoot.folder = link


# masks


def upright_mask(shoot: Shoot) -> None:
    for number in range(COUNT):
        shoot.mask(number, (HEIGHT, WIDTH) if number == 3 else (WIDTH, HEIGHT))


def one_mask_missing(shoot: Shoot) -> None:
    for number in range(COUNT):
        shoot.mask(number)
    (shoot.folder / "masks" / f"{shoot.files[3].stem}.png").unlink()


def torn_mask(shoot: Shoot) -> None:
    for number in range(COUNT):
        torn = shoot.mask(number)
    torn.write_bytes(torn.read_bytes()[:60])
