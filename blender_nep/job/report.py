"""Puts together the content of report.json."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass

import numpy as np
import torch

from blender_nep.job.device import peak_memory, versions
from blender_nep.job.explained import ExplainedReport
from blender_nep.job.preparation import Prepared
from blender_nep.job.reporting.tracker import Tracker
from blender_nep.job.scene_report import SceneReport
from blender_nep.job.settings import Settings
from blender_nep.job.stage_names import StageName
from blender_nep.job.stage_reports import StageReportView
from blender_nep.messages import Message
from blender_nep.profiling import Profile


@dataclass(frozen=True)
class JobReport:
    """All sources of the facts in report.json."""

    settings: Settings
    prepared: Prepared
    stages: dict[StageName, StageReportView]
    materials: list[dict]
    """The materials that an artist can correct"""
    scene: SceneReport
    explained: ExplainedReport
    tracker: Tracker
    warnings: list[Message]
    profile: Profile | None

    def content(self) -> dict:
        """The content of report.json as plain values, as far as the job is now."""
        s, tracker, memory = self.settings, self.tracker, peak_memory()
        return {
            "preset": s.preset.name,
            "seed": s.seed,
            "device": str(self.prepared.device),
            "threads": torch.get_num_threads(),
            "versions": versions(),
            "capture": self._capture(),
            "seconds": {str(stage): round(tracker.seconds[stage], 2) for stage in StageName},
            "seconds_total": round(sum(tracker.seconds.values()), 2),
            "peak_memory_mb": None if memory is None else round(memory, 1),
            "resumed_stages": [str(stage) for stage in tracker.resumed],
            **self.scene.report(),
            "losses": {str(stage): loss for stage, loss in tracker.losses.items()},
            **({} if self.profile is None else {"profile": self.profile.report()}),
            "materials": self.materials,
            "corrections": {},
            "explained": self.explained.to_dict(),
            "stages": {str(stage): part.facts for stage, part in self.stages.items()},
            "warnings": [warning.to_dict() for warning in self.warnings],
            "fingerprint": self.prepared.fingerprint,
        }

    def _capture(self) -> dict:
        capture, rays = self.prepared.capture, self.prepared.scene.rays
        return {
            "folder": os.path.abspath(capture.folder),
            "views": len(capture.views),
            **({"photos_left_out": list(self.prepared.left_out)} if self.prepared.left_out else {}),
            "pixels": rays.count,
            "color_space": capture.color_space,
            "object_center": capture.object_center.tolist(),
            "object_radius": capture.object_radius,
            "bounds_source": capture.bounds_source,
            "masks": rays.mask is not None,
            "mask_meaning": capture.mask_reading.meaning.value if any(v.mask_path for v in capture.views) else None,
            "exposure": rays.exposure,
            **({} if rays.curve_of_files is None else {"camera_curve": rays.curve_of_files.strength}),
            **({} if rays.gain is None else {"photo_gains": np.round(rays.gain.tolist(), 4).tolist()}),
            **({} if rays.vignetting is None else {"vignetting": asdict(rays.vignetting)}),
        }
