"""Compares every frame with a fresh render: one by a daemon of its own, which has neither cache nor state and nothing to do but this."""

import hashlib
import json
import queue
import signal
import threading
import time

from processes import free_port
from soaking.wire import Caller, Gone, form
from soaking.world import POOL, query

# The daemon is started afresh after it drew so many frames.
FRAMES_OF_A_DAEMON = 400


def digest(content):
    return hashlib.sha256(content).hexdigest()


def upload(caller, version, headers=None):
    """Posts a version's content as its slot."""
    kind, body = form(version.files())
    return caller.ask("POST", f"/v1/scenes?id={version.slot}&name=scene.json", body, {"Content-Type": kind, **(headers or {})})


def await_ready(caller, process, seconds=180):
    """Waits until a daemon is ready, and tells whether it is."""
    until = time.monotonic() + seconds
    while time.monotonic() < until and process.poll() is None:
        try:
            if caller.ask("GET", "/readyz", timeout=10).status == 200:
                return True
        except Gone:
            pass
        time.sleep(0.05)
    return False


class Reference:
    """A daemon that draws versions from scratch."""

    def __init__(self, program, processes, root):
        self.program, self.processes, self.root = program, processes, root
        self.caller, self.drawn, self.starts = None, 0, 0
        self.shown = {}

    def start(self):
        if self.caller:
            self.processes.end("reference", signal.SIGKILL)
        port = free_port()
        self.starts += 1
        state = self.root.parent / f"reference-state-{self.starts}"
        self.processes.spawn("reference", [
            self.program, "serve", "--listen", f"127.0.0.1:{port}", "--root", str(self.root), "--state", str(state),
            "--no-cache", "--no-prime",
        ])
        self.caller, self.drawn, self.shown = Caller(port), 0, {}
        if not await_ready(self.caller, self.processes.processes["reference"]):
            raise RuntimeError("the daemon of fresh renders does not start")
        for scene in self.caller.ask("GET", "/v1/scenes").json()["scenes"]:
            if scene["id"].startswith("soak-"):
                self.caller.ask("DELETE", f"/v1/scenes/{scene['id']}")

    def _expect(self, reply, *statuses):
        if reply.status not in statuses:
            raise RuntimeError(f"the daemon of fresh renders answers {reply.brief()}")
        return reply

    def _show(self, version):
        seed, edits = self.shown.get(version.slot, (None, ()))
        if seed != version.seed or edits != version.edits[:len(edits)]:
            self._expect(self.caller.ask("DELETE", f"/v1/scenes/{version.slot}"), 204, 404)
            self._expect(upload(self.caller, version, {"Prefer": "wait=120"}), 201)
            edits = ()
        for node, change in version.edits[len(edits):]:
            path = f"/v1/scenes/{version.slot}/nodes/{node}"
            self._expect(self.caller.ask("PATCH", path, json.loads(change)), 200)
        self.shown[version.slot] = (version.seed, version.edits)

    def frame(self, version, number):
        """Entity tag and checksum of a request of the pool."""
        if self.caller is None or self.drawn >= FRAMES_OF_A_DAEMON:
            self.start()
        if number not in version.frames:
            self._show(version)
            reply = self._expect(self.caller.ask("GET", f"/v1/scenes/{version.slot}/frame?{query(POOL[number])}"), 200)
            version.frames[number] = (reply.header("etag"), digest(reply.body))
            self.drawn += 1
        return version.frames[number]

    def film(self, spec):
        """Checksums of a job's frames and of its video."""
        if self.caller is None:
            self.start()
        number = self._expect(self.caller.ask("POST", "/v1/jobs", spec), 201).json()["id"]
        until = time.monotonic() + 300
        while (job := self.caller.ask("GET", f"/v1/jobs/{number}").json())["state"] != "done":
            if job["state"] not in ("queued", "running") or time.monotonic() > until:
                raise RuntimeError(f"the job of the fresh renders is {job['state']}: {job['error']}")
            time.sleep(0.05)
        return film_sums(self.caller, number, spec)


def film_sums(caller, number, spec):
    """Checksums of a finished job: of each frame by number, and of the video."""
    sums = {}
    if "frames" in spec["want"]:
        manifest = caller.ask("GET", f"/v1/jobs/{number}/frames")
        if manifest.status != 200:
            raise Gone(f"the manifest of job {number}: {manifest.brief()}")
        sums = {record["frame"]: record["sha256"] for record in map(json.loads, manifest.body.decode().splitlines()[1:])}
    if "video" in spec["want"]:
        video = caller.ask("GET", f"/v1/jobs/{number}/video.mp4")
        if video.status != 200:
            raise Gone(f"the video of job {number}: {video.brief()}")
        sums["video"] = digest(video.body)
    return sums


class Judge(threading.Thread):
    """Compares frames with fresh renders, in the order in which they come."""

    def __init__(self, world, reference):
        super().__init__(name="judge", daemon=True)
        self.world, self.reference = world, reference
        self.queue = queue.Queue(2000)
        # What was drawn afresh: (version, request, checksum) of each tag, and (version, tag) of each (slot, request, checksum).
        self.by_tag, self.by_sum = {}, {}

    def submit(self, slot, number, began, ended, tag, checksum, source):
        """Hands over a frame: its tag or its checksum may be missing, but not both."""
        self.queue.put((slot, number, slot.may_show(began, ended), tag, checksum, source))

    def run(self):
        while True:
            item = self.queue.get()
            try:
                self.judge(*item)
            except (RuntimeError, Gone, OSError) as error:
                self.world.fault("reference", str(error))
                self.reference.shown = {}
            finally:
                self.queue.task_done()

    def judge(self, slot, number, possible, tag, checksum, source):
        self.world.count("frames checked")
        for version in possible:
            if version is None:
                continue
            if number not in version.frames:
                fresh_tag, fresh_sum = self.reference.frame(version, number)
                self.world.count("frames drawn afresh")
                self.by_tag[fresh_tag] = (version, number, fresh_sum)
                self.by_sum.setdefault((slot.name, number, fresh_sum), version)
            fresh_tag, fresh_sum = version.frames[number]
            if tag in (None, fresh_tag) and checksum in (None, fresh_sum):
                return
        name = f"{source}: {slot.name}?{query(POOL[number])}, tag {tag}, sha256 {checksum}"
        expected = "; ".join(f"{version}: {version.frames[number]}" for version in possible if version) or "no scene"
        known = self.by_tag.get(tag)
        older = known[0] if known and checksum in (None, known[2]) else self.by_sum.get((slot.name, number, checksum))
        if older:
            self.world.fault("stale frame", f"{name} shows {older}; expected {expected}")
        else:
            self.world.fault("wrong frame", f"{name}; expected {expected}")

    def settle(self):
        """Waits until all frames are compared, and forgets versions that nobody sees any more."""
        self.queue.join()
        self.by_tag, self.by_sum = {}, {}
