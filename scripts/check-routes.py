#!/usr/bin/env python3
"""Checks which server HAProxy and nginx send each request to, with the configurations in deploy/ and small servers that say their names.

    scripts/check-routes.py [haproxy] [nginx]      default: both

Jobs, uploads, deletions and repeated loads belong to the keeper, whatever the scene. Everything else about a scene goes to the server that
the scene's id hashes to. Afterwards the rule of each kind of request is taken out of each configuration; the check fails unless it notices.
Exit status 1 with what goes to the wrong server.
"""

import http.client
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
PATIENCE = 60
SCENES = [f"s{number}" for number in range(10)]
# Requests that are the keeper's. {} stands for a scene's id or a job's number.
KEEPERS = [
    ("POST", "/v1/scenes"),
    ("POST", "/v1/scenes?id={}&name=a.ply"),
    ("DELETE", "/v1/scenes/{}"),
    ("POST", "/v1/scenes/{}/retry"),
    ("GET", "/v1/jobs"),
    ("POST", "/v1/jobs"),
    ("GET", "/v1/jobs/{}"),
    ("DELETE", "/v1/jobs/{}"),
    ("POST", "/v1/jobs/{}/resume"),
    ("GET", "/v1/jobs/{}/frames/3"),
]
# Requests that belong to the server of the scene.
SCENE_SERVERS = [
    ("GET", "/v1/scenes/{}"),
    ("GET", "/v1/scenes/{}/frame?w=8&h=8"),
    ("POST", "/v1/scenes/{}/frames"),
    ("POST", "/v1/scenes/{}/pick"),
    ("PATCH", "/v1/scenes/{}/nodes/retry"),
    ("GET", "/v1/scenes/{}/paths/retry"),
    ("DELETE", "/v1/scenes/{}/accuracy"),
    ("POST", "/v1/scenes/{}/accuracy"),
]
# Rules that are taken out, as (file's kind, text, what then goes to the wrong server).
BREAKS = {
    "haproxy": [
        (" or is_retry METH_POST", "/retry"),
        (" or is_scene METH_DELETE", "DELETE /v1/scenes/"),
        (" or is_upload METH_POST", "POST /v1/scenes"),
        ("is_jobs or ", "/v1/jobs"),
        ("    balance hash path,word(3,/)\n    hash-type consistent\n", "one server"),
    ],
    "nginx": [
        ('    "~^POST /v1/scenes/[^/]+/retry$" keeper;\n', "/retry"),
        ('    "~^DELETE /v1/scenes/[^/]+$" keeper;\n', "DELETE /v1/scenes/"),
        ('    "POST /v1/scenes" keeper;\n', "POST /v1/scenes"),
        ('    "~^[A-Z]+ /v1/jobs" keeper;\n', "/v1/jobs"),
        ("    hash $scene consistent;\n", "one server"),
    ],
}


class Named(BaseHTTPRequestHandler):
    """Answers every request with the server's name."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True

    def answer(self):
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        name = self.server.called.encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(name)))
        # nginx keeps frames otherwise.
        self.send_header("Vary", "*")
        self.end_headers()
        self.wfile.write(name)

    do_GET = do_POST = do_DELETE = do_PATCH = answer

    def log_message(self, *_):
        pass


class Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128

    def handle_error(self, request, client_address):
        """Says nothing: balancers break health checks off, and are killed."""


def start_server(name):
    server = Server(("127.0.0.1", 0), Named)
    server.called = name
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"127.0.0.1:{server.server_port}"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def replaced(text, old, new):
    if old not in text:
        sys.exit(f"FAULT: a configuration in deploy/ lacks {old!r}")
    return text.replace(old, new)


def haproxy_config(text, port, servers):
    """deploy/haproxy.cfg with the ports of this check."""
    text = replaced(text, "bind :80\n", f"bind 127.0.0.1:{port}\n")
    backend = "backend keeper\n    http-request disable-l7-retry unless METH_GET\n    server"
    text = replaced(text, f"{backend} render1 127.0.0.1:8081", f"{backend} keeper {servers[0]}")
    for number, address in enumerate(servers[1:]):
        text = replaced(text, f"127.0.0.1:{8081 + number}", address)
    # There may be no such socket here.
    return replaced(text, "    log /dev/log local0\n", "    log 127.0.0.1:9 local0\n")


def cluster_config(text, port, servers):
    """deploy/kubernetes/haproxy.cfg with addresses in place of names."""
    text = replaced(text, "bind :8080\n", f"bind 127.0.0.1:{port}\n")
    text = replaced(text, "bind :8081\n", f"bind 127.0.0.1:{free_port()}\n")
    renderers = "".join(f"server render{number} {address}\n    " for number, address in enumerate(servers[1:]))
    text = replaced(text, "server-template render 32 pointillist-renderers:8080 hash-key addr-port", renderers)
    text = replaced(text, "server keeper pointillist-keeper:8080", f"server keeper {servers[0]}")
    text = replaced(text, "    log stdout format raw local0\n", "    log 127.0.0.1:9 local0\n")
    return replaced(text, "check port 9090", "check")


def nginx_config(text, port, servers, folder):
    """deploy/nginx.conf with the ports and folders of this check, as the only file of nginx."""
    one = "server pointillist:8080 max_fails=0;\n    keepalive"
    everyone = "".join(f"server {address} max_fails=0;\n    " for address in servers[1:])
    text = replaced(text, f"{one} 32", f"{everyone}keepalive 32")
    text = replaced(text, f"{one} 8", f"server {servers[0]} max_fails=0;\n    keepalive 8")
    text = replaced(text, "listen 80;", f"listen 127.0.0.1:{port};")
    text = replaced(text, "listen [::]:80;", "")
    text = replaced(text, "/var/cache/nginx/pointillist", f"{folder}/cache")
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    places = "".join(f"{kind}_temp_path {folder}/{kind};\n" for kind in kinds)
    head = f"daemon off;\nmaster_process off;\npid {folder}/pid;\nevents {{}}\n"
    return f"{head}http {{\naccess_log off;\n{places}{text}}}\n"


class Balancer:
    """A balancer that runs with a configuration."""

    def __init__(self, program, config, port, folder):
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
        file, log = folder / "config", folder / "log"
        file.write_text(config)
        flags = ["-db", "-f", file] if program.endswith("haproxy") else ["-e", "stderr", "-p", folder, "-c", file]
        with open(log, "w") as sink:
            self.process = subprocess.Popen([program, *flags], stdout=sink, stderr=sink)
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=5).close()
                return
            except OSError:
                pass
            if self.process.poll() is not None or time.monotonic() > deadline:
                self.end()
                sys.exit(f"FAULT: {program} does not listen: {log.read_text()}")
            time.sleep(0.02)

    def end(self):
        self.connection.close()
        self.process.kill()
        self.process.wait()

    def ask(self, method, path):
        """Returns the name of the server that answers."""
        self.connection.request(method, path, body=b"x" if method in ("POST", "PATCH") else None)
        answer = self.connection.getresponse()
        text = answer.read().decode()
        return text if answer.status == 200 else f"nobody ({answer.status})"


def faults(balancer):
    """Lists what goes to the wrong server."""
    for method, path in KEEPERS:
        names = SCENES if "{}" in path else [""]
        wrong = {balancer.ask(method, path.format(name)) for name in names} - {"keeper"}
        if wrong:
            yield f"{method} {path.format('…')} goes to {', '.join(sorted(wrong))}; it is the keeper's"
    owners = {}
    for scene in SCENES:
        found = {balancer.ask(method, path.format(scene)) for method, path in SCENE_SERVERS}
        if len(found) > 1:
            yield f"requests about the scene {scene} go to {', '.join(sorted(found))}, not to one server"
        owners[scene] = found.pop()
    if len(set(owners.values())) < 2:
        yield f"requests about {len(SCENES)} scenes all go to one server, {owners[SCENES[0]]}"


def main():
    path = os.pathsep.join([str(HERE / "target/servers/bin"), os.environ["PATH"], "/usr/sbin"])
    wanted = sys.argv[1:] or ["haproxy", "nginx"]
    # In the backend of all servers, the keeper has another name, so that it is seen by which rule a request reached it.
    servers = [start_server(name) for name in ("keeper", "render1", "render2", "render3")]
    kinds = {
        "haproxy.cfg": ("haproxy", haproxy_config),
        "kubernetes/haproxy.cfg": ("haproxy", cluster_config),
        "nginx.conf": ("nginx", nginx_config),
    }
    found, tried = [], 0
    for file, (name, adapt) in kinds.items():
        if name not in wanted:
            continue
        program = shutil.which(name, path=path)
        if program is None:
            sys.exit(f"FAULT: there is no {name}: scripts/setup-servers.sh unpacks one")

        def told(text):
            with tempfile.TemporaryDirectory() as folder:
                port = free_port()
                more = [folder] if name == "nginx" else []
                balancer = Balancer(program, adapt(text, port, servers, *more), port, Path(folder))
                try:
                    return list(faults(balancer))
                finally:
                    balancer.end()

        text = (HERE / "deploy" / file).read_text()
        found += [f"{file}: {fault}" for fault in told(text)]
        for rule, words in BREAKS[name]:
            tried += 1
            if not any(words in fault for fault in told(replaced(text, rule, ""))):
                found.append(f"{file}: without {rule.strip()!r}, nothing is said about {words!r}")
    for fault in found:
        print(f"FAULT: {fault}")
    if not found:
        print(f"{len(KEEPERS)} kinds of requests reach the keeper, {len(SCENE_SERVERS)} the server of the scene; {tried} broken configurations are noticed")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
