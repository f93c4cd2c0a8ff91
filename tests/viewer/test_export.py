from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from listener import recorded

from twinct.core.errors import StorageError
from twinct.observers import Audience
from twinct.runs import Run
from twinct.scan import SimulationBuilder
from twinct.viewer import movie
from twinct.viewer.movie import HEIGHT, WIDTH, write_movie
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.single_file import export_page


@pytest.fixture(scope="module")
def page(
    finished: Run, builder: SimulationBuilder, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    show = RunFolder(finished.paths.path).look()
    path = tmp_path_factory.mktemp("page") / "sub" / "page.html"
    export_page(show, builder, path, Audience())
    return path


def messages_of(page: Path) -> list[tuple[float, dict]]:
    """The messages of an exported page, with their times."""
    data = re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page.read_text(encoding="utf-8"))
    assert data is not None
    return recorded(base64.b64decode(data.group(1)))


def test_it_plays_all_views(page: Path, finished: Run) -> None:
    messages = messages_of(page)
    executed = finished.scan.executed.geometry(finished.scenario.detector.panel)
    balls = [
        (time, np.array(m["position"]))
        for time, m in messages
        if m["type"] == "SetPositionMessage" and "/balls/executed" in m["name"]
    ]
    times = sorted({time for time, _ in balls})
    assert times == pytest.approx([0.1 * view for view in range(8)], abs=1e-9)
    for view, time in enumerate(times):
        last = [place for at, place in balls if at == time][-1]
        np.testing.assert_allclose(last, executed.source[view] * 1e-3, atol=1e-6)
    images = {
        bytes(m["updates"]["_data"])
        for _, m in messages
        if m["type"] == "SceneNodeUpdateMessage" and "_data" in m["updates"]
    }
    assert len(images) >= 7  # the first is in the node that was added
    names = {m.get("name", "") for _, m in messages}
    assert {f"/run/slices/{axis}" for axis in "xyz"} <= {n.rpartition("/")[0] for n in names}
    assert any("/surface/" in name for name in names)


def test_it_needs_no_network(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    text = re.sub(r'__VISER_EMBED_DATA__="[^"]+"', "", text)
    assert not re.findall(r'<(?:script|link|img|iframe)[^>]+(?:src|href)="(?!data:)[^"]+"', text)
    assert not re.findall(r"@import|url\((?!['\"]?(?:data:|#))[^)]*://", text)
    assert text.count("<img alt=") == 2  # slices and curves
    assert "<title>out - twinct</title>" in text


@pytest.mark.process
def test_a_film_has_a_picture_of_each_view(
    finished: Run, builder: SimulationBuilder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import imageio_ffmpeg

    show = RunFolder(finished.paths.path).look()
    path = tmp_path / "film.mp4"
    drawn: list[np.ndarray] = []
    frames = movie.frames

    def noted(*told) -> Iterator[np.ndarray]:
        for frame in frames(*told):
            drawn.append(frame)
            yield frame

    monkeypatch.setattr(movie, "frames", noted)
    write_movie(show, builder, path, Audience())
    reader = imageio_ffmpeg.read_frames(str(path))
    told = next(reader)
    found = [np.frombuffer(frame, np.uint8).reshape(HEIGHT, WIDTH, 3) for frame in reader]
    assert told["size"] == (WIDTH, HEIGHT) and told["codec"] == "h264"
    assert len(found) == len(show) == 8
    for shown, frame in zip(drawn, found, strict=True):
        # H.264 at this quality, and colours at half the resolution.
        assert np.abs(shown.astype(float) - frame).mean() < 4
    first, last = (frame.astype(float) for frame in (found[0], found[-1]))
    assert np.abs(first - last)[:, :860].mean() > 2  # the arms have moved
    assert np.abs(first - last)[:360, 870:].mean() > 2  # and the image is another
    assert sorted(p.name for p in tmp_path.iterdir()) == ["film.mp4"]


FFMPEG = """#!/bin/sh
for path; do :; done
head -c {taken} > "${{path#file:}}"
echo '{said}' >&2
exit {code}
"""


@pytest.mark.process
@pytest.mark.parametrize(
    ("taken", "said", "code", "told"),
    [
        (
            10**9,
            "Error writing trailer: No space left on device",
            228,
            "film.mp4: the disk is full",
        ),
        (9, "Error opening output: No space left on device", 228, "film.mp4: the disk is full"),
        (9, "no such encoder", 1, "film.mp4: the film could not be written: no such encoder"),
        (10**9, "", 3, "film.mp4: the film could not be written: ffmpeg ended with 3"),
        (9, "", 0, "film.mp4: the film could not be written: ffmpeg ended with 0"),
    ],
)
def test_a_film_that_ffmpeg_does_not_complete_is_told(
    finished: Run,
    builder: SimulationBuilder,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    taken: int,
    said: str,
    code: int,
    told: str,
) -> None:
    program, path = tmp_path / "ffmpeg", tmp_path / "film" / "film.mp4"
    program.write_text(FFMPEG.format(taken=taken, said=said, code=code))
    program.chmod(0o755)
    path.parent.mkdir()
    path.write_bytes(b"an earlier film")
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: str(program))
    monkeypatch.setattr("imageio_ffmpeg._io.get_ffmpeg_exe", lambda: str(program))
    frame = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    monkeypatch.setattr(movie, "frames", lambda *_: iter([frame] * 3))
    with pytest.raises(StorageError, match=told):
        write_movie(RunFolder(finished.paths.path).look(), builder, path, Audience())
    assert {p.name: p.read_bytes() for p in path.parent.iterdir()} == {
        "film.mp4": b"an earlier film"
    }
