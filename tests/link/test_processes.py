"""Three processes live and die together, and two scans never meet."""

import mmap
import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest
from waiting import HANG_S, until

from twinct.core.errors import InputError, LinkError, MemoryShortageError
from twinct.core.memory import _ULIMIT
from twinct.link import RosRig
from twinct.link.environment import Domain, sweep_shared_memory
from twinct.link.participant import Station
from twinct.scan import SimulationBuilder

pytestmark = [pytest.mark.ros, pytest.mark.process]

PARENT = Path(__file__).with_name("scan_parent.py")
SILENCE_S = 2.0
"""In place of six, where a process hangs."""


class Scan:
    """A scan in a process of its own."""

    def __init__(self, folder: Path, scenario) -> None:
        folder.mkdir()
        self.log_dir = folder / "logs"
        file = folder / "scenario.json"
        file.write_text(scenario.resolved())
        self.process = subprocess.Popen(
            # A test started in the background of a script inherits SIGINT as ignored.
            ["env", "--default-signal=INT", sys.executable, PARENT, file, self.log_dir],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.process.stderr.read()
        self.domain_id, self.pid, self.robots, self.xray = map(int, line.split())

    def reach(self, last: int) -> None:
        """Wait until so many views are taken and the next one is reached: what says its number."""
        for view in range(last + 1):
            assert self.process.stdout.readline() == f"{view}\n"

    def end(self) -> tuple[int, str]:
        """Exit code and what it complained about."""
        _, complaint = self.process.communicate(timeout=HANG_S)
        return self.process.returncode, complaint


@pytest.fixture
def scan(tmp_path, scenario, notes):
    made = []

    def make():
        made.append(Scan(tmp_path / f"scan{len(made)}", scenario))
        return made[-1]

    yield make
    for one in made:
        one.process.kill()
        one.process.communicate()


@pytest.fixture
def hasty(monkeypatch):
    """Nodes and their scan take a shorter silence for a hang."""
    monkeypatch.setenv("FAKE_SILENCE_S", str(SILENCE_S))


@pytest.mark.parametrize("victim", ["robots", "xray"])
def test_a_node_that_dies_ends_the_scan(scan, notes, wait_for_end, victim):
    with notes.renders_held(3):
        running = scan()
        running.reach(3)
        os.kill(getattr(running, victim), signal.SIGKILL)
    wait_for_end([running.pid, running.robots, running.xray])
    code, complaint = running.end()
    assert code == 1
    assert complaint.startswith(f"LinkError: the {victim} node was ended by SIGKILL")
    assert sorted(path.name for path in running.log_dir.iterdir()) == ["robots.log", "xray.log"]


@pytest.mark.clock
@pytest.mark.parametrize("victim", [pytest.param("robots", marks=pytest.mark.tutorial), "xray"])
def test_a_node_that_hangs_ends_the_scan(scan, notes, hasty, wait_for_end, victim):
    with notes.renders_held(3):
        running = scan()
        running.reach(3)
        os.kill(getattr(running, victim), signal.SIGSTOP)
    wait_for_end([running.pid, running.robots, running.xray])
    code, complaint = running.end()
    assert code == 1
    assert complaint.startswith(f"LinkError: the {victim} node hung or was stopped: it was silent")


@pytest.mark.clock
def test_a_scan_that_is_stopped_loses_its_nodes_and_says_so(scan, notes, hasty, wait_for_end):
    with notes.renders_held(3):
        running = scan()
        running.reach(3)
        os.kill(running.pid, signal.SIGSTOP)
    wait_for_end([running.robots, running.xray])
    os.kill(running.pid, signal.SIGCONT)
    code, complaint = running.end()
    assert code == 1
    told = f"the process that started it was silent for {SILENCE_S:.0f} s"
    assert told in complaint


def test_a_node_that_dies_takes_the_other_with_it_while_nobody_asks(
    scenario, fake_command, wait_for_end
):
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        robots, xray = (node.pid for node in rig._nodes)
        os.kill(robots, signal.SIGKILL)
        wait_for_end([robots, xray])
        with pytest.raises(LinkError, match="robots node was ended by SIGKILL"):
            rig.move(0, SimulationBuilder(scenario).targets[0])


def test_a_killed_parent_takes_its_nodes_with_it_even_at_work(scan, notes, wait_for_end):
    with notes.renders_held(3):
        running = scan()
        running.reach(3)
        until(lambda: notes.count("render") == 4, "the fourth image is begun")
        os.kill(running.pid, signal.SIGKILL)
        wait_for_end([running.pid, running.robots, running.xray])
    for log in running.log_dir.iterdir():
        assert "the process that started it has ended" in log.read_text(), "it was not silence"


def test_ctrl_c_is_the_parents_to_handle(scan, notes, wait_for_end):
    with notes.renders_held(1):
        running = scan()
        for node in (running.robots, running.xray):
            assert os.getsid(node) == node != os.getsid(running.pid), "the terminal would reach it"
        running.reach(1)
        os.kill(running.pid, signal.SIGINT)
    wait_for_end([running.pid, running.robots, running.xray])
    _, complaint = running.end()
    assert complaint.rstrip().endswith("KeyboardInterrupt")


def free(domain):
    """Whether a domain can be taken; scans of other tests may have it for a while."""
    try:
        Domain(domain).close()
    except InputError:
        return False
    return True


@pytest.mark.tutorial
def test_two_scans_at_once_do_not_meet_and_leave_nothing(scan, notes, ended):
    with notes.renders_held(1):
        one, other = scan(), scan()
        assert one.domain_id != other.domain_id
        one.reach(1)
        other.reach(1)
    assert one.end() == other.end() == (0, "")
    assert all(map(ended, [one.robots, one.xray, other.robots, other.xray]))
    until(lambda: free(one.domain_id), "the first scan's domain is free")


def test_a_node_that_cannot_start_is_named_with_its_last_words(scenario, tmp_path):
    script = tmp_path / "broken.py"
    script.write_text("import sys; print('no such arm'); sys.exit(2)")
    with pytest.raises(LinkError, match=r"node ended with exit code 2:\n  no such arm"):
        RosRig(scenario, node_command=(sys.executable, str(script)))


def test_a_node_without_memory_ends_the_scan_as_memory_does(scenario, tmp_path):
    script = tmp_path / "short.py"
    script.write_text("import sys; print('twinct: too little memory: 3 MiB'); sys.exit(2)")
    with pytest.raises(MemoryShortageError, match="node ended with exit code 2:\n.*3 MiB"):
        RosRig(scenario, node_command=(sys.executable, str(script)))


def test_no_one_joins_without_memory_for_the_threads(monkeypatch):
    """Fast DDS would end the process."""
    monkeypatch.setattr("twinct.core.memory._limits", lambda: [(2**28, _ULIMIT)])
    with pytest.raises(MemoryShortageError, match="256 MiB are left .* 512 MiB .* to join ROS 2"):
        Station("nobody", 1)


def test_who_joins_before_the_nodes_start_follows_every_view(scenario, fake_command, asked_once):
    """``twinct run`` says its domain before it plans: then a follower misses nothing."""
    example = Path(__file__).parents[2] / "examples" / "follow_scan.py"
    domain = Domain()
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain.id), "PYTHONUNBUFFERED": "1"}
    heard = []
    with subprocess.Popen(
        [sys.executable, example],
        env={**environment, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        stdout=subprocess.PIPE,
        text=True,
    ) as follower:
        reader = Thread(target=lambda: heard.extend(follower.stdout))
        reader.start()
        try:
            until(lambda: heard, "the follower listens")
            assert heard.pop(0) == "waiting for images\n"
            targets = SimulationBuilder(scenario).targets[:8]  # of images the last ten are kept
            with closing(RosRig(scenario, node_command=fake_command, domain=domain)) as rig:
                for view, target in enumerate(targets):
                    rig.move(view, target)
                    rig.expose(view)
                # Nodes that miss each other's first call find each other seconds later: this scan
                # takes less, and what it has said ends with its nodes.
                until(lambda: len(heard) >= len(targets), "the follower hears of all views")
        finally:
            follower.kill()
            reader.join()
    told = [line.split(" at ")[0] for line in heard]
    assert told == [f"view {view}" for view in range(len(targets))]


def test_each_node_logs_its_start_and_its_views(scenario, fake_command, tmp_path):
    targets = SimulationBuilder(scenario).targets
    with closing(RosRig(scenario, node_command=fake_command, log_dir=tmp_path)) as rig:
        for view in range(2):
            rig.move(view, targets[view])
            rig.expose(view)
        ready = f"is ready on ROS domain {rig.domain_id}"
    for name, word in (("robots", "reached view"), ("xray", "image of view")):
        lines = (tmp_path / f"{name}.log").read_text().splitlines()
        told = [line for line in lines if f"twinct_{name}" in line or word in line]
        assert told[0].endswith("starts") and ready in told[1]
        assert [line.partition(word)[2].split(":")[0] for line in told[2:4]] == [" 0", " 1"]


def test_a_domain_in_use_is_refused_and_free_again_afterwards(scenario, fake_command, monkeypatch):
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(rig.domain_id))
        with pytest.raises(InputError, match=f"ROS_DOMAIN_ID={rig.domain_id}: another scan"):
            RosRig(scenario, node_command=fake_command)
    until(lambda: free(None), "the domain in ROS_DOMAIN_ID is free again")


@pytest.mark.parametrize("text", ["-1", "233", "five"])
def test_a_domain_that_is_none_is_refused(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(InputError, match=f"ROS_DOMAIN_ID='?{text}"):
        Domain()


def test_a_domain_where_others_speak_is_not_chosen(monkeypatch):
    from twinct.link import environment

    taken = set()

    def hold(domain):
        """In place of one that processes of other tests share."""
        if domain in taken:
            return None
        taken.add(domain)
        return SimpleNamespace(close=lambda: taken.remove(domain))

    monkeypatch.setattr(environment, "DOMAINS", range(60, 63))
    monkeypatch.setattr(environment, "_hold", hold)
    monkeypatch.setattr(environment, "_silent", lambda domain: domain == 61)
    held = Domain()
    assert taken == {held.id} == {61}
    with pytest.raises(LinkError, match="all ROS domains from 60 to 62 are in use"):
        Domain()
    held.close()
    assert not taken


def test_a_participant_makes_its_domain_loud(foreign):
    from twinct.link.environment import _silent

    held = Domain()
    assert _silent(held.id)
    foreign(held.id)
    assert not _silent(held.id)
    held.close()


def test_who_stays_when_the_first_is_gone_is_heard(foreign):
    from twinct.link.environment import _silent

    held = Domain()
    first, second = foreign(held.id), foreign(held.id)
    first.close()
    assert not _silent(held.id)
    second.close()
    held.close()


@pytest.mark.parametrize("with_children", [False, True])
def test_a_hold_ends_with_the_last_process_that_has_it(with_children):
    held = Domain()
    inherit = (held.hold,) if with_children else ()
    with subprocess.Popen(["sleep", "infinity"], pass_fds=inherit) as child:
        try:
            held.close()
            if with_children:
                with pytest.raises(InputError, match="another scan"):
                    Domain(held.id)
        finally:
            child.kill()
    until(lambda: free(held.id), "the domain is free again")


def test_shared_memory_of_the_dead_is_swept_and_of_the_living_kept(tmp_path):
    import fcntl

    for name in ("fastrtps_port7778", "sem.fastrtps_port7778_mutex", "fastrtps_8d3ea874a08bf714"):
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (1, 1))
    for name in ("fastrtps_port7777", "fastrtps_dead", "fastrtps_alive"):
        for path in (tmp_path / name, tmp_path / f"{name}_el"):
            path.write_text("")
            os.utime(path, (1, 1))
    about_to_be_locked = tmp_path / "fastrtps_0123456789abcdef"
    about_to_be_locked.write_text("")
    os.utime(about_to_be_locked, (2**33, 2**33))
    with (tmp_path / "fastrtps_alive_el").open() as alive:
        fcntl.flock(alive, fcntl.LOCK_EX)
        sweep_shared_memory(tmp_path)
        left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["fastrtps_0123456789abcdef", "fastrtps_alive", "fastrtps_alive_el"]


MAPS = """
import mmap, sys
with open(sys.argv[1], "r+b") as file:
    held = mmap.mmap(file.fileno(), 1)
print("mapped", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("name", ["fastrtps_0123456789abcdef", "fastrtps_port7777"])
def test_shared_memory_that_this_process_sends_through_is_kept(tmp_path, name):
    """Another participant of this process may still send to a port whose listener has left."""
    path = tmp_path / name
    path.write_text("x")
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 1):
        file.close()
        os.utime(path, (1, 1))
        sweep_shared_memory(tmp_path)
        assert [left.name for left in tmp_path.iterdir()] == [name], "no guard of a dead one either"
    sweep_shared_memory(tmp_path)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("how", ["open", "mapped"])
@pytest.mark.parametrize("name", ["fastrtps_0123456789abcdef", "fastrtps_port7777_el"])
def test_shared_memory_that_a_slow_process_has_not_locked_yet_is_kept(tmp_path, name, how):
    path = tmp_path / name
    path.write_text("x")
    os.utime(path, (1, 1))
    code = MAPS if how == "mapped" else "import sys; print('open', flush=True); sys.stdin.read()"
    with (
        path.open("r+b") as file,
        subprocess.Popen(
            [sys.executable, "-c", code, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=() if how == "mapped" else (file.fileno(),),
        ) as child,
    ):
        assert child.stdout.readline()
        sweep_shared_memory(tmp_path)
        assert path.exists()
        child.stdin.close()
    sweep_shared_memory(tmp_path)
    assert not path.exists()
