#!/usr/bin/env python3
"""Runs a small cluster on this machine: a NATS server, a daemon and workers.

    scripts/cluster.py kills --program target/release/pointillist    # a film that survives random kills
    scripts/cluster.py speed --program target/release/pointillist    # three workers against one process
    scripts/cluster.py memory --program target/release/pointillist   # a worker's memory over an hour of films

`kills` draws a film with one process and with three workers, kills workers, daemon and broker at random moments
meanwhile, and compares the checksum of every frame. `speed` compares the times, and measures the broker's round trip.
`memory` draws films one after the other, and measures the memory of the worker and of the daemon after each.
Exit status 1 if frames differ or a limit is missed. Needs nats-server (scripts/setup-nats.sh).
"""

import argparse
import hashlib
import json
import random
import signal
import socket
import statistics
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

from processes import Processes, free_port, nats_command, write_wall
from soaking.machines import Memory


class Cluster(Processes):
    """The processes of a cluster."""

    def __init__(self, options, folder):
        super().__init__(folder)
        self.options = options
        self.root = folder / "root"
        self.root.mkdir()
        write_wall(self.root, options.frames, options.points)
        self.nats_port, self.http_port = free_port(), free_port()
        self.shared = ["--nats", f"nats://127.0.0.1:{self.nats_port}", "--store", str(folder / "store")]

    def command(self, name):
        program = self.options.program
        serve = [program, "serve", "--listen", f"127.0.0.1:{self.http_port}", "--root", str(self.root), "--no-cache"]
        if name == "broker":
            return nats_command(self.folder / "nats", self.nats_port)
        if name == "alone":
            return serve + ["--state", str(self.folder / "state-alone")]
        if name == "daemon":
            return serve + ["--state", str(self.folder / "state")] + self.shared
        return [program, "worker", "--no-cache"] + self.shared

    def start(self, name):
        self.spawn(name, self.command(name))

    def ask(self, path, body=None, method=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"http://127.0.0.1:{self.http_port}{path}", data, method=method)
        request.add_header("Content-Type", "application/json")
        try:
            with urllib.request.urlopen(request, timeout=30) as reply:
                return reply.read()
        except urllib.error.HTTPError as error:
            # The scene may still be loading.
            if error.code in (404, 409, 503):
                raise
            sys.exit(f"cluster: {path}: {error.code} {error.read().decode()}")

    def ready(self):
        until = time.monotonic() + 120
        while True:
            try:
                self.ask("/v1/scenes/wall/frame?w=16&h=16")
                return
            except OSError:
                pass
            if time.monotonic() > until:
                sys.exit(f"cluster: the daemon does not answer; its log is in {self.folder}")
            time.sleep(0.05)

    def begin(self, workers):
        """Starts everything, and waits until the daemon draws frames."""
        for name in ["broker", "daemon", *workers]:
            self.start(name)
        self.ready()

    def order(self):
        width, height = self.options.size.split("x")
        body = {"scene": "wall", "path": "fly", "w": int(width), "h": int(height)}
        return json.loads(self.ask("/v1/jobs", body))["id"]

    def job(self, number):
        """The job's state, or None while the daemon is not there."""
        try:
            return json.loads(self.ask(f"/v1/jobs/{number}"))
        except OSError:
            return None

    def finish(self, number, at_each_look=lambda job: None):
        """Waits for a job's end, and returns its frames' checksums."""
        while True:
            job = self.job(number)
            if job and job["state"] not in ("queued", "running"):
                break
            at_each_look(job)
            time.sleep(0.02)
        if job["state"] != "done":
            sys.exit(f"cluster: the job is {job['state']}: {job['error']}")
        lines = self.ask(f"/v1/jobs/{number}/frames").decode().splitlines()[1:]
        return {record["frame"]: record["sha256"] for record in map(json.loads, lines)}

    def check(self, number, sums):
        """Compares the frames that the daemon serves with their checksums."""
        for frame, expected in sums.items():
            found = hashlib.sha256(self.ask(f"/v1/jobs/{number}/frames/{frame}")).hexdigest()
            if found != expected:
                sys.exit(f"cluster: frame {frame} is damaged")


def sum_of(sums):
    return hashlib.sha256(json.dumps(sorted(sums.items())).encode()).hexdigest()


def alone(cluster):
    """The film as one process draws it: checksums and seconds."""
    cluster.start("alone")
    cluster.ready()
    # The first film builds pipelines.
    cluster.finish(cluster.order())
    began = time.monotonic()
    sums = cluster.finish(cluster.order())
    seconds = time.monotonic() - began
    cluster.end("alone")
    return sums, seconds


def kills(options, cluster):
    expected, seconds = alone(cluster)
    print(f"one process: {len(expected)} frames in {seconds:.1f} s, checksum {sum_of(expected)}")
    chance = random.Random(options.seed)
    workers = [f"worker-{number}" for number in range(options.workers)]
    cluster.begin(workers)
    number = cluster.order()
    # Kills are spread over the film: each happens when so many frames are there.
    due = sorted(chance.randrange(1, options.frames - 1) for _ in range(options.kills))
    victims = [chance.choice(["broker", "daemon", *workers]) for _ in due]
    done = []

    def kill(job):
        while job and len(done) < len(due) and job["frames"]["done"] >= due[len(done)]:
            victim = victims[len(done)]
            print(f"  frame {job['frames']['done']}: kill -9 of {victim}")
            cluster.end(victim, signal.SIGKILL)
            cluster.start(victim)
            done.append(victim)
            if victim == "daemon":
                return

    began = time.monotonic()
    found = cluster.finish(number, kill)
    seconds = time.monotonic() - began
    cluster.check(number, found)
    print(f"{options.workers} workers, {len(done)} kills: {len(found)} frames in {seconds:.1f} s, checksum {sum_of(found)}")
    if found != expected:
        sys.exit("cluster: the frames differ")
    if len(done) < options.kills:
        sys.exit(f"cluster: only {len(done)} of {options.kills} kills happened before the film was over; draw larger frames")
    print("cluster: every checksum is the same")


def round_trips(cluster, count=500):
    """Milliseconds from a message of the work queue to the broker's word that it is stored."""
    with socket.create_connection(("127.0.0.1", cluster.nats_port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        replies = link.makefile("rb")
        replies.readline()
        link.sendall(b'CONNECT {"verbose":false}\r\nSUB _INBOX.speed 1\r\nPING\r\n')
        while replies.readline() != b"PONG\r\n":
            pass
        # No worker is of this kind.
        message = b"PUB pointillist.runs.nobody.speed _INBOX.speed 200\r\n" + b"x" * 200 + b"\r\n"
        times = []
        for _ in range(count):
            began = time.perf_counter()
            link.sendall(message)
            head = replies.readline().split()
            while head[0] != b"MSG":
                head = replies.readline().split()
            reply = replies.read(int(head[-1]) + 2)
            times.append((time.perf_counter() - began) * 1e3)
            if b"error" in reply:
                sys.exit(f"cluster: the broker refuses: {reply.decode()}")
        return times


def speed(options, cluster):
    expected, single = alone(cluster)
    cluster.begin([f"worker-{number}" for number in range(options.workers)])
    # As with one process, the first film builds pipelines in every worker.
    cluster.finish(cluster.order())
    began = time.monotonic()
    found = cluster.finish(cluster.order())
    together = time.monotonic() - began
    trips = round_trips(cluster)
    trip = statistics.median(trips)
    ratio = together / single
    print(f"one process      {single:7.2f} s  {len(expected)} frames of {options.size}")
    print(f"{options.workers} workers        {together:7.2f} s  ratio {ratio:.3f}, limit {options.limit}")
    print(f"broker           {trip:7.3f} ms median round trip of {len(trips)}, limit 2")
    if found != expected:
        sys.exit("cluster: the frames differ")
    if ratio > options.limit or trip >= 2:
        sys.exit("cluster: a limit is missed")


def memory(options, cluster):
    cluster.begin(["worker"])
    measured, faults = Memory(), []
    began = time.monotonic()
    films = 0
    while time.monotonic() - began < 60 * options.minutes:
        number = cluster.order()
        cluster.check(number, cluster.finish(number))
        cluster.ask(f"/v1/jobs/{number}", method="DELETE")
        films += 1
        measured.sample(cluster)
    print(f"{films} films of {options.frames} frames of {options.size} in {(time.monotonic() - began) / 60:.0f} min")
    for what, found in measured.judge(lambda kind, text: faults.append(text)):
        print(f"{what}: {found}")
    if faults:
        sys.exit("cluster: " + "; ".join(faults))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["kills", "speed", "memory"])
    parser.add_argument("--program", default="target/release/pointillist")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--size", default="960x720")
    parser.add_argument("--points", type=int, default=250_000)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60, help="how long `memory` draws films")
    parser.add_argument("--limit", type=float, default=1.1, help="of the ratio of times")
    options = parser.parse_args()
    options.program = str(Path(options.program).resolve())
    with tempfile.TemporaryDirectory(prefix="pointillist-cluster-") as folder:
        cluster = Cluster(options, Path(folder))
        try:
            {"kills": kills, "speed": speed, "memory": memory}[options.what](options, cluster)
        except SystemExit:
            print(cluster.tails(), file=sys.stderr)
            raise
        finally:
            cluster.end_all()


if __name__ == "__main__":
    main()
