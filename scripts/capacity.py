#!/usr/bin/env python3
"""Measures on this machine what the simulation of benches/capacity.rs starts from, and what it is compared with.

    scripts/capacity.py --program target/release/pointillist -o benches/capacity/measured.json

It measures the broker's CPU time for each kind of message, the time of each operation of a store that is a folder, films of one to three
workers, requests on 1 to 64 connections, and a daemon's memory with idle connections. All processes share this machine's cores, with
whatever else runs there. Each point therefore has the CPU time of every process, and of all others together. Needs nats-server
(scripts/setup-nats.sh).
"""

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timezone
from pathlib import Path

import cluster as real

def cpu_s(process):
    """CPU time of a process so far, in seconds."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def machine_cpu_s():
    """CPU time of all processes of the machine so far, in seconds."""
    fields = [int(field) for field in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
    user, nice, system, _, _, irq, softirq, _ = fields
    return (user + nice + system + irq + softirq) / os.sysconf("SC_CLK_TCK")


class Meter:
    """Elapsed time and CPU time from its making to `read`."""

    def __init__(self, cluster):
        self.cluster = cluster
        self.before = {name: cpu_s(process) for name, process in cluster.processes.items()}
        self.machine, self.began = machine_cpu_s(), time.monotonic()

    def read(self, generator_s=0.0):
        seconds = time.monotonic() - self.began
        used = {"broker": 0.0, "daemon": 0.0, "worker": 0.0, "generator": generator_s}
        for name, process in self.cluster.processes.items():
            # Requests are measured with a daemon that has no jobs.
            role = "daemon" if name == "clients" else name.partition("-")[0]
            used[role] += cpu_s(process) - self.before[name]
        others = machine_cpu_s() - self.machine - sum(used.values())
        return {"seconds": seconds, "others_cores": max(0.0, others / seconds)} | {f"{name}_cpu_s": s for name, s in used.items()}


def film_points(options, cluster):
    """Films of one, two and three workers in turns."""
    points = []
    for name in ["broker", "daemon"]:
        cluster.start(name)
    cluster.ready()
    for _ in range(options.rounds):
        for workers in range(1, options.workers + 1):
            cluster.start(f"worker-{workers}")
            # The first film builds pipelines and loads the scene in the new worker.
            cluster.finish(cluster.order())
            meter = Meter(cluster)
            job = cluster.order()
            frames = len(cluster.finish(job))
            point = {"workers": workers, "frames": frames} | meter.read()
            images = [len(cluster.ask(f"/v1/jobs/{job}/frames/{frame}")) for frame in range(0, frames, 10)]
            point["image_bytes"] = int(statistics.mean(images))
            print(point, file=sys.stderr)
            points.append(point)
        for workers in range(1, options.workers + 1):
            cluster.end(f"worker-{workers}")
    cluster.end("daemon")
    cluster.end("broker")
    return points


def client_points(options, cluster):
    """Requests on one, eight and 64 connections in turns: each asks for the next frame as soon as it has one."""
    points = []
    cluster.start("clients")
    cluster.ready()
    for _ in range(options.rounds):
        for clients in (1, 8, 64):
            command = [
                options.program, "load", f"http://127.0.0.1:{cluster.http_port}", "--scene", "wall", "--size", options.client_size,
                "--connections", str(clients), "--rate", "2000", "--spacing", "constant", "--duration", "6", "--warmup", "2", "--json",
            ]
            before = os.times()
            meter = Meter(cluster)
            report = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
            after = os.times()
            used = after.children_user + after.children_system - before.children_user - before.children_system
            found = report["points"][0]
            point = {"clients": clients, "throughput_per_s": found["throughput_per_s"], "service": found["service"],
                     "receipts": found["receipts"]} | meter.read(used)
            print(point, file=sys.stderr)
            points.append(point)
    cluster.end("clients")
    return points


class Nats:
    """A connection that speaks the NATS protocol and sends messages in blocks."""

    def __init__(self, port):
        self.link = socket.create_connection(("127.0.0.1", port))
        self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.replies = self.link.makefile("rb")
        self.replies.readline()
        self.link.sendall(b'CONNECT {"verbose":false,"headers":true}\r\nSUB _INBOX.m.* 1\r\n')
        self.settle()

    def send(self, subject, payload=b"", reply="", msg_id=None):
        if msg_id is None:
            return f"PUB {subject} {reply} {len(payload)}\r\n".encode() + payload + b"\r\n"
        headers = f"NATS/1.0\r\nNats-Msg-Id: {msg_id}\r\n\r\n".encode()
        sizes = f"{len(headers)} {len(headers) + len(payload)}"
        return f"HPUB {subject} {reply} {sizes}\r\n".encode() + headers + payload + b"\r\n"

    def message(self):
        """The next message: its subject to reply to, its payload."""
        while True:
            head = self.replies.readline().split()
            if head and head[0] in (b"MSG", b"HMSG"):
                body = self.replies.read(int(head[-1]) + 2)[:-2]
                if head[0] == b"HMSG":
                    body = body[int(head[-2]):]
                has_reply = len(head) == (5 if head[0] == b"MSG" else 6)
                return (head[3].decode() if has_reply else ""), body

    def settle(self):
        self.link.sendall(b"PING\r\n")
        while self.replies.readline() != b"PONG\r\n":
            pass

    def ask(self, subject, body):
        self.link.sendall(self.send(subject, json.dumps(body).encode(), "_INBOX.m.ask"))
        reply = json.loads(self.message()[1])
        if "error" in reply:
            sys.exit(f"capacity: the broker refuses {subject}: {reply['error']}")
        return reply


BLOCK = 50


def broker_costs(cluster, count=4000):
    """CPU time of the broker for each kind of message, in microseconds. The stream has the settings of src/farm/broker.rs."""
    cluster.start("broker")
    while True:
        try:
            nats = Nats(cluster.nats_port)
            break
        except OSError:
            time.sleep(0.05)
    nats.ask("$JS.API.STREAM.CREATE.M", {
        "name": "M", "subjects": ["m.runs.>"], "retention": "workqueue", "storage": "file", "duplicate_window": 120_000_000_000,
        "max_age": 14 * 24 * 3600 * 10**9, "max_consumers": -1, "max_msgs": -1, "max_bytes": -1, "num_replicas": 1, "discard": "old",
    })
    nats.ask("$JS.API.CONSUMER.DURABLE.CREATE.M.c", {"stream_name": "M", "config": {
        "durable_name": "c", "filter_subject": "m.runs.k.>", "ack_policy": "explicit", "ack_wait": 5_000_000_000, "max_deliver": -1,
        "max_ack_pending": 20_000, "deliver_policy": "all", "replay_policy": "instant",
    }})
    costs = {}

    def measure(name, block, total=count):
        """`block(first)` sends messages from number `first` and takes every answer."""
        before = cpu_s(cluster.processes["broker"])
        for first in range(0, total, BLOCK):
            block(first)
        nats.settle()
        costs[name] = (cpu_s(cluster.processes["broker"]) - before) / total * 1e6
        print(name, costs[name], file=sys.stderr)

    def publish(size, name):
        def block(first):
            messages = [nats.send("m.runs.k.f", b"x" * size, "_INBOX.m.p", f"{name}-{first + i}") for i in range(BLOCK)]
            nats.link.sendall(b"".join(messages))
            for _ in messages:
                nats.message()
        return block

    answers = []

    def pull(_):
        ask = json.dumps({"batch": 1, "expires": 4_000_000_000}).encode()
        nats.link.sendall(b"".join(nats.send("$JS.API.CONSUMER.MSG.NEXT.M.c", ask, "_INBOX.m.q") for _ in range(BLOCK)))
        answers[:] = [nats.message()[0] for _ in range(BLOCK)]

    def ack():
        nats.link.sendall(b"".join(nats.send(subject, b"+ACK", "_INBOX.m.a") for subject in answers))
        for _ in answers:
            nats.message()

    measure("publish_small_us", publish(200, "s"))
    measure("publish_10_kb_us", publish(10_000, "l"))

    def pull_and_ack(first):
        pull(first)
        ack()

    # Half of the messages are small, half are large, as they were queued.
    measure("pull_and_ack_small_us", pull_and_ack)
    measure("pull_and_ack_10_kb_us", pull_and_ack, count - BLOCK)
    pull(0)

    def progress(_):
        nats.link.sendall(nats.send(answers[0], b"+WPI") * BLOCK)

    measure("progress_us", progress, 20 * count)
    ack()

    def note(_):
        nats.link.sendall(nats.send("_INBOX.m.note", b'{"drawn":{"run":12345,"frame":123456}}') * BLOCK)
        for _ in range(BLOCK):
            nats.message()

    measure("note_us", note, 20 * count)
    trips = []
    for number in range(500):
        began = time.perf_counter()
        nats.link.sendall(nats.send("m.runs.k.f", b"x" * 200, "_INBOX.m.p", f"trip-{number}"))
        nats.message()
        trips.append((time.perf_counter() - began) * 1e6)
    costs["publish_round_trip_us"] = statistics.median(trips)
    cluster.end("broker")
    return costs


LARGE_BYTES = 2_000_000


def store_costs(folder, size, rounds=5, count=400):
    """Median time of the file operations behind each operation of the store, in microseconds; the median of several rounds."""
    folder = folder / "files"
    folder.mkdir()
    times = {}

    def put(number, image):
        fresh, name = folder / f"{number}#1", folder / str(number)
        with open(fresh, "xb") as file:
            file.write(image)
        os.rename(fresh, name)

    def get(number, _):
        with open(folder / str(number), "rb") as file:
            os.fstat(file.fileno())
            file.read()

    def head(number, _):
        os.stat(folder / str(number))

    for _ in range(rounds):
        for image, suffix, most in ((os.urandom(size), "us", count), (os.urandom(LARGE_BYTES), "2_mb_us", count // 20)):
            for name, operation in (("put", put), ("get", get), ("head", head)):
                found = []
                for number in range(most):
                    began = time.perf_counter()
                    operation(number, image)
                    found.append((time.perf_counter() - began) * 1e6)
                times.setdefault(f"{name}_{suffix}", []).append(statistics.median(found))
    return {"image_bytes": size} | {name: statistics.median(found) for name, found in times.items()}


def idle_memory(cluster, connections=800):
    """Memory of a daemon for each idle connection over which a frame was asked for, in KiB."""
    cluster.start("clients")
    cluster.ready()

    def resident_kib():
        status = Path(f"/proc/{cluster.processes['clients'].pid}/status").read_text()
        return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])

    ask = b"GET /v1/scenes/wall/frame?w=32&h=32 HTTP/1.1\r\nHost: localhost\r\n\r\n"
    links = []

    def connect(count):
        for _ in range(count):
            link = socket.create_connection(("127.0.0.1", cluster.http_port))
            link.sendall(ask)
            link.recv(1 << 16)
            links.append(link)

    connect(100)
    before = resident_kib()
    connect(connections)
    after = resident_kib()
    cluster.end("clients")
    return (after - before) / connections


class Cluster(real.Cluster):
    def job(self, number):
        # Fewer questions than in the tests, because they cost the daemon time as well.
        time.sleep(0.1)
        return super().job(number)

    def command(self, name):
        command = super().command("alone" if name == "clients" else name)
        if name == "clients":
            at = command.index("--state")
            return command[:at] + ["--no-jobs"]
        return command


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/release/pointillist")
    parser.add_argument("--build", default="release", help="kind of the program's build, for the record")
    parser.add_argument("-o", "--out", required=True)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--size", default="480x360", help="of frames of films")
    parser.add_argument("--client-size", default="320x240", help="of frames of requests")
    parser.add_argument("--points", type=int, default=40_000)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    options.program = str(Path(options.program).resolve())
    with tempfile.TemporaryDirectory(prefix="pointillist-capacity-") as folder:
        cluster = Cluster(options, Path(folder))
        try:
            measured = {
                "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"), "build": options.build, "cores": os.cpu_count(),
                "cpu": next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "unknown"),
                "film_size": options.size, "client_size": options.client_size, "points_of_scene": options.points,
                "broker": broker_costs(cluster), "idle_connection_kib": idle_memory(cluster),
                "films": film_points(options, cluster), "clients": client_points(options, cluster),
            }
            measured["store"] = store_costs(Path(folder), measured["films"][0]["image_bytes"])
        finally:
            cluster.end_all()
    Path(options.out).write_text(json.dumps(measured, indent=1) + "\n")


if __name__ == "__main__":
    main()
