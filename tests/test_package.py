"""What is built can be installed without its sources, and works."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

from twinct.version import __version__

pytestmark = [pytest.mark.package, pytest.mark.process]

ROOT = Path(__file__).parents[1]
LEFT_OUT = {"paper_cranium.yaml"}
"""A built-in scenario whose CT only the repository fetches."""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The source distribution, and the wheel that was built from it."""
    build = runpy.run_path(str(ROOT / "tools" / "build_dist.py"))["build"]
    return build(tmp_path_factory.mktemp("dist"))


def test_the_source_distribution_is_whole(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[0]) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    sources = runpy.run_path(str(ROOT / "tools" / "build_dist.py"))["_sources"]()
    links = {path for path in sources if (ROOT / path).is_symlink()}
    assert not {str(path) for path in sources} - {str(path) for path in links} - packed
    for link in links:  # as the files that they lead to
        inside = {file.name for file in (ROOT / link).iterdir()} - LEFT_OUT
        assert {f"{link}/{name}" for name in inside} <= packed


def test_the_wheel_has_the_scenarios_but_the_one_whose_file_is_fetched(
    built: tuple[Path, Path],
) -> None:
    with zipfile.ZipFile(built[1]) as archive:
        inside = {Path(name).name for name in archive.namelist() if "/built_in/" in name}
    assert inside == {file.name for file in ROOT.glob("scenarios/*.yaml")} - LEFT_OUT


def test_its_description_leads_from_an_index_to_the_repository(built: tuple[Path, Path]) -> None:
    with zipfile.ZipFile(built[1]) as archive:
        name = next(name for name in archive.namelist() if name.endswith("METADATA"))
        told = Parser().parsestr(archive.read(name).decode())
    assert told["Version"] == __version__
    assert told["Description-Content-Type"] == "text/markdown"
    text = str(told.get_payload())
    links = re.findall(r"\]\(([^)]+)\)", text) + re.findall(r'(?:src|href)="([^"]+)"', text)
    assert len(links) > 5
    assert [link for link in links if not re.match("[a-z]+:|#", link)] == []
    urls = dict(one.split(", ") for one in told.get_all("Project-URL", []))
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert all(picture.startswith(("https://", urls["Source"] + "/raw/")) for picture in pictures)
    for link in links:  # and the file is there
        if link.startswith(urls["Source"]):
            file = re.sub(r"^/(blob|raw)/main/|#.*", "", link.removeprefix(urls["Source"]))
            assert (ROOT / file).exists(), link


def test_the_wheel_alone_loads_builds_and_writes(built: tuple[Path, Path], tmp_path: Path) -> None:
    """Its data files are in it: arms, report template, export scripts, scenarios."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    target, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    subprocess.run(
        [*pip, "install", "--quiet", "--no-deps", "--target", target, built[1]], check=True
    )
    environment = os.environ | {"PYTHONPATH": str(target)}
    # Its kernels run uncompiled: a new place has none, and compiling all takes minutes.
    environment |= {"NUMBA_DISABLE_JIT": "1", "TWINCT_ENGINE": "plain"}

    def twinct(*arguments: str) -> str:
        result = subprocess.run(
            [sys.executable, "-m", "twinct", *arguments],
            capture_output=True,
            text=True,
            cwd=work,
            env=environment,
        )
        assert result.returncode == 0, result.stderr
        return result.stdout

    where = subprocess.run(
        [sys.executable, "-c", "import twinct; print(twinct.__file__)"],
        capture_output=True,
        text=True,
        cwd=work,
        env=environment,
    )
    assert where.stdout.startswith(str(target))
    assert "twinct scenario" in twinct("schema")
    small = [
        *("--set", "trajectory={kind: arc, views: 3, longitude_range_deg: 10}"),
        *("--set", "detector={columns: 16, rows: 12, pixel_pitch_mm: 20}"),
        *(
            "--set",
            "specimen.parts=[{shape: {kind: sphere, radius_mm: 40, mesh_resolution_mm: 20}}]",
        ),
        *("--set", "reconstruction={iterations: 1, grid: {voxels: 8, voxel_mm: 20}}"),
        *("--set", "xray.engine=mesh"),
    ]
    said = twinct("demo", *small)
    assert "cell: two arms" in said and said.rstrip().endswith("twinct-demo/report.html")
    assert "<html" in (work / "twinct-demo" / "report.html").read_text()[:500].lower()
    twinct("export", "twinct-demo", "--to", "rtk")
    assert (work / "twinct-demo" / "export-rtk" / "load.py").is_file()
