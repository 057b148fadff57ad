"""What is true: which version of a scene an answer may show, when nothing may be answered, and what was counted.

A slot is a scene's id. Its events are what happened to it, in order: a new content, an edit, a deletion, a restart that forgot edits. An
event holds from its acknowledgement on, and may hold from its request on. So a frame that was asked for at `began` and came at `ended` shows
the last event acknowledged before `began`, or a later one requested before `ended`.
"""

import json
import random
import threading
import time
from collections import Counter

from processes import wall_ply

# A frame's parameters in each request of the pool. All settings and formats that have code of their own are among them.
POOL = [
    {"camera": "front", "w": 96, "h": 72, "format": "png"},
    {"camera": "front", "w": 64, "h": 64, "format": "jpeg", "quality": 80},
    {"eye": [1.5, 1, 2.5], "target": [0, 0, 0], "w": 120, "h": 80, "format": "png", "reconstruct": "points"},
    {"eye": [-1, 0.4, 2.5], "target": [0, 0, 0], "w": 80, "h": 80, "format": "qoi", "reconstruct": "splats"},
    {"eye": [0, 2, 2], "target": [0.2, 0, 0], "w": 96, "h": 96, "format": "webp", "reconstruct": "pull_push"},
    {"eye": [0.5, 0.5, 1.5], "target": [0, 0, 0], "w": 64, "h": 48, "format": "png", "antialias": "4x"},
    {"camera": "front", "w": 90, "h": 60, "format": "png", "output": "depth"},
    {"camera": "side", "w": 90, "h": 60, "format": "png", "output": "id"},
    {"camera": "side", "w": 100, "h": 60, "format": "png", "lod": "spt", "max_error_px": 2},
    {"eye": [2, 0, 2], "target": [0, 0, 0], "w": 72, "h": 72, "format": "png", "reconstruct": "fuzzy"},
    {"eye": [0, -1, 2.5], "target": [0, 0, 0], "w": 72, "h": 72, "format": "raw", "color_by": "height"},
    {"camera": "side", "w": 64, "h": 64, "format": "png", "reconstruct": "painted"},
]
NODES = ("left", "right")


def query(request):
    """A request of the pool as a query string."""
    text = lambda value: ",".join(map(str, value)) if isinstance(value, list) else str(value)
    return "&".join(f"{name}={text(value)}" for name, value in request.items())


class Version:
    """A scene's content and the edits since: what a fresh daemon needs to draw the same."""

    def __init__(self, slot, seed, edits=()):
        self.slot, self.seed, self.edits = slot, seed, edits
        self.frames = {}

    def files(self):
        """The scene and its assets, the scene first."""
        chance = random.Random(self.seed)
        wave, side = chance.uniform(0.05, 0.4), chance.randrange(24, 56)
        place = lambda x: [round(x + chance.uniform(-0.3, 0.3), 3), round(chance.uniform(-0.4, 0.4), 3), 0]
        scene = {
            "pointillist": 1, "name": "soak",
            "assets": {"a": {"file": "a.ply"}, "b": {"file": "b.ply"}},
            "nodes": [
                {"name": "left", "asset": "a", "translate": place(-0.5), "scale": 0.6},
                {"name": "right", "asset": "b", "translate": place(0.5), "scale": 0.6},
            ],
            "cameras": {
                "front": {"eye": [0, 0, 3], "target": [0, 0, 0], "fov": 45},
                "side": {"eye": [2, 1, 2], "target": [0, 0, 0], "fov": 50},
            },
        }
        walls = [(f"{name}.ply", wall_ply(side + more, wave, chance.randrange(256)).encode()) for name, more in (("a", 0), ("b", 9))]
        return [("scene.json", json.dumps(scene).encode()), *walls]

    def __str__(self):
        return f"{self.slot} of seed {self.seed} after {len(self.edits)} edits"


class Event:
    """A slot shows `version` (None: no scene) from some time between `began` and `acked`."""

    def __init__(self, version, acked=None):
        self.version, self.began, self.acked = version, time.monotonic(), acked


class Slot:
    """An id, its history, and the lock that lets one thread change it."""

    def __init__(self, name):
        self.name = name
        self.lock = threading.Lock()
        self.events = [Event(None, 0)]

    def begin(self, version):
        event = Event(version)
        self.events = [*self.events, event]
        return event

    def end(self, event):
        """The change was acknowledged."""
        event.acked = time.monotonic()

    def undo(self, event):
        """The change was refused."""
        self.events = [known for known in self.events if known is not event]

    def may_show(self, began, ended):
        """Versions that a request of this time may see, the newest first."""
        events = self.events
        first = max(number for number, event in enumerate(events) if event.acked is not None and event.acked <= began)
        return [event.version for event in reversed(events[first:]) if event.began <= ended]

    def now(self):
        """The version as far as it is known: (version, whether that is certain)."""
        last = self.events[-1]
        return last.version, last.acked is not None

    def restarted(self, killed):
        """A daemon that was killed at that time is about to serve again: what was edited is as it was uploaded."""
        now = time.monotonic()
        # Changes are over: the daemon was down.
        bases = {version and version.seed: version and Version(self.name, version.seed) for version in self.may_show(now, now)[::-1]}
        for base in bases.values():
            event = Event(base, now if len(bases) == 1 else None)
            event.began = killed
            self.events = [*self.events, event]

    def forget(self):
        """Drops events that no request in flight can see."""
        self.events = self.events[-1:]


class World:
    """Shared by all threads."""

    def __init__(self, seed, slots, say):
        self.seed, self.say = seed, say
        self.slots = [Slot(f"soak-{number}") for number in range(slots)]
        self.lock = threading.Lock()
        self.counts = Counter()
        self.faults = []
        self.outages, self.full_disks, self.worker_ends = [], [], []
        self.serving, self.running = threading.Event(), threading.Event()
        self.ended = threading.Event()
        self.parked, self.actors = 0, 0

    def chance(self, name):
        """A generator of random numbers for one actor: its choices do not depend on the others."""
        return random.Random(f"{self.seed}/{name}")

    def count(self, what, number=1):
        with self.lock:
            self.counts[what] += number

    def fault(self, kind, text):
        """Something that must not happen: wrong, stale, lost frame, lost job, lost upload …"""
        with self.lock:
            self.counts[kind] += 1
            self.faults.append(f"{kind}: {text}")
        self.say(f"!! {kind}: {text}")

    def begin(self, intervals):
        with self.lock:
            intervals.append([time.monotonic(), None])

    def finish(self, intervals):
        with self.lock:
            intervals[-1][1] = time.monotonic()

    def overlaps(self, intervals, began, ended):
        with self.lock:
            return any(first <= ended and (last is None or last >= began) for first, last in intervals)

    def lost(self, error, began, what="lost"):
        """An answer did not come: a fault, unless the daemon was down meanwhile."""
        if self.overlaps(self.outages, began, time.monotonic()):
            self.count("cut by a kill")
            self.serving.wait(1)
        else:
            self.fault(what, str(error))

    def pause(self, seconds):
        self.ended.wait(seconds)

    def checkpoint(self):
        """Parks the actor while the soak rests, and tells whether the actor goes on."""
        if not self.running.is_set():
            with self.lock:
                self.parked += 1
            while not self.running.wait(0.2) and not self.ended.is_set():
                pass
            with self.lock:
                self.parked -= 1
        return not self.ended.is_set()

    def refused(self, reply):
        """Counts a refusal that a client may get at any time, and tells whether the answer is one.

        429 and 503 say when to come again. A full disk is said with 507.
        """
        if reply.status in (429, 503):
            self.count(f"refused {reply.status} {reply.kind()}")
            if reply.header("retry-after") is None:
                self.fault("refusal", f"no Retry-After: {reply.brief()}")
            return True
        if reply.status == 507 and self.overlaps(self.full_disks, reply.began, reply.ended):
            self.count("refused 507")
            return True
        return False
