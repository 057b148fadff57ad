"""Clients that change scenes: each slot has one, and what was acknowledged counts from then on. Hostile uploads beside them."""

import json
import time

from soaking.clients import Actor
from soaking.fresh import upload
from soaking.wire import Gone, form
from soaking.world import NODES, Version


class Editor(Actor):
    """Uploads, edits, replaces and deletes the scenes of its slots."""

    def __init__(self, soak, name, number, slots):
        super().__init__(soak, name, number)
        self.own = slots

    def step(self):
        slot = self.chance.choice(self.own)
        with slot.lock:
            # A restart waits for this lock, so nothing is changed while it is not known what the daemon kept.
            if self.world.serving.is_set():
                self.change(slot)
        self.world.pause(self.chance.uniform(0.1, 0.8))

    def change(self, slot):
        version, is_certain = slot.now()
        if not is_certain:
            self.delete(slot)
        elif version is None:
            self.upload(slot)
        else:
            deed = self.chance.random()
            if deed < 0.8 and len(version.edits) < 12:
                self.patch(slot, version)
            elif deed < 0.93:
                # Another scene takes the id.
                self.delete(slot)
                if slot.now() == (None, True):
                    self.upload(slot)
            else:
                self.delete(slot)

    def upload(self, slot):
        version = Version(slot.name, self.chance.randrange(1 << 30))
        event = slot.begin(version)
        reply = upload(self.caller, version, {"Prefer": f"wait={self.chance.choice((0, 60))}"})
        if reply.status not in (201, 202):
            self.refused(slot, event, reply, "upload")
            return
        self.world.count("uploads")
        # An upload that is still being loaded is acknowledged; its frames come once it is loaded.
        self.soak.kept[slot.name] = False
        state = self.soak.loaded(self.caller, slot.name)
        if state == "ready":
            self.soak.kept[slot.name] = True
            slot.end(event)
        else:
            self.world.fault("lost upload", f"{version}: {state}")

    def patch(self, slot, version):
        node = self.chance.choice(NODES)
        place = [round(self.chance.uniform(-0.8, 0.8), 3) for _ in range(3)]
        change = {"translate": place, "rotate": [0, self.chance.randrange(90), 0], "scale": 0.6}
        if self.chance.random() < 0.2:
            change["visible"] = self.chance.random() < 0.5
        event = slot.begin(Version(slot.name, version.seed, (*version.edits, (node, json.dumps(change)))))
        reply = self.caller.ask("PATCH", f"/v1/scenes/{slot.name}/nodes/{node}", change)
        if reply.status == 200:
            slot.end(event)
            self.world.count("edits")
            wanted = len(event.version.edits) + 1
            if reply.json()["revision"] != wanted:
                self.world.fault("lost edit", f"{event.version}: revision {reply.json()['revision']} instead of {wanted}")
        else:
            self.refused(slot, event, reply, "edit")

    def delete(self, slot):
        event = slot.begin(None)
        was_kept = self.soak.kept.pop(slot.name, None)
        reply = self.caller.ask("DELETE", f"/v1/scenes/{slot.name}")
        if reply.status in (204, 404):
            slot.end(event)
            self.world.count("deletions")
        else:
            if was_kept is not None:
                self.soak.kept[slot.name] = was_kept
            self.refused(slot, event, reply, "deletion")

    def refused(self, slot, event, reply, what):
        slot.undo(event)
        if reply.status == 409 or self.world.refused(reply):
            self.world.count(f"{what} refused {reply.status}")
        else:
            self.world.fault("wrong refusal", f"{what} of {slot.name}: {reply.brief()}")


class Uploader(Actor):
    """Uploads of every kind that must leave nothing, and chunked ones that stay until they are deleted."""

    def step(self):
        deed = self.chance.choice((self.hostile, self.hostile, self.hostile, self.bomb, self.broken_off, self.too_large, self.chunked))
        self.world.count(f"upload: {deed.__name__}")
        deed()
        self.world.pause(self.chance.uniform(0.1, 0.6))

    def hostile(self):
        header = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        bodies = {
            "name=giant.ply": header.format("binary_little_endian", 4_000_000_000).encode(),
            "name=cut.ply": header.format("ascii", 100).encode() + b"0 0 0\n1 1",
            "name=nothing.obj": b"f 1 2 3\n" * 500,
            "name=noise.laz": bytes(self.chance.randrange(256) for _ in range(3000)),
            "name=noise.glb": b"glTF" + bytes(self.chance.randrange(256) for _ in range(500)),
            "name=what.exe": b"MZ",
            "name=deep.json": b"[" * 20_000,
            "name=out.json": b'{"assets": {"a": {"file": "../../../../etc/passwd"}}, "nodes": [{"asset": "a"}]}',
            "name=link.json": b'{"assets": {"a": {"file": "http://127.0.0.1/x.ply"}}, "nodes": [{"asset": "a"}]}',
            "name=.upload.json": b"{}",
            "id=../x&name=a.ply": b"ply\n",
        }
        name = self.chance.choice(sorted(bodies))
        # A server that is killed while it loads an upload lists it as failed until it is deleted.
        scene = name.partition("name=")[2].rpartition(".")[0].strip(".")
        try:
            reply = self.caller.ask("POST", f"/v1/scenes?{name}", bodies[name], {"Prefer": "wait=60"})
        except Gone:
            self.remove(scene)
            raise
        if reply.status == 409:
            self.remove(scene)
        elif reply.status in (201, 202):
            self.world.fault("wrong refusal", f"{name} was taken: {reply.brief()}")
        elif reply.status not in (400, 413, 415, 422, 507) and not self.world.refused(reply):
            self.world.fault("wrong refusal", f"{name}: {reply.brief()}")

    def bomb(self):
        """A small file of many points. It may be refused, and it is deleted while it loads or afterwards."""
        name = f"soak-{self.name}-bomb"
        wait = f"wait={self.chance.choice((0, 60))}"
        try:
            reply = self.caller.ask("POST", f"/v1/scenes?id={name}&name=bomb.xyz.gz", self.soak.bomb, {"Prefer": wait})
            if reply.status not in (201, 202, 409, 413, 507) and not self.world.refused(reply):
                self.world.fault("wrong refusal", f"a bomb: {reply.brief()}")
        finally:
            self.remove(name)

    def broken_off(self):
        """Vanishes in the middle of an upload. Nothing is listed later."""
        kind, body = form(Version("soak-broken", self.chance.randrange(1 << 30)).files())
        headers = {"Content-Type": kind}
        is_chunked = self.chance.random() < 0.5
        headers.update({"Transfer-Encoding": "chunked"} if is_chunked else {"Content-Length": str(len(body))})
        link = self.caller.connect()
        try:
            link.sendall(self.caller.head("POST", "/v1/scenes?id=soak-broken&name=scene.json", headers))
            piece = body[:self.chance.randrange(1, len(body))]
            link.sendall(b"%x\r\n%s\r\n" % (len(piece), piece) if is_chunked else piece)
            self.world.pause(self.chance.uniform(0, 0.3))
        except OSError as error:
            raise Gone(str(error)) from error
        finally:
            link.close()

    def too_large(self):
        body = b"0 0 0\n" * ((self.soak.upload_mib << 20) // 6 + 1000)
        is_chunked = self.chance.random() < 0.5
        pieces = (body[at:at + 65536] for at in range(0, len(body), 65536))
        try:
            reply = self.caller.ask("POST", "/v1/scenes?name=large.xyz", pieces if is_chunked else body)
        except Gone:
            # The daemon closes before it has read all, and the answer may be lost with the connection.
            self.world.count("uploads cut as too large")
            return
        if reply.status != 413 and not self.world.refused(reply):
            self.world.fault("wrong refusal", f"a file of {len(body)} bytes: {reply.brief()}")

    def chunked(self):
        """An upload in chunks under an id of its own, which is kept for a while; kills may come between."""
        name = f"soak-{self.name}-{self.chance.randrange(1 << 30)}"
        kind, body = form(Version(name, 7).files())
        pieces = (body[at:at + 5000] for at in range(0, len(body), 5000))
        try:
            reply = self.caller.ask("POST", f"/v1/scenes?id={name}&name=scene.json", pieces, {"Content-Type": kind, "Prefer": "wait=60"})
            if reply.status not in (201, 202):
                if not self.world.refused(reply):
                    self.world.fault("wrong refusal", f"a chunked upload: {reply.brief()}")
                return
            self.world.count("uploads")
            self.soak.kept[name] = reply.status == 201
            self.world.pause(self.chance.uniform(0, 3))
            state = self.soak.loaded(self.caller, name)
            if state != "ready":
                self.world.fault("lost upload", f"{name}: {state}")
        finally:
            # An upload whose answer was cut off may be there or not.
            self.remove(name)

    def remove(self, name):
        self.soak.kept.pop(name, None)
        until = time.monotonic() + 120
        while True:
            began = time.monotonic()
            try:
                reply = self.caller.ask("DELETE", f"/v1/scenes/{name}")
                if reply.status in (204, 404):
                    break
                if not self.world.refused(reply) and reply.status != 409:
                    self.world.fault("wrong refusal", f"deletion of {name}: {reply.brief()}")
                    break
            except Gone as error:
                self.world.lost(error, began)
            if began > until:
                self.world.fault("lost", f"{name} could not be deleted for two minutes")
                break
            time.sleep(0.2)
