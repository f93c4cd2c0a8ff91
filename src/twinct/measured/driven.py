"""Scans that real arms made: joint states and images of their drivers, and the user's scenario.

The executed poses of a view are those of the cell's kinematics, calibrated if the scenario names a
calibration, at the joints that the drivers reported about the time of its image. If the images fit
the plan that was sent, its poses are the commanded ones.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.files.boundary import library_errors
from twinct.core.files.images import read_image
from twinct.core.files.lock import sole_owner
from twinct.core.files.plain_json import json_of
from twinct.core.files.writing import complete, storage_errors, write_json
from twinct.core.foreign_text import quoted
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.link.recording.arms_recording import ArmsRecording
from twinct.measured.joint_track import JointTrack, track_of
from twinct.measured.sent_plan import SET_BACK, UNFIT, SentPlan
from twinct.runs import Folder
from twinct.scan import ScanStore, SimulationBuilder, line_integrals
from twinct.scan.encoder_model import EncoderModel
from twinct.scenario import Cell, Scenario, load_scenario, parse_scenario
from twinct.trajectory import write_views

Floats = NDArray[np.float64]

VIEWS_FILE = "views.csv"

DRIVE_FORMAT = "twinct driven 1"

RAW = {"mono16": ("u2", 1), "16UC1": ("u2", 1), "mono8": ("u1", 1), "8UC1": ("u1", 1)}
"""Type of the numbers of raw images by their encoding."""

STEP_S = 0.001
"""Half of the time between two renderings, of which a latency is estimated."""

LARGEST_STEP_S = 0.02
"""Largest change of a latency in one iteration."""

MOST_FOR_LATENCY = 12
"""Largest number of views of which a latency is estimated."""


@dataclass(eq=False)
class _Heard:
    """Everything that recordings hold, but the pixels."""

    joints: dict[tuple[str, ...], tuple[list[int], list[Any]]] = field(default_factory=dict)
    images_ns: list[int] = field(default_factory=list)
    topics: set[str] = field(default_factory=set)
    files: dict[str, bytes] = field(default_factory=dict)
    notes: dict[str, dict[str, str]] = field(default_factory=dict)

    def hear_joints(self, record: Any) -> None:
        """Keep a message with the positions of joints."""
        message = record.message
        names, position = tuple(message.name), message.position
        if len(names) != len(position):
            raise ValueError(f"{len(position)} positions of {len(names)} joints")
        stamps, rows = self.joints.setdefault(names, ([], []))
        stamps.append(record.stamp_ns)
        rows.append(position)

    def noted(self, name: str, key: str) -> Any:
        """Return the value of a key of a note.

        Raises:
            InputError: it is missing, or no JSON.
        """
        with library_errors(f"{key} in the note {quoted(name)} of the recording"):
            return json_of(self.notes[name][key])


@dataclass(frozen=True, eq=False)
class Driven:
    """Result of an import.

    Attributes:
        scenario: the scenario that was written.
        latency_ms: time from exposures to stamps that was taken into account.
        lag_ms: time by which the arms followed the plan; None without a plan.
        notes: sentences for users, on what was left out.
        views: number of views.
    """

    scenario: Scenario
    latency_ms: float
    lag_ms: float | None
    notes: tuple[str, ...]
    views: int


def is_driven(paths: Sequence[Path], choice: ArmsRecording) -> bool:
    """Return True for recordings of real arms: a scenario is named, or ``twinct drive`` made them.

    Raises:
        InputError: a file is no recording.
    """
    from twinct.link.recording.drive_file import NOTE
    from twinct.link.recording.reader import Recording

    if choice.scenario is not None:
        return True
    for path in paths:
        for record in Recording(path).records():
            return getattr(record, "name", None) == NOTE
    return False


def import_driven(paths: Sequence[Path], out: Path, choice: ArmsRecording) -> Driven:
    """Create a run's folder from recordings of real arms.

    Args:
        paths: MCAP files.
        out: the folder, without a run in it.
        choice: what in them is what.

    Raises:
        InputError: joints or images are missing, or do not fit the scenario; nothing is written.
        ScanExistsError: the folder holds a scan.
        StorageError: the folder cannot be written.
    """
    from twinct.robots.cell import joint_names_of

    folder = Folder(out)
    folder.refuse_others()
    folder.refuse_if_taken(resumes=False)
    heard = _heard(paths, choice)
    scenario = _scenario(heard, choice)
    assert isinstance(scenario.cell, Cell)
    fields = _Fields.of(choice)
    epoch_ns = min([heard.images_ns[0], *(stamps[0] for stamps, _ in heard.joints.values())])
    panel, still = scenario.detector.panel, scenario.specimen.world_from_specimen
    model = EncoderModel(scenario.cell, panel, scenario.uncertainty)
    names = _names(heard, choice, joint_names_of(scenario.cell, panel))
    joints = tuple(names.values())
    track, notes = track_of(heard.joints, names, joints, epoch_ns)
    images_s = (np.array(heard.images_ns, np.int64) - epoch_ns) / 1e9
    latency_s = choice.latency_ms / 1000
    if choice.estimate_latency:
        good, _ = _usable(track, images_s, latency_s, notes)
        few = good[:: max(1, len(good) // MOST_FOR_LATENCY)]
        measured = line_integrals(
            np.stack([*_pixels(paths, choice, fields, set(few.tolist()), panel)])
        )
        with SimulationBuilder(scenario).imager() as imager:

            def rendered(position: Floats) -> list[NDArray[np.float32]]:
                views = model.poses(position).geometry(panel)
                return [line_integrals(imager.render(view, still)) for view in views]

            latency_s = _latency_s(rendered, track, images_s[few], measured, latency_s)
    used, lost = _usable(track, images_s, latency_s, notes)
    time_s = images_s[used] - latency_s
    position, speed, _ = track.at(time_s)
    poses = model.poses(position)
    sent = _sent(heard, track, epoch_ns) if track.one_time else None
    commanded, drive, unfit = _planned(sent, time_s, poses)
    drive["latency_ms"] = 1000 * latency_s
    images = _pixels(paths, choice, fields, set(used.tolist()), panel)
    with storage_errors(out), ExitStack() as stack:
        out.mkdir(parents=True, exist_ok=True)
        stack.enter_context(sole_owner(folder.lock))
        draft = stack.enter_context(complete(folder.scan))
        write_views(out / VIEWS_FILE, commanded.geometry(panel))
        scenario = _placed(scenario, out / VIEWS_FILE)
        numbers = position, speed, time_s
        store = ScanStore.create(
            draft, scenario, commanded, joints, 0, recordings=tuple(path.name for path in paths)
        )
        _write(store, joints, poses, still, numbers, images)
        folder.write_scenario(scenario)
        write_json(folder.drive, drive)
    notes = (*notes, *lost, *unfit, *(() if track.one_time else (SET_BACK,)))
    return Driven(scenario, 1000 * latency_s, drive["lag_ms"], notes, len(used))


def _planned(
    sent: SentPlan | None, time_s: Floats, poses: PosePairs
) -> tuple[PosePairs, dict[str, Any], tuple[str, ...]]:
    """Return commanded poses, the content of the drive's file, and sentences on what is unknown.

    Args:
        sent: the plan, if any.
        time_s: times of the exposures, (images,).
        poses: executed poses, which stand in where no plan fits.
    """
    drive: dict[str, Any] = {"format": DRIVE_FORMAT, "lag_ms": None}
    if sent is None:
        return poses, drive, ()
    drive["lag_ms"] = 1000 * sent.lag_s
    if (views := sent.views_at(time_s)) is None:
        return poses, drive, (UNFIT,)
    return sent.commanded(views), {**drive, **sent.beside(views, time_s)}, ()


def _usable(
    track: JointTrack, images_s: Floats, latency_s: float, left_out: tuple[str, ...] = ()
) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Return the images whose joints are known, and sentences on the others.

    Args:
        track: the joints.
        images_s: stamps of the images, (images,).
        latency_s: time from exposures to stamps.
        left_out: sentences on joint states that were left out, for the message.

    Raises:
        InputError: there is none.
    """
    forward = np.concatenate([[True], images_s[1:] > np.maximum.accumulate(images_s)[:-1]])
    _, _, there = track.at(images_s - latency_s)
    notes = []
    for good, why in (
        (forward, "have stamps that run backwards"),
        (there, "have no joint states about their time"),
    ):
        if lost := np.flatnonzero(~good).tolist():
            notes.append(f"images {', '.join(map(str, lost[:10]))} {why}: left out")
    used = np.flatnonzero(forward & there)
    if not len(used):
        after_s = images_s[0] - track.groups[0].time_s[0]
        raise InputError(
            "no image has joint states about its time: are both stamped by one clock? The first of "
            f"{len(images_s)} comes {after_s:.3f} s after the first joint state"
            + "".join(f"; {note}" for note in left_out)
        )
    return used, tuple(notes)


def _heard(paths: Sequence[Path], choice: ArmsRecording) -> _Heard:
    """Read joint states, stamps of images, and what ``twinct drive`` wrote."""
    from twinct.link.recording.drive_file import NOTE
    from twinct.link.recording.reader import RecordedMessage, Recording
    from twinct.link.topics import JOINTS

    heard, joint_states = _Heard(), choice.joint_states or (JOINTS.name,)
    for path in paths:
        for record in Recording(path).records():
            if not isinstance(record, RecordedMessage):
                if (note := getattr(record, "metadata", None)) is None:
                    heard.files[record.name] = getattr(record, "data", b"")
                else:
                    heard.notes[record.name] = note
                    if record.name == NOTE and not choice.joint_states:
                        joint_states = _topics(heard.noted(NOTE, "joint_states"))
                continue
            heard.topics.add(record.topic)
            if record.topic in joint_states:
                with library_errors(f"{path}: a message on {record.topic}"):
                    heard.hear_joints(record)
            elif record.topic == choice.image:
                heard.images_ns.append(record.stamp_ns)
    for what, heard_topics in ((joint_states, heard.joints), ((choice.image,), heard.images_ns)):
        if not heard_topics:
            raise InputError(
                f"{', '.join(map(str, paths))}: nothing on {', '.join(what)}; topics found: "
                f"{', '.join(sorted(heard.topics)) or 'none'} (--arms.image, --arms.joint-states)"
            )
    return heard


def _topics(noted: Any) -> tuple[str, ...]:
    """Return the topics in the note of a drive.

    Raises:
        InputError: they are no names.
    """
    if not isinstance(noted, list) or not all(isinstance(name, str) for name in noted):
        raise InputError(f"joint_states in the note of the recording is no list: {quoted(noted)}")
    return tuple(noted)


def _scenario(heard: _Heard, choice: ArmsRecording) -> Scenario:
    """Return the user's scenario, or the one of a drive; its cell must have arms."""
    from twinct.link.recording.recorder import SCENARIO

    if choice.scenario is not None:
        scenario = load_scenario(choice.scenario)
    elif SCENARIO in heard.files:
        with library_errors("the scenario in the recording"):
            scenario = parse_scenario(json_of(heard.files[SCENARIO]))
    else:
        raise InputError("the recording holds no scenario: name yours (--arms.scenario)")
    if not isinstance(scenario.cell, Cell):
        raise InputError(f"cell.kind: a {scenario.cell.kind} has no joints that could be recorded")
    return scenario


def _names(heard: _Heard, choice: ArmsRecording, own: tuple[str, ...]) -> dict[str, str]:
    """Return the scenario's own joint names, source first, by those of the drivers."""
    from twinct.link.recording.drive_file import NOTE

    if NOTE in heard.notes and not (choice.source_prefix or choice.detector_prefix):
        noted = heard.noted(NOTE, "joints")
        if not isinstance(noted, dict) or tuple(noted.values()) != own:
            raise InputError(
                f"the recording names the joints {quoted(noted)}, but the scenario has "
                f"{', '.join(own)}"
            )
        return noted
    prefixes = {"source_": choice.source_prefix, "detector_": choice.detector_prefix}
    names = {}
    for name in own:
        side = next(side for side in prefixes if name.startswith(side))
        driver = (prefixes[side] or side) + name.removeprefix(side)
        names[driver] = name
    return names


def _sent(heard: _Heard, track: JointTrack, epoch_ns: int) -> SentPlan | None:
    """Return the plan that ``twinct drive`` sent, if any."""
    from twinct.link.recording.drive_file import OUTCOME
    from twinct.link.recording.recorder import PLAN

    if PLAN not in heard.files or "start_ns" not in heard.notes.get(OUTCOME, {}):
        return None
    start_ns, duration_s = (heard.noted(OUTCOME, key) for key in ("start_ns", "duration_s"))
    with library_errors("the outcome in the recording"):
        return SentPlan.of(heard.files[PLAN], (start_ns - epoch_ns) / 1e9, duration_s, track)


def _placed(scenario: Scenario, views: Path) -> Scenario:
    """Return the scenario with imported views as its trajectory, and without reported noise."""
    plain = json.loads(scenario.resolved())
    plain["trajectory"] = {"kind": "file", "path": str(views.absolute())}
    plain["motion"]["plan"] = None
    for side in ("source", "detector"):
        plain["uncertainty"][side]["sigma_mm"] = 0
    return parse_scenario(plain)


def _write(
    store: ScanStore,
    joints: tuple[str, ...],
    executed: PosePairs,
    still: Pose,
    numbers: tuple[Floats, Floats, Floats],
    images: Iterator[NDArray[np.float32]],
) -> None:
    """Write the views of a store, with their executed poses; the specimen stands still."""
    none = np.zeros(0)
    for view, (image, position, speed, time_s) in enumerate(zip(images, *numbers, strict=True)):
        reached = Reached(
            executed=PosePairs.at(*executed[view], still),
            joint_names=joints,
            position=position,
            velocity=speed,
            effort=np.zeros(len(joints)),
            state=none,
            time_s=float(time_s),
            clearance_mm=float("nan"),
        )
        store.write(view, image, reached)


@dataclass(frozen=True, eq=False)
class _Fields:
    """Flat and dark image, and the way in which images are turned over."""

    flat: Floats | None
    dark: Floats | None
    axes: tuple[int, ...]

    @classmethod
    def of(cls, choice: ArmsRecording) -> _Fields:
        """Read the files.

        Raises:
            InputError: one cannot be read, or no light is left.
        """
        if unknown := set(choice.flip) - {"rows", "columns"}:
            raise InputError(f"--arms.flip {' '.join(unknown)}: choose from rows, columns")
        flat, dark = (
            np.mean([read_image(file, name) for file in files], axis=0) if files else None
            for name, files in (("a flat image", choice.flat), ("a dark image", choice.dark))
        )
        if flat is not None and not ((flat - (0 if dark is None else dark)) > 0).all():
            raise InputError("--arms.flat: a pixel is no brighter than in the dark image")
        axes = tuple(axis for axis, name in enumerate(("rows", "columns")) if name in choice.flip)
        return cls(flat, dark, axes)

    def transmission(self, message: Any, topic: str) -> NDArray[np.float32]:
        """Return the transmission of an image, (rows, columns).

        Raises:
            InputError: the image has no known encoding, another size, or no flat image.
        """
        image = _numbers(message, topic)
        if self.flat is None:
            if message.encoding != "32FC1":
                raise InputError(
                    f"{topic}: raw images ({message.encoding}) need flat ones (--arms.flat)"
                )
            return np.flip(image, self.axes).astype(np.float32)
        dark = 0.0 if self.dark is None else self.dark
        if image.shape != self.flat.shape or np.shape(dark) not in ((), image.shape):
            raise InputError(
                f"{topic}: images of {image.shape}, but flat or dark ones of {self.flat.shape}"
            )
        return np.flip((image - dark) / (self.flat - dark), self.axes).astype(np.float32)


def _numbers(message: Any, topic: str) -> Floats:
    kind, _ = RAW.get(message.encoding, ("f4", 0) if message.encoding == "32FC1" else ("", 0))
    if not kind:
        known = ", ".join((*RAW, "32FC1"))
        raise InputError(f"{topic}: encoding {message.encoding}; {known} are read")
    number = np.dtype((">" if message.is_bigendian else "<") + kind)
    rows, columns = message.height, message.width
    data = np.frombuffer(bytes(message.data), np.uint8)
    if message.step < columns * number.itemsize or len(data) != rows * message.step:
        raise InputError(f"{topic}: {len(data)} bytes for {columns} x {rows} px")
    lines = data.reshape(rows, message.step)[:, : columns * number.itemsize]
    return np.ascontiguousarray(lines).view(number).astype(np.float64)


def _pixels(
    paths: Sequence[Path], choice: ArmsRecording, fields: _Fields, wanted: set[int], panel: Any
) -> Iterator[NDArray[np.float32]]:
    """Yield the transmissions of some images, in order."""
    from twinct.link.recording.reader import RecordedMessage, Recording

    index = -1
    for path in paths:
        for record in Recording(path).records():
            if isinstance(record, RecordedMessage) and record.topic == choice.image:
                index += 1
                if index in wanted:
                    image = fields.transmission(record.message, choice.image)
                    if image.shape != (panel.rows, panel.columns):
                        raise InputError(
                            f"{choice.image}: {image.shape[1]} x {image.shape[0]} px, but the "
                            f"scenario's detector has {panel.columns} x {panel.rows}"
                        )
                    if not np.isfinite(image).all():
                        raise InputError(f"{choice.image}: image {index}: a pixel is not finite")
                    yield image


def _latency_s(
    rendered: Callable[[Floats], Sequence[NDArray[np.float32]]],
    track: JointTrack,
    images_s: Floats,
    measured: NDArray[np.float32],
    first_s: float,
) -> float:
    """Return the latency with which rendered images of the specimen resemble the measured ones.

    Gauss-Newton on the line integrals: images rendered a little before and after the supposed time
    give their change with time.

    Args:
        rendered: renders line integrals of the specimen for joint positions, (views, joints), rad.
        track: the joints.
        images_s: stamps of the images, (images,).
        measured: line integrals of the images, (images, rows, columns).
        first_s: latency at which the search starts.

    Raises:
        InputError: no pixel changes with time, or the search does not end.
    """
    latency = first_s
    for _ in range(12):
        top = bottom = 0.0
        for line, time_s in zip(measured, images_s.tolist(), strict=True):
            times = time_s - latency + np.array([-STEP_S, STEP_S])
            position, _, there = track.at(times)
            if not there.all():
                continue
            before, after = rendered(position)
            change = (after - before).astype(np.float64) / (2 * STEP_S)
            top -= float((change * (line - (before + after) / 2)).sum())
            bottom += float((change**2).sum())
        if not bottom:
            raise InputError("--arms.estimate-latency: no image changes with time")
        latency += (step := float(np.clip(top / bottom, -LARGEST_STEP_S, LARGEST_STEP_S)))
        if abs(step) < 1e-5:
            return latency
    raise InputError("--arms.estimate-latency: the images do not fit the scenario at any time")
