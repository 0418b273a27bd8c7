"""Photos in another light are found by their surroundings; a white balance or an exposure alone is no other light."""

from dataclasses import replace
from datetime import datetime, timedelta

import pytest
import torch
from PIL import ExifTags, Image

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.exposure import other_light as other_light_module
from blender_nep.capture.exposure.other_light import other_light
from blender_nep.capture.exposure.sessions import times_of
from blender_nep.capture.exposure.surroundings import SPHERES, compare_exposures
from blender_nep.capture.photos.photo_files import time_taken

PHOTOS, EVENING = 40, (8, 9, 10, 25, 26, 27, 28)
LAMP = torch.tensor([1.6, 0.9, 0.35])
MORNING = datetime(2026, 3, 4, 10, 0)


@pytest.fixture
def room(make_capture):
    """Photos in a colored ball, as PixelRays, and a function of two light patterns that makes photos in two lights."""
    rays = PixelRays.from_capture(load_capture(make_capture(views=PHOTOS, size=64).folder), 40_000, False)
    origin, direction, _ = rays.rays(torch.arange(rays.count))
    distance = SPHERES[4] * float(origin.norm(dim=-1).mean())
    along = (origin * direction).sum(-1)
    t = -along + (along**2 - origin.square().sum(-1) + distance**2).sqrt()
    place = (origin + t[:, None] * direction) / distance
    paint = 0.3 + 0.2 * torch.sin(5 * place + torch.tensor([0.0, 1.0, 2.0])) * torch.cos(4 * place.roll(1, -1))
    evening = torch.isin(rays.view_of(torch.arange(rays.count)), torch.tensor(EVENING))[:, None]

    def lit(day: torch.Tensor, lamps: torch.Tensor) -> PixelRays:
        """The photos with the light of `day` [3] from above, and in the evening that of `lamps` [3] from the side."""
        sun, lamp = (0.6 + 0.4 * place[:, axis : axis + 1] for axis in (2, 0))
        noise = 1 + 0.05 * torch.randn(paint.shape, generator=torch.Generator().manual_seed(0))
        return replace(rays, radiance=paint * torch.where(evening, lamp * lamps, sun * day) * noise)

    def balanced(gain: torch.Tensor) -> PixelRays:
        """The photos in one light, in the evening with another white balance."""
        noise = 1 + 0.05 * torch.randn(paint.shape, generator=torch.Generator().manual_seed(0))
        return replace(rays, radiance=paint * torch.where(evening, gain, torch.ones(3)) * noise)

    return lit, balanced


def no_times() -> list[datetime | None]:
    return [None] * PHOTOS


def times(pause: timedelta) -> list[datetime | None]:
    """A photo a minute, and the photos of the evening after a pause."""
    return [MORNING + timedelta(minutes=k) + (pause if k in EVENING else timedelta()) for k in range(PHOTOS)]


def found(rays: PixelRays, when: list[datetime | None]) -> tuple[int, ...]:
    compared = compare_exposures(rays)
    assert compared is not None
    return other_light(compared, when)


def test_photos_by_lamps_are_found_without_times(room):
    assert found(room[0](torch.ones(3), LAMP), no_times()) == EVENING


def test_the_light_of_most_photos_stays(room):
    assert found(room[0](LAMP, torch.ones(3)), no_times()) == EVENING


def test_too_few_photos_in_one_light_are_all_kept(room, monkeypatch):
    monkeypatch.setattr(other_light_module, "MINIMUM_VIEWS", PHOTOS - len(EVENING) + 1)
    assert found(room[0](torch.ones(3), LAMP), no_times()) == ()


def test_another_white_balance_is_no_other_light(room):
    assert found(room[1](LAMP), no_times()) == ()
    assert found(room[1](LAMP), times(timedelta(hours=8))) == ()


def test_warm_white_lamps_are_found_by_time(room):
    rays = room[0](torch.ones(3), torch.tensor([1.2, 1.0, 0.8]))
    assert found(rays, times(timedelta(hours=8))) == EVENING
    assert found(rays, times(timedelta(minutes=5))) == ()
    assert found(rays, no_times()) == ()


def test_the_same_light_on_another_day_stays(room):
    assert found(room[1](torch.ones(3)), times(timedelta(days=1))) == ()


def test_exif_tells_when_a_photo_was_taken(tmp_path):
    plain, dated, odd = (tmp_path / f"{name}.jpg" for name in ("plain", "dated", "odd"))
    exif = Image.Exif()
    Image.new("RGB", (8, 8)).save(plain)
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = "2026:03:04 19:26:17"
    Image.new("RGB", (8, 8)).save(dated, exif=exif)
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.DateTimeOriginal] = "0000:00:00 00:00:00"
    Image.new("RGB", (8, 8)).save(odd, exif=exif)
    assert [time_taken(path) for path in (plain, dated, odd)] == [None, datetime(2026, 3, 4, 19, 26, 17), None]


def test_a_damaged_photo_has_no_time(make_capture):
    capture = load_capture(make_capture(views=8).folder)
    capture.views[3].image_path.write_bytes(b"no photo")
    assert times_of(capture) == [None] * 8
