"""Scans rebuilt from their recordings, whole, in parts, damaged, and of other tools."""

import filecmp
import struct

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from twinct.cli import run_command
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.private import DRAFT
from twinct.link.recording import ForeignScan
from twinct.link.recording.bag import Bag
from twinct.link.topics import IMAGE, JOINTS, REACHED, STATE
from twinct.runs import import_recordings, load_scan, reconstruct_run
from twinct.scan import ScanStore


def assert_same(one, other):
    """The bytes of two folders."""
    names = [sorted(p.relative_to(top) for p in top.rglob("*")) for top in (one, other)]
    assert names[0] == names[1]
    files = [name for name in names[0] if (one / name).is_file()]
    assert filecmp.cmpfiles(one, other, files, shallow=False)[1:] == ([], [])


def cut(bag, share, path):
    """The first part of a recording."""
    data = bag.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


def told_again(bag, path, keep=lambda topic: True):
    """The messages of a recording as another tool would have written them, without its files."""
    with bag.open("rb") as source, path.open("wb") as target:
        writer, channels = Writer(target), {}
        writer.start("ros2")
        for schema, channel, message in make_reader(source).iter_messages():
            if keep(channel.topic):
                if channel.topic not in channels:
                    kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.topic] = writer.register_channel(channel.topic, "cdr", kind)
                at = message.log_time
                writer.add_message(channels[channel.topic], at, message.data, at)
        writer.finish()
    return path


@pytest.mark.parametrize("keys", [(), ("cell={kind: gantry}",)], ids=["arms", "gantry"])
def test_a_rebuilt_store_has_the_same_bytes(take, taken, keys, tmp_path):
    scan = take(tmp_path / "scan", *keys) if keys else taken
    found = import_recordings([scan.folder / "scan.mcap"], tmp_path / "again")
    assert found.missing == () and found.contents.problems == ()
    assert_same(scan.folder / "scan.zarr", tmp_path / "again" / "scan.zarr")


def test_what_was_cut_off_is_resumed(take, taken, tmp_path):
    part = cut(taken.folder / "scan.mcap", 0.7, tmp_path / "cut.mcap")
    found = import_recordings([part], tmp_path / "out")
    assert 0 < len(found.missing) < 4 and found.missing_in_words.endswith("3")
    assert found.contents.problems == (f"{part} was cut off",)
    assert ScanStore(tmp_path / "out" / "scan.zarr").acquired == 4 - len(found.missing)

    rest = take(tmp_path / "out")
    assert_same(taken.folder / "scan.zarr", tmp_path / "out" / "scan.zarr")
    both = import_recordings([part, rest.folder / "scan.mcap"], tmp_path / "both")
    assert both.missing == ()
    assert_same(taken.folder / "scan.zarr", tmp_path / "both" / "scan.zarr")


def test_an_import_that_is_cut_short_leaves_nothing_and_can_be_repeated(
    taken, tmp_path, monkeypatch
):
    out, write = tmp_path / "out", ScanStore.write

    def interrupted(store, index, *view):
        if index == 2:
            raise KeyboardInterrupt
        write(store, index, *view)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(ScanStore, "write", interrupted)
        import_recordings([taken.folder / "scan.mcap"], out)
    assert not list(out.iterdir())
    left = out / f"{DRAFT}abcdefgh"  # of a kill
    (left / "scan.zarr" / "images").mkdir(parents=True)
    (left / ".held").touch()
    import_recordings([taken.folder / "scan.mcap"], out)
    assert_same(taken.folder / "scan.zarr", out / "scan.zarr")
    assert not [path for path in out.iterdir() if path.name.startswith(".")]


def test_a_damaged_part_costs_its_views_only(taken, tmp_path):
    bag = tmp_path / "scan.mcap"
    data = bytearray((taken.folder / "scan.mcap").read_bytes())
    image = ScanStore(taken.folder / "scan.zarr").transmission(1).tobytes()
    data[data.index(image)] ^= 1
    bag.write_bytes(data)
    found = import_recordings([bag], tmp_path / "out")
    assert found.missing == (1,) and found.missing_in_words == "view 1"
    assert found.contents.problems == (f"{bag}: 1 damaged parts",)


def test_another_tools_recording_gives_what_is_there(taken, tmp_path):
    seen = 0

    def all_but_the_second_image(topic):
        nonlocal seen
        seen += topic == "/xray/image"
        return topic != "/xray/image" or seen != 2

    bag = told_again(taken.folder / "scan.mcap", tmp_path / "bag.mcap", all_but_the_second_image)
    found = import_recordings([bag], tmp_path / "out")
    assert isinstance(found, ForeignScan) and found.missing == (1,)
    own = ScanStore(taken.folder / "scan.zarr").read()
    scan = load_scan(tmp_path / "out")
    panel = scan.settings.detector.panel
    assert (panel.pitch_u, panel.pitch_v) == (10.0, 10.0) and panel.shape == (24, 32)
    there = [0, 2, 3]
    assert (scan.transmission == own.transmission[there]).all()
    for side in ("source", "detector"):
        for which, kept in (("commanded", "targets"), ("executed", "stated")):
            poses, known = getattr(scan.poses(kept), side), getattr(own.poses(which), side)
            for pose, view in zip(poses, there, strict=True):
                assert (pose.matrix == known[view].matrix).all()
    assert scan.settings.specimen is None and scan.settings.source is None
    grid = "reconstruction.grid={voxels: 16, voxel_mm: 10}"
    made = reconstruct_run(tmp_path / "out", [grid], geometry="targets")
    assert made.geometry == "targets" and made.volume.shape == (16, 16, 16)


def test_bad_input(take, taken, tmp_path):
    own = taken.folder / "scan.mcap"
    text, empty = tmp_path / "text.mcap", tmp_path / "empty.mcap"
    text.write_text("no bag, but longer than a few bytes")
    empty.touch()
    image = text.with_name("p_1.tif")
    image.write_text(text.read_text())
    early = cut(own, 0.02, tmp_path / "early.mcap")
    joints = told_again(own, tmp_path / "joints.mcap", lambda topic: topic == "/joint_states")
    other = take(tmp_path / "other", "cell={kind: gantry}").folder / "scan.mcap"
    newer = tmp_path / "newer.mcap"
    newer.write_bytes(own.read_bytes().replace(b"twinct recording 1", b"twinct recording 2"))
    for files, words in [
        ([], "no recording given"),
        ([text], "text.mcap is not an MCAP file$"),
        ([image], "p_1.tif is not an MCAP file, but images without geometry: .* a YAML file"),
        ([empty], "empty.mcap is not an MCAP file"),
        ([tmp_path / "none.mcap"], "none.mcap does not exist"),
        ([early], "early.mcap(: | was )cut off"),
        ([joints], "nothing can be imported without /scan/reached, /xray/camera_info, /xray/image"),
        ([own, other], "belongs to another scan than"),
        ([newer], "'twinct recording 2'; this twinct reads 'twinct recording 1'"),
    ]:
        with pytest.raises(InputError, match=words):
            import_recordings(files, tmp_path / "out")
        assert not (tmp_path / "out").exists(), words
    with pytest.raises(ScanExistsError, match="already holds scan.zarr"):
        import_recordings([own], taken.folder)


def test_the_command_names_what_is_missing(taken, tmp_path, capsys):
    part = cut(taken.folder / "scan.mcap", 0.7, tmp_path / "cut.mcap")
    assert run_command(["import", str(part), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    words = " ".join((said.out + said.err).split())
    assert "cut.mcap was cut off" in words and "missing: view" in words
    assert "of 4 views imported" in words

    assert run_command(["import", str(tmp_path / "none.mcap"), "--out", str(tmp_path / "no")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "no").exists()


def otherwise(bag, path, changes, *, files=True):
    """A recording some of whose messages, or files, are others: by topic or name."""
    with bag.open("rb") as source:
        reader = make_reader(source)
        told = Bag(path, 4096)
        for note in reader.iter_metadata() if files else ():
            told.note(note.name, note.metadata)
        for file in reader.iter_attachments() if files else ():
            told.attach(file.name, changes.get(file.name, lambda data: data)(file.data))
        for number, (schema, channel, message) in enumerate(reader.iter_messages()):
            data = changes.get(channel.topic, lambda data: data)(message.data)
            at = message.log_time
            told.write_raw(channel.topic, schema.name, data, at, at, number)
        told.close()
    return path


def last_number(value):
    """Another number at a message's end."""
    return lambda data: data[:-8] + struct.pack("<d", value)


@pytest.mark.parametrize(
    ("changes", "files", "why"),
    [
        ({JOINTS: last_number(np.nan)}, True, "effort on /joint_states: not a finite number"),
        ({STATE: last_number(np.inf)}, True, "/scan/state holds a number that is not finite"),
        ({REACHED: last_number(7.0)}, True, "not a unit quaternion"),
        (
            {IMAGE: lambda data: data[:-4] + b"\xff" * 4},
            False,
            "/xray/image: a pixel is not finite",
        ),
        ({IMAGE: lambda data: data[:-4] + b"\xff" * 4}, True, "/xray/image: a pixel is not finite"),
        ({"scenario.json": lambda data: b"[" * 9}, True, "scenario.json: not valid JSON"),
    ],
)
def test_messages_that_no_scan_says_are_told_and_nothing_is_left(
    taken, tmp_path, changes, files, why
):
    """Found by changing single messages."""
    bag = otherwise(taken.folder / "scan.mcap", tmp_path / "x.mcap", changes, files=files)
    with pytest.raises(InputError, match=why):
        import_recordings([bag], tmp_path / "out")
    assert not (tmp_path / "out" / "scan.zarr").exists()
