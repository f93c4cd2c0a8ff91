"""A film of a scan: the room, the projection and the middle slice of the volume, view by view."""

from __future__ import annotations

import errno
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from twinct.core.errors import StorageError
from twinct.core.files.writing import complete, storage_errors
from twinct.core.foreign_text import shortened
from twinct.core.progress import Progress
from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.robots.cell import (
    Marks,
    PictureContent,
    build_cell,
    paint_specimen,
    room_pictures,
    whole_camera,
)
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell
from twinct.specimen import BuiltSpecimen
from twinct.viewer.filling import gantry_of, specimen_as_it_looks
from twinct.viewer.magnified import corners
from twinct.viewer.projection import Projections
from twinct.viewer.room import GantryPlaces, Room
from twinct.viewer.show import Show
from twinct.viewer.single_file import VIEWS_A_SECOND, first_look
from twinct.viewer.slices import Plane
from twinct.viewer.stage import COLOURS, slice_picture

WIDTH, HEIGHT, ROOM_WIDTH = 1280, 720, 860
CRF = 15
"""Quality of the film, by the scale of x264: 0 is lossless, 51 the worst."""
PAPER, INK = (255, 255, 255), (31, 41, 51)
PATH_RADIUS_MM = 4.0


def write_movie(
    show: Show, builder: SimulationBuilder | None, path: Path, progress: Progress
) -> None:
    """Write a film (MP4, H.264) that shows each view for a tenth of a second.

    Raises:
        InputError: the scenario's room cannot be built, or MuJoCo cannot draw here.
        StorageError: the file cannot be written.
    """
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with (
            complete(path) as draft,
            progress.stage("film", len(show)) as step,
            _encoder(draft, path) as pipe,
        ):
            for frame in frames(show, None if builder is None else builder.specimen):
                pipe.write(np.ascontiguousarray(frame).data)
                step()


@contextmanager
def _encoder(draft: Path, path: Path) -> Iterator[IO[bytes]]:
    """Yield a pipe that takes frames to ffmpeg, and wait until it has written all of them.

    ``imageio_ffmpeg.write_frames`` does not report that ffmpeg failed at the end.

    Raises:
        OSError: the disk is full.
        StorageError: ffmpeg failed for another reason.
    """
    import imageio_ffmpeg

    words = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
        "-s", f"{WIDTH}x{HEIGHT}", "-r", str(VIEWS_A_SECOND), "-i", "-", "-vcodec", "libx264",
        "-pix_fmt", "yuv420p", "-crf", str(CRF), f"file:{draft}",
    ]  # fmt: skip
    whole = False
    with tempfile.TemporaryFile() as messages:
        encoder = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=messages,
            process_group=0,
        )
        assert encoder.stdin is not None
        try:
            with suppress(BrokenPipeError):  # its exit code and message follow
                yield encoder.stdin
                encoder.stdin.close()
                whole = True
            code = encoder.wait()
        finally:
            encoder.kill()  # unless it has ended
            encoder.wait()
            with suppress(BrokenPipeError):
                encoder.stdin.close()
        if whole and code == 0:
            return
        messages.seek(0)
        why = messages.read().decode(errors="replace")
    if os.strerror(errno.ENOSPC) in why:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    ending = shortened(why) or f"ffmpeg ended with {code}"
    raise StorageError(f"{path}: the film could not be written: {ending}")


def frames(show: Show, specimen: BuiltSpecimen | None) -> Iterator[NDArray[np.uint8]]:
    """Yield one picture per view, (HEIGHT, WIDTH, 3)."""
    beside, projections = _middle_slice(show), Projections(show)
    pictures = _rooms(show, specimen)
    for view, room in enumerate(pictures):
        frame = Image.new("RGB", (WIDTH, HEIGHT), PAPER)
        frame.paste(Image.fromarray(room), (0, 0))
        draw, font = ImageDraw.Draw(frame), ImageFont.load_default(20)
        left, width = ROOM_WIDTH + 10, WIDTH - ROOM_WIDTH - 20
        image = Image.fromarray(np.ascontiguousarray(projections.at(view)[::-1]))
        scale = min(width / image.width, 300 / image.height)
        image = image.resize((round(image.width * scale), round(image.height * scale)))
        frame.paste(image, (left + (width - image.width) // 2, 40))
        draw.text((left, 10), f"view {view} of {len(show)}", INK, font)
        if beside is not None:
            frame.paste(beside, (left + (width - beside.width) // 2, HEIGHT - beside.height - 10))
        draw.text((16, HEIGHT - 34), show.name, INK, font)
        yield np.asarray(frame)


def _rooms(show: Show, specimen: BuiltSpecimen | None) -> Iterator[NDArray[np.uint8]]:
    mesh = None if specimen is None else specimen_as_it_looks(specimen)
    if isinstance(show.cell, Cell):
        model = build_cell(show.cell, mesh, show.place, show.settings.detector.panel)
        moved = None
    else:
        model = gantry_of(show, mesh)
        room = Room(model)
        moved = room, GantryPlaces(room, *show.first[0], show.c_arm)

    def moments() -> Iterator[PictureContent]:
        for view in range(len(show)):
            name, geometry = show.geometry(show.kept, view)
            source, rim = geometry.source[view], corners(geometry, view)
            rays = np.stack([np.repeat(source[None], 4, axis=0), rim], axis=1)
            points = show.geometry(name, view)[1].source[: view + 1]
            colour = (*(c / 255 for c in COLOURS[name]), 1.0)
            marks = Marks(
                points=points,
                colours=np.tile(colour, (len(points), 1)),
                radius_mm=PATH_RADIUS_MM,
                lines=rays,
            )
            places = dict(_object(show, view))
            if moved is not None:
                places |= _tools(show, view, *moved)
            yield PictureContent(show.joints_at(view), marks, places)

    if specimen is not None:
        paint_specimen(model, specimen.colour)
    camera = whole_camera(model, show.joints_at(len(show) // 2), ROOM_WIDTH / HEIGHT)
    yield from room_pictures(model, moments(), ROOM_WIDTH, HEIGHT, camera)


def _object(show: Show, view: int) -> Iterator[tuple[str, Pose]]:
    """Yield the pose of the specimen, which moves with the patient."""
    if view < len(show.objects):
        yield "specimen", show.objects[view]


def _tools(show: Show, view: int, room: Room, places: GantryPlaces) -> dict[str, Pose]:
    positions, quats = places.at(*show.poses_at(view))
    return {
        body.name: _pose(positions[index], quats[index])
        for index, body in enumerate(room.bodies)
        if body.name in places.moving
    }


def _pose(position_m: Floats, wxyz: Floats) -> Pose:
    return Pose(position_m * MM_PER_M, np.roll(wxyz, -1))


def _middle_slice(show: Show) -> Image.Image | None:
    """Return the middle slice across z of the first volume."""
    if not show.volumes:
        return None
    look = first_look(show)
    plane = Plane.of(show.volumes[look.shown].grid, 2, look.slices[2])
    picture = slice_picture(show, look.shown, plane, look.window)
    width, height = plane.size_mm
    scale = 330 / max(width, height)
    image = Image.fromarray(np.ascontiguousarray(picture[::-1]))
    return image.resize((round(width * scale), round(height * scale)))
