"""What scripts that start clusters share: processes by name, free ports, a NATS server, a scene."""

import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

FPS = 30


def nats_program():
    """Path of the NATS server, or None."""
    own = Path(__file__).resolve().parent.parent / "target/nats/usr/sbin/nats-server"
    for name in ("nats-server", "/usr/sbin/nats-server", str(own)):
        found = shutil.which(name)
        if found:
            return found
    return None


def nats_command(folder, port):
    """Command line of a NATS server that keeps its streams in `folder`."""
    program = nats_program()
    if program is None:
        sys.exit("no nats-server here; scripts/setup-nats.sh installs one")
    return [program, "-js", "-sd", str(folder), "-a", "127.0.0.1", "-p", str(port)]


def free_port():
    """A port of the loopback address that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wall_ply(side, wave=0.2, blue=90):
    """A wavy wall of `side` × `side` coloured points, as PLY text."""
    lines = [
        "ply", "format ascii 1.0", f"element vertex {side * side}",
        "property float x", "property float y", "property float z",
        "property uchar red", "property uchar green", "property uchar blue", "end_header",
    ]
    for row in range(side):
        for column in range(side):
            x, y = (2 * column / (side - 1) - 1, 2 * row / (side - 1) - 1)
            z = wave * math.sin(5 * x) * math.cos(4 * y)
            lines.append(f"{x:.5f} {y:.5f} {z:.5f} {255 * column // side} {255 * row // side} {blue}")
    return "\n".join(lines) + "\n"


def write_wall(root, frames, points):
    """Writes the scene `wall` into `root`: a wavy wall of points, and a path `fly` of so many frames around it."""
    (root / "wall.ply").write_text(wall_ply(int(math.sqrt(points))))
    end = (frames - 1) / FPS
    keys = [
        {"t": 0, "eye": [0, 0, 3], "target": [0, 0, 0]},
        {"t": end / 2, "eye": [2, 1, 2], "target": [0, 0, 0]},
        {"t": end, "eye": [-2, 0.5, 2], "target": [0, 0, 0]},
    ]
    scene = {
        "pointillist": 1, "name": "wall", "assets": {"w": {"file": "wall.ply"}},
        "nodes": [{"asset": "w"}], "paths": {"fly": {"fps": FPS, "keys": keys}},
    }
    (root / "wall.json").write_text(json.dumps(scene))


class Processes:
    """Processes by name. Each has its log in `folder`, and can be killed and started again."""

    def __init__(self, folder):
        self.folder = folder
        self.processes = {}

    def spawn(self, name, command, **environment):
        with open(self.folder / f"{name}.log", "ab") as log:
            self.processes[name] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                env=dict(os.environ, TMPDIR=str(self.folder), **environment),
            )

    def end(self, name, how=signal.SIGTERM, patience=None):
        """Sends a signal, waits for the end, and returns the exit status. After `patience` seconds the process is killed."""
        process = self.processes.pop(name)
        process.send_signal(how)
        try:
            return process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return None

    def end_all(self):
        for name in list(self.processes):
            self.end(name, signal.SIGKILL)

    def tails(self, characters=3000):
        """The ends of all logs, for people."""
        return "\n".join(
            f"--- {log.name}\n{log.read_text(errors='replace')[-characters:]}" for log in sorted(self.folder.glob("*.log"))
        )
