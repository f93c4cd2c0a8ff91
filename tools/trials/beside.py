"""Commands that run beside one under trial, such as the controller of the arms that it drives."""

import contextlib
import os
import signal
import subprocess

from processes import PATIENCE_S


@contextlib.contextmanager
def domain(command):
    """Yield the environment of a command and the one beside it: a ROS domain of their own."""
    if not command.beside:
        yield {}
        return
    from twinct.link.environment import Domain

    with contextlib.closing(Domain()) as held:
        yield {"ROS_DOMAIN_ID": str(held.id)}


class Beside:
    """A process beside a command."""

    CODES = 0, 128 + signal.SIGTERM, -signal.SIGTERM
    """Exit codes, while it works and while it starts."""

    def __init__(self, words, environment, log):
        """Start it, with what it says in a file."""
        self.log = log
        with log.open("wb") as told:
            self.process = subprocess.Popen(
                words, env=environment, stdin=subprocess.DEVNULL, stdout=told, stderr=told
            )

    def end(self):
        """End it with SIGTERM; return what went wrong."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process.pid, signal.SIGTERM)
        try:
            code = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            return [f"the process beside it hung for {PATIENCE_S:.0f} s"]
        said = self.log.read_text(errors="replace")
        return [] if code in self.CODES else [f"the process beside it ended with {code}: {said}"]

    def kill(self):
        """End it at once, if it is there."""
        self.process.kill()
        self.process.wait()
