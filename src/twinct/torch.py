"""Projections in PyTorch: line integrals with gradients by the volume and by the poses.

    project = Projection(projector)
    p = project(x)                       # gradients by x: the exact adjoint
    p = project(x, twists)               # gradients by x and by errors of the poses

The volume may be a parameter, or the output of a network. Twists may be what a calibration looks
for, or the next views that a plan tries. All of ``torch.optim`` applies to both.
"""

# torch.autograd is not typed.
# pyright: basic
from __future__ import annotations

from importlib import import_module
from typing import Any, TypeAlias

import numpy as np

from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.geometry import ScanGeometry
from twinct.recon.projector import Projector
from twinct.recon.ray_slopes import pose_gradient

require("torch")
torch: Any = import_module("torch")  # the type checker need not have it
once_differentiable = torch.autograd.function.once_differentiable

Tensor: TypeAlias = Any
"""A tensor of PyTorch."""


class Projection(torch.nn.Module):
    """Line integrals of a volume, as a layer without parameters.

    Its result is float32, or float64 if the volume is, on the volume's device; the kernels
    compute in float32, on the processor or on the card of the projector's engine.

    Attributes:
        projector: the operator, with the geometry about which the twists turn.
    """

    def __init__(self, projector: Projector) -> None:
        """Take a projector.

        Raises:
            InputError: the projector is of a moving body.
        """
        super().__init__()
        if type(projector) is not Projector:
            raise InputError(
                f"projector is a {type(projector).__name__}; it must be a Projector: only a rigid "
                "body's line integrals have gradients by the poses"
            )
        self.projector = projector
        geometry = projector.geometry
        poses = geometry.source_poses(), geometry.detector_poses()
        matrices = np.array([[one.matrix for one in of_body] for of_body in poses])
        self._world_from_tool = torch.from_numpy(matrices.swapaxes(0, 1))

    def forward(self, volume: Tensor, twists: Tensor | None = None) -> Tensor:
        """Return the line integrals, (views, rows, columns), mm times the unit of the volume.

        Args:
            volume: (z, y, x).
            twists: (v, w) of source and panel in each view, (views, 2, 6), mm and rad, right of
                ``world_from_source`` and ``world_from_detector``: in the tool's own axes. By
                default zero. A turn of the source about itself changes nothing.

        Raises:
            InputError: an argument has another shape; or the moved views cannot be projected.
        """
        A = self.projector
        if tuple(volume.shape) != A.domain_shape:
            raise InputError(
                f"the volume has shape {tuple(volume.shape)}; the grid needs {A.domain_shape} "
                "(z, y, x)"
            )
        if twists is None:
            return _Line.apply(volume, A)
        if tuple(twists.shape) != (len(A), 2, 6):
            raise InputError(
                f"twists has shape {tuple(twists.shape)}; it must be {(len(A), 2, 6)}: (v, w) of "
                "source and panel in each view"
            )
        return _MovedLine.apply(volume, self._vectors(twists), A)

    def geometry(self, twists: Tensor) -> ScanGeometry:
        """Return the views that the twists lead to.

        Args:
            twists: as in ``forward``.
        """
        return _geometry(self._vectors(twists), self.projector)

    def _vectors(self, twists: Tensor) -> Tensor:
        """Return S, D, u and v of each view, (views, 4, 3), float64, on the processor."""
        moved = self._world_from_tool @ torch.linalg.matrix_exp(_hats(twists.cpu().double()))
        source, panel = moved[:, 0], moved[:, 1]
        return torch.stack([source[:, :3, 3], panel[:, :3, 3], panel[:, :3, 0], panel[:, :3, 1]], 1)


class _Line(torch.autograd.Function):
    """A x; its gradient is that of a linear function, and has one itself."""

    @staticmethod
    def forward(ctx: Any, volume: Tensor, A: Projector) -> Tensor:
        ctx.A = A
        return _like(A(_array(volume)), volume)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return _Spread.apply(gradients[0], ctx.A), None


class _Spread(torch.autograd.Function):
    """A^T y."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, A: Projector) -> Tensor:
        ctx.A = A
        return _like(A.T(_array(images)), images)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        return _Line.apply(gradients[0], ctx.A), None


class _MovedLine(torch.autograd.Function):
    """A x as a function of the volume and of S, D, u and v."""

    @staticmethod
    def forward(ctx: Any, volume: Tensor, vectors: Tensor, A: Projector) -> Tensor:
        ctx.A = A.on(A.grid, _geometry(vectors, A))
        ctx.save_for_backward(volume)
        return _like(ctx.A(_array(volume)), volume)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        (volume,), (images,) = ctx.saved_tensors, gradients
        by_volume = by_vectors = None
        if ctx.needs_input_grad[0]:
            by_volume = _like(ctx.A.T(_array(images)), volume)
        if ctx.needs_input_grad[1]:
            by_vectors = torch.from_numpy(pose_gradient(ctx.A, _array(volume), _array(images)))
        return by_volume, by_vectors, None


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32)


def _like(array: np.ndarray, tensor: Tensor) -> Tensor:
    """Return an array as a tensor of the other one's type and device."""
    return torch.from_numpy(array).to(device=tensor.device, dtype=tensor.dtype)


def _geometry(vectors: Tensor, A: Projector) -> ScanGeometry:
    source, detector, u, v = vectors.detach().numpy().swapaxes(0, 1)
    try:
        return ScanGeometry(source, detector, u, v, A.geometry.panel)
    except ValueError as error:
        raise InputError(f"the twists lead to no geometry: {error}") from None


def _hats(twists: Tensor) -> Tensor:
    """Return the matrices of twists (v, w), (..., 4, 4), whose exponentials are poses."""
    v, (x, y, z) = twists[..., :3], twists[..., 3:].unbind(-1)
    zero = torch.zeros_like(x)
    turns = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1)
    rows = torch.cat([turns.reshape(*x.shape, 3, 3), v[..., None]], -1)
    return torch.nn.functional.pad(rows, (0, 0, 0, 1))
