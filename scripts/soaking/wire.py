"""HTTP requests and WebSockets, each from an address of the loopback network that the caller chooses."""

import base64
import http.client
import json
import os
import socket
import struct
import time

TIMEOUT = 180


class Gone(Exception):
    """No answer came, or not all of it."""


class Reply:
    """A whole answer, with the times before the request and after the answer."""

    def __init__(self, status, headers, body, began, ended):
        self.status, self.headers, self.body, self.began, self.ended = status, headers, body, began, ended

    def json(self):
        return json.loads(self.body)

    def header(self, name):
        return self.headers.get(name.lower())

    def brief(self):
        """Status and problem on one line."""
        if "json" in (self.header("content-type") or ""):
            problem = json.loads(self.body)
            return f"{self.status} {problem.get('type', '')} {problem.get('detail', '')}"[:400]
        return f"{self.status}, {len(self.body)} bytes"

    def kind(self):
        """The last part of the problem's type."""
        try:
            return str(json.loads(self.body).get("type", "")).rsplit(":", 1)[-1]
        except (ValueError, AttributeError):
            return ""


class Caller:
    """Sends requests to one port with one key, from one source address."""

    def __init__(self, port, key=None, source="127.0.0.1"):
        self.port, self.key, self.source = port, key, source

    def headers(self, more=None):
        headers = {"Host": f"127.0.0.1:{self.port}", **(more or {})}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        return headers

    def ask(self, method, path, body=None, headers=None, timeout=TIMEOUT):
        """Sends one request on a connection of its own. An iterable body is sent in chunks."""
        if isinstance(body, dict):
            body, headers = json.dumps(body).encode(), {"Content-Type": "application/json", **(headers or {})}
        is_chunked = body is not None and not isinstance(body, bytes)
        began = time.monotonic()
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout, source_address=(self.source, 0))
        try:
            link.request(method, path, body, self.headers(headers), encode_chunked=is_chunked)
        except (BrokenPipeError, ConnectionResetError):
            # A server that refuses a request by its head answers while the body is still being sent.
            pass
        except OSError as error:
            link.close()
            raise Gone(f"{method} {path}: {error}") from error
        try:
            answer = link.getresponse()
            content = answer.read()
        except (OSError, http.client.HTTPException) as error:
            raise Gone(f"{method} {path}: {type(error).__name__} {error}") from error
        finally:
            link.close()
        found = {name.lower(): value for name, value in answer.getheaders()}
        return Reply(answer.status, found, content, began, time.monotonic())

    def connect(self, timeout=TIMEOUT):
        try:
            return socket.create_connection(("127.0.0.1", self.port), timeout, source_address=(self.source, 0))
        except OSError as error:
            raise Gone(f"no connection: {error}") from error

    def head(self, method, path, more=None):
        """The head of a request as bytes, for clients that send it by themselves."""
        lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in self.headers(more).items())]
        return "\r\n".join([*lines, "", ""]).encode()


def form(files):
    """A `multipart/form-data` body of (name, bytes), the scene first; with its content type."""
    boundary = "soak-boundary"
    body = b""
    for number, (name, content) in enumerate(files):
        field = "scene" if number == 0 else "file"
        body += (
            f'--{boundary}\r\nContent-Disposition: form-data; name="{field}"; filename="{name}"\r\n'
            "Content-Type: application/octet-stream\r\n\r\n"
        ).encode() + content + b"\r\n"
    return f"multipart/form-data; boundary={boundary}", body + f"--{boundary}--\r\n".encode()


def parts(reply):
    """The parts of a `multipart/mixed` answer: (headers, body) each."""
    boundary = reply.header("content-type").split("boundary=")[1].strip('"')
    found, rest = [], reply.body
    while True:
        at = rest.find(b"--" + boundary.encode())
        if at < 0:
            raise Gone("a multipart answer without its end")
        rest = rest[at + 2 + len(boundary):]
        if rest.startswith(b"--"):
            return found
        head, rest = rest.split(b"\r\n\r\n", 1)
        lines = (line.split(": ", 1) for line in head.decode().strip().split("\r\n"))
        headers = {name.lower(): value for name, value in lines}
        length = int(headers["content-length"])
        found.append((headers, rest[:length]))
        rest = rest[length:]


class WebSocket:
    """A client's side of RFC 6455: text out, text and binary in."""

    def __init__(self, caller, path, timeout=TIMEOUT):
        self.link = caller.connect(timeout)
        self.buffer = b""
        nonce = base64.b64encode(os.urandom(16)).decode()
        upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": nonce}
        try:
            self.link.sendall(caller.head("GET", path, upgrade))
            while b"\r\n\r\n" not in self.buffer:
                self.buffer += self._more()
        except OSError as error:
            self.link.close()
            raise Gone(f"{path}: {error}") from error
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        self.status = int(head.split(b" ", 2)[1])

    def _more(self):
        try:
            data = self.link.recv(1 << 16)
        except OSError as error:
            raise Gone(f"a stream: {error}") from error
        if not data:
            raise Gone("a stream ended without a close")
        return data

    def _exactly(self, count):
        while len(self.buffer) < count:
            self.buffer += self._more()
        taken, self.buffer = self.buffer[:count], self.buffer[count:]
        return taken

    def send(self, message, opcode=1):
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        size = len(data)
        head = bytes([0x80 | opcode]) + (
            bytes([0x80 | size]) if size < 126 else bytes([0x80 | 126]) + struct.pack(">H", size) if size < 1 << 16
            else bytes([0x80 | 127]) + struct.pack(">Q", size)
        )
        # The mask is 0, which leaves the data as they are.
        try:
            self.link.sendall(head + bytes(4) + data)
        except OSError as error:
            raise Gone(f"a stream: {error}") from error

    def next(self):
        """The next message: ("frame", header, image), ("event", object) or ("close", code)."""
        message = b""
        while True:
            first, size = self._exactly(2)
            if size == 126:
                size = struct.unpack(">H", self._exactly(2))[0]
            elif size == 127:
                size = struct.unpack(">Q", self._exactly(8))[0]
            data, opcode = self._exactly(size), first & 15
            if opcode == 8:
                return "close", struct.unpack(">H", data[:2])[0] if len(data) >= 2 else 1005
            if opcode == 9:
                self.send(data, 10)
                continue
            if opcode == 10:
                continue
            if opcode:
                kind = opcode
            message += data
            if first & 0x80:
                break
        if kind == 1:
            return "event", json.loads(message)
        length = struct.unpack("<I", message[:4])[0]
        return "frame", json.loads(message[4:4 + length]), message[4 + length:]

    def close(self):
        self.link.close()
