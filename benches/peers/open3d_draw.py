#!/usr/bin/env python3
"""Draws the vertices of one PLY with Open3D, off screen, at a given pose, and prints what a frame costs as JSON.

    open3d_draw.py cloud.ply --eye 0,0,4 --target 0,0,0 --size 1024x1024 --point-size 3 --png frame.png

Points are squares of --point-size pixels, unlit and without post-processing, which would change colours. `--multisamples 1` turns the four
samples a pixel off that Open3D has by default. What else is asked for and printed is as in vtk_draw.py, `--interactive` too.

What is timed is `render_to_image()`, which also reads the image back: Open3D has no call that draws alone and waits.
"""
import json
import os
import sys
import time

import numpy as np

# Its options, its reader and its turning camera; VTK itself draws nothing here.
import vtk_draw

try:
    import open3d
    from open3d.visualization import rendering
except (ImportError, OSError) as error:
    sys.exit(f"open3d_draw.py: no Open3D here ({error}); run benches/peers/install.sh and use its python")


def cloud_of(path):
    """The file's vertices with their colours."""
    vertices = vtk_draw.read_vertices(path)
    if vertices is None or not {"red", "green", "blue"} <= set(vertices.dtype.names):
        sys.exit(f"{path}: not a binary PLY whose first element is vertices with colours")
    positions = np.stack([vertices[axis].astype("f8") for axis in "xyz"], axis=1)
    colors = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1) / 255.0
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions))
    cloud.colors = open3d.utility.Vector3dVector(colors)
    return cloud


def keep_output():
    """Leaves standard output to this script alone: Open3D logs to Python's, and Filament to the process's."""
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    sys.stdout = os.fdopen(os.dup(1), "w", buffering=1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)


def main():
    parser = vtk_draw.scene_arguments(__doc__.split("\n\n")[0])
    parser.add_argument("--png", help="write the unturned frame here")
    parser.set_defaults(multisamples=4)
    args = parser.parse_args()
    if not args.eye or not args.target:
        parser.error("the pose is needed: --eye and --target")
    keep_output()
    began = time.perf_counter()
    cloud = cloud_of(args.ply)
    renderer = rendering.OffscreenRenderer(*args.size)
    renderer.scene.set_background([0.0, 0.0, 0.0, 1.0])
    renderer.scene.view.set_post_processing(False)
    renderer.scene.view.set_sample_count(args.multisamples)
    material = rendering.MaterialRecord()
    material.shader = "defaultUnlit"
    material.point_size = args.point_size
    renderer.scene.add_geometry("cloud", cloud, material)
    load_ms = (time.perf_counter() - began) * 1e3
    last = None

    def frame(degrees, distance=1.0):
        nonlocal last
        started = time.perf_counter()
        eye = np.asarray(vtk_draw.turned(args.eye, args.target, args.up, degrees))
        eye = np.asarray(args.target) + distance * (eye - args.target)
        renderer.setup_camera(args.fov, args.target, eye.tolist(), args.up)
        last = renderer.render_to_image()
        return (time.perf_counter() - started) * 1e3

    def save(file):
        if not open3d.io.write_image(file, last):
            sys.exit(f"{file}: cannot be written")

    first_ms = frame(0.0)
    if args.png:
        save(args.png)
    times = vtk_draw.timed(args, frame, load_ms, first_ms, save)
    if not times:
        return
    described = {
        "version": open3d.__version__,
        "file": args.ply,
        "mode": "points",
        "multisamples": args.multisamples,
        "point_size": args.point_size,
        "width": args.size[0],
        "height": args.size[1],
        "points": len(cloud.points),
        "triangles": 0,
    }
    summary = vtk_draw.summarized(times, described, load_ms, first_ms)
    print(json.dumps({"peer": "open3d", **described, **summary}))


if __name__ == "__main__":
    main()
