"""``twinct view``: what it refuses, and what it writes."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from urllib.request import urlopen

import pytest
from waiting import HANG_S

from twinct.cli import run_command
from twinct.cli.live_page import serving
from twinct.viewer.server import address

DEMO = str(Path(__file__).parents[2] / "scenarios" / "demo.yaml")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing"], "nothing"),
        (["{tmp}"], "is not a run folder"),
        (["{tmp}", "{tmp}", "{tmp}"], "3 folders: the page shows one, or two side by side"),
        (["{tmp}", "--set", "seed=1"], "a run is shown as it is"),
        ([DEMO, "--host", "0.0.0.0"], "for this machine only"),
        ([DEMO, "--port", "{taken}"], "the port is in use"),
        ([DEMO, "--export", "page.txt"], "--export page.txt: a page must be an HTML file"),
        ([DEMO, "--movie", "film.avi"], "--movie film.avi: a film must be an MP4 file"),
        ([DEMO, "--export", "{tmp}"], "this is a folder"),
    ],
)
def test_bad_input_is_one_message(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [a.format(tmp=tmp_path, taken=port) for a in arguments]
        assert run_command(["view", *words]) == 2
    told = capsys.readouterr().err.strip()
    assert message in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("network", [False, True])
def test_the_printed_address_opens_the_page(
    network: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with serving("0.0.0.0" if network else "127.0.0.1", 0, network) as server:
        told = "".join(capsys.readouterr())
        page = told.split("page: ")[1].split()[0]
        assert page == address(server)
        with urlopen(page, timeout=HANG_S) as opened:
            assert opened.status == 200
    assert ("--allow-network: whoever knows this address" in told) == network
    assert ("unencrypted" in told) == network
    assert ("ssh -N -L" in told) != network


def test_a_run_is_not_begun_where_its_page_has_no_port(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        out = tmp_path / "out"
        assert run_command(["run", DEMO, "--out", str(out), "--view", "--port", port]) == 2
    assert "the port is in use" in capsys.readouterr().err
    assert not out.exists()


def test_a_plan_is_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], keys: Callable[[], list[str]]
) -> None:
    page = tmp_path / "page.html"
    overrides = [word for key in keys() for word in ("--set", key)]
    assert run_command(["view", DEMO, "--export", str(page), *overrides]) == 0
    text = page.read_text(encoding="utf-8")
    assert "not run; 6 views planned" in text
    assert f"wrote {page}" in capsys.readouterr().out


@pytest.fixture
def keys() -> Callable[[], list[str]]:
    return lambda: [
        "trajectory.views=6",
        "specimen.parts=[{shape: {kind: sphere, radius_mm: 50, mesh_resolution_mm: 4}}]",
        "detector={columns: 32, rows: 24, pixel_pitch_mm: 10}",
        "reconstruction.grid={voxels: 20, voxel_mm: 8}",
    ]
