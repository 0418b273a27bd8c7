"""How far a job is, in an artist's words."""

from dataclasses import dataclass

from .words import Said, Translate

# the names are those of blender_nep/job/stage_names.py, which Blender's Python does not have
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
    note: Said | None = None

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
            Said.of(event["note"]) if event.get("note") else None,
        )

    def lines(self, translate: Translate = str) -> list[str]:
        """What is being done; the step, or a note that says more; the time left."""
        found = [translate(self.stage)]
        if self.note is not None:
            found.append(self.note.words(translate))
        elif self.steps > 1:
            found.append(translate(STEP).format(step=self.step, steps=self.steps))
        if self.eta_s is not None:
            found.append(translate(LEFT).format(time=duration(self.eta_s, translate)))
        return found


STEP, LEFT = "Step {step} of {steps}", "{time} left"
SECONDS, MINUTES, MINUTES_AND_SECONDS = "about {seconds} s", "about {minutes} min", "about {minutes} min {seconds} s"
HOURS, HOURS_AND_MINUTES = "about {hours} h", "about {hours} h {minutes} min"


def texts() -> list[str]:
    """Every text of this file: what a translator translates."""
    start = Progress().stage
    return [start, *STAGES.values(), STEP, LEFT, SECONDS, MINUTES, MINUTES_AND_SECONDS, HOURS, HOURS_AND_MINUTES]


def duration(seconds: float, translate: Translate = str) -> str:
    """75 -> 'about 1 min 20 s'; steps that grow with the length, as an estimate deserves."""
    if seconds < 60:
        return translate(SECONDS).format(seconds=max(5, 5 * round(seconds / 5)))
    if seconds < 300:
        minutes, rest = divmod(10 * round(seconds / 10), 60)
        return translate(MINUTES_AND_SECONDS if rest else MINUTES).format(minutes=minutes, seconds=rest)
    if seconds < 3570:
        return translate(MINUTES).format(minutes=round(seconds / 60))
    hours, minutes = divmod(5 * round(seconds / 300), 60)
    return translate(HOURS_AND_MINUTES if minutes else HOURS).format(hours=hours, minutes=minutes)


def describe(event: dict) -> str:
    """One line for people."""
    if event["event"] == "progress":
        progress = Progress.of(event)
        return "  ".join([f"{100 * progress.fraction:3.0f} %", *progress.lines()])
    if event["event"] == "warning":
        return f"warning: {event.get('message', '')}"
    if event["event"] == "scene":
        return " ".join(Said.of(line).message for line in event.get("lines") or ())
    return str(event.get("message") or event.get("path") or event.get("asset") or event["event"])
