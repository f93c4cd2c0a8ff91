"""Contents of a page, to compare with a scan."""

from __future__ import annotations

import numpy as np
from listener import Listener

from twinct.viewer.show import Show


def seen(show: Show, view: int) -> np.ndarray:
    """The image of a view as the page shows it, up to the scale of its greys."""
    assert show.transmission is not None
    return -np.log(show.transmission(view))


def alike(picture: np.ndarray, values: np.ndarray) -> float:
    """Correlation of a picture's greys with values."""
    grey = picture[:, :, 0].astype(float)
    assert grey.shape == values.shape
    return float(np.corrcoef(grey.ravel(), values.ravel())[0, 1])


def label(listener: Listener) -> str:
    return listener.node("/label")["text"]
