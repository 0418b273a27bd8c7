"""Object fields whose SDF is known in closed form."""

import torch


class AnalyticField(torch.nn.Module):
    """An SDF given as a function of points [n, 3]."""

    def __init__(self, function, fine=None):
        super().__init__()
        self.function = function
        self.anchor = torch.nn.Parameter(torch.zeros(1))
        self.fine = fine

    def sdf_and_gradient(self, points):
        points = points.detach().clone().requires_grad_(True)
        sdf = self.function(points)
        (gradient,) = torch.autograd.grad(sdf.sum(), points)
        return sdf.detach(), gradient

    def normal(self, points):
        return torch.nn.functional.normalize(self.sdf_and_gradient(points)[1], dim=-1)

    def sdf_grid(self, n):
        axis = torch.linspace(-1, 1, n)
        grid = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        return self.function(grid).reshape(n, n, n).numpy()


def ball(center, radius):
    """The SDF of a ball."""
    return lambda p: (p - torch.tensor(center, dtype=p.dtype)).norm(dim=-1) - radius


def union(*parts):
    """The SDF of the union of bodies."""
    return lambda p: torch.stack([part(p) for part in parts]).amin(0)
