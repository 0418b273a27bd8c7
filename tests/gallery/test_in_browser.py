"""The pages in Chromium, opened as files: nothing is fetched, the model turns, and the light comes from where it should.

Skipped without playwright's Python package or without a Chromium of the system. Nothing is downloaded.
"""

from __future__ import annotations

import io
import math
import shutil

import numpy as np
import pytest
from PIL import Image

from blender_nep.gallery import write_gallery
from support.batch_folder import SPOTS, write_batch, write_mirror_ball

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")]

QUIET = ["--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"]
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
NAME = "ball & é #1 100%"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("gallery") / "museum & co"
    write_mirror_ball(found / NAME)
    failure = {"name": "x", "values": {}, "code": 1, "message": "<img src=x onerror='window.broken = 1'>", "hint": ""}
    objects = [{"name": NAME}, {"name": "cup", "state": "failed", "error": failure}, {"name": "jug", "state": "waiting"}]
    write_gallery(write_batch(found, objects))
    return found


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        arguments = [*QUIET, "--disable-sync", *SOFTWARE_GL]
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments, chromium_sandbox=False)
        yield started
        started.close()


@pytest.fixture
def opened(browser):
    """A function that opens a file in a fresh window. At the end the page must not have complained or asked the network."""
    complaints, contexts = [], []

    def look(message):
        if message.type == "error":
            complaints.append(message.text)

    def asked(request):
        if request.url.partition(":")[0] not in ("file", "data", "blob"):
            complaints.append(request.url)

    def open_page(path, **options):
        contexts.append(browser.new_context(viewport={"width": 720, "height": 420}, **options))
        page = contexts[-1].new_page()
        page.on("console", look)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", asked)
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not complaints


def shown(page) -> list[str]:
    return page.locator(".card:visible h3").all_inner_texts()


def test_filter_search_and_keyboard(opened, folder):
    page = opened(folder / "index.html")
    assert shown(page) == [NAME, "cup", "jug"]
    page.get_by_role("radio", name="Failed").check(force=True)
    assert shown(page) == ["cup"]
    page.keyboard.press("ArrowRight")
    assert shown(page) == ["jug"]
    page.get_by_role("radio", name="All").check(force=True)
    page.keyboard.press("/")
    page.keyboard.type("BALL")
    assert shown(page) == [NAME]
    page.keyboard.type(" of gold")
    assert shown(page) == [] and page.get_by_text("No object fits").is_visible()
    page.locator(".totals a", has_text="failed").click()
    page.locator(".card").first.wait_for(state="visible")
    assert shown(page) == [NAME, "cup", "jug"]
    assert page.evaluate("window.broken") is None
    assert page.locator(".picture img").evaluate("image => image.naturalWidth") == 480


def test_without_scripts_all_objects_are_shown(opened, folder):
    page = opened(folder / "index.html", java_script_enabled=False)
    assert shown(page) == [NAME, "cup", "jug"] and not page.locator("#tools").is_visible()


def test_nothing_is_wider_than_the_window(opened, folder):
    page = opened(folder / "index.html")
    for width in (320, 390, 1400):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_the_model_turns_in_its_light(opened, folder):
    page = opened(folder / "index.html")
    page.locator(".picture").first.click()
    page.wait_for_selector("#message", state="hidden", timeout=60_000)
    page.evaluate("document.getElementById('viewer').setAttribute('tone-mapping', 'linear')")
    seen = set()
    for azimuth, polar in ((0, 72), (200, 100)):
        picture, field_of_view, distance = screenshot(page, azimuth, polar)
        reflected, clear = mirrored(picture.shape[:2], field_of_view, distance, math.radians(azimuth), math.radians(polar))
        for direction, color in SPOTS.items():
            inside = clear & (reflected @ np.array(direction, float) > math.cos(math.radians(8)))
            if inside.sum() > 50:
                assert np.median(np.abs(picture[inside] - np.array(color)).max(-1)) < 0.35, (azimuth, direction)
                seen.add(direction)
    assert seen == set(SPOTS)
    page.get_by_text("Gallery", exact=True).click()
    assert shown(page) == [NAME, "cup", "jug"]


def screenshot(page, azimuth: float, polar: float) -> tuple[np.ndarray, float, float]:
    """The viewer's picture [h, w, 3] in 0..1 from a camera at these angles, its vertical angle of view, and its distance.

    Exposure 1 shows a spot of radiance 1 as 1.
    """
    orbit = page.evaluate(
        """async ([azimuth, polar]) => {
            const viewer = document.getElementById('viewer');
            viewer.exposure = 1;
            viewer.maxCameraOrbit = 'auto 180deg auto';
            viewer.cameraOrbit = `${azimuth}deg ${polar}deg 105%`;
            await viewer.updateComplete;
            viewer.jumpCameraToGoal();
            for (let k = 0; k < 4; k++) await new Promise(requestAnimationFrame);
            return [viewer.getFieldOfView(), viewer.getCameraOrbit().radius];
        }""",
        [azimuth, polar],
    )
    png = page.locator("#viewer").screenshot(animations="disabled")
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")) / 255
    return pixels, *orbit


def mirrored(size: tuple[int, int], field_of_view: float, distance: float, azimuth: float, polar: float):
    """What a camera sees in a mirror ball of radius 1 at the origin: directions [h, w, 3] in the capture's frame.

    The second result tells where that is clear: on the ball, but not near its rim, where spots are thin.

    glTF's (x, y, z) is the capture's (x, -z, y).
    """
    height, width = size
    back = np.array([math.sin(polar) * math.sin(azimuth), -math.sin(polar) * math.cos(azimuth), math.cos(polar)])
    right = np.cross([0, 0, 1], back) / math.sin(polar)
    up = np.cross(back, right)
    scale = math.tan(math.radians(field_of_view) / 2) / (height / 2)
    y, x = np.mgrid[:height, :width] + 0.5
    ray = -back + scale * ((x - width / 2)[..., None] * right - (y - height / 2)[..., None] * up)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ (distance * back)
    inside = along**2 - distance**2 + 1
    normal = distance * back + (-along - np.sqrt(np.maximum(inside, 0)))[..., None] * ray
    facing = -(ray * normal).sum(-1)
    return ray + 2 * facing[..., None] * normal, (inside > 0) & (facing > 0.4)


def test_a_page_cannot_reach_the_network(browser, folder):
    page = browser.new_page()
    for path in (folder / "index.html", folder / NAME / "view.html"):
        page.goto(path.as_uri(), wait_until="domcontentloaded")
        refused = "() => fetch('http://127.0.0.1:9/').then(() => 'reached', error => String(error))"
        page.evaluate(
            "document.addEventListener('securitypolicyviolation', event => { window.stopped = event.blockedURI; })"
        )
        assert "Failed to fetch" in page.evaluate(refused)
        assert page.evaluate("window.stopped") == "http://127.0.0.1:9/"
    page.close()
