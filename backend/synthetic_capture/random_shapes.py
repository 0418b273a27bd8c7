"""Closed triangle or quad meshes of random shapes, with numpy alone: (vertices [V,3] float64, faces as lists of indices).

The faces are counter-clockwise seen from outside. No shape has a certain size; `scenes.normalize` scales it.
"""

import math

import numpy as np

Faces = list[list[int]]


def vase(rng: np.random.Generator, around: int = 128) -> tuple[np.ndarray, Faces]:
    """A lathed vase: hollow, open at the top, with a flat foot. Its wall has the same thickness everywhere."""
    steps = 64
    height, wall = rng.uniform(1.6, 2.4), rng.uniform(0.05, 0.09)
    knots = np.linspace(0, 1, 5)
    radii = np.array([rng.uniform(0.35, 0.6), *rng.uniform(0.45, 0.95, 2), rng.uniform(0.3, 0.55), rng.uniform(0.38, 0.65)])
    at = np.linspace(0, 1, steps)
    outer = _smooth(np.interp(at, knots, radii), 9)
    slope = np.gradient(outer, at * height)
    inner = np.maximum(outer - wall * np.sqrt(1 + slope**2), 0.12)
    z = at * height
    inside = z > wall
    lip = [((outer[-1] + inner[-1]) / 2, height + wall / 3)]
    profile = [
        (outer[0] - wall / 3, 0.0),
        *zip(outer, z + wall / 3 * (at == 0), strict=True),
        *lip,
        *zip(inner[inside][::-1], z[inside][::-1], strict=True),
    ]
    return lathe(np.array(profile), around, bottom=0.0, top=wall)


def lathe(profile: np.ndarray, around: int, bottom: float, top: float) -> tuple[np.ndarray, Faces]:
    """The closed surface of revolution of `profile` [N,2] (radius, z) about the z axis.

    The profile goes up on the outside. Two points on the axis close it: one at the height `bottom` before the first point,
    and one at the height `top` after the last point.
    """
    angle = np.arange(around) * 2 * math.pi / around
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = len(profile)
    vertices = np.empty((rows, around, 3))
    vertices[..., :2] = profile[:, None, :1] * ring
    vertices[..., 2] = profile[:, 1:]
    first, last = rows * around, rows * around + 1
    faces = []
    for j in range(around):
        k = (j + 1) % around
        faces.append([first, k, j])
        faces += [[i * around + j, i * around + k, (i + 1) * around + k, (i + 1) * around + j] for i in range(rows - 1)]
        faces.append([last, (rows - 1) * around + j, (rows - 1) * around + k])
    return np.concatenate([vertices.reshape(-1, 3), [[0, 0, bottom], [0, 0, top]]]), faces


def gear(rng: np.random.Generator) -> tuple[np.ndarray, Faces]:
    """A gear: teeth, a bore in the middle, and windows between spokes."""
    teeth, spokes = int(rng.integers(9, 19)), int(rng.integers(3, 7))
    per_tooth = 12
    around = teeth * per_tooth
    bore, hub, rim, root = rng.uniform(0.12, 0.2), rng.uniform(0.3, 0.4), rng.uniform(0.62, 0.7), 0.83
    half = rng.uniform(0.12, 0.25)
    phase = (np.arange(around) % per_tooth) / per_tooth
    tip = np.interp(phase, [0, 0.18, 0.3, 0.7, 0.82, 1], [root, root, 1, 1, root, root])
    radii = np.concatenate([np.linspace(bore, hub, 3), np.linspace(hub, rim, 8)[1:], np.linspace(rim, root - 0.06, 3)[1:]])
    levels = len(radii) + 1
    angle = np.arange(around) * 2 * math.pi / around
    grid = np.concatenate([np.broadcast_to(radii[:, None], (levels - 1, around)), tip[None]])
    flat = np.stack([grid * np.cos(angle), grid * np.sin(angle)], axis=-1)
    middle = (grid[:-1] + grid[1:]) / 2
    in_spoke = (np.arange(around) + 0.5) * spokes / around % 1 < 0.38
    solid = ~((middle > hub) & (middle < rim) & ~in_spoke[None])
    return extrude_cells(flat, solid, half)


def extrude_cells(flat: np.ndarray, solid: np.ndarray, half: float) -> tuple[np.ndarray, Faces]:
    """The closed body of the cells of a polar grid, from z = -half to z = half.

    `flat` [R,A,2] holds the grid's points; the second axis goes around and closes. `solid` [R-1,A] bool says which cells are
    filled. Walls stand where a filled cell meets an empty one or the grid's border.
    """
    rows, around = flat.shape[:2]
    used = np.zeros((rows, around), bool)
    faces: Faces = []

    def point(i: int, j: int, above: bool) -> int:
        used[i, j % around] = True
        return (int(above) * rows + i) * around + j % around

    for i, j in zip(*np.nonzero(solid), strict=True):
        i, j = int(i), int(j)
        corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        faces.append([point(*corner, True) for corner in corners])
        faces.append([point(*corner, False) for corner in corners[::-1]])
        beside = [(i, j - 1), (i + 1, j), (i, j + 1), (i - 1, j)]  # the neighbors across the edges of `corners`
        for k, (a, b) in enumerate(beside):
            if not 0 <= a < rows - 1 or not solid[a, b % around]:
                start, end = corners[k], corners[(k + 1) % 4]
                faces.append([point(*start, False), point(*end, False), point(*end, True), point(*start, True)])
    vertices = np.empty((2, rows, around, 3))
    vertices[..., :2] = flat
    vertices[..., 2] = np.array([-half, half])[:, None, None]
    keep = np.concatenate([used.ravel(), used.ravel()])
    index = np.cumsum(keep) - 1
    return vertices.reshape(-1, 3)[keep], [[int(index[c]) for c in face] for face in faces]


def torus_knot(rng: np.random.Generator) -> tuple[np.ndarray, Faces]:
    """A tube along a torus knot."""
    p, q = ((2, 3), (3, 2), (2, 5), (1, 3))[rng.integers(4)]
    thickness = rng.uniform(0.13, 0.2)
    along, around = 480, 32
    t = np.arange(along) * 2 * math.pi / along
    ring = 1 + 0.45 * np.cos(q * t)
    path = np.stack([ring * np.cos(p * t), ring * np.sin(p * t), 0.6 * np.sin(q * t)], axis=1)
    tangent = np.roll(path, -1, 0) - np.roll(path, 1, 0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    core = np.stack(
        [np.cos(p * t), np.sin(p * t), np.zeros(along)], axis=1
    )  # the axis inside the torus; the path winds around it
    normal = path - core
    normal -= (normal * tangent).sum(1, keepdims=True) * tangent
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    binormal = np.cross(tangent, normal)
    angle = np.arange(around) * 2 * math.pi / around
    offset = np.cos(angle)[:, None] * normal[:, None] + np.sin(angle)[:, None] * binormal[:, None]
    vertices = path[:, None] + thickness * offset
    faces = []
    for i in range(along):
        for j in range(around):
            a, b = (i + 1) % along, (j + 1) % around
            faces.append([i * around + j, a * around + j, a * around + b, i * around + b][::-1])
    return vertices.reshape(-1, 3), faces


def displaced_sphere(rng: np.random.Generator) -> tuple[np.ndarray, Faces]:
    """A sphere whose radius is changed by smooth waves."""
    rings, around = 95, 192
    polar = np.linspace(0, math.pi, rings + 2)[1:-1]
    profile = np.stack([np.sin(polar[::-1]), np.cos(polar[::-1])], axis=1)
    vertices, faces = lathe(profile, around, bottom=-1.0, top=1.0)
    waves = rng.normal(size=(10, 3)) * np.geomspace(1.5, 6, 10)[:, None]
    height = np.geomspace(0.16, 0.04, 10) * rng.uniform(0.5, 1.2, 10)
    change = np.sin(vertices @ waves.T + rng.uniform(0, 2 * math.pi, 10)) @ height
    return vertices * np.exp(0.75 * change)[:, None] * rng.uniform(0.75, 1.0, 3), faces


def thin_shell(rng: np.random.Generator) -> tuple[np.ndarray, Faces]:
    """A thin curved disc with a wavy border, such as a bowl, a leaf or a saddle. Its border is round."""
    rows, around = 40, 160
    radius = np.linspace(0, 1, rows + 1)[1:]
    angle = np.arange(around) * 2 * math.pi / around
    lobes = int(rng.integers(2, 6))
    bowl, saddle, turn = rng.uniform(0.25, 0.8), rng.uniform(-0.25, 0.25), rng.uniform(0, 2 * math.pi)
    half = rng.uniform(0.018, 0.035)
    reach = 1 + rng.uniform(0, 0.12) * np.cos(lobes * angle)
    x, y = (radius[:, None] * reach * np.cos(angle), radius[:, None] * reach * np.sin(angle))
    z = radius[:, None] ** 2 * (bowl + saddle * np.cos(lobes * angle + turn))
    middle = np.stack([x, y, z], axis=-1)
    along = np.roll(middle, -1, 1) - np.roll(middle, 1, 1)
    outward = np.gradient(middle, axis=0)
    normal = np.cross(outward, along)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    border = middle[-1] + half * outward[-1] / np.linalg.norm(outward[-1], axis=-1, keepdims=True)
    sheet = np.concatenate([middle - half * normal, border[None], (middle + half * normal)[::-1]])
    vertices, faces = lathe(np.zeros((len(sheet), 2)), around, bottom=-half, top=half)
    vertices[:-2] = sheet.reshape(-1, 3)
    return vertices, faces


def _smooth(values: np.ndarray, width: int) -> np.ndarray:
    padded = np.pad(values, width, mode="reflect", reflect_type="odd")
    window = np.hanning(2 * width + 3)[1:-1]
    return np.convolve(padded, window / window.sum(), mode="valid")


SHAPES = {
    "vase": vase,
    "gear": gear,
    "torus knot": torus_knot,
    "displaced sphere": displaced_sphere,
    "thin shell": thin_shell,
}
"""Kind of object -> the function that draws its mesh."""
