import os

from twinct.recon._fresh import drop_stale


def test_kernels_older_than_what_they_are_made_of_are_dropped(tmp_path):
    compiled = tmp_path / "__pycache__"
    compiled.mkdir()
    for at, name in ((1, "_rays.py"), (3, "_march.py"), (9, "sart.py")):
        tmp_path.joinpath(name).touch()
        os.utime(tmp_path / name, (at, at))
    for at, name in ((2, "_rays.chords-1.py311.nbi"), (4, "_march.new-2.py311.nbi"), (2, "x.pyc")):
        compiled.joinpath(name).touch()
        os.utime(compiled / name, (at, at))
    drop_stale(tmp_path)
    assert sorted(f.name for f in compiled.iterdir()) == ["_march.new-2.py311.nbi", "x.pyc"]
