#!/usr/bin/env python3
"""Draws one PLY with VTK, off screen, at a given pose, and prints what a frame costs as JSON.

    vtk_draw.py cloud.ply --eye 0,0,4 --target 0,0,0 --size 1024x1024 --png frame.png

Five ways to draw (`--mode`), each VTK's own:
  points     one hardware point a sample (vtkPolyDataMapper, point size 1, no lighting)
  point-gaussian   vtkPointGaussianMapper with scale factor 0: its fastest path for large clouds
  splats     vtkPointGaussianMapper, an unlit disc of --radius scene units a sample
  gaussians  vtkPointGaussianMapper as it is made: blended Gaussians, here cut off at --radius, two standard deviations
  surface    the file's triangles, smooth shaded
  tubes      vtkTubeFilter over the polylines of a legacy `.vtk` file, of --radius scene units and --sides sides

Everything else is off by default, which is as fast as VTK gets here; `--lighting`, `--multisamples`,
`--point-size`, `--spheres`, `--colors lut` and `--window` turn on, one by one, what VTK, PyVista and ParaView
do when they are told nothing.

What is timed is `Render()` with the camera turned a little before each frame, then a wait until the
driver has drawn (without it the call may return early). Loading, the first frame (upload, shader
compilation) and `--warmup` more are outside; `first_ms` gives the first frame apart. With `--jpeg Q`
or `--encode-png` the whole image is read back and encoded into memory within the timed part, as a
server would have to.

With `--remote Q` a frame is what a remote view of trame or ParaViewWeb does for it on the server: `vtkWebApplication` draws, reads back
and has a JPEG of that quality encoded. It encodes in a thread of its own and is not waited for: the bytes it gives are those of the frame
before. The network, and Python's part in it, are left out; `trame_view.py` has them, and waits.

A `.json` in the PLY's place is a scene of copies: a list of `{"file": …, "matrices": [[16 numbers, column by column], …]}`, each file
drawn by one `vtkGlyph3DMapper`. Matrices turn, scale evenly and move.

With `--interactive` the frames come on request, so that another program's can be timed in between: one line
`{"ready": …}` when all is loaded and warm, then for each line on standard input, a number of degrees, one
line with that frame's milliseconds; the summary follows the end of the input. A second number is the camera's distance, in units
of the pose's own. What follows it on the line is a file that the frame is written to as a PNG, outside of what is timed.
"""
import argparse
import json
import math
import os
import statistics
import sys
import time

import numpy as np

try:
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy
except ImportError:
    sys.exit("vtk_draw.py: no vtk here; run benches/peers/install.sh and use its python")

PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}


def vector(text):
    parts = [float(part) for part in text.split(",")]
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"expected x,y,z, found {text!r}")
    return parts


def size(text):
    width, _, height = text.lower().partition("x")
    return int(width), int(height)


def read_vertices(path):
    """The vertex element of a binary PLY as a numpy record array, or None where VTK's reader must do."""
    with open(path, "rb") as file:
        if file.readline().strip() != b"ply":
            sys.exit(f"{path}: not a PLY file")
        order, count, fields, element = None, 0, [], None
        first = None
        while True:
            line = file.readline()
            if not line:
                sys.exit(f"{path}: the header has no end_header")
            words = line.decode("ascii", "replace").split()
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "end_header":
                break
            if words[0] == "format":
                order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1])
            elif words[0] == "element":
                element = words[1]
                first = first or element
                if element == "vertex":
                    count = int(words[2])
            elif words[0] == "property" and element == "vertex":
                if words[1] == "list":
                    return None
                fields.append((words[2], words[1]))
        if order is None or first != "vertex":
            return None
        dtype = np.dtype([(name, order + PLY_TYPES[kind]) for name, kind in fields])
        vertices = np.fromfile(file, dtype=dtype, count=count)
        if len(vertices) != count:
            sys.exit(f"{path}: {count} vertices promised, {len(vertices)} found")
        return vertices


def load(path, mode, coloring):
    """PLY → vtkPolyData, and whether it has colours."""
    vertices = None if mode == "surface" else read_vertices(path)
    data = vtk.vtkPolyData()
    if vertices is None:
        reader = vtk.vtkPLYReader()
        reader.SetFileName(path)
        reader.Update()
        data.ShallowCopy(reader.GetOutput())
        colors = data.GetPointData().GetArray("RGB") or data.GetPointData().GetArray("RGBA")
        if colors is not None:
            data.GetPointData().SetScalars(colors)
    else:
        positions = np.stack([vertices[axis].astype("f4") for axis in "xyz"], axis=1)
        points = vtk.vtkPoints()
        points.SetData(numpy_to_vtk(positions, deep=True))
        data.SetPoints(points)
        colors = None
        if {"red", "green", "blue"} <= set(vertices.dtype.names):
            rgb = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1)
            colors = numpy_to_vtk(np.ascontiguousarray(rgb), deep=True)
            data.GetPointData().SetScalars(colors)
        if coloring == "lut":
            height = np.ascontiguousarray(positions[:, 2])
            colors = numpy_to_vtk(height, deep=True)
            data.GetPointData().SetScalars(colors)
    if coloring == "none":
        data.GetPointData().SetScalars(None)
        colors = None
    if mode == "surface":
        if data.GetNumberOfPolys() == 0:
            sys.exit(f"{path}: no faces to draw as a surface")
        if data.GetPointData().GetNormals() is None:
            normals = vtk.vtkPolyDataNormals()
            normals.SetInputData(data)
            normals.SplittingOff()
            normals.Update()
            data = normals.GetOutput()
        return data, colors is not None
    count = data.GetNumberOfPoints()
    if mode == "points":
        cells = vtk.vtkCellArray()
        offsets = numpy_to_vtk(np.arange(count + 1, dtype=np.int32), deep=True, array_type=vtk.VTK_INT)
        indices = numpy_to_vtk(np.arange(count, dtype=np.int32), deep=True, array_type=vtk.VTK_INT)
        cells.SetData(offsets, indices)
        data.SetVerts(cells)
        data.SetPolys(vtk.vtkCellArray())
    return data, colors is not None


def tubes(path, radius, sides):
    """Triangle strips around the polylines of a file, with normals."""
    reader = vtk.vtkPolyDataReader()
    reader.SetFileName(path)
    tube = vtk.vtkTubeFilter()
    tube.SetInputConnection(reader.GetOutputPort())
    tube.SetRadius(radius)
    tube.SetNumberOfSides(sides)
    tube.CappingOn()
    tube.Update()
    if tube.GetOutput().GetNumberOfStrips() == 0:
        sys.exit(f"{path}: no polylines to draw as tubes")
    data = vtk.vtkPolyData()
    # Without the filter, which keeps its input.
    data.ShallowCopy(tube.GetOutput())
    return data


def triangles_of(data):
    """How many triangles a mesh has, those of strips included."""
    strips = data.GetStrips()
    return data.GetNumberOfPolys() + strips.GetNumberOfConnectivityIds() - 2 * strips.GetNumberOfCells()


def glyphs(path):
    """One actor a file of a scene of copies, the box around them, and how many triangles are drawn."""
    with open(path) as file:
        parts = json.load(file)
    actors, corners, triangles = [], [], 0
    for part in parts:
        data, has_colors = load(part["file"], "surface", "file")
        matrices = np.array(part["matrices"], dtype=float).reshape(-1, 4, 4).transpose(0, 2, 1)
        scales = np.linalg.norm(matrices[:, :3, 0], axis=1)
        # w, x, y, z; the turns of scenes are far from half a turn's degenerate case, which `max` keeps finite.
        turns = matrices[:, :3, :3] / scales[:, None, None]
        w = 0.5 * np.sqrt(np.maximum(1 + turns[:, 0, 0] + turns[:, 1, 1] + turns[:, 2, 2], 1e-12))
        x = (turns[:, 2, 1] - turns[:, 1, 2]) / (4 * w)
        y = (turns[:, 0, 2] - turns[:, 2, 0]) / (4 * w)
        z = (turns[:, 1, 0] - turns[:, 0, 1]) / (4 * w)
        half = np.trace(turns, axis1=1, axis2=2) < -0.999
        # Half turns in these scenes are about the upright axis.
        w[half], x[half], y[half], z[half] = 0.0, 0.0, 1.0, 0.0
        places = vtk.vtkPolyData()
        points = vtk.vtkPoints()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(matrices[:, :3, 3]), deep=True))
        places.SetPoints(points)
        for name, values in (("turn", np.stack([w, x, y, z], axis=1)), ("scale", scales)):
            array = numpy_to_vtk(np.ascontiguousarray(values.astype("f4")), deep=True)
            array.SetName(name)
            places.GetPointData().AddArray(array)
        mapper = vtk.vtkGlyph3DMapper()
        mapper.SetInputData(places)
        mapper.SetSourceData(data)
        mapper.SetOrientationArray("turn")
        mapper.SetOrientationModeToQuaternion()
        mapper.SetScaleArray("scale")
        mapper.SetScaleModeToScaleByMagnitude()
        # Colours are the mesh's own, not those of the places.
        mapper.SetScalarVisibility(False)
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().SetInterpolationToPhong()
        actors.append(actor)
        corners += [matrices[:, :3, 3].min(axis=0), matrices[:, :3, 3].max(axis=0)]
        triangles += data.GetNumberOfPolys() * len(matrices)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return actors, np.stack([low, high], axis=1), triangles


def make_actor(data, has_colors, args):
    mode = args.mode
    if mode in ("points", "surface", "tubes"):
        mapper = vtk.vtkPolyDataMapper()
    else:
        mapper = vtk.vtkPointGaussianMapper()
        mapper.EmissiveOff()
        mapper.SetScaleFactor({"splats": args.radius, "gaussians": args.radius / 2}.get(mode, 0.0))
        # Triangles no larger than what is drawn of them; VTK's own bound of 3 shades nine times a disc's area.
        tight = {"splats": 1.0, "gaussians": 2.0}.get(mode, 3.0)
        mapper.SetBoundScale(tight if args.bound_scale is None else args.bound_scale)
        if mode == "splats":
            mapper.SetSplatShaderCode(
                "//VTK::Color::Impl\n"
                "float dist2 = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);\n"
                "if (dist2 > 1.0) { discard; }\n"
            )
    mapper.SetInputData(data)
    mapper.SetScalarVisibility(has_colors)
    if args.colors == "lut" and has_colors:
        mapper.SetScalarRange(data.GetPointData().GetScalars().GetRange())
    actor = vtk.vtkActor()
    actor.SetMapper(mapper)
    actor.GetProperty().SetPointSize(args.point_size)
    actor.GetProperty().SetRenderPointsAsSpheres(args.spheres)
    if mode in ("surface", "tubes"):
        actor.GetProperty().SetInterpolationToPhong()
    else:
        actor.GetProperty().SetLighting(args.lighting)
    return actor


def turned(eye, target, up, degrees):
    """The eye, turned about the target's up axis by `degrees`."""
    eye, target, up = (np.asarray(v, dtype=float) for v in (eye, target, up))
    axis = up / np.linalg.norm(up)
    angle = math.radians(degrees)
    offset = eye - target
    offset = (
        offset * math.cos(angle)
        + np.cross(axis, offset) * math.sin(angle)
        + axis * np.dot(axis, offset) * (1 - math.cos(angle))
    )
    return (target + offset).tolist()


class Scene:
    """What is drawn, in a window off screen; nothing is drawn yet."""

    def __init__(self, args):
        if args.window:
            kind = {"egl": "vtkEGLRenderWindow", "osmesa": "vtkOSOpenGLRenderWindow"}[args.window]
            os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = kind
        began = time.perf_counter()
        if args.ply.endswith(".json"):
            actors, low_high, self.triangles = glyphs(args.ply)
            self.has_colors, self.points = False, 0
        else:
            if args.mode == "tubes":
                data, self.has_colors = tubes(args.ply, args.radius, args.sides), False
            else:
                data, self.has_colors = load(args.ply, args.mode, args.colors)
            actors = [make_actor(data, self.has_colors, args)]
            low_high = np.array(data.GetBounds()).reshape(3, 2)
            self.points, self.triangles = data.GetNumberOfPoints(), triangles_of(data)
        self.load_ms = (time.perf_counter() - began) * 1e3

        self.args = args
        self.target = args.target or list(low_high.mean(axis=1))
        if args.eye:
            self.eye = args.eye
        else:
            radius = 0.5 * np.linalg.norm(low_high[:, 1] - low_high[:, 0])
            back = radius / math.sin(math.radians(args.fov) / 2)
            self.eye = [self.target[0], self.target[1], self.target[2] + back]

        self.renderer = vtk.vtkRenderer()
        self.renderer.SetBackground(0, 0, 0)
        for actor in actors:
            self.renderer.AddActor(actor)
        vtk.vtkObject.GlobalWarningDisplayOff()  # no "bad X server" line: having none is the point
        self.window = vtk.vtkRenderWindow()
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(args.multisamples)
        self.window.SetSize(*args.size)
        self.window.AddRenderer(self.renderer)
        self.renderer.GetActiveCamera().SetViewAngle(args.fov)

    def look(self, eye, target, up):
        """Moves the camera."""
        camera = self.renderer.GetActiveCamera()
        camera.SetPosition(*eye)
        camera.SetFocalPoint(*target)
        camera.SetViewUp(*up)
        self.renderer.ResetCameraClippingRange()

    def described(self):
        """What a summary tells of it; a frame has been drawn."""
        args, gl = self.args, {}
        for line in self.window.ReportCapabilities().splitlines():
            key, _, value = line.partition(":")
            gl[key.strip()] = value.strip()
        return {
            "version": vtk.vtkVersion().GetVTKVersion(),
            "window": self.window.GetClassName(),
            "renderer": gl.get("OpenGL renderer string"),
            "file": args.ply,
            "mode": args.mode,
            "multisamples": self.window.GetMultiSamples(),
            "point_size": args.point_size,
            "lighting": args.lighting,
            "spheres": args.spheres,
            "colors": args.colors if self.has_colors else "none",
            "width": args.size[0],
            "height": args.size[1],
            "points": self.points,
            "triangles": self.triangles,
        }


def encoder(window, jpeg_quality, encode_png, remote_quality):
    """A function that reads the frame back and returns the encoded length, or None when nothing of that is wanted."""
    if remote_quality is not None:
        from vtkmodules.vtkWebCore import vtkWebApplication

        application = vtkWebApplication()
        application.SetImageEncoding(application.ENCODING_NONE)
        application.SetImageCompression(application.COMPRESSION_JPEG)

        def still():
            # Draws by itself; unchanged windows are not drawn again.
            application.InvalidateCache(window)
            return application.StillRenderToBuffer(window, 0, remote_quality).GetNumberOfTuples()

        return still
    if jpeg_quality is None and not encode_png:
        return None
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.ShouldRerenderOff()
    if jpeg_quality is not None:
        writer = vtk.vtkJPEGWriter()
        writer.SetQuality(jpeg_quality)
    else:
        writer = vtk.vtkPNGWriter()
    writer.WriteToMemoryOn()
    writer.SetInputConnection(grab.GetOutputPort())

    def encode():
        grab.Modified()
        writer.Write()
        return writer.GetResult().GetNumberOfTuples()

    return encode


def write_png(window, path):
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.ShouldRerenderOff()
    grab.Update()
    writer = vtk.vtkPNGWriter()
    writer.SetFileName(path)
    writer.SetInputConnection(grab.GetOutputPort())
    writer.Write()
    return vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())


def scene_arguments(description):
    """A parser of what is drawn, and of the frames that are timed."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("ply")
    parser.add_argument(
        "--mode", default="points",
        choices=["points", "point-gaussian", "splats", "gaussians", "surface", "tubes"],
    )
    parser.add_argument("--eye", type=vector, help="x,y,z (default: the whole scene in view)")
    parser.add_argument("--target", type=vector)
    parser.add_argument("--up", type=vector, default=[0.0, 1.0, 0.0])
    parser.add_argument("--fov", type=float, default=45.0, help="vertical, degrees")
    parser.add_argument("--size", type=size, default=(1024, 1024), help="WxH")
    parser.add_argument("--frames", type=int, default=9, help="timed frames")
    parser.add_argument("--warmup", type=int, default=2, help="frames between the first and the timed ones")
    parser.add_argument("--step", type=float, default=0.5, help="degrees the camera turns a frame")
    parser.add_argument("--radius", type=float, default=0.01, help="of a splat or a tube, scene units")
    parser.add_argument("--sides", type=int, default=3, help="of a tube; VTK's default is 3")
    parser.add_argument(
        "--bound-scale", type=float, help="triangles of Gaussians and discs, in scale factors; VTK's default is 3"
    )
    parser.add_argument("--lighting", action="store_true", help="points lit by VTK's headlight, its default")
    parser.add_argument("--multisamples", type=int, default=0, help="VTK's default is 8, PyVista's 4")
    parser.add_argument("--point-size", type=float, default=1.0, help="pixels; PyVista's default is 5")
    parser.add_argument("--spheres", action="store_true", help="render points as spheres")
    parser.add_argument(
        "--colors", default="file", choices=["file", "lut", "none"],
        help="the file's, heights through a lookup table, or one colour for all",
    )
    parser.add_argument("--window", choices=["egl", "osmesa"], help="default: VTK chooses")
    parser.add_argument("--interactive", action="store_true", help="draw frames as standard input asks")
    return parser


def parse_arguments():
    parser = scene_arguments(__doc__.split("\n\n")[0])
    parser.add_argument("--jpeg", type=int, metavar="Q", help="time readback and JPEG encoding too")
    parser.add_argument("--encode-png", action="store_true", help="time readback and PNG encoding too")
    parser.add_argument("--remote", type=int, metavar="Q", help="time what a remote view does for a frame")
    parser.add_argument("--png", help="write the unturned frame here")
    return parser.parse_args()


def timed(args, frame, load_ms, first_ms, save=None):
    """Milliseconds of frames, as the arguments or standard input ask for them; `frame` draws at a number of degrees, and `save` writes
    the frame drawn last to a file."""
    for index in range(args.warmup):
        frame((index + 1) * args.step)
    if not args.interactive:
        return [frame((args.warmup + 1 + index) * args.step) for index in range(args.frames)]
    print(json.dumps({"ready": True, "load_ms": round(load_ms, 1), "first_ms": round(first_ms, 1)}), flush=True)
    times = []
    for line in sys.stdin:
        words = line.rstrip("\n").split(" ", 2)
        times.append(frame(*(float(word) for word in words[:2])))
        if len(words) > 2:
            save(words[2])
        print(f"{times[-1]:.3f}", flush=True)
    return times


def summarized(times, scene, load_ms, first_ms):
    """What a summary tells of frames of a scene that `Scene.described` tells of."""
    median = statistics.median(times)
    return {
        "frames": len(times),
        "median_ms": round(median, 3),
        "min_ms": round(min(times), 3),
        "max_ms": round(max(times), 3),
        "points_per_s": round(scene["points"] / median * 1e3),
        "triangles_per_s": round(scene["triangles"] / median * 1e3),
        "load_ms": round(load_ms, 1),
        "first_ms": round(first_ms, 1),
    }


def main():
    args = parse_arguments()
    scene = Scene(args)
    encode = encoder(scene.window, args.jpeg, args.encode_png, args.remote)

    def frame(degrees, distance=1.0):
        started = time.perf_counter()
        eye = np.asarray(turned(scene.eye, scene.target, args.up, degrees))
        eye = scene.target + distance * (eye - scene.target)
        scene.look(eye.tolist(), scene.target, args.up)
        if args.remote is None:
            scene.window.Render()
        if encode:
            encode()
        else:
            scene.window.WaitForCompletion()
        return (time.perf_counter() - started) * 1e3

    first_ms = frame(0.0)
    covered = None
    if args.png:
        image = write_png(scene.window, args.png)
        covered = int((image[:, :3].max(axis=1) > 0).sum())
    times = timed(args, frame, scene.load_ms, first_ms, lambda file: write_png(scene.window, file))
    if not times:
        return
    described = scene.described()
    print(json.dumps({
        "peer": "vtk",
        **described,
        "encode": "remote" if args.remote is not None else "jpeg" if args.jpeg is not None else "png" if args.encode_png else None,
        **summarized(times, described, scene.load_ms, first_ms),
        "covered_pixels": covered,
    }))


if __name__ == "__main__":
    main()
