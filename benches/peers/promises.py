#!/usr/bin/env python3
"""Checks promises of the program that need no timing, and writes what was found beside the bounds, as the benches do.

    promises.py target/release/pointillist --scenes scenes -o promises.json

- Every file of the hard scenes is drawn, or refused with a reason.
- A frame without an effect has the same bytes as one that never mentions it, and no pass of the effect.
- An image that is put together from parts is the image that is drawn at once.
- FLIP is what the published flip-evaluator computes.

Without flip-evaluator, numpy or pillow (benches/peers/install.sh), what needs them is left out and says so.
"""
import argparse
import base64
import contextlib
import copy
import io
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

try:
    import numpy
    from PIL import Image
except ImportError:
    numpy = None
try:
    import flip_evaluator
except ImportError:
    flip_evaluator = None

# Those whose settings the report compares, with its cameras.
SURVEYED = {"town": "overview", "plaza": "assembly", "relief": "front"}
SIZE = [480, 270]
# Seconds after which a file counts as neither drawn nor refused. Drivers compile shaders meanwhile.
PATIENCE_S = 120
# `tiles` draws it in four parts, whose borders cross at BORDERS.
SEAM_SIZE = [1900, 850]
# The unit tests of FLIP have the same bound. Single precision, which flip-evaluator computes with, causes less.
FLIP_MILLIONTHS = 20
BORDERS = [1856, 832]
# A pixel at the edge of a triangle may go to the other surface. A seam is a difference beside a border that is visible, in more pixels than elsewhere.
SEAM_PX, SEAM_STEPS = 2, 3


def has_shadows(light):
    return light["kind"] in ("sun", "point")


def casting(scene, is_on):
    """Whether the scene can have shadows, after they have been added to its lights or removed."""
    for light in filter(has_shadows, scene.get("lights", [])):
        if is_on:
            light["shadows"] = True
        else:
            # The last two say how wide the edges of shadows are, and are refused without them.
            for key in ("shadows", "radius", "angle"):
                light.pop(key, None)
    return any(map(has_shadows, scene.get("lights", [])))


def block(name, value):
    """A change of scenes that adds a block of the scene file, where it is not there, or removes it."""

    def change(scene, is_on):
        if is_on:
            scene.setdefault(name, value)
        else:
            scene.pop(name, None)
        return True

    return change


# Effects that a scene calls for: the setting that leaves them out, their passes and specialisations, and what calls for them.
CALLED_FOR = {
    "fog": ("fog=off", {"fog", "fog_background"}, block("fog", {"color": "#cfdbe6", "density": 0.05, "scale_height": 12})),
    "ambient occlusion": ("ao=off", {"ambient_occlusion"}, block("ambient_occlusion", {"radius": 0.3})),
    "shadows": ("shadows=off", {"shadow_map"}, casting),
}
# Effects that a request asks for, by settings that change nothing. Where a scene has the effect without being asked, it is left out.
ASKED_FOR = {
    "environment": ("environment=off", {"environment", "environment_background"}),
    "tone": ("exposure=0&tone_map=none", {"tone"}),
    "eye-dome light": ("edl=off", {"edl"}),
    "antialiasing": ("antialias=off", {"average"}),
    "lens and shutter": ("aperture=0&shutter=0", {"accumulate"}),
}


class Found:
    """Targets and tables in the form of benches/common/report.rs."""

    def __init__(self, is_quick):
        self.targets, self.tables, self.adapter, self.is_quick = [], [], "", is_quick

    def at_most(self, what, measured, limit, unit):
        self.target(what, measured, "≤", limit, unit, measured is not None and measured <= limit)

    def at_least(self, what, measured, limit, unit):
        self.target(what, measured, "≥", limit, unit, measured is not None and measured >= limit)

    def target(self, what, measured, sign, limit, unit, is_met):
        met = None if measured is None else bool(is_met)
        self.targets.append({"what": what, "measured": measured, "unit": unit, "target": f"{sign} {limit:g}", "limit": limit, "met": met})
        print(f"{ {True: 'met', False: 'NOT MET', None: 'not measured'}[met]}: {what}: {measured} {unit} (target {sign} {limit:g} {unit})")

    def table(self, title, columns, rows):
        self.tables.append({"title": title, "columns": columns, "rows": rows})

    def json(self):
        def git(*args):
            asked = subprocess.run(["git", *args], capture_output=True, text=True)
            return asked.stdout.strip() if asked.returncode == 0 else None

        changes = git("status", "--porcelain", "--untracked-files=no")
        cpus = [line for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
        machine = {
            "cpu": cpus[0].split(":")[1].strip() if cpus else None,
            "cores": len(os.sched_getaffinity(0)),
            "commit": git("rev-parse", "--short=12", "HEAD"),
            "changed_since_commit": None if changes is None else changes != "",
            "load_average_1_min": os.getloadavg()[0],
        }
        return {
            "bench": "promises", "quick": self.is_quick, "adapter": self.adapter, "machine": machine,
            "values": {}, "tables": self.tables, "targets": self.targets,
        }


class Daemon:
    """A server of the scenes in a folder."""

    def __init__(self, binary, root):
        self.log = tempfile.TemporaryFile()
        quiet = {"POINTILLIST_NO_PRIME": "true", "POINTILLIST_NO_CACHE": "true", "POINTILLIST_NO_JOBS": "true"}
        environment = {name: value for name, value in os.environ.items() if name != "POINTILLIST_CONFIG"}
        self.child = subprocess.Popen(
            [binary, "serve", "--listen", "127.0.0.1:0", "--root", root],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=self.log, text=True, env=environment | quiet,
        )
        self.address = ""
        for line in self.child.stdout:
            if line.startswith("listening on "):
                self.address = line.split()[-1]
                break

    def __enter__(self):
        deadline = time.monotonic() + 4 * PATIENCE_S
        while self.address and self.child.poll() is None and time.monotonic() < deadline:
            with contextlib.suppress(urllib.error.URLError):
                with urllib.request.urlopen(self.address + "/readyz"):
                    return self
            time.sleep(0.02)
        self.__exit__()
        self.log.seek(0)
        sys.exit(f"promises.py: the server does not become ready:\n{self.log.read().decode(errors='replace')}")

    def __exit__(self, *_):
        self.child.terminate()
        self.child.wait()

    def frame(self, scene, settings):
        """Bytes of a frame, its receipt, and the names of the passes and effects that ran."""
        image, headers = opened(f"{self.address}/v1/scenes/{scene}/frame?{settings}")
        receipt = json.loads(headers["Pointillist-Receipt"])
        # A pass with a time ran, whatever its line says.
        lines = receipt["passes"] + receipt["specialisations"]
        ran = {line["name"] for line in lines if line["ran"] or line.get("gpu_ns") is not None}
        return image, receipt, ran

    def compare(self, scene, wanted):
        body = json.dumps(wanted).encode()
        asked = urllib.request.Request(f"{self.address}/v1/scenes/{scene}/compare", body, {"Content-Type": "application/json"})
        return json.loads(opened(asked)[0])


def opened(asked):
    """Body and headers of an answer; ends with the server's reason where it refuses."""
    try:
        with urllib.request.urlopen(asked) as answer:
            return answer.read(), answer.headers
    except urllib.error.HTTPError as error:
        address = asked if isinstance(asked, str) else asked.full_url
        sys.exit(f"promises.py: {address}: {error.read().decode(errors='replace')}")


def hard_files(found, binary, folder, out):
    files = sorted(path for path in folder.iterdir() if path.is_file())
    files = files[:2] if found.is_quick else files
    counts, odd = {"drawn": 0, "refused": 0}, []
    for path in files:
        image = out / "hard.raw"
        image.unlink(missing_ok=True)
        try:
            ended = subprocess.run(
                [binary, "render", path, "--size", "64x48", "-o", image, "--no-cache"], capture_output=True, text=True, errors="replace", timeout=PATIENCE_S
            )
        except subprocess.TimeoutExpired:
            odd.append([path.name, f"neither after {PATIENCE_S} s"])
            continue
        if ended.returncode == 0 and image.exists() and image.stat().st_size == 4 * 64 * 48:
            counts["drawn"] += 1
        elif ended.returncode == 1 and any(line.startswith("pointillist: ") for line in ended.stderr.splitlines()):
            counts["refused"] += 1
        else:
            odd.append([path.name, f"ended with status {ended.returncode}"])
    told = f"files of {folder} drawn ({counts['drawn']}) or refused with a reason ({counts['refused']}), of {len(files)}"
    found.at_least(told, len(files) - len(odd), len(files), "files")
    if odd:
        found.table(f"Files of {folder} that were neither drawn nor refused", ["file", "how"], odd)


def variants(root, names):
    """Writes each scene with and without what calls for each effect. Returns scene, effect and the names of both."""
    made = []
    for name in names:
        scene = json.loads((root / f"{name}.json").read_text())
        for effect, (_, _, change) in CALLED_FOR.items():
            pair = []
            for is_on in (True, False):
                changed = copy.deepcopy(scene)
                if not change(changed, is_on):
                    break
                # A scene that is so already serves as it is.
                pair.append(name)
                if changed != scene:
                    pair[-1] = f"{name}-{'with' if is_on else 'without'}-{effect.replace(' ', '-')}"
                    (root / f"{pair[-1]}.json").write_text(json.dumps(changed))
            if len(pair) == 2:
                made.append((name, effect, *pair))
    return made


def effects(found, daemon, root, names, made):
    pairs, different, ran_still, table = 0, 0, 0, {effect: [0, 0, 0] for effect in [*CALLED_FOR, *ASKED_FOR]}
    frames = {}

    def drawn(scene, camera, setting):
        asked = f"camera={camera}&w=160&h=90&format=raw&{setting}"
        if (scene, asked) not in frames:
            frames[scene, asked] = daemon.frame(scene, asked)
        return frames[scene, asked]

    def judge(effect, own, off, without):
        nonlocal pairs, different, ran_still
        counts = [1, off[0] != without[0], bool(own & (off[2] | without[2]))]
        pairs, different, ran_still = pairs + counts[0], different + counts[1], ran_still + counts[2]
        table[effect] = [sum(both) for both in zip(table[effect], counts)]

    _, receipt, _ = daemon.frame(names[0], "w=16&h=16&format=raw")
    known = {line["name"] for line in receipt["passes"] + receipt["specialisations"]}
    named = set().union(*(own for _, own, _ in CALLED_FOR.values()), *(own for _, own in ASKED_FOR.values()))
    if not named <= known:
        sys.exit(f"promises.py: no pass or effect is called {', '.join(sorted(named - known))}")

    cameras = {name: next(iter(json.loads((root / f"{name}.json").read_text())["cameras"])) for name in names}
    for name, effect, with_it, without_it in made:
        off, own, _ = CALLED_FOR[effect]
        on = drawn(with_it, cameras[name], "")
        # An effect that this way of drawing cannot have anyway would prove nothing.
        if on[2] & own:
            judge(effect, own, drawn(with_it, cameras[name], off), drawn(without_it, cameras[name], ""))
    for name in names:
        plain = drawn(name, cameras[name], "")
        found.adapter = plain[1]["adapter"]
        for effect, (off, own) in ASKED_FOR.items():
            if not plain[2] & own:
                judge(effect, own, drawn(name, cameras[name], off), plain)
    found.at_most(f"frames without an effect that differ from frames that never mention it, of {pairs} (scenes × effects)", different, 0, "frames")
    found.at_most(f"frames without an effect in which a pass of it ran or was timed, of {pairs}", ran_still, 0, "frames")
    rows = [[effect, *map(str, counts)] for effect, counts in table.items()]
    found.table(f"Frames without an effect, of {len(names)} scenes", ["effect", "frames", "other bytes", "a pass ran"], rows)


def seams(found, binary, root, names, out):
    at_all = f"pixels of images of parts that differ from the image drawn at once, of {len(names)} scenes"
    by_more = f"pixels within {SEAM_PX} of a border of parts that differ by more than {SEAM_STEPS} of 255, beyond the share elsewhere, worst of {len(names)} scenes"
    if numpy is None:
        found.at_most(at_all, None, 0, "pixels")
        found.at_most(by_more, None, 0, "pixels")
        return
    rows, worst, different = [], 0.0, 0
    near = numpy.zeros((SEAM_SIZE[1], SEAM_SIZE[0]), dtype=bool)
    near[:, BORDERS[0] - SEAM_PX : BORDERS[0] + SEAM_PX] = True
    near[BORDERS[1] - SEAM_PX : BORDERS[1] + SEAM_PX, :] = True
    for name in names:
        images = []
        for command in ("render", "tiles"):
            image = out / f"{command}.png"
            size = "x".join(map(str, SEAM_SIZE))
            subprocess.run(
                [binary, command, root / f"{name}.json", "--camera", SURVEYED[name], "--size", size, "--edl", "off", "-o", image],
                check=True, stderr=subprocess.DEVNULL,
            )
            images.append(numpy.asarray(Image.open(image).convert("RGBA")).astype(int))
        apart = abs(images[0] - images[1]).max(axis=2)
        visible = apart > SEAM_STEPS
        excess = float(visible[near].sum() - visible[~near].mean() * near.sum())
        worst, different = max(worst, excess), different + int((apart > 0).sum())
        rows.append([name, str(apart.size), str((apart > 0).sum()), str(visible.sum()), str(visible[near].sum()), str(apart.max())])
    found.at_most(at_all, different, 0, "pixels")
    found.at_most(by_more, worst, 0, "pixels")
    columns = ["scene", "pixels", "that differ", f"by more than {SEAM_STEPS}", "of these beside a border", "largest difference"]
    found.table(f"`pointillist tiles` at {SEAM_SIZE[0]} × {SEAM_SIZE[1]}, beside `render`", columns, rows)


def flip(found, daemon, names):
    if numpy is None or flip_evaluator is None:
        found.at_most("FLIP, largest difference from flip-evaluator", None, FLIP_MILLIONTHS, "millionths")
        return
    rows, worst = [], 0.0
    for name in names:
        wanted = {"camera": SURVEYED[name], "w": SIZE[0], "h": SIZE[1], "a": {}, "b": {"antialias": "16x"}}
        answer = daemon.compare(name, wanted)

        def pixels(side):
            png = base64.b64decode(answer[side]["image"].split(",", 1)[1])
            return numpy.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(numpy.float32) / 255

        _, theirs, _ = flip_evaluator.evaluate(pixels("b"), pixels("a"), "LDR", parameters={"ppd": 67})
        ours = answer["flip"]
        assert ours > 0, f"{name}: both frames are equal, so that FLIP shows nothing"
        worst = max(worst, 1e6 * abs(ours - theirs))
        rows.append([name, f"{ours:.6f}", f"{theirs:.6f}"])
    found.at_most(f"FLIP, largest difference from flip-evaluator, of {len(names)} scenes", worst, FLIP_MILLIONTHS, "millionths")
    found.table("FLIP of each scene without antialiasing against `antialias=16x`", ["scene", "ours", "flip-evaluator"], rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary", type=pathlib.Path)
    parser.add_argument("--scenes", type=pathlib.Path, default="scenes")
    parser.add_argument("-o", "--out", type=pathlib.Path, required=True)
    parser.add_argument("--quick", action="store_true", help="a smoke check of a few files and one scene")
    args = parser.parse_args()
    binary = args.binary.resolve()
    found = Found(args.quick)
    surveyed = ["relief"] if args.quick else list(SURVEYED)
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder)
        hard_files(found, binary, args.scenes / "hard", out)
        root = out / "scenes"
        root.mkdir()
        for path in args.scenes.iterdir():
            if path.is_file():
                shutil.copy(path, root)
        names = surveyed if args.quick else sorted(path.stem for path in root.glob("*.json"))
        seams(found, binary, root, surveyed, out)
        made = variants(root, names)
        with Daemon(binary, root) as daemon:
            effects(found, daemon, root, names, made)
            flip(found, daemon, surveyed)
    args.out.write_text(json.dumps(found.json(), indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
