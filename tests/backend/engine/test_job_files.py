"""The files by which Blender follows a job."""

from backend.engine.job_files import EventFile


def test_only_whole_events_are_read_and_other_lines_are_left_out(tmp_path):
    file = EventFile(tmp_path / "events.jsonl")
    assert file.read() == []
    with open(tmp_path / "events.jsonl", "ab", buffering=0) as writer:
        writer.write(b'a stray line\n[1]\n{"event": "warn')
        assert file.read() == []
        writer.write(b'ing", "message": "\xc3\xa4"}\n{"event": "done"}\n')
        assert file.read() == [{"event": "warning", "message": "ä"}, {"event": "done"}]
        assert file.read() == []
