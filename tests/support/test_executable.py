"""Executables of tests run where Python's path has a space and is longer than a line `#!` may be."""

import json
import subprocess
import sys

from support.executable import write_executable


def test_a_script_runs_where_pythons_path_is_long_with_spaces(tmp_path):
    folder = tmp_path / f"a {'long ' * 40}path"
    folder.mkdir()
    python = folder / "python"
    python.symlink_to(sys.executable)
    script = "import json, sys\nprint(json.dumps([sys.executable, __file__, *sys.argv[1:]]))\n"
    engine = write_executable(folder / "an engine", script, str(python))
    done = subprocess.run([engine, "-I", "two words", ""], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [str(python), engine, "-I", "two words", ""]
