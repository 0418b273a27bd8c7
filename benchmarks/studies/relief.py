"""Which relief does a job find? A ball with four bands of waves tells, each half as long as the one before.

    python -m benchmarks.studies.relief ball ball.ply
    python backend/synthetic.py --scene ball.ply --material gold --views 42 --test-views 4 --size 640 --samples 6 --seed 3 \
        --out ball                                        # about 11 minutes on two cores
    blender-nep reconstruct ball --preset quality --masks ignore --out asset
    python -m benchmarks.studies.relief score asset ball ball.ply

The score is the mean angle in degrees between the normals that a renderer shades with and the true ones, in each band.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import igl
import numpy as np
import trimesh

from benchmarks.scoring.asset_mesh import read_asset_mesh
from benchmarks.scoring.geometry import true_mesh
from blender_nep.capture import load_capture
from blender_nep.geometry.mesh import Surface, normalized

BANDS = {0.16: (28, 58), 0.08: (58, 84), 0.04: (84, 108), 0.02: (108, 130)}
"""{length of the waves: polar angles in degrees at which the band begins and ends}. Lengths are about in object radii."""
STEEPNESS = 0.06
"""Height of the waves as a share of their length. Their steepest slope is then 20 degrees."""
_RADIUS = 0.95
_FADE = np.radians(3)
_INNER = 4
"""Degrees at the border of a band that do not count: there its waves rise."""
_POINTS = 200_000


def ball(subdivisions: int = 8) -> trimesh.Trimesh:
    """The ball, a little lobed, so that its parts can be told apart."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    direction = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    polar, azimuth = np.arccos(direction[:, 2]), np.arctan2(direction[:, 1], direction[:, 0])
    radius = _RADIUS * (1 - 0.10 * np.cos(2 * polar) - 0.04 * np.cos(3 * azimuth) * np.sin(polar) ** 3)
    for length, (begin, end) in BANDS.items():
        begin, end = np.radians(begin), np.radians(end)
        strength = np.clip((polar - begin) / _FADE, 0, 1) * np.clip((end - polar) / _FADE, 0, 1)
        around = round(2 * np.pi * _RADIUS * np.sin((begin + end) / 2) / length)
        waves = np.sin(around * azimuth) * np.sin(2 * np.pi * _RADIUS * polar / length)
        radius += strength * STEEPNESS * length * waves
    return trimesh.Trimesh(direction * radius[:, None], sphere.faces, process=False)


def score(asset: Surface, truth: trimesh.Trimesh, polar: np.ndarray) -> dict[str, float]:
    """Mean angle in degrees between interpolated normals of asset and truth for each band. Both are in the unit frame.

    polar [V]: polar angles in degrees of the truth's vertices, by which the bands are told apart.
    """
    points, face = trimesh.sample.sample_surface(truth, _POINTS, seed=0)
    at = trimesh.triangles.points_to_barycentric(truth.triangles[face], points)
    angle = (polar[truth.faces[face]] * at).sum(1)
    faces = np.asarray(asset.faces, np.int64)
    _, nearest, place = igl.point_mesh_squared_distance(np.ascontiguousarray(points), asset.vertices, faces)
    there = trimesh.triangles.points_to_barycentric(asset.vertices[faces[nearest]], place)
    ours = _interpolated(asset.normals, faces[nearest], there)
    cosine = (_interpolated(truth.vertex_normals, truth.faces[face], at) * ours).sum(1)
    error = np.degrees(np.arccos(cosine.clip(-1, 1)))
    bands = {f"{length:g}": (begin + _INNER, end - _INNER) for length, (begin, end) in BANDS.items()}
    bands["smooth"] = (0, BANDS[0.16][0] - _INNER)
    return {name: float(error[(angle > begin) & (angle < end)].mean()) for name, (begin, end) in bands.items()}


def _interpolated(normals: np.ndarray, corners: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """Unit normals [n, 3] from normals [V, 3] at the corners [n, 3] of faces."""
    return normalized((normals[corners] * barycentric[..., None]).sum(1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("ball", help="write the ball").add_argument("file", type=Path)
    scored = commands.add_parser("score", help="score an asset of the ball")
    for name in ("asset", "capture", "ball"):
        scored.add_argument(name, type=Path)
    options = parser.parse_args()
    if options.command == "ball":
        ball().export(options.file)
        return
    capture = load_capture(options.capture)
    made, truth = trimesh.load(options.ball, process=False), true_mesh(options.capture, capture).mesh
    asset = read_asset_mesh(options.asset / "mesh.obj", capture)
    if len(made.vertices) != len(truth.vertices):
        raise SystemExit(f"{options.ball} is not the mesh from which {options.capture} was rendered")
    polar = np.degrees(np.arccos(made.vertices[:, 2] / np.linalg.norm(made.vertices, axis=1)))
    for name, degrees in score(asset, truth, polar).items():
        print(f"{name:>7}: {degrees:.2f} degrees")


if __name__ == "__main__":
    main()
