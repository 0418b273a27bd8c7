"""The mean square of touched entries: both bodies against a selection of the entries."""

import pytest
import torch

from blender_nep.ops.object.touched import PART, touched_mean_square


@pytest.mark.parametrize("n", [1, 1000, PART, 3 * PART + 5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("body", ["numba", "torch"])
def test_mean_square_is_that_of_the_touched_entries(n, dtype, body):
    gradient = torch.randn(n, generator=torch.Generator().manual_seed(n)).to(dtype)
    gradient[torch.rand(n, generator=torch.Generator().manual_seed(1)) < 0.8] = 0
    touched = gradient[gradient != 0]
    expected = touched.square().mean() if len(touched) else gradient.new_zeros(())
    torch.testing.assert_close(touched_mean_square(gradient, body), expected, rtol=1e-5, atol=0)


def test_mean_square_of_untouched_and_not_contiguous_gradients():
    assert touched_mean_square(torch.zeros(7)) == 0
    assert touched_mean_square(torch.tensor([[3.0, 0.0], [0.0, 5.0], [2.0, 0.0]]).T) == pytest.approx((9 + 25 + 4) / 3)
