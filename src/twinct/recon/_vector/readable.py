"""Kernels that are fast as the plain engine has them: here with fast mathematics."""

from twinct.recon import _plain
from twinct.recon._vector.options import CUBE, IMAGE, MATRICES, STACK, kernel

ratio = kernel(
    f"({IMAGE}, {IMAGE}, {IMAGE}, f4, f4, {IMAGE}, {IMAGE}, i4[:, ::1])", parallel=False
)(_plain.ratio.py_func)
back_project = kernel(f"({STACK}, {MATRICES}, f8[::1], {CUBE})")(_plain.back_project.py_func)
primal = kernel(f"({CUBE}, {CUBE}, f4[:, :, :, ::1], f8[::1], f4, {CUBE})")(_plain.primal.py_func)
ascend = kernel(f"({CUBE}, {CUBE}, f8[::1], f8, f8, f4[:, :, :, ::1])")(_plain.ascend.py_func)
