#!/usr/bin/env python3
"""Runs a cluster under load and faults, and compares every frame with a fresh render.

    scripts/soak.py --program target/debug/pointillist --time 30m --seed 7

A broker, a daemon and workers serve viewers, streams, editors, uploads and films. Other clients stall, vanish, send half a request or flood.
Meanwhile processes are killed, stopped and told to drain, devices are lost, and the disk is full. The order of everything that one
client does, and that of the faults, follows from the seed. Memory is measured at the end of each cycle, when no scenes and
jobs are left. In the first part of the time the daemon lives, so that its memory can be compared.

Exit status 1 on a wrong, lost or stale frame, a lost job or upload, a panic in a log, or growth of memory; the folder of the logs is kept then.
Needs a debug build, which loses its device when told to, and nats-server (scripts/setup-nats.sh). The full disk needs `unshare` and is
left out, with a line that says so, where that is not allowed.
"""

import argparse
import gzip
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from processes import nats_program
from soaking import films
from soaking.clients import Rogue, Streamer, Viewer
from soaking.edits import Editor, Uploader
from soaking.fresh import Judge, Reference, await_ready, digest
from soaking.machines import KEY, PATIENCE, ROGUES_KEY, Cluster, Faults, Memory
from soaking.wire import Caller, Gone, Reply
from soaking.world import World

HERE = Path(__file__).resolve().parent
DISK_MIB = 96
# Kinds of faults that fail the soak; the table shows each.
FATAL = (
    "wrong frame", "stale frame", "lost", "lost job", "lost upload", "lost edit", "lost process", "wrong refusal", "refusal", "growth",
    "panic", "reference", "script",
)


def seconds_of(text):
    """30m, 8h, 90s or 90 in seconds."""
    unit = {"s": 1, "m": 60, "h": 3600}
    try:
        return float(text[:-1]) * unit[text[-1]] if text[-1] in unit else float(text)
    except (ValueError, IndexError):
        raise argparse.ArgumentTypeError(f"{text!r} is no time; 90s, 30m or 8h would be one") from None


class Soak:
    """All that takes part, and what several of them need."""

    upload_mib = 4

    def __init__(self, options, folder, disk):
        self.options, self.has_small_disk = options, disk is not None
        self.began = time.monotonic()
        self.total = options.time
        # A fault every few seconds.
        self.pace = (0.3, 1.5) if self.total < 300 else (2, 8)
        self.cycle = min(60, max(8, self.total / 30))
        self.world = World(options.seed, 6, self.say)
        self.cluster = Cluster(options.program, folder, disk or folder / "disk", options.workers, self.upload_mib, HERE.parent / "scenes")
        self.port, self.key, self.folder = self.cluster.port, KEY, folder
        self.caller = Caller(self.port, KEY, "127.0.0.1")
        fresh_root = folder / "fresh"
        shutil.copytree(self.cluster.root, fresh_root)
        self.reference = Reference(options.program, self.cluster, fresh_root)
        self.judge = Judge(self.world, self.reference)
        # Uploads that were acknowledged, and whether they were loaded.
        self.kept = {}
        self.bomb = gzip.compress(b"0 0 0\n" * 1_000_000, 1)
        self.memory = Memory()
        self.specs, self.film_sums = films.SPECS, []

    def say(self, text):
        print(f"{time.monotonic() - self.began:7.1f} s  {text}", flush=True)

    def reply(self, status, headers, body, began):
        return Reply(status, headers, body, began, time.monotonic())

    def take(self, slot, number, reply, known, source):
        """Judges an answer to a request for a frame."""
        if reply.status == 200:
            tag = reply.header("etag")
            if tag is None:
                self.world.count("provisional frames")
            else:
                self.judge.submit(slot, number, reply.began, reply.ended, tag, digest(reply.body), source)
        elif reply.status == 304 and known:
            self.world.count("answered 304")
            self.judge.submit(slot, number, reply.began, reply.ended, known, None, source)
        else:
            self.no_frame(slot, reply, source)

    def no_frame(self, slot, reply, source):
        """Judges a refusal: a scene may be missing or loading only when the slot says so."""
        if self.world.refused(reply):
            return
        absent = None in slot.may_show(reply.began, reply.ended)
        if absent and (reply.status == 404 or reply.kind() in ("scene-loading", "load-cancelled", "load-lost", "scene-changed")):
            self.world.count("frames of absent scenes")
        else:
            self.world.fault("lost", f"{source} of {slot.name}: {reply.brief()}")

    def loaded(self, caller, name, may_retry=True):
        """Waits until an upload is loaded and returns "ready", or what is wrong. An upload whose first load was cut by a kill is retried."""
        until = time.monotonic() + PATIENCE
        reply = None
        while time.monotonic() < until:
            reply = caller.ask("GET", f"/v1/scenes/{name}")
            if reply.status == 404:
                return "it is not listed"
            found = reply.json() if reply.status == 200 else {}
            if found.get("state") == "ready":
                return "ready"
            if found.get("state") == "failed":
                if not (may_retry and found["problem"]["type"].endswith(":load-lost")):
                    return str(found["problem"])
                caller.ask("POST", f"/v1/scenes/{name}/retry")
            time.sleep(0.05)
        return f"it is not loaded after {PATIENCE} s: {reply.brief()}"

    def probe_upload(self, caller):
        """Uploads and deletes a small file."""
        reply = caller.ask("POST", "/v1/scenes?id=soak-probe&name=probe.xyz", b"0 0 0\n1 1 1\n" * 2000, {"Prefer": "wait=60"})
        caller.ask("DELETE", "/v1/scenes/soak-probe")
        return reply

    def restart_daemon(self, how, meanwhile=lambda: None):
        """Ends the daemon, starts it again, and looks whether all that it acknowledged is there."""
        self.world.serving.clear()
        self.world.begin(self.world.outages)
        killed = time.monotonic()
        status = self.cluster.end("daemon", how, PATIENCE)
        if how == signal.SIGTERM and status != 0:
            self.world.fault("lost process", f"the daemon did not end well after SIGTERM: {status}")
        meanwhile()
        for slot in self.world.slots:
            # A change that was under way has failed by now.
            with slot.lock:
                pass
        kept = dict(self.kept)
        # Before the daemon starts: its first answers may come before all scenes are known to be loaded.
        for slot in self.world.slots:
            slot.restarted(killed)
        self.cluster.start("daemon")
        if not await_ready(self.caller, self.cluster.processes["daemon"]):
            self.world.fault("lost process", "the daemon does not come back")
            self.world.ended.set()
            return
        for name, was_loaded in sorted(kept.items()):
            if name not in self.kept:
                continue
            state = self.loaded(self.caller, name, not was_loaded)
            if state != "ready" and name in self.kept:
                self.world.fault("lost upload", f"{name} after a restart: {state}")
        self.world.finish(self.world.outages)
        self.world.serving.set()

    def rest(self):
        """Has everybody pause, ends all jobs, deletes all scenes, and measures memory."""
        began = time.monotonic()
        self.world.running.clear()
        until = time.monotonic() + 2 * PATIENCE
        while self.world.parked < self.world.actors and time.monotonic() < until and not self.world.ended.is_set():
            time.sleep(0.02)
        if self.world.parked < self.world.actors:
            idle = [actor.name for actor in self.actors if actor.is_alive()]
            self.world.fault("lost", f"{self.world.actors - self.world.parked} clients of {idle} still wait for an answer")
            return
        parked = time.monotonic()
        for producer in self.producers:
            producer.finish(time.monotonic() + films.PATIENCE)
        for editor in self.editors:
            for slot in editor.own:
                if slot.now() != (None, True):
                    editor.delete(slot)
        finished = time.monotonic()
        self.judge.settle()
        self.look_for_rests()
        for slot in self.world.slots:
            slot.forget()
        # A device keeps buffers as large as its largest frame needed. New ones begin alike.
        if "lose_device" not in self.options.without:
            for name in ("daemon", "worker-0"):
                self.cluster.lose_device(name)
        # Connections of clients that vanished end, and the allocator gives back what it gives back.
        time.sleep(2)
        self.memory.sample(self.cluster)
        self.world.count("cycles")
        self.say(
            f"cycle {self.world.counts['cycles']}: {self.world.counts['frames checked']} frames checked; clients paused after "
            f"{parked - began:.1f} s, jobs ended after {finished - parked:.1f} s, frames were compared after {time.monotonic() - finished:.1f} s"
        )

    def look_for_rests(self):
        """Nothing is left of what was deleted, broken off or refused."""
        until = time.monotonic() + PATIENCE
        while True:
            scenes = sorted(scene["id"] for scene in self.caller.ask("GET", "/v1/scenes").json()["scenes"])
            jobs = [job["id"] for job in self.caller.ask("GET", "/v1/jobs").json()["jobs"]]
            folder = self.cluster.root / "uploads"
            left = sorted(file.name for file in folder.iterdir()) if folder.exists() else []
            left = [name for name in left if not name.startswith(".lock") and name not in (".claim",)]
            if (scenes, jobs, left) == (["part", "wall"], [], []):
                return
            if time.monotonic() > until:
                self.world.fault("lost", f"something is left: scenes {scenes}, jobs {jobs}, files {left}")
                return
            time.sleep(0.1)

    def start(self):
        self.cluster.start("broker")
        for name in ["daemon", *self.cluster.workers]:
            self.cluster.start(name)
        self.reference.start()
        self.film_sums = [self.reference.film(spec) for spec in self.specs]
        if not await_ready(self.caller, self.cluster.processes["daemon"]):
            sys.exit("soak: the daemon does not start")
        self.world.serving.set()
        slots = self.world.slots
        self.producers = [films.Producer(self, f"producer-{number}", 50 + number) for number in range(2)]
        self.editors = [Editor(self, f"editor-{number}", 60 + number, slots[number::3]) for number in range(3)]
        self.faults = Faults(self, "faults", 90)
        self.actors = [
            *(Viewer(self, f"viewer-{number}", 10 + number) for number in range(4)),
            *(Streamer(self, f"streamer-{number}", 20 + number) for number in range(3)),
            *(Rogue(self, f"rogue-{number}", 30 + number, ROGUES_KEY) for number in range(2)),
            *(Uploader(self, f"uploader-{number}", 40 + number) for number in range(2)),
            *self.producers, *self.editors, self.faults,
        ]
        self.world.actors = len(self.actors)
        self.judge.start()
        for actor in self.actors:
            actor.start()

    def run(self):
        self.start()
        self.say(f"soaking for {self.total:.0f} s with seed {self.options.seed}")
        end = time.monotonic() + self.total
        hard = end - 0.4 * self.total
        while time.monotonic() < end and not self.world.ended.is_set():
            self.faults.is_hard = time.monotonic() > hard
            self.world.running.set()
            self.world.pause(min(self.cycle, max(1, end - time.monotonic())))
            self.rest()
        # Each kind of fault happens at least once, however short the time.
        missing = [deed for deed in self.faults.kinds(True) if not self.world.counts[f"fault: {deed.replace('_', ' ')}"]]
        if missing and not self.world.ended.is_set():
            self.faults.is_hard, self.faults.bag = True, missing[::-1]
            self.world.running.set()
            while self.faults.bag and len(self.faults.bag) <= len(missing) and not self.world.ended.is_set():
                time.sleep(0.1)
            self.rest()
        self.world.ended.set()
        self.finish()

    def finish(self):
        for name in ["daemon", *self.cluster.workers]:
            if name in self.cluster.processes and self.cluster.end(name, signal.SIGTERM, PATIENCE) != 0:
                self.world.fault("lost process", f"{name} did not end well after SIGTERM at the end")
        for log in self.folder.glob("*.log"):
            for line in log.read_text(errors="replace").splitlines():
                if "panicked at" in line:
                    self.world.fault("panic", f"{log.name}: {line}")

    def table(self):
        memory = self.memory.judge(self.world.fault)
        counts = self.world.counts
        for needed in ("frames checked", "frames drawn afresh", "frames on streams", "jobs done", "uploads", "edits", "answered 304", "cycles"):
            if not counts[needed]:
                self.world.fault("lost", f"there were no {needed}")
        rows = sorted((name, str(number)) for name, number in counts.items() if name not in FATAL)
        rows += [(name, str(counts[name])) for name in FATAL]
        rows += memory
        width = max(len(name) for name, _ in rows)
        print(f"\nsoak of {self.total:.0f} s, seed {self.options.seed}")
        for name, value in rows:
            print(f"  {name:{width}}  {value}")
        for fault in self.world.faults[:20]:
            print(f"  !! {fault}")
        return not self.world.faults


def small_disk(arguments, folder):
    """Starts this script again where a small disk can be mounted, or says why not."""
    probe = ["unshare", "--user", "--map-root-user", "--mount"]
    try:
        can = subprocess.run([*probe, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, check=False).returncode == 0
    except OSError:
        can = False
    if can:
        again = [*probe, sys.executable, str(Path(__file__).resolve()), *arguments, "--folder", folder, "--mount"]
        os.execvp(again[0], again)
    print("soak: SKIPPED: a full disk; no disk of its own can be mounted here (unshare --user --mount)")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="target/debug/pointillist")
    parser.add_argument("--time", type=seconds_of, default="30m", help="such as 90s, 30m or 8h")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument(
        "--without", action="append", default=[], choices=list(dict.fromkeys(Faults.GENTLE + Faults.HARD)),
        help="a fault to leave out, such as lose_device with a release build",
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", help="folder for logs and data; a temporary one by default, which is kept if the soak fails")
    parser.add_argument("--mount", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.program = str(Path(options.program).resolve())
    if not nats_program():
        sys.exit("soak: no nats-server here; scripts/setup-nats.sh installs one")
    folder = options.folder or tempfile.mkdtemp(prefix="pointillist-soak-")
    if options.seed is None:
        options.seed = int.from_bytes(os.urandom(3), "big")
        sys.argv += ["--seed", str(options.seed)]
    if not options.mount:
        small_disk(sys.argv[1:], folder)
    folder = Path(folder)
    disk = None
    if options.mount:
        disk = folder / "small"
        disk.mkdir(parents=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "tmpfs", str(disk)], check=True)
    (folder / "logs").mkdir()
    soak = Soak(options, folder / "logs", disk)
    is_well = False
    try:
        soak.run()
        is_well = soak.table()
    finally:
        soak.world.ended.set()
        soak.cluster.end_all()
        if disk:
            subprocess.run(["umount", "-l", str(disk)], check=False)
        if is_well:
            shutil.rmtree(folder, ignore_errors=True)
        else:
            print(f"soak: failed; logs are in {soak.folder}; --seed {options.seed} repeats the order of events", file=sys.stderr)
    sys.exit(0 if is_well else 1)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    main()
