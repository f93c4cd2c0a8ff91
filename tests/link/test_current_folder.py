"""Fast DDS takes its settings from twinct, or from a file that the user names."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.process]

PROFILES = """<?xml version="1.0"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
<participant profile_name="planted" is_default_profile="true"><rtps><planted/></rtps></participant>
</profiles></dds>
"""
"""With a word that Fast DDS complains of."""

JOINS = """
import os, sys
from twinct.link.participant import Station
os.environ.update(SKIP_DEFAULT_XML_FILE=sys.argv[2]) if sys.argv[2] else None
Station("here", int(sys.argv[1])).close()
"""


def said(folder: Path, domain: int, skip: str, **settings: str) -> str:
    """What a process says that joins a graph from a folder."""
    result = subprocess.run(
        [sys.executable, "-P", "-c", JOINS, str(domain), skip],
        cwd=folder,
        env={k: v for k, v in os.environ.items() if k != "SKIP_DEFAULT_XML_FILE"} | settings,
        capture_output=True,
        text=True,
        check=True,
    )
    return result.stdout + result.stderr


def test_profiles_in_the_current_folder_are_not_read(tmp_path: Path, domain: int) -> None:
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(PROFILES)
    assert "planted" not in said(tmp_path, domain, "")
    assert "planted" in said(tmp_path, domain, "0")  # it would be read


def test_twincts_own_settings_are_understood(tmp_path: Path, domain: int) -> None:
    # Ports in shared memory are one set for all domains of a machine: Fast DDS may complain of a
    # port that another process is just leaving.
    assert "XML" not in said(tmp_path, domain, "")


def test_settings_of_the_user_take_precedence(tmp_path: Path, domain: int) -> None:
    own = tmp_path / "own.xml"
    own.write_text(PROFILES)
    heard = said(tmp_path, domain, "", FASTRTPS_DEFAULT_PROFILES_FILE=str(own))
    assert "planted" in heard
    assert "XML" in heard  # so a file with mistakes is told
