"""Compares the latency of frames with and without HAProxy in front of a daemon, in pairs.

    scripts/compare-proxy.py DAEMON [PAIRS]

Starts one daemon and HAProxy with deploy/haproxy.cfg on free ports, and sends the same requests to both addresses in turns, over
kept-alive connections. The order within a pair is random. Prints a line of medians and percentiles for each kind of request.
Exit status 1 if HAProxy adds 1 ms or more in the median. Frames that are drawn are not judged: their own times vary by more.
"""

import http.client
import os
import random
import re
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
LIMIT_MS = 1.0
CLOUD = (
    "ply\nformat ascii 1.0\nelement vertex 4096\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    + "".join(f"{i % 64 / 32 - 1} {i // 64 / 32 - 1} 0\n" for i in range(4096))
)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(port, what):
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        try:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
            connection.request("GET", "/readyz")
            if connection.getresponse().status == 200:
                return
        except OSError:
            pass
        time.sleep(0.05)
    raise SystemExit(f"{what} does not get ready on port {port}")


def timed(connection, path, headers):
    began = time.perf_counter()
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answer.read()
    elapsed = time.perf_counter() - began
    if answer.status not in (200, 304):
        raise SystemExit(f"{path}: status {answer.status}")
    return elapsed * 1000


def percentile(values, share):
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def main():
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    daemon, pairs = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    path = os.pathsep.join([str(HERE / "target/servers/bin"), os.environ["PATH"], "/usr/sbin"])
    haproxy = shutil.which("haproxy", path=path)
    if haproxy is None:
        raise SystemExit("there is no haproxy: scripts/setup-servers.sh unpacks one")
    children = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "root").mkdir()
        (folder / "root/wall.ply").write_text(CLOUD)
        direct, proxied = free_port(), free_port()
        config = (HERE / "deploy/haproxy.cfg").read_text()
        config = config.replace("bind :80\n", f"bind 127.0.0.1:{proxied}\n")
        config = re.sub(r"127\.0\.0\.1:808\d", f"127.0.0.1:{direct}", config)
        (folder / "haproxy.cfg").write_text(config)
        try:
            serve = [daemon, "serve", "--listen", f"127.0.0.1:{direct}", "--root", str(folder / "root"), "--no-jobs", "--no-cache"]
            children.append(subprocess.Popen(serve, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            wait_for(direct, "the daemon")
            children.append(subprocess.Popen([haproxy, "-db", "-q", "-f", str(folder / "haproxy.cfg")], stderr=subprocess.DEVNULL))
            wait_for(proxied, "HAProxy")
            connections = [http.client.HTTPConnection("127.0.0.1", port) for port in (direct, proxied)]
            frame = "/v1/scenes/wall/frame?w=256&h=256&format=png&eye=0,0,3&target=0,0,0"
            connections[0].request("GET", frame)
            answer = connections[0].getresponse()
            tag = answer.headers["ETag"]
            size = len(answer.read())
            kinds = [
                ("limits", "/v1/limits", {}, pairs, True),
                ("304 of a frame", frame, {"If-None-Match": tag}, pairs, True),
                ("contract", "/openapi.yaml", {}, pairs, True),
                (f"256 x 256 PNG, {size} bytes", frame, {}, max(pairs // 5, 50), False),
            ]
            failed = False
            print("| request | pairs | direct, median ms | HAProxy, median ms | median of differences, ms | 95th percentile, ms |")
            print("|---|---|---|---|---|---|")
            for name, address, headers, count, is_judged in kinds:
                for connection in connections:
                    for _ in range(20):
                        timed(connection, address, headers)
                times = ([], [])
                for pair in range(count):
                    order = (0, 1) if random.Random(pair).random() < 0.5 else (1, 0)
                    for side in order:
                        times[side].append(timed(connections[side], address, headers))
                added = [behind - before for before, behind in zip(*times)]
                median = statistics.median(added)
                failed |= is_judged and median >= LIMIT_MS
                print(
                    f"| {name} | {count} | {statistics.median(times[0]):.3f} | {statistics.median(times[1]):.3f}"
                    f" | {median:.3f} | {percentile(added, 0.95):.3f} |"
                )
            return 1 if failed else 0
        finally:
            for child in children:
                child.terminate()
                child.wait(60)


if __name__ == "__main__":
    sys.exit(main())
