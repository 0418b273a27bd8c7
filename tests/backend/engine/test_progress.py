"""How far a job is, in an artist's words."""

from backend.engine.progress import Progress, describe, duration, in_panel_words


def test_words_for_people():
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
    assert in_panel_words("say so by --metal yes or --metal no") == "Say so in Advanced > Material"
    assert in_panel_words("Free some space, then go on with --resume.") == "Free some space, then go on with Resume."
    assert in_panel_words("stopped (standard input was closed); the checkpoint is written") == (
        "Stopped because Blender closed; the checkpoint is written"
    )
