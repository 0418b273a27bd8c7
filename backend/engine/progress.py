"""Puts a job's progress into the words of Blender's panel. No bpy in this file."""

from dataclasses import dataclass

from .words import EngineMessage, Translate

# The keys are the stage names of blender_nep/job/stage_names.py, which Blender's Python cannot import.
STAGES = {
    "capture": "Reading the photos",
    "fields_learning": "Learning shape and light",
    "surface": "Making the mesh",
    "material_learning": "Learning the materials",
    "asset": "Writing the result",
    "finding_cameras": "Finding the cameras",
    "batch": "Reconstructing the objects",
}


@dataclass(frozen=True)
class Progress:
    """How far a job is.

    `fraction`: the part of the whole job that is done, 0..1. `step` and `steps`: the present step of the present stage and
    the number of its steps; 0 where the stage counts no steps. `eta_s`: seconds left, None where not known. `note`: a
    sentence that is shown in the place of the step.
    """

    fraction: float = 0.0
    stage: str = "Starting the engine"
    step: int = 0
    steps: int = 0
    eta_s: float | None = None
    note: EngineMessage | None = None

    @classmethod
    def of(cls, event: dict) -> "Progress":
        """The Progress that a `progress` event of the engine describes."""
        stage, eta = str(event.get("stage", "")), event.get("eta_s")
        return cls(
            min(max(float(event.get("fraction") or 0), 0.0), 1.0),
            STAGES.get(stage, stage.replace("_", " ")),
            int(event.get("step") or 0),
            int(event.get("steps") or 0),
            None if eta is None else float(eta),
            EngineMessage.of(event["note"]) if event.get("note") else None,
        )

    def lines(self, translate: Translate = str) -> list[str]:
        """The lines that the panel shows: the stage, then the note or the step, then the time left."""
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
    """All texts of this file that a translator translates."""
    start = Progress().stage
    return [start, *STAGES.values(), STEP, LEFT, SECONDS, MINUTES, MINUTES_AND_SECONDS, HOURS, HOURS_AND_MINUTES]


def duration(seconds: float, translate: Translate = str) -> str:
    """A length of time in words, for example 75 -> 'about 1 min 20 s'.

    The time is rounded, and longer times are rounded more, because it is an estimate.
    """
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
    """One line of text for an event of the engine, for people who read a terminal or a log."""
    if event["event"] == "progress":
        progress = Progress.of(event)
        return "  ".join([f"{100 * progress.fraction:3.0f} %", *progress.lines()])
    if event["event"] == "warning":
        return f"warning: {event.get('message', '')}"
    if event["event"] == "scene":
        return " ".join(EngineMessage.of(line).message for line in event.get("lines") or ())
    return str(event.get("message") or event.get("path") or event.get("asset") or event["event"])
