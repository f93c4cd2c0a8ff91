"""The text of the manifest: any change of it shows."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.scan.manifest import FRAME_FILE, sealed, unsealed, view_of

DIGESTS = {"a/c.0": "12", "b c": "34"}


def test_a_sealed_text_tells_of_any_change() -> None:
    text, rng = sealed(DIGESTS, 200), np.random.default_rng(1)
    assert len(text) == 200 and unsealed(text) == DIGESTS
    for place, other in zip(range(200), rng.integers(1, 256, 200), strict=True):
        changed = text[:place] + bytes([text[place] ^ int(other)]) + text[place + 1 :]
        with pytest.raises(ValueError, match=r"seal|decode"):
            unsealed(changed)
    for cut in (0, 50, 199):
        with pytest.raises(ValueError, match="seal"):
            unsealed(text[:cut])


def test_which_view_a_file_is_of() -> None:
    assert [view_of(f) for f in ("a/b/c.12.0.0", "c.3", "status/c.4.partial")] == [12, 3, 4]
    for file in ("a/zarr.json", "commanded/u/c/0/0", FRAME_FILE, "c.x"):
        assert view_of(file) is None
