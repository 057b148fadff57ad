#!/usr/bin/env python3
"""Shows the scene of vtk_draw.py in a remote view of trame, and prints what a frame costs its client as JSON.

    trame_view.py copies.json --eye 0,2,9 --target 0,1,0 --size 640x480 --quality 85 --save frame.jpg

Two processes: a trame application with one `VtkRemoteView`, and its client, which is this one and speaks to it over loopback
with trame's own Python client. A frame's time is the client's, from sending a pose to holding the whole JPEG of it;
poses are sent one at a time. What is asked for and printed is otherwise as in vtk_draw.py, `--interactive` too.

Between frames, outside of what is timed, the client decodes the JPEG, and stops where it has another size than was asked for or
shows the same as the one before.
"""
from __future__ import annotations

import asyncio
import importlib.metadata
import io
import json
import os
import subprocess
import sys
import threading
import time

import vtk_draw
from vtk_draw import vtk

try:
    import aiohttp
    from PIL import Image
    from trame.app import get_server
    from trame.ui.html import DivLayout
    from trame.widgets.vtk import VtkRemoteView
    from trame_server.client import WsLinkSession
    from trame_vtk.modules.vtk.protocols import vtkWebPublishImageDelivery
except ImportError:
    sys.exit("trame_view.py: no trame here; run benches/peers/install.sh and use its python")

# A frame that takes longer has got lost.
FRAME_LIMIT_S = 60.0


def parse_arguments():
    parser = vtk_draw.scene_arguments(__doc__.split("\n\n")[0])
    parser.add_argument("--quality", type=int, default=85, metavar="Q", help="of the JPEGs")
    parser.add_argument("--save", help="write the unturned frame's JPEG here")
    parser.add_argument("--serve", action="store_true", help="be the application; the client starts it so")
    args = parser.parse_args()
    if not args.eye or not args.target:
        parser.error("a client sends poses: --eye and --target are needed")
    return args


def push_without_waits(protocol):
    """Sets what trame waits for between a pose and its image as low as it goes."""
    for link in protocol.getLinkProtocols():
        if isinstance(link, vtkWebPublishImageDelivery):
            # VTK encodes in a thread of its own, so a push right after drawing finds no image yet. trame looks for it half a second
            # later, which would be all that is measured. With none to wait it looks each time its event loop comes round. Any wait
            # but none is of no use: it grows with each look, and one that comes too early is the last.
            link.delta_stale_time_before_render = 0.0
            link.stale_count_limit = sys.maxsize
            # The most frames a second of animations, which push by a clock. None is started here, where each pose pushes; raised
            # from 30 so that no limit is left.
            link.max_frame_rate = 1000.0


def serve(args):
    """The application. Ends when its standard input does, that is with its client, whatever becomes of that."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(0)), daemon=True).start()
    # What trame reads instead of this program's arguments.
    os.environ["TRAME_ARGS"] = "--server"
    # No line of wslink's on standard output.
    os.environ["WSLINK_READY_MSG"] = ""
    scene = vtk_draw.Scene(args)
    # trame wants one, to keep it from drawing a second time.
    interactor = vtk.vtkRenderWindowInteractor()
    interactor.SetRenderWindow(scene.window)
    server = get_server(client_type="vue3")
    with DivLayout(server):
        # The full size and the stream's quality at rest and in motion, where trame would take 60 in motion. It is the page's
        # script that hands them to the application: the client does it in its stead.
        view = VtkRemoteView(
            scene.window,
            ref="view",
            interactive_ratio=1,
            interactive_quality=args.quality,
            still_ratio=1,
            still_quality=args.quality,
        )
    # After the view, which has brought the protocols that this looks through.
    server.add_protocol_to_configure(push_without_waits)

    @server.trigger("pose")
    def pose(eye, target, up):
        scene.look(eye, target, up)
        view.update()

    @server.trigger("described")
    def described():
        return {**scene.described(), "trame": importlib.metadata.version("trame")}

    @server.controller.add("on_server_ready")
    def ready(**_):
        print(json.dumps({"port": server.port, "load_ms": scene.load_ms}), flush=True)

    # No time limit without clients: standard input's end is what stops this.
    server.start(port=0, host="127.0.0.1", open_browser=False, show_connection_info=False, timeout=0)


class Client:
    """What the page of a remote view does, without drawing what it gets."""

    def __init__(self, args):
        self.args = args
        self.arriving = None
        self.shown = b""
        command = [sys.executable, os.path.abspath(__file__), "--serve", *sys.argv[1:]]
        self.application = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        line = self.application.stdout.readline()
        if not line.startswith("{"):
            sys.exit(f"trame_view.py: the application did not start: {line!r}")
        ready = json.loads(line)
        self.load_ms = ready["load_ms"]
        # Runs while something is awaited, and rests while others are timed.
        self.loop = asyncio.new_event_loop()
        self.loop.run_until_complete(self.open(ready["port"]))

    async def open(self, port):
        self.http = aiohttp.ClientSession()
        # Does not offer to compress messages, as browsers do: JPEGs get no smaller by it, only later.
        self.socket = await self.http.ws_connect(f"ws://127.0.0.1:{port}/ws", compress=0)
        self.session = WsLinkSession(self.socket)
        self.listening = asyncio.ensure_future(self.session.listen())
        await self.reply(await self.session.auth(secret="wslink-secret"))
        self.session.register_subscription("viewport.image.push.subscription", self.arrived)
        view = (await self.call("trame.state.get"))["state"]["viewId"]
        # Pushes an image of its own, at full quality.
        self.arriving = asyncio.get_running_loop().create_future()
        await self.call("viewport.image.push.observer.add", view)
        await self.reply(self.arriving)
        await self.call("viewport.image.push.original.size", view, *self.args.size)
        await self.call("viewport.image.push.quality", view, self.args.quality, 1)

    async def call(self, method, *args):
        return await self.reply(await self.session.call(method, list(args)))

    async def reply(self, future):
        """What is waited for, unless the application ends before."""
        waiting = {future, self.listening}
        await asyncio.wait(waiting, timeout=FRAME_LIMIT_S, return_when=asyncio.FIRST_COMPLETED)
        if not future.done():
            raise ConnectionError("the application closed the connection, or is stuck")
        return future.result()

    def arrived(self, message):
        # Stale ones show an earlier pose, while the newest is encoded.
        if not message["stale"] and self.arriving and not self.arriving.done():
            self.arriving.set_result(bytes(message["image"]))

    async def pose(self, eye):
        """Sends a pose and waits for its image: the JPEG and the milliseconds."""
        self.arriving = asyncio.get_running_loop().create_future()
        began = time.perf_counter()
        called = await self.session.call("trame.trigger", ["pose", [eye, self.args.target, self.args.up], {}])
        # The answer is sent before VTK has encoded, and tells what went wrong where no image will come.
        await self.reply(called)
        image = await self.reply(self.arriving)
        milliseconds = (time.perf_counter() - began) * 1e3
        return image, milliseconds

    def frame(self, degrees):
        """Milliseconds of a frame, which is looked at afterwards."""
        eye = vtk_draw.turned(self.args.eye, self.args.target, self.args.up, degrees)
        image, milliseconds = self.loop.run_until_complete(self.pose(eye))
        # Fails where bytes are missing.
        picture = Image.open(io.BytesIO(image), formats=["JPEG"])
        picture.load()
        if picture.size != self.args.size:
            sys.exit(f"trame_view.py: an image of {picture.size} where {self.args.size} was asked for")
        if image == self.shown:
            sys.exit(f"trame_view.py: the image at {degrees} degrees is the one before it")
        self.shown = image
        return milliseconds

    def described(self):
        return self.loop.run_until_complete(self.call("trame.trigger", "described", [], {}))

    async def leave(self):
        # Ends the listening, too.
        await self.socket.close()
        await self.http.close()
        await asyncio.wait({self.listening})

    def close(self):
        self.loop.run_until_complete(self.leave())
        self.application.stdin.close()
        try:
            self.application.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self.application.kill()
            self.application.wait()


def main():
    args = parse_arguments()
    if args.serve:
        serve(args)
        return
    client = Client(args)
    try:
        first_ms = client.frame(0.0)
        if args.save:
            with open(args.save, "wb") as file:
                file.write(client.shown)
        times = vtk_draw.timed(args, client.frame, client.load_ms, first_ms)
        if not times:
            return
        described = client.described()
        print(json.dumps({
            "peer": "trame",
            **described,
            "quality": args.quality,
            "bytes": len(client.shown),
            **vtk_draw.summarized(times, described, client.load_ms, first_ms),
        }))
    finally:
        client.close()


if __name__ == "__main__":
    main()
