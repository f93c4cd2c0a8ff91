"""Files beside the results of a run: exports leave it resumable, and no result is replaced."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.core.errors import InputError, ScanExistsError
from twinct.runs.folder import Folder, refuse_result
from twinct.runs.reconstruction_folder import free_name


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    made = Folder(tmp_path)
    made.scenario.write_text("name: scan\n", encoding="utf-8")
    made.volume.touch()
    return made


def test_exports_belong_to_the_folder_of_a_run(folder: Folder) -> None:
    for name in ("export-volume.nii", "export-volume.nii.gz"):
        (folder.path / name).touch()
    (folder.path / "export-rtk").mkdir()
    folder.refuse_others()
    (folder.path / "notes.txt").touch()
    with pytest.raises(InputError, match=r"not part of a run \(notes\.txt\)"):
        folder.refuse_others()


def test_results_are_not_replaced(folder: Folder, tmp_path: Path) -> None:
    with pytest.raises(ScanExistsError, match=r"volume\.nii is a result of the run there"):
        refuse_result(folder.volume)
    for free in ("export-volume.nii", "report.html"):
        refuse_result(folder.path / free)
    folder.scenario.unlink()
    refuse_result(folder.volume)


@pytest.mark.parametrize("name", ["", "bad/name", ".hidden", "a" * 65])
def test_a_name_that_is_none_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at most 64 letters, .* begin with a letter or a digit"):
        free_name(name, "sart", tmp_path)


def test_only_a_command_with_resume_offers_it(folder: Folder) -> None:
    with pytest.raises(ScanExistsError, match="or continue with --resume"):
        folder.refuse_if_taken()
    with pytest.raises(ScanExistsError, match="choose another --out$"):
        folder.refuse_if_taken(resumes=False)
