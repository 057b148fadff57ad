"""Tests the contract against a running daemon, with openapi-spec-validator and schemathesis.

    target/python/bin/python tests/contract/run.py target/debug/pointillist [--seconds N | --cases N] [-- ARGUMENTS OF schemathesis]

Exit status 0 where nothing was found. `scripts/setup-python.sh` makes the environment.
"""

import argparse
import os
import pathlib
import queue
import re
import subprocess
import sys
import tempfile
import threading
import time

import requests
import yaml
from openapi_spec_validator import OpenAPIV31SpecValidator

HERE = pathlib.Path(__file__).resolve().parent
# The path is short, because streaming a film takes as long as the film plays.
SCENE = """{ "pointillist": 1, "name": "grid",
  "assets": { "g": { "file": "grid.ply" } },
  "nodes": [ { "name": "wall", "asset": "g" } ],
  "cameras": { "front": { "eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45 } },
  "paths": { "past": { "fps": 120, "keys": [
    { "t": 1, "eye": [-1, 0, 3], "target": [0, 0, 0] }, { "t": 1.025, "eye": [1, 0, 3], "target": [0, 0, 0] } ] } } }
"""


def wall(side):
    """A wall of side × side coloured points, as PLY."""
    head = "ply\nformat ascii 1.0\nelement vertex %d\n" % (side * side)
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {channel}\n" for channel in ("red", "green", "blue")) + "end_header\n"
    step = 2 / (side - 1)
    rows = (f"{x * step - 1} {y * step - 1} 0 {255 * x // side} {255 * y // side} 90\n" for y in range(side) for x in range(side))
    return head + "".join(rows)


class Daemon:
    """A daemon with one small scene, in a folder of its own."""

    def __init__(self, program, folder):
        root = folder / "root"
        root.mkdir()
        (root / "grid.ply").write_text(wall(24))
        (root / "grid.json").write_text(SCENE)
        self.log = folder / "log"
        environment = {**os.environ, "POINTILLIST_STATE": str(folder / "state"), "POINTILLIST_NO_CACHE": "true"}
        environment.pop("POINTILLIST_CONFIG", None)
        self.process = subprocess.Popen(
            # The limit ends the event streams of jobs that wait behind many others.
            [program, "serve", "--listen", "127.0.0.1:0", "--root", str(root), "--watch-seconds", "2"],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self.log.open("w"),
            text=True,
        )
        lines = queue.Queue()
        threading.Thread(target=lambda: [lines.put(line) for line in self.process.stdout], daemon=True).start()
        self.address = None
        until = time.monotonic() + 120
        while time.monotonic() < until:
            try:
                line = lines.get(timeout=1)
            except queue.Empty:
                if self.process.poll() is not None:
                    break
                continue
            if line.startswith("listening on "):
                self.address = line.split()[-1]
            if line.startswith("curl "):
                return
        self.stop()
        sys.exit(f"the daemon did not start:\n{self.log.read_text()}")

    def stop(self):
        self.process.terminate()
        try:
            return self.process.wait(timeout=60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return None


def make_job(address):
    """A finished job, for the operations on jobs."""
    body = {"scene": "grid", "path": "past", "w": 16, "h": 16}
    requests.post(f"{address}/v1/jobs", json=body, timeout=30).raise_for_status()
    for _ in range(600):
        if requests.get(f"{address}/v1/jobs/1", timeout=30).json()["state"] == "done":
            return
        time.sleep(0.1)
    sys.exit("the job does not end")


def schemathesis(address, folder, options, rest):
    """Runs schemathesis. Returns its exit status and the number of cases."""
    # One worker, because Python 3.11 sometimes fails when two threads parse Python ("AST constructor recursion depth mismatch").
    arguments = ["--url", address, "--no-color", "--output-truncate", "false", "--seed", str(options.seed), "--workers", "1"]
    if options.cases:
        # Ask for more cases per operation than the average needs, because some operations have few.
        arguments += ["--max-examples", str(max(20, options.cases // 20))]
    else:
        arguments += ["--max-examples", "10", "--max-time", str(options.seconds)]
    command = [str(pathlib.Path(sys.executable).parent / "schemathesis"), "--config-file", str(HERE / "schemathesis.toml")]
    command += ["run", str(folder / "openapi.yaml"), *arguments, *rest]
    settings = folder / "settings.json"
    settings.write_bytes(requests.get(f"{address}/v1/settings", timeout=30).content)
    environment = {
        **os.environ,
        "SCHEMATHESIS_HOOKS": str(HERE / "hooks.py"),
        "CONTRACT_SETTINGS": str(settings),
        "CONTRACT_ADDRESS": address,
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    process = subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    cases = 0
    for line in process.stdout:
        print(line, end="", flush=True)
        found = re.search(r"([\d,]+) generated", line)
        cases = int(found[1].replace(",", "")) if found else cases
    return process.wait(), cases


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--seconds", type=int, default=75, help="time for schemathesis")
    parser.add_argument("--cases", type=int, default=0, help="cases to make, however long that takes")
    parser.add_argument("--seed", type=int, default=1)
    options, rest = parser.parse_known_args()
    rest = [argument for argument in rest if argument != "--"]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        daemon = Daemon(str(options.program.resolve()), folder)
        try:
            contract = folder / "openapi.yaml"
            contract.write_bytes(subprocess.run([str(options.program.resolve()), "openapi"], stdout=subprocess.PIPE, check=True).stdout)
            document = yaml.safe_load(contract.read_text())
            faults = [f"{'/'.join(map(str, fault.absolute_path))}: {fault.message}" for fault in OpenAPIV31SpecValidator(document).iter_errors()]
            print(f"openapi-spec-validator: {len(faults)} faults", *faults, sep="\n  ")
            make_job(daemon.address)
            status, cases = schemathesis(daemon.address, folder, options, rest)
            alive = daemon.process.poll() is None
        finally:
            ended = daemon.stop()
        log = daemon.log.read_text()
        internal = [line for line in log.splitlines() if "panicked" in line or "internal error" in line]
        for line in internal[:20]:
            print(f"log: {line}")
        print(f"contract: {cases} cases, status {status}; daemon {'alive' if alive else 'DEAD'}, ended with {ended}, {len(internal)} internal errors")
        is_enough = cases >= options.cases
        sys.exit(0 if not faults and status == 0 and alive and not internal and is_enough else 1)


if __name__ == "__main__":
    main()
