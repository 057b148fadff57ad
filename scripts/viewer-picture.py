"""Takes a picture of the viewer through chromedriver, once the frame at rest is there.

    python3 scripts/viewer-picture.py CHROMEDRIVER URL OUT.png
"""

import base64
import json
import subprocess
import sys
import time
import urllib.request

SECONDS = 120
ARGUMENTS = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
SIZE = {"width": 1440, "height": 900}
STATE = "return document.querySelector('canvas').dataset.state"


def main(driver, url, out):
    process = subprocess.Popen([driver, "--port=0"], stdout=subprocess.PIPE, text=True)
    try:
        port = next(line.split()[-1].rstrip(".") for line in process.stdout if "successfully on port" in line)

        def call(method, path, body=None):
            data = None if body is None else json.dumps(body).encode()
            address = f"http://127.0.0.1:{port}/session{path}"
            request = urllib.request.Request(address, data, method=method)
            request.add_header("content-type", "application/json")
            with urllib.request.urlopen(request, timeout=SECONDS) as answer:
                return json.load(answer)["value"]

        options = {"goog:chromeOptions": {"args": ARGUMENTS}}
        session = "/" + call("POST", "", {"capabilities": {"alwaysMatch": options}})["sessionId"]
        call("POST", session + "/window/rect", SIZE)
        call("POST", session + "/url", {"url": url})
        end = time.monotonic() + SECONDS
        while call("POST", session + "/execute/sync", {"script": STATE, "args": []}) != "still":
            if time.monotonic() > end:
                sys.exit(f"viewer-picture: no frame at rest within {SECONDS} s")
            time.sleep(0.5)
        with open(out, "wb") as file:
            file.write(base64.b64decode(call("GET", session + "/screenshot")))
        call("DELETE", session)
    finally:
        process.terminate()


main(*sys.argv[1:])
