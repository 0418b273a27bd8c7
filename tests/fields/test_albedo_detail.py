"""The grids of fine paint are interpolated, have right gradients, and paint lines that the MLP cannot paint."""

import itertools

import numpy as np
import pytest
import torch

from blender_nep.fields.object import albedo_detail
from blender_nep.fields.object.albedo_detail import CELLS, ENTRIES, AlbedoDetail


def reference(detail: AlbedoDetail, point: np.ndarray) -> np.ndarray:
    """The logits [3] at a point [3], corner by corner."""
    found, logits = np.zeros(3), detail.logits.detach().double().numpy()
    for grid, cells in enumerate(CELLS):
        place = (np.clip(point, -1, 1) + 1) / 2 * cells
        low = np.minimum(np.floor(place), cells - 1)
        for corner in itertools.product((0, 1), repeat=3):
            x, y, z = (int(k) for k in low + corner)
            entry = (x ^ y * 2_654_435_761 ^ z * 805_459_861) % ENTRIES
            weight = np.prod([share if up else 1 - share for up, share in zip(corner, place - low, strict=True)])
            found += weight * logits[grid * ENTRIES + entry]
    return found


@pytest.fixture
def detail() -> AlbedoDetail:
    made = AlbedoDetail().double()
    torch.nn.init.normal_(made.logits, generator=torch.Generator().manual_seed(0))
    return made


def test_each_grid_is_interpolated_between_the_corners_of_a_cell(detail):
    inside = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    points = np.concatenate([inside, [[-1, -1, -1], [1, 1, 1], [1, -1, 0], [0, 0, 0], [1.5, 0.2, -2]]])
    expected = [reference(detail, point) for point in points]
    np.testing.assert_allclose(detail(torch.from_numpy(points)).detach().numpy(), expected, atol=1e-6)


def test_gradients_are_right(detail, monkeypatch):
    monkeypatch.setattr(albedo_detail, "ENTRIES", 64)
    small = AlbedoDetail().double()
    torch.nn.init.normal_(small.logits, generator=torch.Generator().manual_seed(1))
    points = torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 1.8 - 0.9
    points.requires_grad_()

    def value(points, logits):
        return torch.func.functional_call(small, {"logits": logits}, (points,))

    assert torch.autograd.gradcheck(value, (points, small.logits), eps=1e-7, atol=1e-4)


def test_nothing_is_painted_at_first():
    assert not AlbedoDetail()(torch.rand(10, 3)).any()


def test_a_line_of_a_thirtieth_of_the_radius_is_painted():
    detail = AlbedoDetail()
    optimizer = torch.optim.Adam(detail.parameters(), 0.02)
    generator = torch.Generator().manual_seed(0)
    for _ in range(300):
        points = torch.rand(2000, 3, generator=generator) * torch.tensor([2.0, 2.0, 0.0]) - torch.tensor([1.0, 1.0, 0.0])
        line = (points[:, 0].remainder(0.2) < 1 / 30).float()[:, None] * 2 - 1
        loss = (detail(points) - line).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss < 0.35
