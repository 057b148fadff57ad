"""Clients that ask for frames, over HTTP and WebSockets, and clients that behave badly."""

import socket
import struct
import threading
import time

from soaking.fresh import digest
from soaking.wire import Caller, Gone, WebSocket, parts
from soaking.world import NODES, POOL, query

SIGNATURES = {"png": b"\x89PNG", "jpeg": b"\xff\xd8", "webp": b"RIFF", "qoi": b"qoif"}


class Actor(threading.Thread):
    """A thread that takes one step after the other until the soak ends; each has its own address and its own chance."""

    def __init__(self, soak, name, number, key=None):
        super().__init__(name=name, daemon=True)
        self.soak, self.world = soak, soak.world
        self.chance = self.world.chance(name)
        self.caller = Caller(soak.port, key or soak.key, f"127.0.{number // 200 + 1}.{number % 200 + 1}")

    def run(self):
        while self.world.checkpoint():
            began = time.monotonic()
            try:
                self.step()
            except Gone as error:
                self.world.lost(error, began)
            except Exception as error:  # noqa: BLE001: a fault of this script must not pass for silence
                self.world.fault("script", f"{self.name}: {type(error).__name__} {error}")
                raise

    def slot(self):
        """One of the slots, mostly one that has a scene."""
        chosen = self.chance.choice(self.world.slots)
        if chosen.now()[0] is None and self.chance.random() < 0.8:
            chosen = self.chance.choice([slot for slot in self.world.slots if slot.now()[0]] or [chosen])
        return chosen


class Viewer(Actor):
    """Asks for frames, again with their tags, and for many in one request."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.tags = {}

    def step(self):
        slot, number = self.slot(), self.chance.randrange(len(POOL))
        if self.chance.random() < 0.1:
            self.many(slot)
        else:
            self.one(slot, number)
        self.world.pause(self.chance.uniform(0, 0.05))

    def one(self, slot, number):
        known = self.tags.get((slot.name, number)) if self.chance.random() < 0.4 else None
        path = f"/v1/scenes/{slot.name}/frame?{query(POOL[number])}"
        reply = self.caller.ask("GET", path, headers={"If-None-Match": known} if known else None)
        self.soak.take(slot, number, reply, known, "frame")
        if reply.status == 200:
            if len(self.tags) > 200:
                self.tags.clear()
            self.tags[slot.name, number] = reply.header("etag")

    def many(self, slot):
        numbers = [self.chance.randrange(len(POOL)) for _ in range(4)]
        # All frames of an answer have one format.
        numbers = [number for number in numbers if POOL[number]["format"] == "png"]
        if not numbers:
            return
        poses = [{name: value for name, value in POOL[number].items() if name != "format"} for number in numbers]
        body = {"format": "png", "poses": poses}
        reply = self.caller.ask("POST", f"/v1/scenes/{slot.name}/frames", body)
        if reply.status != 200:
            self.soak.no_frame(slot, reply, "frames")
            return
        found = parts(reply)
        if len(found) != len(numbers):
            self.world.fault("lost", f"{len(found)} parts of {len(numbers)} poses: {slot.name}")
        for number, (headers, content) in zip(numbers, found):
            if headers["content-type"] != "image/png":
                self.world.count("parts without a frame")
                continue
            self.soak.judge.submit(slot, number, reply.began, reply.ended, None, digest(content), "frames")


class Streamer(Actor):
    """A WebSocket: moving poses, then one that rests, whose frame is compared."""

    def step(self):
        slot = self.slot()
        began = time.monotonic()
        socket_ = WebSocket(self.caller, f"/v1/scenes/{slot.name}/stream")
        try:
            if socket_.status != 101:
                self.world.count(f"streams refused {socket_.status}")
                self.world.pause(0.2)
                return
            self.world.count("streams")
            for turn in range(self.chance.randrange(2, 7)):
                if not self.look(socket_, slot, turn):
                    return
            if self.chance.random() < 0.3:
                socket_.link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        except Gone as error:
            if not any(version is None for version in slot.may_show(began, time.monotonic())):
                raise
            self.world.count("streams of deleted scenes")
        finally:
            socket_.close()

    def look(self, socket_, slot, turn):
        number = self.chance.randrange(len(POOL))
        for step in range(self.chance.randrange(4)):
            pose = {"seq": 10 * turn + step, "reset": True, **POOL[self.chance.randrange(len(POOL))], "moving": True}
            socket_.send(pose)
        asked = time.monotonic()
        last = 10 * turn + 9
        socket_.send({"seq": last, "reset": True, **POOL[number], "moving": False})
        while True:
            kind, *message = socket_.next()
            ended = time.monotonic()
            if kind == "close":
                self.closed(message[0], slot, asked, ended)
                return False
            if kind == "event":
                if message[0]["event"] == "problem":
                    self.world.count("problems on streams")
                    if message[0].get("seq") == last and not message[0]["type"].rsplit(":", 1)[-1] in ("busy", "device-lost"):
                        self.problem(message[0], slot, asked, ended)
                        return True
                elif message[0]["event"] == "deleted":
                    self.world.count("streams of deleted scenes")
                    return False
                continue
            header, image = message
            if header["bytes"] != len(image):
                self.world.fault("wrong frame", f"stream of {slot.name}: {len(image)} bytes, the header says {header['bytes']}")
            socket_.send({"ack": header["frame"]})
            self.world.count("frames on streams")
            signature = SIGNATURES.get(header["format"], b"")
            if not image.startswith(signature):
                self.world.fault("wrong frame", f"stream of {slot.name}: not a {header['format']}")
            if header["seq"] == last and header["quality"] == "still":
                self.soak.judge.submit(slot, number, asked, ended, None, digest(image), "stream")
                return True

    def problem(self, problem, slot, asked, ended):
        kind = problem["type"].rsplit(":", 1)[-1]
        if kind in ("unknown-scene", "shutting-down", "frame-timeout"):
            return
        self.world.fault("wrong refusal", f"stream of {slot.name}: {problem['type']} {problem.get('detail')}")

    def closed(self, code, slot, asked, ended):
        self.world.count(f"streams closed {code}")
        if code == 4404 or (code == 1001 and self.world.overlaps(self.world.outages, asked, ended)) or code == 4429:
            return
        self.world.fault("lost", f"stream of {slot.name}: closed with {code}")


class Rogue(Actor):
    """Stalls, vanishes, sends half a request, floods, and asks for what cannot be had."""

    def step(self):
        deed = self.chance.choice((self.stall, self.vanish, self.half, self.flood, self.heavy, self.late, self.nonsense, self.silent_stream))
        self.world.count(f"rogue: {deed.__name__}")
        try:
            deed(self.slot())
        except OSError as error:
            raise Gone(f"{deed.__name__}: {error}") from error
        self.world.pause(self.chance.uniform(0.2, 1.2))

    def path(self, slot, **more):
        number = self.chance.randrange(len(POOL))
        return number, f"/v1/scenes/{slot.name}/frame?{query({**POOL[number], **more})}"

    def cut(self, link):
        """Resets a connection."""
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        link.close()

    def stall(self, slot):
        """Reads an answer that is larger than all buffers only after a while: it is whole."""
        _, path = self.path(slot, w=500, h=400, format="raw", antialias="off")
        began = time.monotonic()
        link = self.caller.connect()
        with link:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            link.sendall(self.caller.head("GET", path, {"Connection": "close"}))
            content = link.recv(64)
            self.world.pause(self.chance.uniform(0.2, 1.5))
            while data := link.recv(1 << 16):
                content += data
        head, _, body = content.partition(b"\r\n\r\n")
        lengths = [int(line.split(b":")[1]) for line in head.split(b"\r\n") if line.lower().startswith(b"content-length:")]
        if not lengths or len(body) != lengths[0]:
            raise Gone(f"a slow reader got {len(body)} bytes of {lengths} after {time.monotonic() - began:.1f} s")

    def vanish(self, slot):
        """Goes while its frame is drawn, or in the middle of the answer."""
        _, path = self.path(slot, w=self.chance.choice((64, 700)))
        link = self.caller.connect()
        link.sendall(self.caller.head("GET", path))
        if self.chance.random() < 0.5:
            link.recv(100)
        else:
            self.world.pause(self.chance.uniform(0, 0.05))
        self.cut(link)

    def half(self, slot):
        """Sends half a head, or half a body."""
        link = self.caller.connect()
        if self.chance.random() < 0.5:
            head = self.caller.head("GET", self.path(slot)[1])
            link.sendall(head[:self.chance.randrange(1, len(head) - 1)])
        else:
            node = f"/v1/scenes/{slot.name}/nodes/{NODES[0]}"
            link.sendall(self.caller.head("PATCH", node, {"Content-Type": "application/json", "Content-Length": "100"}))
            link.sendall(b'{"translate": [9, 9')
        self.world.pause(self.chance.uniform(0, 1))
        (self.cut if self.chance.random() < 0.5 else socket.socket.close)(link)

    def flood(self, slot):
        """Sends more requests than its address may: each gets its frame, or 429 or 503 with a time to come again."""
        number = self.chance.randrange(len(POOL))
        head = self.caller.head("GET", f"/v1/scenes/{slot.name}/frame?{query(POOL[number])}")
        links = []
        try:
            for _ in range(self.chance.choice((4, 30))):
                link = self.caller.connect()
                links.append((link, time.monotonic()))
                link.sendall(head * 6)
            for link, began in links:
                self.answers(link, 6, slot, number, began)
        finally:
            for link, _ in links:
                link.close()

    def answers(self, link, count, slot, number, began):
        """Reads pipelined answers. The server may close after a refusal."""
        reader = link.makefile("rb")
        for _ in range(count):
            line = reader.readline()
            if not line:
                break
            status, headers = int(line.split()[1]), {}
            while (line := reader.readline().strip()):
                name, _, value = line.decode().partition(":")
                headers[name.lower()] = value.strip()
            body = reader.read(int(headers.get("content-length", 0)))
            reply = self.soak.reply(status, headers, body, began)
            self.world.count(f"flood answered {status}")
            self.soak.take(slot, number, reply, None, "flood")

    def heavy(self, slot):
        """Asks for large frames on many connections at once and reads no answer."""
        links = []
        for _ in range(self.chance.randrange(3, 8)):
            link = self.caller.connect()
            links.append(link)
            link.sendall(self.caller.head("GET", self.path(slot, w=640, h=480, antialias="off")[1]))
        self.world.pause(self.chance.uniform(0, 0.3))
        for link in links:
            self.cut(link)

    def late(self, slot):
        """Sets a deadline that cannot be kept, or just so."""
        number, path = self.path(slot)
        reply = self.caller.ask("GET", f"{path}&deadline_ms={self.chance.choice((1, 5, 50, 500))}")
        self.soak.take(slot, number, reply, None, "late")

    def nonsense(self, slot):
        """Asks for what does not exist."""
        path, status = self.chance.choice((
            (f"/v1/scenes/{slot.name}/frame?w=0&h=3", 422), (f"/v1/scenes/{slot.name}/frame?w=64&h=64&lod=no", 422),
            ("/v1/scenes/no-such-scene/frame?w=8&h=8", 404), ("/v1/jobs/999999999", 404), ("/v1/none", 404),
            (f"/v1/scenes/{slot.name}/frame?w=9999999&h=9", 422),
        ))
        reply = self.caller.ask("GET", path)
        # The scene may be missing or loading.
        if reply.status not in (status, 404, 409) and not self.world.refused(reply):
            self.world.fault("wrong refusal", f"{path}: {reply.brief()}")

    def silent_stream(self, slot):
        """Opens a stream, asks for frames and acknowledges none, or sends what is no message."""
        stream = WebSocket(self.caller, f"/v1/scenes/{slot.name}/stream")
        try:
            if stream.status != 101:
                return
            deed = self.chance.randrange(4)
            if deed == 0:
                stream.send(b"\xff\xfe not text", 1)
            elif deed == 1:
                stream.send(b"binary", 2)
            elif deed == 2:
                stream.send(b'{"seq": 1, "eye": "nowhere"}')
            else:
                for seq in range(300):
                    stream.send({"seq": seq, "reset": True, **POOL[seq % len(POOL)], "moving": True})
            self.world.pause(self.chance.uniform(0.1, 1))
        except Gone:
            # The server closed first.
            pass
        finally:
            self.cut(stream.link)
