"""The fine level of the SDF: where it has coefficients, and what it can hold."""

import math

import pytest
import torch
from torch.nn import functional

from blender_nep.fields.object.field import REFERENCE_CELL, ObjectField
from blender_nep.fields.object.fine_level import REACH, FineLevel

CELLS = 64


def points_near(radius, width, count, seed=0):
    generator = torch.Generator().manual_seed(seed)
    direction = functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    return direction * (radius + width * (2 * torch.rand(count, 1, generator=generator) - 1))


@pytest.fixture
def field():
    field = ObjectField(16, 0.6)
    field.add_levels(2)
    return field


def test_it_changes_nothing_at_first_and_is_complete_near_points(field):
    seen = points_near(0.6, 0.3, 2000)
    before = field.shape().sample(seen, hessian=True)
    points = points_near(0.6, 0.0, 3000, seed=1)[:20]
    field.fine = FineLevel.at(points, CELLS)
    torch.testing.assert_close(field.shape().sample(seen, hessian=True), before, rtol=0, atol=0)
    assert field.shape().cell == pytest.approx(2 / CELLS)
    offset = (2 * torch.rand(200, 20, 3, generator=torch.Generator().manual_seed(2)) - 1) * REACH * 2 / CELLS
    assert field.fine.complete_at((points + offset).reshape(-1, 3)).all()
    assert not field.fine.complete_at(-points + 0.2).any(), "elsewhere there is nothing"


def test_an_extended_level_keeps_what_it_has_learned(field):
    field.fine = FineLevel.at(points_near(0.6, 0.0, 500), CELLS)
    with torch.no_grad():
        field.fine.coefficients.normal_(std=0.003)
    seen = points_near(0.6, 0.02, 1000)
    before, bricks = field.sdf(seen), len(field.fine.coefficients)
    further = points_near(0.8, 0.0, 500)
    field.fine = FineLevel.at(further, CELLS, field.fine)
    assert len(field.fine.coefficients) > bricks
    assert field.fine.complete_at(further).all()
    torch.testing.assert_close(field.sdf(seen), before, rtol=0, atol=0)


def test_its_steps_are_those_of_its_cell_width(field):
    field.fine = FineLevel.at(points_near(0.6, 0.0, 500), CELLS)
    optimizer = field.shape_optimizer(0.01, (0.9, 0.99))
    before = field.fine.coefficients.detach().clone()
    field.fine.coefficients.grad = torch.ones_like(field.fine.coefficients)
    optimizer.step()
    expected = 0.01 * (2 / CELLS) / REFERENCE_CELL
    torch.testing.assert_close(before - field.fine.coefficients.detach(), torch.full_like(before, expected))


def test_its_state_is_restored(field):
    field.fine = FineLevel.at(points_near(0.6, 0.0, 500), CELLS)
    with torch.no_grad():
        field.fine.coefficients.normal_(std=0.01)
    again = ObjectField(16, 0.6)
    again.grow(field.structure())
    again.load_state_dict(field.state_dict())
    points = points_near(0.6, 0.02, 500)
    assert torch.equal(again.sdf(points), field.sdf(points))


def test_it_holds_relief_that_is_too_fine_for_the_other_levels(field):
    """Waves of 1.8 coarse cells: the least-squares fit of the coarse levels misses them, and that of the bricks does not."""
    points = points_near(0.6, 0.0, 30_000)
    wave = 2 * math.pi / (1.8 * 2 / 32)
    relief = 0.01 * torch.sin(wave * points).prod(-1)
    field.fine = FineLevel.at(points, CELLS)

    def error(parameters):
        for parameter in (*field.levels, field.fine.coefficients):
            parameter.requires_grad_(any(parameter is one for one in parameters))
        optimizer = torch.optim.Adam(parameters, lr=2e-3)
        for _ in range(150):
            optimizer.zero_grad()
            loss = (field.shape().sample(points)[:, 0] - relief).square().mean()
            loss.backward()
            optimizer.step()
        return float((field.sdf(points) - relief).square().mean().sqrt() / relief.std())

    coarse = error([*field.levels])
    fine = error([field.fine.coefficients])
    assert coarse > 0.5
    assert fine < 0.2
