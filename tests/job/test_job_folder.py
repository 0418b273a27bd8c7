"""Files of the job folder: they survive a full disk."""

from __future__ import annotations

import errno
import os

from blender_nep.job.job_folder import Journal


def test_a_journal_outlives_a_full_disk(tmp_path, monkeypatch):
    journal, room = Journal(tmp_path / "journal"), [5]
    write = os.write

    def narrow(descriptor, data):
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = write(descriptor, data[: room[0]])
        room[0] -= taken
        return taken

    monkeypatch.setattr(os, "write", narrow)
    journal.write("first line\n")
    journal.flush()
    room[0] = 100
    journal.write("second line\n")
    journal.flush()
    assert (tmp_path / "journal").read_text() == "first line\nsecond line\n"
