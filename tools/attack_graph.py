"""Attack running scans from a foreign ROS 2 node; no wrong data may reach the store.

python tools/attack_graph.py --attacks 200 --seed 1
python tools/attack_graph.py --attacks 12 --engines real

The scans run over ROS 2 with tiny engines (``--engines real``: MuJoCo and gVXR). The attacker is a
second process in the same domain that knows the stamps of all targets and answers in advance. It
attacks in twenty ways for three views each, in random order: forged answers, wrong shapes, NaN,
other types on the same topics, floods, repeated, early, late and changed targets, forged plans,
clocks and refusals, service calls, and readers that take no messages. In every second scan it bears
the name of one of the scan's own nodes. The store must equal an undisturbed store in files and
bytes, or the scan must end with a message that names the stranger. A stranger that answers must be
named once per topic. The exit code is 1 otherwise.
"""

import argparse
import json
import logging
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path

from attacker import ANSWERS, KINDS, OWN_NAMES, Attacker
from store_damages import contents

from twinct.core.errors import TwinctError
from twinct.link import Domain, RosRig
from twinct.link.rig import NODE_COMMAND
from twinct.link.stamps import Epoch
from twinct.runs import acquire_to_store
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario, stage_digests

ROOT = Path(__file__).parents[1]
KEYS = [
    *("detector.columns=32", "detector.rows=24", "detector.pixel_pitch_mm=10"),
    "specimen.parts=[{name: ball, shape: {kind: sphere, radius_mm: 60}, material: bone}]",
]
FAKE_COMMAND = (sys.executable, str(ROOT / "tests" / "link" / "fake_node.py"))
ANSWER_S = 120.0
VIEWS_AN_ATTACK = 3


class Log(logging.Handler):
    """Collect the log messages about strangers."""

    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        """See ``logging.Handler``."""
        if "not part of this scan" in record.getMessage():
            self.lines.append(record.getMessage())


def scan(scenario, path, command, domain=None, before=None):
    """Run a scan into a store; call ``before(view)`` before each view is requested."""

    def rigs(builder, first, state):
        rig = RosRig(
            scenario,
            plan=builder.plan if command == NODE_COMMAND else None,
            first_view=first,
            start_state=state,
            node_command=command,
            answer_s=ANSWER_S,
            domain=domain,
        )
        move = rig.move

        def attacked(view, target):
            if before is not None:
                before(view)
            return move(view, target)

        rig.move = attacked if before else move
        return rig

    return acquire_to_store(SimulationBuilder(scenario), path, rigs, resume=False)


class Attacked:
    """A scan under attack.

    Attributes:
        ended: outcome of the scan, such as "equal".
        faults: descriptions of all faults.
        done: first attacked view of each attack that began.
    """

    def __init__(self, name, seed, kinds, every, scenario, folder, command, store):
        self.domain, self.log, self.done, self.faults = Domain(), Log(), {}, []
        self.kinds, self.every = list(kinds), every
        taken_s = store.readings(0, store.views).simulated_s - 1 / 300
        self.told = {
            "name": name,
            "seed": seed,
            "domain": self.domain.id,
            "scenario": json.loads(scenario.resolved()),
            "epoch": str(Epoch.of(stage_digests(scenario)["images"])),
            "targets": [t.sevens[0] for t in SimulationBuilder(scenario).targets],
            "taken_s": taken_s.tolist(),
        }
        self.stranger = None
        logger = logging.getLogger("twinct")
        logger.addHandler(self.log)
        path = folder / "scan.zarr"
        try:
            scan(scenario, path, command, self.domain, self.before)
            self.ended = "equal"
        except TwinctError as error:
            self.ended = "ended, named" if "not part of this scan" in str(error) else "ended"
            if self.ended == "ended":
                self.faults.append(f"ended without the stranger's name: {error}")
        except Exception as error:
            self.ended = "crashed"
            self.faults.append(repr(error))
        finally:
            logger.removeHandler(self.log)
            if self.stranger is not None:
                if self.stranger.poll() is not None:
                    self.faults.append(f"the attacker ended with {self.stranger.returncode}")
                self.stranger.kill()
                self.stranger.communicate()
        self.judge(path, store.path)

    def before(self, view):
        """Start the next attack if it is due."""
        if view % self.every or view // self.every >= len(self.kinds):
            return
        if self.stranger is None:
            self.stranger = subprocess.Popen(
                [sys.executable, __file__, "--attacker", json.dumps(self.told)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            self.heard("here")
        kind = self.kinds[view // self.every]
        self.done[kind] = view
        assert self.stranger.stdin is not None
        self.stranger.stdin.write(f"{kind}:{view}\n")
        self.stranger.stdin.flush()
        self.heard("begun")

    def heard(self, word):
        """Raise RuntimeError unless the attacker's next line equals a word."""
        assert self.stranger is not None and self.stranger.stdout is not None
        line = self.stranger.stdout.readline().strip()
        if line != word:
            raise RuntimeError(f"the attacker said {line!r}")

    def judge(self, path, whole):
        """Compare the store and the log with those of an undisturbed scan."""
        expected, found = contents(whole), contents(path) if path.exists() else {}
        if self.ended == "equal" and found != expected:
            names = [n for n in expected.keys() | found.keys() if expected.get(n) != found.get(n)]
            self.faults.append(f"the store differs: {sorted(names)[:5]}")
        chunks = {n: data for n, data in found.items() if "/c." in n}
        if wrong := [n for n, data in chunks.items() if expected.get(n) != data]:
            self.faults.append(f"wrong data stored: {wrong[:5]}")
        lines = self.log.lines
        if len(lines) != len(set(lines)):
            self.faults.append("named more than once")
        if "forged answers" in self.done:
            for topic in ANSWERS:
                if not any(f"on {topic.name}:" in line for line in lines):
                    self.faults.append(f"the sender on {topic.name} was not named")


def main():
    """Run the attacks and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--attacks", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--engines", choices=("tiny", "real"), default="tiny")
    parser.add_argument("--attacker", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.attacker:
        Attacker(json.loads(options.attacker)).run()
        return 0
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    real = options.engines == "real"
    command = NODE_COMMAND if real else FAKE_COMMAND
    views = VIEWS_AN_ATTACK * len(options.kinds) + 2
    keys = [*KEYS, f"trajectory.views={views}"]
    scenario = load_scenario(ROOT / "scenarios" / "demo.yaml", keys)
    bad, total, number = 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        store = scan(scenario, Path(folder) / "whole.zarr", command)
        print("scan  stranger's name   attacks  ended         named on  faults")
        while total < options.attacks:  # a scan that ends early omits some attacks
            rng = random.Random(f"{options.seed} {number}")
            kinds = rng.sample(options.kinds, len(options.kinds))[: options.attacks - total]
            name = rng.choice(OWN_NAMES) if number % 2 else "stranger"
            with tempfile.TemporaryDirectory(dir=folder) as place:
                told = f"{options.seed} {number}", kinds, VIEWS_AN_ATTACK, scenario, Path(place)
                attacked = Attacked(name, *told, command, store)
            total += len(attacked.done)
            if not attacked.done:
                raise SystemExit(f"no attack began: {attacked.faults}")
            bad += bool(attacked.faults)
            topics = f"{len(attacked.log.lines)} topics"
            faults = "; ".join(attacked.faults) or "none"
            done = len(attacked.done)
            print(
                f"{number:4}  {name:16}  {done:7}  {attacked.ended:12}  {topics:8}  {faults}",
                flush=True,
            )
            for line in attacked.log.lines if attacked.faults else ():
                print(line, file=sys.stderr)
            if attacked.faults:
                print(f"attacks and first views: {attacked.done}", file=sys.stderr)
            number += 1
    print(f"{total} attacks of {len(options.kinds)} kinds")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
