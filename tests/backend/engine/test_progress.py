"""The progress of a job in the words of the panel."""

from backend.engine.progress import Progress, describe, duration


def test_progress_is_put_into_words():
    event = {"event": "progress", "stage": "fields_learning", "step": 2, "steps": 9, "fraction": 0.5, "eta_s": 75}
    assert describe(event) == " 50 %  Learning shape and light  Step 2 of 9  about 1 min 20 s left"
    assert Progress.of({"event": "progress", "fraction": None, "eta_s": None}).lines() == [""]
    assert [duration(s) for s in (1, 44, 299, 300, 3600, 5400)] == [
        "about 5 s",
        "about 45 s",
        "about 5 min",
        "about 5 min",
        "about 1 h",
        "about 1 h 30 min",
    ]
    noted = {"event": "progress", "stage": "surface", "steps": 1, "note": {"code": "progress.warming_up", "values": {}}}
    assert Progress.of(noted).lines() == ["Making the mesh", "Warming up"]
