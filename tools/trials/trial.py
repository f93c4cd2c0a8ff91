"""One trial: a command meets a fault, and is continued or repeated."""

import bisect
import contextlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import time

from beside import Beside, domain
from commands import COMMANDS, begin, contents, environment, is_draft, line, prepare
from faults import FAULTS
from processes import (
    MARK,
    PATIENCE_S,
    TO_END_S,
    alive,
    end_all,
    may_mount,
    mounted,
    remount,
    until,
    with_shared_memory,
)
from recordings import is_part
from simulated_cluster import SimulatedCluster

DRAFT = re.compile(r"^\.twinct-draft-|partial|lock$|lifeline")
DRAWS = 5
"""A trial is drawn at most so often."""
EARLY = 0.75
"""Share of a command's moments before which a signal ends it surely."""
RESUMED = 0.25
"""Share of two commands at once that resume a killed one."""
TRACER = "lttng-ust-wait"
"""Shared memory of the tracer that ROS 2 loads, one for all processes of a user."""
FAILED = re.compile(r"\d+ trials? failed, the first because: ")
BUG = re.compile(r"Traceback|this is a bug in twinct")


class Trials:
    """A folder with the inputs of all trials, and the results of undisturbed commands.

    Attributes:
        can_mount: disks can be mounted for a trial.
        whole: of each command, the results when nothing disturbs it, and the times of the moments
            of its processes, and those of its start and end.
    """

    def __init__(self, folder, names, stack):
        """Prepare the inputs of some commands; ``stack`` ends what they need."""
        self.folder, self.made = folder, folder / "made"
        self.made.mkdir(parents=True)
        self.can_mount = may_mount(folder)
        self.whole = {}
        self.cluster = None
        if any(COMMANDS[name].of_cluster for name in names):
            self.cluster = SimulatedCluster(folder / "nodes")
            stack.callback(self.cluster.close)
        prepare(self.made, names)

    def undisturbed(self, name):
        """Return the name of a command, and what ``whole`` holds of it."""
        place = self.folder / "whole" / name
        place.mkdir(parents=True)
        out = place / "results"
        begin(COMMANDS[name], self.made, out)
        with domain(COMMANDS[name]) as own:
            beside = self.beside(COMMANDS[name], out, environment(own), place / "beside.log")
            begun = time.monotonic()
            done = subprocess.run(
                self.line(COMMANDS[name], out),
                env=environment({"TWINCT_TRIAL": f"any|0|0|||{place}", **own}),
                capture_output=True,
                text=True,
            )
            whole_s = time.monotonic() - begun
            if wrong := beside and beside.end():
                raise SystemExit(f"{name}: {wrong}")
        if done.returncode:
            raise SystemExit(f"{name} ended with {done.returncode}:\n{done.stderr}")
        times = {p.stem: json.loads(p.read_text()) for p in place.glob("[!.]*.json")}
        times["whole"] = [0.0, whole_s]
        results = contents(out, COMMANDS[name].results)
        shutil.rmtree(place)
        return name, (results, times)

    def line(self, command, out):
        """Return the command line of a command."""
        return line(command.words, self.made, out, self.cluster.address if self.cluster else "")

    def beside(self, command, out, own, log, wrapped=list):
        """Start what runs beside a command, if anything does; return it or None."""
        if not command.beside:
            return None
        return Beside(wrapped(line(command.beside, self.made, out)), own, log)

    def trial(self, name, kind, seed):
        """Do one trial; draw it again while its fault comes too late and nothing goes wrong.

        Returns:
            Whether its fault came in time; the exit codes; all that went wrong; seconds from the
            fault until no process was left, or None; the number of draws.
        """
        expected, times = self.whole[name]
        draw = 0
        while True:
            draw += 1
            with contextlib.ExitStack() as stack:
                one = Trial(self, name, kind, random.Random(f"{seed} {draw}"), expected, stack)
                *found, wrong, gone_s = one.run(times)
                if one.in_time or wrong or draw == DRAWS:
                    return *found, wrong, gone_s, draw


def drawn_moment(rng, times):
    """Return the number of a moment, and a while after it, s; half of them by time, half by moment.

    ``times`` has the times of all moments, and of the end.
    """
    number = rng.randrange(1, len(times))
    if rng.random() < 0.5:
        return number, 0.0
    time_s = rng.uniform(times[0], times[-1])
    number = max(bisect.bisect_right(times[:-1], time_s), 1)
    return number, time_s - times[number - 1]


def met_python(code, words, number):
    """Return True if a signal came before the first line of twinct, to Python or the shell."""
    told = not words or "KeyboardInterrupt" in words
    return "twinct: " not in words and (code == -number or code == 1 and told)


def is_begun_scan(path):
    """Return True in a study's draft of a scan that has a view, which --resume continues."""
    drafts = [part for part in (path, *path.parents) if part.name.endswith(".partial")]
    return any(one for part in drafts for one in (part / "scan.zarr" / "status").glob("c.*"))


class Trial:
    """A trial in a folder of its own."""

    def __init__(self, trials, name, kind, rng, expected, stack):
        """Make the folder and its disks, which ``stack`` removes."""
        self.trials, self.command, self.fault = trials, COMMANDS[name], FAULTS[kind]
        self.rng, self.expected = rng, expected
        self.place = trials.folder / f"trial {os.getpid()}"
        self.mark = f"{os.getpid()}-{rng.getrandbits(64):x}"
        self.disk, self.shared = self.place / "disk", self.place / "shm"
        self.temporary, self.gone_s = self.place / "tmp", None
        stack.callback(shutil.rmtree, self.place, ignore_errors=True)
        self.temporary.mkdir(parents=True)
        if trials.can_mount:
            stack.enter_context(mounted(self.shared, self.fault.shared_kib))
        if self.fault.disk:
            stack.enter_context(mounted(self.disk, 1024 * self.fault.disk))
        stack.callback(end_all, self.mark)
        self.domain, self.beside = stack.enter_context(domain(self.command)), None
        stack.callback(lambda: self.beside and self.beside.kill())
        self.out = self.disk / self.fault.name / "results"
        begin(self.command, trials.made, self.out)
        if self.command.over and rng.random() < 0.5:  # over earlier results
            for file, data in expected.items():
                (self.out / file).write_bytes(data)

    def run(self, times):
        """Run the command with its fault, then to its end; see ``Trials.trial``."""
        before, fault = self.results(), self.fault
        self.wrong_beside = []
        expected = times.get(fault.victim, [0, 0])
        moment, wait_s = drawn_moment(self.rng, expected)
        self.later_s = self.rng.uniform(*times["whole"])
        self.early = moment < EARLY * len(expected)
        argument = fault.argument(self.rng, self.disk)
        plan = f"{fault.victim}|{moment}|{wait_s:.3f}|{fault.kind}|{argument}|{self.place}"
        if fault.read_only:
            remount(self.disk, "ro")
        wrong = self.met({"TWINCT_TRIAL": plan} if fault.kind else {})
        if fault.read_only:
            remount(self.disk, "rw")
        (self.disk / "filler").unlink(missing_ok=True)
        now, command = self.results(), self.command
        for file in before.keys() | (now.keys() if not command.again else set()):
            if now.get(file) in (before.get(file), self.expected.get(file)):
                continue
            if command.grows and is_part(now[file], self.expected[file]):
                wrong += self.unsent(now[file])
                (self.out / file).unlink()  # a user chooses another name
            else:
                wrong.append(f"{file} is neither as before nor complete")
        if now != self.expected or command.again:
            wrong += self.gone_on()
        there = [p.name for p in self.shared.glob("*")]
        if left := [name for name in there if not name.startswith(TRACER)]:
            wrong.append(f"left in /dev/shm: {', '.join(left)}")
        return self.in_time, self.codes, wrong + self.wrong_beside, self.gone_s

    def unsent(self, told):
        """Return that a signal left the recording of a plan that was not sent, if it did."""
        if not self.fault.ends_surely or self.killed or told.get("sent"):
            return []
        return [f"a recording is left although nothing was sent: {sorted(told)}"]

    @property
    def fired(self):
        """True if the command met the fault before its end."""
        return not self.fault.kind or (self.place / "fired").exists()

    @property
    def in_time(self):
        """True if the fault met the command while it had something to lose."""
        if self.fault.any_time:
            return self.codes[0] in self.fault.codes
        ended = self.fault.codes and 0 not in self.fault.codes and self.fault.kind
        return self.fired and not (ended and 0 in self.codes)

    def results(self):
        """Return the results at present."""
        return contents(self.out, self.command.results)

    def met(self, plan):
        """Run the command with the fault; return what went wrong."""
        fault, more = self.fault, ()
        if fault.twice and self.rng.random() < RESUMED:
            self.killed_before(plan)
            more = self.command.again
        changes = plan | dict(fault.environment)
        processes = [self.start("first", changes, more, disturbed=True)]
        first = processes[0]

        def over():
            return first.poll() is not None

        if fault.any_time:
            until(over, self.later_s)
            first.send_signal(fault.any_time)
        if fault.twice or fault.stops or fault.outside:
            until(lambda: self.fired or over())
        if fault.twice:
            processes.append(self.start("second", {}, more))
        if fault.stops:
            until(lambda: [*alive(self.mark)] == [first.pid] or over())
            first.send_signal(signal.SIGCONT)
        if fault.outside:
            fault.outside(self.trials.cluster, self.rng, over)
        wrong, codes, said = [], [], ""
        self.codes = codes
        for process, name in zip(processes, ("first", "second"), strict=False):
            code, words = self.end(process, name)
            codes.append(code)
            if fault.any_time and met_python(code, words, fault.any_time):
                return self.leftovers()
            said += words
            if BUG.search(words):
                wrong.append(f"it said {words}")
        right = (0, *fault.codes) if self.fired else (0,)
        if any(code not in right for code in codes) or (
            fault.twice and not more and sorted(codes) != [0, 2]
        ):
            wrong.append(f"exit code {', '.join(map(str, codes))}: {said}")
        if any(code > 0 for code in codes) and not re.search(fault.said, said):
            wrong.append(f"it said nothing like {fault.said!r} but {said!r}")
        if fault.ends_surely and self.fired and self.early and 0 in codes:
            wrong.append("the signal was lost: the command went on to its end")
        told = FAILED.search(said) and re.search(fault.said, said)  # a study has all its rows
        if 0 in codes and not (fault.twice or told) and self.results() != self.expected:
            wrong.append(f"it succeeded with {self.differing()}")
        return wrong + (self.leftovers() if -signal.SIGKILL not in codes else self.running())

    def killed_before(self, plan):
        """Kill the command at the drawn moment, so that the next one resumes it."""
        plan = plan["TWINCT_TRIAL"].replace("|none|", "|signals|9")
        self.end(self.start("killed", {"TWINCT_TRIAL": plan}), "killed")
        (self.place / "fired").unlink(missing_ok=True)
        self.running()

    def gone_on(self):
        """Continue or repeat the command without a fault; return what went wrong."""
        before = {p: p.stat().st_mtime_ns for p in self.kept()}
        code, said = self.end(self.start("again", {}, self.command.again), "again")
        wrong = [] if code == 0 else [f"again, exit code {code}: {said}"]
        after = {p: p.stat().st_mtime_ns for p in self.kept()}
        wrong += [f"{p.name} was made again" for p in before if after.get(p) != before[p]]
        if self.results() != self.expected:
            wrong.append(f"again, it ended with {self.differing()}")
        return wrong + self.leftovers()

    def kept(self):
        """Return the complete files that must not be made again."""
        files = {p for pattern in self.command.kept for p in self.out.glob(pattern)}
        return sorted(p for p in files if not is_draft(p))

    def differing(self):
        """Return the names of results that differ from those of an undisturbed command."""
        now = self.results()
        names = sorted(n for n in now.keys() | self.expected if now.get(n) != self.expected.get(n))
        return f"{len(names)} other files: {', '.join(names[:4])}"

    def start(self, name, changes, more=(), *, disturbed=False):
        """Start the command with its words into files; ``disturbed`` by what is there all along."""
        words = self.wrapped([*self.trials.line(self.command, self.out), *more])
        log, own = self.place / "beside.log", environment(self.domain)
        self.beside = self.trials.beside(self.command, self.out, own, log, self.wrapped)
        own = {MARK: self.mark, "TMPDIR": str(self.temporary), **self.domain}
        unread = disturbed and self.fault.unread
        with (self.place / f"{name}.err").open("wb") as told, contextlib.ExitStack() as stack:
            out = stack.enter_context((self.place / f"{name}.out").open("wb"))
            if unread:
                read, write = os.pipe()
                os.close(read)
                out = stack.enter_context(os.fdopen(write, "wb"))
            return subprocess.Popen(
                words,
                env=environment(changes | own),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=told,
                preexec_fn=(lambda: self.fault.limit(self.rng)) if disturbed else None,
            )

    def wrapped(self, words):
        """Return a command line whose processes see the trial's shared memory."""
        return with_shared_memory(self.shared, words) if self.trials.can_mount else words

    def end(self, process, name):
        """Wait for a process, and end the one beside it; return its exit code and its message."""
        try:
            code = process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait(), f"hung for {PATIENCE_S:.0f} s"
        finally:
            if self.beside:
                self.wrong_beside += self.beside.end()
        return code, (self.place / f"{name}.err").read_text(errors="replace")

    def running(self):
        """Return the processes that outlive the command by too long."""
        cluster = self.trials.cluster

        def there():
            return alive(self.mark) | (cluster.workers() if cluster else {})

        until(lambda: not there(), TO_END_S)
        if self.fault.kind and self.fired and self.gone_s is None:
            self.gone_s = time.time() - (self.place / "fired").stat().st_mtime
        return [f"left running: {words}" for words in there().values()]

    def leftovers(self):
        """Return what is left of a command that had the time to clean up."""
        drafts = [
            str(path.relative_to(self.out))
            for path in self.out.rglob("*")
            if DRAFT.search(path.name) and not is_begun_scan(path)
        ]
        beside = [p.name for p in self.out.parent.iterdir() if p != self.out]
        temporary = [p.name for p in self.temporary.iterdir()] if not self.killed else []
        left = [*drafts, *beside, *temporary]
        return self.running() + ([f"left behind: {', '.join(left)}"] if left else [])

    @property
    def killed(self):
        """True if processes were killed, whose temporary files nobody can remove."""
        return self.fault.kind == "signals" and self.fault.codes in ((-9,), (1,), (0,))
