"""Folders of strangers: no code in them runs, wherever twinct reads them or is started."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planted import planted, unpickled

import twinct
from twinct.core.errors import InputError
from twinct.core.files.arrays import read_npy, read_npz
from twinct.recon.volume import Volume
from twinct.robots.motion import load_plan
from twinct.scan import ScanStore
from twinct.study import load_results
from twinct.study.sections import read_sections

SOURCES = Path(twinct.__file__).parent

TO_OWN_WORKERS = {
    *("workers/call.py", "workers/local.py", "workers/worker.py"),
    "view_plans/search_work.py",
}
"""These send pickles through pipes to processes that they start themselves."""

RUN_CODE = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
"""Modules whose formats may hold code."""


def unsafe(source: str) -> set[str]:
    """What a module names that could run the code of a file."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {name.name.partition(".")[0] for name in node.names} & RUN_CODE
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found |= {(node.module or "").partition(".")[0]} & RUN_CODE
        elif isinstance(node, ast.Call):
            for key in node.keywords:
                if key.arg == "allow_pickle" and ast.unparse(key.value) != "False":
                    found.add("allow_pickle")
            name = ast.unparse(node.func)
            if name in ("yaml.load", "yaml.unsafe_load", "yaml.full_load", "torch.load"):
                found.add(name)
            found |= {name} & {"pandas.read_pickle", "pd.read_pickle"}
    return found


@pytest.mark.parametrize(
    "source",
    ["import pickle", "from pickle import loads", "np.load(f, allow_pickle=True)", "yaml.load(f)"],
)
def test_what_could_run_the_code_of_a_file_is_noticed(source: str) -> None:
    assert unsafe(source)


def test_no_module_reads_a_format_that_may_hold_code() -> None:
    found = {
        str(path.relative_to(SOURCES))
        for path in SOURCES.rglob("*.py")
        if unsafe(path.read_text(encoding="utf-8"))
    }
    assert found == TO_OWN_WORKERS


def store_of_pickles(folder: Path, junk: bytes) -> None:
    """A Zarr store of the old format, whose chunks are pickles by its own account."""
    array = folder / "status"
    array.mkdir(parents=True)
    (folder / ".zgroup").write_text('{"zarr_format": 2}')
    told = {"format": 1, "digest": "", "scenario": "{}", "joint_names": []}
    (folder / ".zattrs").write_text(json.dumps(told))
    metadata = {"zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "order": "C"}
    codecs: dict[str, Any] = {"compressor": {"id": "pickle"}, "filters": [{"id": "vlen-utf8"}]}
    (array / ".zarray").write_text(json.dumps({**metadata, **codecs, "fill_value": None}))
    (array / "0").write_bytes(junk)


def table(folder: Path, junk: bytes) -> None:
    (folder / "journal.jsonl").write_bytes(junk + b"\n")
    (folder / "results.parquet").write_bytes(junk)


READERS: dict[str, tuple[Callable[[Path, bytes], object], Callable[[Path], object]]] = {
    "array": (Path.write_bytes, lambda path: read_npy(path, "it")),
    "archive": (Path.write_bytes, lambda path: read_npz(path, "it", 2**30)),
    "plan": (Path.write_bytes, load_plan),
    "sections": (Path.write_bytes, read_sections),
    "volume.nii": (Path.write_bytes, Volume.read),
    "scan.zarr": (store_of_pickles, lambda path: ScanStore(path)._array("status")[:]),
    "study": (lambda path, junk: (path.mkdir(), table(path, junk)), load_results),
}


@pytest.mark.parametrize("name", READERS)
def test_no_reader_loads_a_pickle(name: str, tmp_path: Path) -> None:
    write, read = READERS[name]
    write(tmp_path / name, planted(tmp_path / "mark"))
    with unpickled() as found, pytest.raises((InputError, ValueError, RuntimeError)):
        read(tmp_path / name)
    assert not found and not (tmp_path / "mark").exists()


def test_arrays_of_objects_are_refused(tmp_path: Path) -> None:
    """Else the test before might say nothing of arrays."""
    objects, mark = np.empty(1, object), tmp_path / "mark"
    path = tmp_path / "array.npy"
    np.save(path, objects, allow_pickle=True)
    path.write_bytes(path.read_bytes()[:128] + planted(mark))
    with unpickled() as found, pytest.raises(InputError, match="Python objects"):
        read_npy(path, "it")
    assert not found
    with unpickled() as found:
        np.load(path, allow_pickle=True)
    assert found and mark.exists()


@pytest.mark.process
def test_numba_takes_no_cache_from_the_current_folder(tmp_path: Path) -> None:
    """Its cache is pickled, and it reads a file of settings where it is started."""
    told = "cache_dir: planted\ncache_locator_classes: planted.Class\ncpu_name: generic\n"
    (tmp_path / ".numba_config.yaml").write_text(told)
    code = (
        "from numba.core import config as c\n"
        "print([c.CACHE_DIR, c.CACHE_LOCATOR_CLASSES, c.CPU_NAME])"
    )
    own = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    found = [
        subprocess.run(
            [sys.executable, "-P", "-c", f"{first}\n{code}"],
            cwd=tmp_path,
            env=own,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for first in ("", "import twinct")
    ]
    assert found == ["['planted', 'planted.Class', 'generic']", "['', '', 'generic']"]


@pytest.mark.process  # the kernels may have to be compiled
def test_processes_import_nothing_from_the_current_folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from twinct.link.rig import NODE_COMMAND
    from twinct.recon._vector import cache as kernel_cache

    asked: list[list[str]] = []

    def run(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        asked.append(command)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(kernel_cache.subprocess, "run", run)
    kernel_cache._compiled(tmp_path / "draft", tmp_path / "kernels")
    assert asked and all("-P" in command[1:2] for command in [*asked, NODE_COMMAND])


@pytest.mark.process
@pytest.mark.parametrize("command", [["view", "nothing"], ["check", "nothing"]], ids=" ".join)
def test_commands_run_no_module_of_the_current_folder(command: list[str], tmp_path: Path) -> None:
    """Also those that only ask which libraries there are: GLFW starts a Python to find itself."""
    mark = tmp_path / "mark"
    code = f"import os\nos.makedirs({str(mark)!r}, exist_ok=True)\nraise ImportError('planted')\n"
    for name in ("ctypes", "glfw", "json", "mujoco", "numpy", "re", "twinct"):
        (tmp_path / f"{name}.py").write_text(code)
    own = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"}
    result = subprocess.run(
        [sys.executable, "-P", "-m", "twinct", *command],
        cwd=tmp_path,
        env=own | {"PYTHONPATH": str(SOURCES.parent)},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 2 and "nothing" in result.stderr
    assert not mark.exists()
