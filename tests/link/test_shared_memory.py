"""Full shared memory: said before any library of ROS is loaded, and after a node died of it."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from twinct.core.errors import InputError
from twinct.link.environment import require_shared_memory
from twinct.link.processes import NodeProcess

PAGE = os.sysconf("SC_PAGE_SIZE")
FULL = """
mount -t tmpfs -o size=64k tmpfs /dev/shm && head -c 65536 /dev/zero > /dev/shm/full && exec "$@"
"""
"""Runs a command that finds a full /dev/shm of its own."""


def test_two_pages_are_needed(tmp_path):
    require_shared_memory(tmp_path, free=2 * PAGE)
    for free in (0, PAGE, 2 * PAGE - 1):
        problem = f"{tmp_path} is full: {free} bytes .* needs {2 * PAGE} .*--shm-size.*--link local"
        with pytest.raises(InputError, match=problem):
            require_shared_memory(tmp_path, free=free)


def test_pages_that_are_there_already_are_not_needed_again(tmp_path):
    user = os.getuid()
    (tmp_path / f"lttng-ust-wait-6-{user}").write_bytes(bytes(PAGE))
    require_shared_memory(tmp_path, free=PAGE)
    with pytest.raises(InputError, match=f"needs {PAGE} at its start"):
        require_shared_memory(tmp_path, free=0)
    (tmp_path / "lttng-ust-wait-6").touch()  # without a page
    with pytest.raises(InputError, match=f"needs {PAGE} at its start"):
        require_shared_memory(tmp_path, free=0)
    (tmp_path / "lttng-ust-wait-6").write_bytes(bytes(PAGE))
    require_shared_memory(tmp_path, free=0)


def test_no_shared_memory_is_none_of_its_business(tmp_path):
    require_shared_memory(tmp_path / "nowhere")


@pytest.mark.process
def test_a_full_disk_ends_no_process_without_a_word():
    """ROS itself ends here by SIGBUS, when its tracer is loaded."""
    code = "from twinct.link import require_ros; require_ros()"
    line = ["unshare", "--mount", "sh", "-c", FULL, "sh", sys.executable, "-c", code]
    done = subprocess.run(line, capture_output=True, text=True)
    if "unshare" in done.stderr or "mount:" in done.stderr:
        return  # without the right to mount; the tests above pass the free space in
    assert done.returncode == 1
    assert "InputError: /dev/shm is full: 0 bytes of shared memory are free" in done.stderr


@pytest.mark.process
def test_a_node_that_died_by_sigbus_names_shared_memory(tmp_path):
    ended = SimpleNamespace(node=None)
    node = NodeProcess(
        "xray",
        [sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGBUS)"],
        tmp_path / "log",
        environment=os.environ,
        on_end=lambda node: setattr(ended, "node", node),
    )
    for thread in node._threads:
        thread.join()
    assert ended.node is node
    told = node.describe_end()
    assert told.startswith("the xray node was ended by SIGBUS, because /dev/shm had no room: ")
    assert "--shm-size=64m" in told
    node.stop()
