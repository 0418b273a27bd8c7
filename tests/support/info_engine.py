"""An executable that plays the engine's Python for `blender_nep info CAPTURE --json`.

It writes its arguments to info_arguments.json beside itself, and the picture that was asked for: between black rows, its
left half is red and its right half green. Then it does what the file `info_mode` beside it says: well (or no such file):
it says what was found. fail: it reports that the capture cannot be read. slow: it waits until the file `go` is there. old:
it does not know the options. silent: it dies without an answer.
"""

import json
from pathlib import Path

from support.executable import write_executable

FOUND = {
    "photos": 6,
    "sizes": {"48 x 32": 6},
    "directions_covered": 0.41,
    "largest_hole": {"code": "capture.hole_below", "values": {"degrees": 70.2}, "message": "below"},
    "sphere_width": 31.2,
    "exposure_stops": 1.26,
    "object_center": [0.1, 0.2, 0.3],
    "object_radius": 0.7,
    "warnings": [
        {"code": "capture.photos_blurred", "values": {"count": 1, "names": ["photo_3.jpg"]}, "message": "blurred"},
        {"code": "capture.of_tomorrow", "values": {}, "message": "too many moons"},
    ],
}

SCRIPT = """
import json, pathlib, sys, time
from PIL import Image
assert sys.argv[1:5] == ["-I", "-m", "blender_nep", "info"], sys.argv
here, options = pathlib.Path(__file__).parent, sys.argv[5:]
(here / "info_arguments.json").write_text(json.dumps(options))
mode = (here / "info_mode").read_text() if (here / "info_mode").exists() else "well"
while mode == "slow" and not (here / "go").exists():
    time.sleep(0.02)
if mode == "old":
    sys.exit("blender-nep: error: unrecognized arguments: --picture")
if mode == "silent":
    sys.exit("the last words")
if mode == "fail":
    values = dict(photo="photo_3.jpg")
    error = dict(code=3, name="capture.photo_unreadable", values=values, message="photo_3.jpg is torn", hint="Take it out.")
    print(json.dumps(dict(error=error)))
    sys.exit(3)
if "--picture" in options:
    picture = Image.new("RGB", (100, 50))
    picture.paste((255, 0, 0), (0, 4, 50, 39))
    picture.paste((0, 255, 0), (50, 4, 100, 39))
    picture.save(options[options.index("--picture") + 1])
print((here / "found.json").read_text())
"""


def make(folder: Path) -> str:
    """Write the executable, and what it says; returns its path."""
    (folder / "found.json").write_text(json.dumps(FOUND))
    return write_executable(folder / "info-engine-python", SCRIPT)
