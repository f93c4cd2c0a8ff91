"""Send a signal to commands of twinct at random moments, and count how they end.

    python tools/interrupt.py --tries 40 --seed 5
    python tools/interrupt.py --commands render predict --signal SIGTERM

Each try starts a command on a tiny scenario and sends the signal once, at a moment drawn between
the start of the process and its usual end. The command must end with 128 + the number of the signal
and say "interrupted: ", wherever the signal meets it: also while modules are imported, some of
which catch every exception. A signal before the first line of twinct meets Python alone: tries that
end in that way are counted apart. The exit code is 1 if any other try ends otherwise.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

TINY = {
    "trajectory.views": 6,
    "detector": {"columns": 24, "rows": 16, "pixel_pitch_mm": 14},
    "xray.engine": "mesh",
    "reconstruction.grid": {"voxels": 12, "voxel_mm": 13},
    "reconstruction.iterations": 2,
}
SET = [word for key, value in TINY.items() for word in ("--set", f"{key}={json.dumps(value)}")]
COMMANDS = {
    "run": "run circle_gantry --out NEW --link local SET",
    "render": "render circle_gantry --out NEW.png SET",
    "predict": "predict RUN --as NAME",
    "reconstruct": "reconstruct RUN --set reconstruction.relaxation=RANDOM --as NAME",
}


def words_of(command, folder, number, rng):
    """Return the command line of a command for one try."""
    places = {"NEW": str(folder / f"new{number}"), "RUN": str(folder / "run"), "NAME": f"n{number}"}
    found = [sys.executable, "-m", "twinct"]
    for word in COMMANDS[command].split():
        if word == "SET":
            found += SET
            continue
        for name, place in {**places, "RANDOM": f"{rng.uniform(0.1, 0.9):.6f}"}.items():
            word = word.replace(name, place)
        found.append(word)
    return found


def tried(words, number=None, after_s=0.0):
    """Run a command, with a signal after a time if any; return exit code, stderr and seconds."""
    begun = time.monotonic()
    process = subprocess.Popen(
        words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    if number is not None:
        time.sleep(after_s)
        process.send_signal(number)
    _, told = process.communicate()
    return process.returncode, told, time.monotonic() - begun


def verdict(code, told, number):
    """Return how a try ended: as wanted, too late, before twinct began, or wrong."""
    if code == 128 + number and "twinct: interrupted: " in told:
        return "interrupted"
    if code == 0:
        return "done before"
    if "twinct: " not in told and (not told or "KeyboardInterrupt" in told or code == -number):
        return "before twinct began"
    return "WRONG"


def main():
    """Do all tries, print how they end, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--signal", choices=("SIGINT", "SIGTERM", "SIGHUP"), default="SIGINT")
    parser.add_argument("--tries", type=int, default=40, help="tries of each command")
    parser.add_argument("--seed", type=int, default=1, help="seed of the moments")
    options = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    number, rng, wrong = signal.Signals[options.signal], random.Random(options.seed), 0
    os.environ.setdefault("MUJOCO_GL", "egl")
    with tempfile.TemporaryDirectory(prefix="twinct-interrupt-") as name:
        folder = Path(name)
        made = [sys.executable, "-m", "twinct", "run", "circle_gantry", "--out", name + "/run"]
        subprocess.run([*made, "--link", "local", *SET], check=True, capture_output=True)
        for command in options.commands:
            counts = Counter()
            _, _, whole_s = tried(words_of(command, folder, "whole", rng))
            for one in range(options.tries):
                moment = rng.uniform(0.0, whole_s)
                code, told, _ = tried(words_of(command, folder, one, rng), number, moment)
                ended = verdict(code, told, number)
                counts[ended] += 1
                if ended == "WRONG":
                    print(f"try {one}, after {moment:.2f} s: exit code {code}: {told.strip()}")
            wrong += counts["WRONG"]
            told = ", ".join(f"{counts[ended]} {ended}" for ended in sorted(counts))
            print(f"{command}, {options.signal}, {whole_s:.1f} s: {told}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
