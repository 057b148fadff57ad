#!/usr/bin/env python3
"""Draws rows with two builds in turns, and prints the ratios of their GPU times and whether their frames have equal bytes.

    scripts/compare.py BASE NEW [--folder FOLDER] [--rounds N] [--repeat N] [--rows REGEX]

BASE and NEW are programs. `scripts/compare.sh` builds them from commits. A row is a scene, a pose and settings. Both builds get the pose of NEW.
Each build draws the scene files of its own commit, since an older one may not know all keys. An option that a build does not have is left out there,
and the row says so.
"""

import argparse
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys

# Files that rows draw besides the scenes of the repository, and the arguments of `generate` that make them.
FILES = {
    "statue-1m.ply": ["statue", "--points", "1000000"],
    "relief-100k.ply": ["relief", "--triangles", "100000"],
    "town-2m.ply": ["town", "--points", "2000000"],
}
# Name, scene, options.
ROWS = [
    ("statue points", "statue-1m.ply", "--reconstruct points --edl off"),
    ("statue splats", "statue-1m.ply", "--reconstruct splats"),
    ("statue fuzzy", "statue-1m.ply", "--reconstruct fuzzy"),
    ("statue spt points", "statue-1m.ply", "--lod spt --reconstruct points"),
    ("statue spt splats", "statue-1m.ply", "--lod spt --reconstruct splats"),
    ("relief triangles", "relief-100k.ply", ""),
    ("relief spt splats", "relief-100k.ply", "--lod spt --reconstruct splats"),
    ("town points", "town-2m.ply", "--reconstruct points --edl off"),
    ("town splats", "town-2m.ply", "--reconstruct splats --edl off"),
    ("town depth", "town-2m.ply", "--reconstruct points --output depth"),
    ("plaza assembly", "scenes/plaza.json", "--camera assembly --reconstruct points --edl off"),
    ("plaza spt splats", "scenes/plaza.json", "--camera overview --lod spt --reconstruct splats"),
    ("textured front", "scenes/textured.json", "--camera front --reconstruct points"),
    ("part front", "scenes/part.json", "--camera front --reconstruct splats"),
]
# At most so many frames at first, which build pipelines and trees.
WARM_UP = 2


def fail(text):
    sys.exit(f"compare: {text}")


class Program:
    """A build, with the options that its `render` has, and the folder that holds its commit's `scenes/`."""

    def __init__(self, path, name, root, folder):
        self.path, self.name, self.root = path.resolve(), name, root
        self.state = folder / f"state-{name}"
        self.state.mkdir(parents=True, exist_ok=True)
        shown = subprocess.run([self.path, "render", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if shown.returncode:
            fail(f"{path}: `render --help` fails: {shown.stderr.strip()}")
        self.options = set(re.findall(r"--[a-z][a-z-]*", shown.stdout))

    def known(self, options):
        """Splits options with one value each into those that this build has and those that it lacks."""
        pairs = list(zip(options[::2], options[1::2]))
        kept = [word for pair in pairs if pair[0] in self.options for word in pair]
        return kept, [" ".join(pair) for pair in pairs if pair[0] not in self.options]

    def draw(self, scene, options, size, repeat, image):
        """Draws a frame into a file, and returns its receipt."""
        receipt = image.with_suffix(".json")
        command = [self.path, "render", scene, "-o", image, "--size", size, "--receipt", receipt, "--repeat", str(repeat), *options]
        environment = {**os.environ, "POINTILLIST_CACHE": str(self.state)}
        ran = subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if ran.returncode:
            fail(f"{self.name}: `{' '.join(map(str, command[1:]))}` fails: {ran.stderr.strip()[-500:]}")
        return json.loads(receipt.read_text())


def make_files(program, folder, names):
    for name, arguments in FILES.items():
        file = folder / name
        if name in names and not file.exists():
            partial = folder / f"partial-{name}"
            subprocess.run([program.path, "generate", *arguments, "-o", partial], check=True, stdout=subprocess.DEVNULL)
            partial.rename(file)


def pose_of(receipt):
    """The options of a pose that a receipt tells."""
    camera = receipt["camera"]
    vector = lambda name: ",".join(map(str, camera[name]))
    return ["--eye", vector("eye"), "--target", vector("target"), "--up", vector("up"), "--fov", str(camera["fov_deg"])]


PROJECTING = ("project_", "walk_", "rasterise_")


def gpu_ms(receipt):
    """GPU times of a frame, and of its passes that are not those of projection."""
    if receipt["gpu_ns"] is None:
        fail("the adapter measures no GPU time")
    projecting = [entry.get("gpu_ns") for entry in receipt["passes"] if entry["name"].startswith(PROJECTING)]
    # A pass that did not run has no time; in a frame that is timed, one that ran has.
    projecting = sum(ns for ns in projecting if ns is not None)
    return receipt["gpu_ns"] / 1e6, (receipt["gpu_ns"] - projecting) / 1e6


class Row:
    """`times`: for each build, pairs of a frame's time and of that without projection, a pair a round."""

    def __init__(self, name, times, is_equal, left_out):
        self.name, self.times, self.is_equal, self.left_out = name, times, is_equal, left_out

    def figures(self):
        base, new = ([whole for whole, _ in pairs] for pairs in self.times)
        ratios = sorted(b / a for a, b in zip(base, new))
        rest = [b / a for (_, a), (_, b) in zip(*self.times) if a > 0]
        return {
            "row": self.name,
            "base_ms": {"min": min(base), "median": statistics.median(base)},
            "new_ms": {"min": min(new), "median": statistics.median(new)},
            "ratio_of_min": min(new) / min(base),
            # The median is that of the rounds' ratios, since a machine's speed changes from round to round.
            "ratio": {"median": statistics.median(ratios), "least": ratios[0], "most": ratios[-1]},
            "ratio_without_projection": statistics.median(rest) if rest else None,
            "equal_bytes": self.is_equal,
            "left_out": self.left_out,
        }


def measure(row, programs, options):
    name, scene, settings = row
    paths = [options.folder / scene if scene in FILES else program.root / scene for program in programs]
    settings = settings.split()
    images = [options.folder / f"frame-{program.name}.png" for program in programs]
    kept, _ = programs[1].known(settings)
    pose = pose_of(programs[1].draw(paths[1], kept, options.size, 1, images[1]))
    if "--camera" in settings:
        at = settings.index("--camera")
        del settings[at : at + 2]
    settings += pose
    plans = [program.known(settings) for program in programs]

    def draw(index, repeat):
        return programs[index].draw(paths[index], plans[index][0], options.size, repeat, images[index])

    for index in (0, 1):
        draw(index, WARM_UP)
    times = ([], [])
    for number in range(options.rounds):
        # Neither build is always the one that follows.
        for index in (0, 1) if number % 2 == 0 else (1, 0):
            times[index].append(gpu_ms(draw(index, options.repeat)))
    is_equal = images[0].read_bytes() == images[1].read_bytes()
    left_out = [f"{program.name}: {words}" for program, (_, lacking) in zip(programs, plans) for words in lacking]
    return Row(name, times, is_equal, left_out)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("base", type=pathlib.Path)
    parser.add_argument("new", type=pathlib.Path)
    parser.add_argument("--base-root", type=pathlib.Path, default=pathlib.Path("."), help="folder with the scenes/ of BASE")
    parser.add_argument("--new-root", type=pathlib.Path, default=pathlib.Path("."))
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path("target/compare"))
    parser.add_argument("--rounds", type=int, default=int(os.environ.get("COMPARE_ROUNDS", "7")))
    parser.add_argument("--repeat", type=int, default=int(os.environ.get("COMPARE_REPEAT", "3")))
    parser.add_argument("--rows", type=re.compile, default=re.compile(os.environ.get("COMPARE_ROWS", "")))
    parser.add_argument("--size", default="1024x1024")
    options = parser.parse_args()
    if options.rounds < 1 or options.repeat < 1:
        fail("--rounds and --repeat must be at least 1")
    rows = [row for row in ROWS if options.rows.search(row[0])]
    if not rows:
        fail(f"no row matches `{options.rows.pattern}`; rows are {', '.join(row[0] for row in ROWS)}")
    options.folder.mkdir(parents=True, exist_ok=True)
    programs = [
        Program(options.base, "base", options.base_root, options.folder),
        Program(options.new, "new", options.new_root, options.folder),
    ]
    make_files(programs[1], options.folder, {scene for _, scene, _ in rows})
    print(f"{options.size}, {options.rounds} rounds in turns, each the median of {options.repeat} frames")
    print("ratios are new / base; below 1, the new build is faster")
    print()
    print("| row | base ms (min, median) | new ms (min, median) | ratio of min | ratio of each round: median (least to most) | without projection | bytes |")
    print("|---|---:|---:|---:|---:|---:|---|")
    results = []
    for row in rows:
        found = measure(row, programs, options).figures()
        results.append(found)
        rest = found["ratio_without_projection"]
        base, new, ratio = found["base_ms"], found["new_ms"], found["ratio"]
        notes = "equal" if found["equal_bytes"] else "differ"
        if found["left_out"]:
            notes += f" (left out: {'; '.join(found['left_out'])})"
        print(
            f"| {found['row']} | {base['min']:.2f}, {base['median']:.2f} | {new['min']:.2f}, {new['median']:.2f} "
            f"| {found['ratio_of_min']:.3f} | {ratio['median']:.3f} ({ratio['least']:.3f} to {ratio['most']:.3f}) "
            f"| {'–' if rest is None else f'{rest:.3f}'} | {notes} |",
            flush=True,
        )
    (options.folder / "compare.json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
