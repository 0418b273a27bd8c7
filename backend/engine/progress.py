"""How far a job is, in an artist's words."""

from dataclasses import dataclass

STAGES = {
    "capture": "Reading the photos",
    "fields_learning": "Learning shape and light",
    "surface": "Making the mesh",
    "material_learning": "Learning the materials",
    "asset": "Writing the result",
}


@dataclass(frozen=True)
class Progress:
    """`fraction` of the whole job 0..1, step and steps of its present part (0: none to count), seconds left or None."""

    fraction: float = 0.0
    stage: str = "Starting the engine"
    step: int = 0
    steps: int = 0
    eta_s: float | None = None

    @classmethod
    def of(cls, event: dict) -> "Progress":
        """A `progress` event of the engine."""
        stage, eta = str(event.get("stage", "")), event.get("eta_s")
        return cls(
            min(max(float(event.get("fraction") or 0), 0.0), 1.0),
            STAGES.get(stage, stage.replace("_", " ")),
            int(event.get("step") or 0),
            int(event.get("steps") or 0),
            None if eta is None else float(eta),
        )

    def lines(self) -> list[str]:
        """What is being done; the step; the time left."""
        found = [self.stage]
        if self.steps > 1:
            found.append(f"Step {self.step} of {self.steps}")
        if self.eta_s is not None:
            found.append(f"{duration(self.eta_s)} left")
        return found


def duration(seconds: float) -> str:
    """75 -> 'about 1 min 20 s'; steps that grow with the length, as an estimate deserves."""
    if seconds < 60:
        return f"about {max(5, 5 * round(seconds / 5))} s"
    if seconds < 300:
        minutes, rest = divmod(10 * round(seconds / 10), 60)
        return f"about {minutes} min" + (f" {rest} s" if rest else "")
    if seconds < 3570:
        return f"about {round(seconds / 60)} min"
    hours, minutes = divmod(5 * round(seconds / 300), 60)
    return f"about {hours} h" + (f" {minutes} min" if minutes else "")


# the engine speaks of its command line; the panel has other words for the same
_IN_PANEL = {
    ", with --engine-python or by the variable NEP_ENGINE_PYTHON": "",
    "--masks ignore": "Use Masks is off",
    "--overwrite": "Start Again",
    "--resume": "Resume",
    "--out": "output folder",
    "--seed": "Seed",
    "by --metal yes or --metal no": "in Advanced > Material",
    "--device cpu": "the device CPU",
    "--preset preview": "the preset Preview",
    "--mesh": "Known Mesh",
    "`blender-nep info`": "the capture's description",
    "stopped (standard input was closed)": "Stopped because Blender closed",
    "stopped (stop file)": "Stopped",
    "stopped (stop command)": "Stopped",
    "Stopped during ": "Stopped while ",
    "fields learning": "learning shape and light",
    "material learning": "learning the materials",
}


def in_panel_words(text: str) -> str:
    """A message of the engine for whoever has no command line."""
    for option, words in _IN_PANEL.items():
        text = text.replace(option, words)
    return text[:1].upper() + text[1:]


def describe(event: dict) -> str:
    """One line for people."""
    if event["event"] == "progress":
        progress = Progress.of(event)
        return "  ".join([f"{100 * progress.fraction:3.0f} %", *progress.lines()])
    if event["event"] == "warning":
        return f"warning: {event.get('message', '')}"
    if event["event"] == "scene":
        return " ".join(str(line) for line in event.get("lines") or ())
    return str(event.get("message") or event.get("path") or event.get("asset") or event["event"])
