"""``twinct ctsimu``: what it writes, and one sentence with exit code 2 for bad input."""

from __future__ import annotations

from pathlib import Path

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
        (["render", "none.json", "--out", "x"], ["none.json", "does not exist"]),
        (["render", "none.json", "--out", "x", "--samples", "0"], ["--samples 0", "at least 1"]),
        (["render", "none.json", "--out", "x", "--samples", "100000"], ["--samples 100000", "64"]),
        (["render", "none.json", "--out", "x", "--spot-points", "99999"], ["99999", "10000"]),
        (["render", "none.json", "--out", "x", "--seed", "-1"], ["--seed -1", "at least 0"]),
        (["render", "none.json", "--out", "file"], ["--out file", "this is a file"]),
        (["render", "none.json", "--out", "file/x"], ["--out file/x", "file is not a folder"]),
        (["qualify", "--out", "file"], ["--out file", "this is a file"]),
        (["export", "nowhere", "--out", "x"], ["nowhere", "scan.zarr"]),
        (["qualify", "--out", "x", "--tests", "2D-XX-9"], ["2D-XX-9", "2D-FB-1"]),
    ],
)
def test_bad_input_is_named(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("not a folder")
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


def test_bad_scenario_is_named_before_anything_is_written(data, write, tmp_path, capsys):
    data["detector"]["columns"] = {"value": 1e9, "unit": "px"}
    data["acquisition"]["number_of_projections"] = "ten"
    path, out = write(data), tmp_path / "out"
    assert run_command(["ctsimu", "render", str(path), "--out", str(out)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[:3] for line in said] == [
        ["twinct", str(path), "acquisition.number_of_projections"],
        ["twinct", str(path), "detector.columns"],
    ]
    assert not out.exists()


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a /proc")
@pytest.mark.parametrize("command", ["render", "qualify"])
def test_folder_that_cannot_be_made_is_named(data, write, capsys, command):
    if command == "qualify":
        pytest.importorskip("ctsimu.toolbox", reason="needs the extra ctsimu")
    arguments = [str(write(data))] if command == "render" else []
    assert run_command(["ctsimu", command, *arguments, "--out", "/proc/twinct"]) == 2
    said = capsys.readouterr().err
    assert "/proc/twinct" in said and "bug" not in said


def test_too_little_memory_is_no_bug(data, write, tmp_path, monkeypatch, capsys):
    def render(*args, **kwargs):
        raise MemoryError("Unable to allocate 2 GiB")

    monkeypatch.setattr("twinct.cli.commands.ctsimu.render_ctsimu", render)
    path = str(write(data))
    assert run_command(["ctsimu", "render", path, "--out", str(tmp_path / "out")]) == 2
    assert f"{path}: a panel of 24 x 16 pixels does not fit" in capsys.readouterr().err
