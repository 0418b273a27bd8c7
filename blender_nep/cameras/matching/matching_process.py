"""The process that runs pycolmap: features, matches, and the cameras. It is started as a program of its own.

    python -m blender_nep.cameras.matching.matching_process FOLDER

FOLDER holds `settings.json` (see `structure_from_motion`), which names the folder of the photos. The result is written to
FOLDER: COLMAP models in `sparse/0`, `sparse/1` and so on, and `result.json`. Standard output carries JSON lines with stage,
step and steps. Standard error carries pycolmap's log.

pycolmap brings a zlib of its own, with which Python's zlib can crash. So this process compresses nothing, reads no PNG by
Pillow, and imports nothing of the package but the modules that do its work: `feature_matching`, `added_features`, `mapping`,
`adjustment`, `given_adjustment` and `matching_output`. It brings an SQLite of its own, too: Python's SQLite must not open
the database here, because each of the two would release the other's locks.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from blender_nep.cameras.matching.added_features import add_features
from blender_nep.cameras.matching.adjustment import SEED, adjust_robustly
from blender_nep.cameras.matching.feature_matching import extract, near_pairs, similar_pairs
from blender_nep.cameras.matching.given_adjustment import improve
from blender_nep.cameras.matching.mapping import forget_focal_lengths, globally_mapped, mapped, placed
from blender_nep.cameras.matching.matching_output import say, write

_LEAST_MATCHES_OF_GIVEN = 8
"""Matches that a pair of photos must have where the cameras are given. These reject most wrong matches."""


def main(folder: Path) -> None:
    import pycolmap

    settings = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
    # This connection stays open. Where the last one is closed, SQLite locks the whole database, and so does the next one to
    # open it. pycolmap fails if the process that counts the rows (structure_from_motion) reads at that moment.
    with pycolmap.Database.open(str(folder / "database.db")):
        _find(pycolmap, folder, settings)


def _find(pycolmap: Any, folder: Path, settings: dict) -> None:
    database = folder / "database.db"
    names = [name for lens in settings["lenses"] for name in lens["names"]]
    pycolmap.set_random_seed(SEED)
    say("features", 0, len(names))
    for lens in settings["lenses"]:
        extract(pycolmap, database, lens, settings)
    say("features", len(names), len(names))
    given = settings["given"]
    pairs = near_pairs(given, settings["partners"]) if given else similar_pairs(pycolmap, database, settings)
    (folder / "pairs.txt").write_text("".join(f"{a} {b}\n" for a, b in pairs), encoding="utf-8")
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = settings["threads"]
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(folder / "pairs.txt")
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    if given:
        verification.min_num_inliers = _LEAST_MATCHES_OF_GIVEN
    say("matches", 0, len(pairs))
    pycolmap.match_image_pairs(database, matching, pairing, verification, pycolmap.Device.cpu)
    say("matches", len(pairs), len(pairs))
    if settings["earlier"]:
        add_features(pycolmap, folder, Path(settings["earlier"]), verification)
    if given:
        improve(pycolmap, folder, settings)
    else:
        found = mapped(pycolmap, folder, settings)
        if placed(found) < len(names) / 2 and any(lens["params"] for lens in settings["lenses"]):
            forget_focal_lengths(pycolmap, folder, verification)
            found = max(found, mapped(pycolmap, folder, settings), key=placed)
        if settings["global"] and 0 < placed(found) < settings["enough"]:
            found = max(found, globally_mapped(pycolmap, folder, settings), key=placed)
        for model in found:
            adjust_robustly(pycolmap, model, settings["threads"])
        write(folder, [(model, {}) for model in found])


if __name__ == "__main__":
    os.environ.setdefault("GLOG_minloglevel", "1")
    main(Path(sys.argv[1]))
