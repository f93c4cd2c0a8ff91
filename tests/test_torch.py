"""Gradients of projections in PyTorch: checked by gradcheck, and by what an optimiser finds."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.recon.moving import MovingProjector
from twinct.specimen.deformation import Deformation

torch = pytest.importorskip("torch", reason="needs torch: pip install twinct[torch]")

from twinct.torch import Projection  # noqa: E402 - it refuses to load without torch

LINEAR = {"eps": 1.0, "atol": 1e-3, "rtol": 1e-3}
"""A linear function has no error of its step, so a large one outweighs the kernels' rounding."""


@pytest.fixture
def projector():
    """Two views of a small grid; no ray is near to changing its fastest axis."""
    x, y, z = np.eye(3)
    ahead = np.stack([y, 0.98 * y + np.sqrt(1 - 0.98**2) * z])
    right = np.stack([x, x])
    down = np.cross(ahead, right)
    geometry = ScanGeometry(100 * ahead, -80 * ahead, right, down, Panel(5, 6, 9.0, 8.0))
    geometry = Pose.from_euler((0, 0, 0), (3, 4, 5)) @ geometry
    return Projector(geometry, VolumeGrid((8, 9, 10), 4.0, Pose.from_euler((1, 0, -1), (2, -3, 4))))


@pytest.fixture
def volume():
    """Voxels with air around them, so that no ray jumps at the grid's faces."""
    values = torch.zeros(8, 9, 10, dtype=torch.double)
    values[2:-2, 2:-2, 2:-2] = torch.from_numpy(np.random.default_rng(3).random((4, 5, 6)))
    return values


def test_it_is_the_projector(projector, volume):
    project = Projection(projector)
    expected = projector(volume.numpy())
    np.testing.assert_array_equal(project(volume.float()).numpy(), expected)
    at_rest = project(volume.float(), torch.zeros(2, 2, 6)).numpy()
    np.testing.assert_allclose(at_rest, expected, atol=1e-5 * expected.max())


def test_the_volume_has_the_exact_adjoint_as_its_gradient(projector, volume):
    project, x = Projection(projector), volume.clone().requires_grad_()
    weights = torch.from_numpy(np.random.default_rng(1).random(projector.range_shape))
    (project(x) * weights).sum().backward()
    np.testing.assert_array_equal(x.grad.float().numpy(), projector.T(weights.numpy()))


def test_gradients_pass_gradcheck(projector, volume):
    project, x = Projection(projector), volume.clone().requires_grad_()
    assert torch.autograd.gradcheck(project, (x,), **LINEAR)
    assert torch.autograd.gradgradcheck(project, (x,), **LINEAR)
    rng = np.random.default_rng(2)
    twists = torch.from_numpy(rng.normal(size=(2, 2, 6)) * [0.5, 0.5, 0.5, 0.01, 0.01, 0.01])
    twists.requires_grad_()
    keys = {"eps": 3e-4, "atol": 2e-2, "rtol": 1e-2}
    smooth = torch.nn.functional.avg_pool3d(volume[None, None], 3, 1, 1)[0, 0]
    assert torch.autograd.gradcheck(lambda t: project(smooth, t), (twists,), **keys)
    moved = twists.detach()
    assert torch.autograd.gradcheck(lambda v: project(v, moved), (x,), **LINEAR)


def test_an_optimiser_finds_a_displaced_panel(projector, volume):
    project = Projection(projector)
    smooth = torch.nn.functional.avg_pool3d(volume[None, None], 3, 1, 1)[0, 0]
    true = torch.zeros(2, 2, 6, dtype=torch.double)
    true[:, 1, 0], true[:, 1, 1] = 1.5, -0.8
    measured = project(smooth, true)
    found = torch.zeros(2, dtype=torch.double, requires_grad=True)
    adam = torch.optim.Adam([found], lr=0.1)
    for _ in range(150):
        adam.zero_grad()
        shift = torch.zeros(2, 2, 6, dtype=torch.double)
        shift[:, 1, :2] = found
        (project(smooth, shift) - measured).square().sum().backward()
        adam.step()
    np.testing.assert_allclose(found.detach().numpy(), [1.5, -0.8], atol=0.02)


def test_twists_are_in_the_axes_of_source_and_panel(projector):
    twists = torch.zeros(2, 2, 6)
    twists[0, 0, 2], twists[1, 1, 0], twists[0, 1, 5] = 3.0, 2.0, 0.1
    before, after = projector.geometry, Projection(projector).geometry(twists)
    towards = before.detector[0] - before.source[0]
    closer = before.source[0] + 3.0 * towards / np.linalg.norm(towards)
    np.testing.assert_allclose(after.source[0], closer, atol=1e-5)
    np.testing.assert_allclose(after.detector[1], before.detector[1] + 2 * before.u[1], atol=1e-5)
    turned = np.cos(0.1) * before.u[0] + np.sin(0.1) * before.v[0]
    np.testing.assert_allclose(after.u[0], turned, atol=1e-6)


def test_what_does_not_fit_is_refused(projector, volume):
    project = Projection(projector)
    with pytest.raises(InputError, match=r"shape \(9, 9, 10\); the grid needs \(8, 9, 10\)"):
        project(torch.zeros(9, 9, 10))
    with pytest.raises(InputError, match=r"shape \(2, 6\); it must be \(2, 2, 6\)"):
        project(volume, torch.zeros(2, 6))
    behind = torch.zeros(2, 2, 6)
    behind[0, 0, 2] = 500.0
    with pytest.raises(InputError, match="the twists lead to no geometry: u x v of view 0"):
        project(volume, behind)
    still = [Deformation(np.zeros_like, Pose.identity())] * 2
    moving = MovingProjector(projector.geometry, projector.grid, still)
    with pytest.raises(InputError, match="projector is a MovingProjector"):
        Projection(moving)
