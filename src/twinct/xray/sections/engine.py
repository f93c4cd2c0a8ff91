"""Computation of the X-ray images."""

from __future__ import annotations

from twinct.core.settings import Section, setting


class Xray(Section):
    """Computation of the X-ray images."""

    engine: str = setting(
        "gvxr",
        "Engine that renders the images: gvxr, mesh (our own rays), cuda_mesh (the rays of "
        "mesh, on a CUDA card), or one of another package, see docs/engines.md.",
        source="the paper",
    )
