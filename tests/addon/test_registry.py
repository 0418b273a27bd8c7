"""The registry of running processes. The processes are played."""

import contextlib
import io
import sys
from pathlib import Path

from support.blender_checks import Drawn, register
from support.own_process import in_blender


def test_the_registry_follows_keeps_and_forgets_tasks(package):
    in_blender(check_registry, package)


def check_registry(folder):
    import bpy

    tasks = register().tasks
    registry, tick = tasks.registry, tasks.clock.tick

    class Played(registry.Task):
        done, calls, outlives = False, (), None

        def poll(self):
            self.calls += ("poll",)
            return self.done

        def finish(self):
            assert self.ended
            self.calls += ("finish",)

        def close(self):
            self.calls += ("close",)

        def outlives_file(self):
            return super().outlives_file() if self.outlives is None else self.outlives

    class InFolder(Played):
        one_per_folder = True

    class Broken(Played):
        def poll(self):
            raise ZeroDivisionError

    first = registry.start(Played(folder))
    assert registry.running(Played) is registry.running(Played, folder) is first and registry.ended(Played) is None
    assert registry.running(Played, folder / "other") is None
    assert tick() is not None
    first.done = True
    assert tick() is None and tick() is None and first.calls == ("poll", "poll", "finish")
    assert registry.running(Played) is None and registry.ended(Played, folder) is first
    second = Played(folder / "other")
    second.done = True
    assert registry.start(second, wait=True).ended and registry.tasks_of(Played) == [second] and first.calls[-1] == "close"
    registry.forget_ended(Played)
    assert registry.find(Played) is None and second.calls == ("poll", "finish", "close")

    one, two, broken = InFolder(folder), InFolder(folder / "other"), Broken()
    for task in (broken, one, two, one):
        registry.start(task)
    with contextlib.redirect_stderr(io.StringIO()) as printed:
        tick()
    assert registry.tasks_of(InFolder) == [one, two] and one.calls == two.calls == ("poll",)
    assert "ZeroDivisionError" in printed.getvalue(), "an error of one task is told, and the others are followed"
    one.done = True
    tick()
    assert registry.running(InFolder) is two and registry.find(InFolder, folder) is one

    kept, dropped = InFolder(folder / "kept"), InFolder(folder / "dropped")
    kept.done, kept.outlives, dropped.outlives = True, True, False
    for task in (kept, dropped):
        registry.start(task)
    tick()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "saved.blend"))
    assert one.is_of_open_file, "Save As is no other file"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert registry.tasks_of(InFolder) == [two, kept] and not two.is_of_open_file
    assert one.calls[-1] == dropped.calls[-1] == "close" and "close" not in two.calls + kept.calls
    tick()
    assert dropped.calls == ("poll", "close") and two.calls.count("poll") > kept.calls.count("poll")
    check_status_bar(bpy, registry, InFolder, folder)
    registry.close_all()
    assert not registry.find(registry.Task) and two.calls[-1] == kept.calls[-1] == "close" and tick() is None


def check_status_bar(bpy, registry, kind, folder):
    """Work under way is told whatever scene is shown, and its end until it is dismissed. A script needs no news."""
    from types import SimpleNamespace

    from nep_addon.addon.panels.status_bar import draw_status
    from nep_addon.addon.tasks.clock import tick

    class Told(kind):
        done_fraction, has_failed = 0.43, False

        def status_name(self):
            return self.folder.name

        def end_status(self):
            return f"{self.folder.name} is done"

    def told() -> list[str]:
        layout = Drawn()
        draw_status(SimpleNamespace(layout=layout), bpy.context)
        return [text for text in layout.log if text]

    task = registry.start(Told(folder / "pot"))
    tick()
    assert told() == ["pot: 43 %"]
    bpy.context.window.scene = bpy.data.scenes.new("another")
    assert told() == ["pot: 43 %"]
    task.done = True
    tick()
    assert told() == ["pot is done", "nep.dismiss"]
    assert bpy.ops.nep.dismiss() == {"FINISHED"} and told() == []
    waited = Told(folder / "script")
    waited.done = True
    assert registry.start(waited, wait=True).ended and told() == []


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
