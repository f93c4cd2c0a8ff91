"""The list of the published versions of the site."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_list_of_versions_leads_to_the_newest_release(tmp_path: Path) -> None:
    for name in ("dev", "v1.0.0", "v1.10.0", "v1.9.1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "index.html").write_text("")
    runpy.run_path(str(ROOT / "tools" / "site_versions.py"))["write"](tmp_path, "/twinct")
    entries = json.loads((tmp_path / "switcher.json").read_text(encoding="utf-8"))
    assert [entry["name"] for entry in entries] == ["dev", "v1.10.0", "v1.9.1", "v1.0.0"]
    assert [entry["name"] for entry in entries if entry["preferred"]] == ["v1.10.0"]
    assert "/twinct/v1.10.0/" in (tmp_path / "index.html").read_text(encoding="utf-8")
