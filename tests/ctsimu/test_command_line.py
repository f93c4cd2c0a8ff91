"""``twinct ctsimu``: what it writes, and one sentence with exit code 2 for bad input."""

from __future__ import annotations

import pytest

from twinct.cli import run_command


def test_render_writes_images_and_metadata(data, write, tmp_path, capsys):
    path, out = str(write(data)), str(tmp_path / "out")
    assert run_command(["ctsimu", "render", path, "--out", out, "--samples", "1"]) == 0
    names = {p.name for p in (tmp_path / "out").iterdir()}
    images = {f"small_000{i}.tif" for i in range(3)}
    assert names == images | {"small_metadata.json", "small_rendering.json"}
    assert "small_metadata.json" in "".join(capsys.readouterr().out.split())
    assert run_command(["ctsimu", "render", path, "--out", out, "--samples", "1"]) == 2
    assert "--resume" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "none.json", "--out", "x"], ["none.json", "No such file"]),
        (["render", "none.json", "--out", "x", "--samples", "0"], ["--samples 0", "at least 1"]),
        (["export", "nowhere", "--out", "x"], ["nowhere", "scan.zarr"]),
        (["qualify", "--out", "x", "--tests", "2D-XX-9"], ["2D-XX-9", "2D-FB-1"]),
    ],
)
def test_bad_input_is_named(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run_command(["ctsimu", *arguments]) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    for word in words:
        assert word in said


def test_monochromatic_source_has_no_photon_number(data, write, tmp_path, capsys):
    data["detector"]["gray_value"] = {"factor": {"value": 1e13}, "offset": {"value": 0}}
    path = str(write(data))
    assert run_command(["ctsimu", "render", path, "--out", str(tmp_path / "out")]) == 2
    assert "gray_value" in capsys.readouterr().err
