"""Jobs: ordered, cancelled, resumed, watched and deleted. Each ends as it was ordered, with the frames of a fresh render."""

import time

from soaking.clients import Actor
from soaking.fresh import digest, film_sums
from soaking.wire import Gone

# Jobs of one producer that are not deleted yet.
MOST = 3
# How long an undisturbed job may take.
PATIENCE = 300

SPECS = [
    {"scene": "wall", "path": "fly", "w": 96, "h": 72, "to": 11, "want": ["frames"]},
    {"scene": "wall", "path": "fly", "w": 128, "h": 96, "from": 5, "to": 21, "want": ["frames", "video"]},
    {"scene": "part", "path": "turn", "w": 96, "h": 64, "to": 9, "format": "jpeg", "want": ["frames"]},
    {"scene": "wall", "path": "fly", "w": 64, "h": 64, "to": 17, "want": ["video"]},
    {"scene": "part", "path": "turn", "w": 80, "h": 80, "to": 11, "reconstruct": "points", "want": ["frames"]},
    {"scene": "wall", "path": "fly", "w": 80, "h": 60, "to": 23, "lod": "spt", "want": ["frames", "video"]},
]


class Job:
    def __init__(self, key, number):
        self.key, self.spec, self.id = key, number, None
        self.since = time.monotonic()
        self.cancelled = self.checked = False
        self.resumes = 0


class Producer(Actor):
    """Orders films and keeps a ledger of them."""

    def __init__(self, soak, name, number):
        super().__init__(soak, name, number)
        self.ledger, self.orders = [], 0

    def step(self):
        deed = self.chance.random()
        if len(self.ledger) < MOST and deed < 0.4:
            self.orders += 1
            self.ledger.append(Job(f"{self.name}-{self.world.seed}-{self.orders}", self.chance.randrange(len(self.soak.specs))))
        unanswered = [job for job in self.ledger if job.id is None]
        known = [job for job in self.ledger if job.id is not None]
        if unanswered:
            # A repeated request with the same key makes no second job, so an order that got no answer is sent again.
            self.order(unanswered[0])
        elif known and deed < 0.55:
            self.cancel(self.chance.choice(known))
        elif known and deed < 0.65:
            self.watch(self.chance.choice(known))
        for job in known:
            self.look(job)
        self.world.pause(self.chance.uniform(0.2, 0.8))

    def order(self, job):
        reply = self.caller.ask("POST", "/v1/jobs", self.soak.specs[job.spec], {"Idempotency-Key": job.key})
        if reply.status == 201 or reply.status == 200:
            job.id = reply.json()["id"]
            self.world.count("jobs ordered")
        elif not self.world.refused(reply):
            self.world.fault("wrong refusal", f"a job: {reply.brief()}")

    def change(self, job, what):
        reply = self.caller.ask("POST", f"/v1/jobs/{job.id}/{what}")
        if reply.status == 404:
            self.lose(job, "404")
        elif reply.status not in (200, 409) and not self.world.refused(reply):
            self.world.fault("wrong refusal", f"{what} of job {job.id}: {reply.brief()}")
        return reply.status == 200

    def cancel(self, job):
        # The daemon may take the order and be killed before it answers.
        job.cancelled = True
        if self.change(job, "cancel"):
            self.world.count("jobs cancelled")

    def lose(self, job, why):
        self.world.fault("lost job", f"{job.id} ({job.key}): {why}")
        self.ledger = [known for known in self.ledger if known is not job]

    def watch(self, job):
        """Follows a job, and vanishes."""
        link = self.caller.connect()
        try:
            link.sendall(self.caller.head("GET", f"/v1/jobs/{job.id}/{self.chance.choice(('events', 'multipart'))}"))
            link.settimeout(self.chance.uniform(0.05, 1))
            while link.recv(1 << 14):
                pass
        except OSError:
            pass
        finally:
            link.close()
        self.world.count("jobs watched")

    def look(self, job):
        reply = self.caller.ask("GET", f"/v1/jobs/{job.id}")
        if reply.status == 404:
            self.lose(job, "404")
            return
        if reply.status != 200:
            if not self.world.refused(reply):
                self.world.fault("wrong refusal", f"job {job.id}: {reply.brief()}")
            return
        found = reply.json()
        state = found["state"]
        if state == "done":
            self.check(job)
        elif state == "cancelled":
            if not job.cancelled:
                self.lose(job, "cancelled by nobody")
            elif self.chance.random() < 0.7:
                if self.change(job, "resume"):
                    job.cancelled, job.since = False, time.monotonic()
                    self.world.count("jobs resumed")
            else:
                self.delete(job)
        elif state == "failed":
            self.failed(job, found["error"])
        elif time.monotonic() - job.since > PATIENCE and not self.world.overlaps(self.world.outages, job.since, time.monotonic()):
            self.lose(job, f"{state} for {PATIENCE} s: {found}")

    def failed(self, job, error):
        """A full disk, and workers that end or lose their device at one frame again and again, may fail a job. Then it goes on when it is told to."""
        text = f"{error['type']} {error['detail']}"
        now = time.monotonic()
        is_disk = self.world.overlaps(self.world.full_disks, job.since, now)
        is_aside = "is set aside" in text and (is_disk or self.world.overlaps(self.world.worker_ends, job.since, now))
        if is_aside or (is_disk and ("storage" in text or "is full" in text or "No space" in text)):
            self.world.count("jobs failed by faults")
            if self.change(job, "resume"):
                job.since = time.monotonic()
                self.world.count("jobs resumed")
        else:
            self.lose(job, f"failed: {text}")

    def check(self, job):
        spec, expected = self.soak.specs[job.spec], self.soak.film_sums[job.spec]
        if not job.checked:
            found = film_sums(self.caller, job.id, spec)
            if found != expected:
                wrong = sorted(str(name) for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
                self.world.fault("wrong frame", f"job {job.id} of {spec}: {len(wrong)} differ: {', '.join(wrong[:5])}")
            for number in self.chance.sample(sorted(set(found) - {"video"}), min(3, len(set(found) - {"video"}))):
                frame = self.caller.ask("GET", f"/v1/jobs/{job.id}/frames/{number}")
                if frame.status == 200 and digest(frame.body) != found[number]:
                    self.world.fault("wrong frame", f"frame {number} of job {job.id} differs from its manifest")
                elif frame.status != 200 and not self.world.refused(frame):
                    self.world.fault("lost", f"frame {number} of job {job.id}: {frame.brief()}")
            self.world.count("jobs done")
            self.world.count("frames of jobs", len(set(expected) - {"video"}))
            job.checked = True
        deed = self.chance.random()
        if deed < 0.3:
            self.delete(job)
        elif deed < 0.4 and self.change(job, "resume"):
            # The daemon checks what it has, and draws nothing again.
            job.checked, job.since = False, time.monotonic()

    def delete(self, job):
        reply = self.caller.ask("DELETE", f"/v1/jobs/{job.id}")
        if reply.status in (204, 404):
            self.ledger = [known for known in self.ledger if known is not job]
            self.world.count("jobs deleted")
        elif not self.world.refused(reply):
            self.world.fault("wrong refusal", f"deletion of job {job.id}: {reply.brief()}")

    def finish(self, until):
        """Waits until every job has ended and was compared, and deletes all. Runs while the soak rests."""
        while self.ledger and time.monotonic() < until:
            began = time.monotonic()
            try:
                for job in list(self.ledger):
                    if job.id is None:
                        self.order(job)
                    elif job.checked or (job.cancelled and self.caller.ask("GET", f"/v1/jobs/{job.id}").json().get("state") == "cancelled"):
                        self.delete(job)
                    else:
                        self.look(job)
            except Gone as error:
                self.world.lost(error, began)
            time.sleep(0.1)
        for job in list(self.ledger):
            self.lose(job, "has not ended")
