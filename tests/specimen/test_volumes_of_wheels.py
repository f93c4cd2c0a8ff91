"""Test files of others, from the wheels of pydicom and nibabel (tests/support/read_wheels.py)."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ct_files import assert_same, by_itk

from twinct.scenario import HuLine
from twinct.specimen.ct_image import AIR_HU
from twinct.specimen.volumes import read_ct

TOOL = Path(__file__).parents[1] / "support" / "read_wheels.py"
LIBRARY_WORDS = re.compile(r"Error|Exception|numpy|nibabel|pydicom|\bdtype\b|Traceback")
NOT_BY_ITK = ("rtdose_1frame.dcm", "rtdose_expb_1frame.dcm", "rtdose_rle_1frame.dcm")
"""Single slices of a dose, whose place SimpleITK does not find."""

MOST_MB = 3000
FEWEST_FILES, FEWEST_READ = 250, 40
"""The wheels of pydicom 3.0 and nibabel 5.3 have more."""


@pytest.mark.tutorial
@pytest.mark.process
def test_each_file_is_read_right_or_refused_in_our_words(
    tmp_path: Path, figure: Callable[[str], None]
) -> None:
    command = [sys.executable, TOOL, "--json", "--keep", tmp_path]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr
    found: list[dict[str, Any]] = [json.loads(line) for line in result.stdout.splitlines()]
    for one in found:
        if one["outcome"] == "refused":
            assert one["told"].startswith("it")
            assert not LIBRARY_WORDS.search(one["told"]), one
    assert max(one["peak_mb"] for one in found) < MOST_MB
    read = [one for one in found if one["outcome"] == "read"]
    for one in read:
        source = Path(one["source"])
        image = read_ct(source, "it", HuLine() if one["stated"] else None)
        if Path(one["path"]).name not in NOT_BY_ITK:
            other = by_itk(source)
            padding = (image.values == AIR_HU) & (other.values < AIR_HU)  # which ITK leaves
            values = np.where(padding, AIR_HU, other.values)
            assert_same(image, replace(other, values=values), 0.01)
    files, stated = len({one["path"] for one in found}), sum(one["stated"] for one in read)
    figure(f"{files} files and folders: {len(read) - stated} read, with hu stated {stated}")
    assert files >= FEWEST_FILES and stated >= FEWEST_READ
