"""Drafts and temporary files: nobody plants anything there, and no killed process leaves them."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from waiting import HANG_S

from twinct.core.errors import InputError, StorageError
from twinct.core.files.links import look_through, no_link, own_folder
from twinct.core.files.lock import sole_owner
from twinct.core.files.private import (
    DRAFT,
    TEMPORARY,
    is_private,
    private_folder,
    sweep,
    temporary_folder,
)
from twinct.core.files.writing import complete, storage_errors, write_json, write_text

# Forked: a process that imports all of twinct takes seconds.
PROCESSES = multiprocessing.get_context("fork")
FORKS = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


def killed(work: Callable[[], object]) -> None:
    """Do work in a process that has to end by SIGKILL."""
    process = PROCESSES.Process(target=work)
    process.start()
    process.join(HANG_S)
    assert process.exitcode == -signal.SIGKILL


def die(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def write_and_die_before_the_rename(path: Path) -> None:
    Path.replace = die  # type: ignore[method-assign]  # of this process alone
    write_text(path, "half")


def die_with_a_temporary_folder() -> None:
    with temporary_folder() as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "file").write_text("x")
        die()


@pytest.mark.process
@FORKS
def test_the_next_writer_removes_what_a_killed_one_left(tmp_path: Path) -> None:
    killed(lambda: write_and_die_before_the_rename(tmp_path / "a.json"))
    (left,) = tmp_path.iterdir()
    assert is_private(left.name) and (left / "a.json").read_text() == "half"
    write_text(tmp_path / "b.json", "whole")
    assert [path.name for path in tmp_path.iterdir()] == ["b.json"]


@pytest.mark.process
@FORKS
def test_the_next_owner_of_a_folder_removes_it_at_any_depth(tmp_path: Path) -> None:
    (tmp_path / "geometries").mkdir()
    killed(lambda: write_and_die_before_the_rename(tmp_path / "geometries" / "a.json"))
    assert list((tmp_path / "geometries").iterdir())
    with sole_owner(tmp_path / "lock"):
        assert not list((tmp_path / "geometries").iterdir())


@pytest.mark.process
@FORKS
def test_the_next_temporary_folder_removes_that_of_a_killed_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    killed(die_with_a_temporary_folder)
    assert [path.name.startswith(TEMPORARY) for path in tmp_path.iterdir()] == [True]
    with temporary_folder() as folder:
        assert list(tmp_path.iterdir()) == [folder]
        assert folder.stat().st_mode & 0o777 == 0o700
    assert not list(tmp_path.iterdir())


@pytest.mark.process
@FORKS
def test_a_removal_that_was_killed_is_finished(tmp_path: Path) -> None:
    def remove_half() -> None:
        os.rmdir = die
        with private_folder(tmp_path) as folder:
            (folder / "file").touch()

    killed(remove_half)
    assert len(list(tmp_path.iterdir())) == 1
    sweep(tmp_path)
    assert not list(tmp_path.iterdir())


def test_what_somebody_holds_or_did_not_make_stays(tmp_path: Path) -> None:
    (elsewhere := tmp_path / "elsewhere").mkdir()
    (elsewhere / "file").touch()
    (tmp_path / f"{DRAFT}linked00").symlink_to(elsewhere)
    others = [f"{DRAFT}short", f"{DRAFT}UPPERCAS", ".other-draft-abcdefgh", f"x{DRAFT}abcdefgh"]
    for name in others:
        (tmp_path / name).mkdir()
        (tmp_path / name / ".held").touch()
    (without := tmp_path / f"{DRAFT}nolock00").mkdir()
    (without / "file").touch()
    with private_folder(tmp_path) as held:
        sweep(tmp_path)
        assert held.is_dir()
    there = {path.name for path in tmp_path.iterdir()}
    assert there == {"elsewhere", f"{DRAFT}linked00", *others, without.name}
    assert (elsewhere / "file").exists()


def test_a_lock_that_is_a_link_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "outside").write_text("mine")
    (left := tmp_path / f"{DRAFT}abcdefgh").mkdir()
    (left / ".held").symlink_to(tmp_path / "outside")
    sweep(tmp_path)
    assert left.exists() and (tmp_path / "outside").read_text() == "mine"


def test_that_of_another_user_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (left := tmp_path / f"{DRAFT}abcdefgh").mkdir()
    (left / ".held").touch()
    own = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    sweep(tmp_path)
    assert left.exists()
    monkeypatch.setattr(os, "geteuid", lambda: own)
    sweep(tmp_path)
    assert not left.exists()


def test_a_sweep_between_any_two_steps_takes_no_folder_from_its_maker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever sweeps before the folder is locked makes its maker take another one."""
    for step in ("open", "flock"):
        swept: list[str] = []
        module = os if step == "open" else fcntl
        real = getattr(module, step)

        def sweeping(*arguments: object, real=real, swept=swept, module=module, step=step):
            if not swept:
                swept.append(step)
                monkeypatch.setattr(module, step, real)
                sweep(tmp_path)
            return real(*arguments)

        with private_folder(tmp_path):  # the first one sweeps by itself
            pass
        monkeypatch.setattr(module, step, sweeping)
        with private_folder(tmp_path) as folder:
            assert swept == [step]
            sweep(tmp_path)
            assert list(tmp_path.iterdir()) == [folder]
        assert not list(tmp_path.iterdir())


def test_a_disk_without_locks_is_written_and_never_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with complete(tmp_path / "a") as draft:
        draft.write_text("x")
        sweep(tmp_path)
        assert draft.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@contextmanager
def outside(folder: Path) -> Iterator[Path]:
    """A file and a folder that nobody may change."""
    (folder / "outside").mkdir()
    (folder / "outside" / "file").write_text("mine")
    yield folder / "outside"
    assert [path.name for path in (folder / "outside").iterdir()] == ["file"]
    assert (folder / "outside" / "file").read_text() == "mine"


@pytest.mark.parametrize("target", ["file", "missing"])
@pytest.mark.parametrize("name", [".a.json.partial.json", ".a.json.partial", "a.json"])
def test_a_planted_link_leads_no_writer_to_another_file(
    tmp_path: Path, name: str, target: str
) -> None:
    (out := tmp_path / "out").mkdir()
    with outside(tmp_path) as there:
        (out / name).symlink_to(there / target)
        write_json(out / "a.json", {"b": 1})
        assert not (out / "a.json").is_symlink()
        assert (out / "a.json").read_text() == '{\n  "b": 1\n}\n'


def test_a_folder_takes_no_links_place(tmp_path: Path) -> None:
    (out := tmp_path / "out").mkdir()
    with outside(tmp_path) as there:
        for target in ("file", "missing", ""):
            (out / "folder").symlink_to(there / target)
            with (
                pytest.raises(InputError, match="out/folder is a symbolic link"),
                complete(out / "folder") as draft,
            ):
                draft.mkdir()
            (out / "folder").unlink()
        (out / "folder").symlink_to(there)
        with pytest.raises(InputError, match="out/folder is a symbolic link"):
            own_folder(out / "folder")


def test_a_file_of_a_known_name_is_not_opened_through_a_link(tmp_path: Path) -> None:
    (out := tmp_path / "out").mkdir()
    with outside(tmp_path) as there:
        for target in ("file", "missing"):
            (out / "log").symlink_to(there / target)
            with (
                pytest.raises(InputError, match="out/log is a symbolic link"),
                storage_errors(out),
                open(out / "log", "ab", opener=no_link),
            ):
                pass
            with (
                pytest.raises(InputError, match="out/log is a symbolic link"),
                sole_owner(out / "log", alone=False),
            ):
                pass
            (out / "log").unlink()
    with open(out / "log", "ab", opener=no_link) as stream:
        stream.write(b"x")
    assert (out / "log").read_bytes() == b"x"


def test_links_in_a_folder_are_refused_and_those_above_it_are_not(tmp_path: Path) -> None:
    (tmp_path / "disk" / "out" / "deep" / "scan.zarr").mkdir(parents=True)
    (tmp_path / "out").symlink_to(tmp_path / "disk" / "out")
    with sole_owner(tmp_path / "out" / "lock"):
        pass
    for name in ("deep/link", "deep/other.zarr", "link"):
        for target in ("/nowhere", tmp_path, "/etc/hostname"):
            (link := tmp_path / "out" / name).symlink_to(target)
            with pytest.raises(InputError, match=f"out/{name} is a symbolic link"):
                look_through(tmp_path / "out")
            with (
                pytest.raises(InputError, match=f"out/{name} is a symbolic link"),
                sole_owner(tmp_path / "out" / "lock"),
            ):
                pass
            link.unlink()
    assert not (tmp_path / "out" / "lock").exists()


def test_without_a_folder_it_is_said(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="there is no folder"):
        write_text(tmp_path / "no" / "file", "x")


def test_a_mode_of_a_file_is_that_of_any_other(tmp_path: Path) -> None:
    write_text(tmp_path / "a", "x")
    (tmp_path / "b").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode
