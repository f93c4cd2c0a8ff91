"""Small files that unpack to more than the memory are refused before anything is unpacked."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import bombs
import pytest

MOST_BYTES = 300 * 2**20
"""Largest memory of the whole process, its imports included."""

REFUSALS = {
    "zarr_chunk": "grows from",
    "zarr_stream": "its chunk c/1/0/0 has",
    "zarr_shard": "its chunk c/0/0/0 unpacks to more than the 1024 bytes that it states",
    "hdf5_chunk": "grows from",
    "hdf5_stream": "its chunk at (1, 0, 0) unpacks to more than the 1024 bytes that it states",
    "npz": "grows from",
    "tiff_size": "grows from",
    "tiff_stream": "unpacks to more than the 1024 bytes that it states",
    "png": "states more pixels than a picture may have",
    "dicom_frame": "grows from",
    "dicom_deflated": "is deflated",
    "metaimage": "grows from",
    "mcap": "grows from",
    "rtk_xml": "it defines entities",
    "yaml_aliases": "anchors are not supported",
    "nifti": "grows from",
    "invesalius": "grows from",
    "ply": "states 4000000000 elements",
    "arm_texture": "its element <texture> makes",
    "arm_copies": "its element <replicate> makes",
}
NAMES = [make.__name__ for make in (*bombs.IMPORTED, *bombs.BODIES, *bombs.ARMS)]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Refusal, memory and size of each file, all read by one process."""
    script = Path(bombs.__file__).with_name("read_bombs.py")
    line = [sys.executable, str(script), str(tmp_path_factory.mktemp("bombs")), *NAMES]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.process
@pytest.mark.parametrize("name", NAMES)
def test_a_small_file_does_not_fill_the_memory(results, name):
    refusal, peak, size = results[name]
    assert REFUSALS[name] in refusal
    assert peak < MOST_BYTES
    assert size < 5e6
