"""Rules of the HTTP API that a schema cannot say, applied to the cases that schemathesis makes.

A schema describes one parameter. These rules are about several parameters, or about what the daemon holds: a pose is given in one of three
ways, a filter needs splats, a path has to exist. A case that is meant to be accepted is changed so that it follows them; whatever else the
schemas allow must then be accepted. A case that is meant to be refused keeps its fault: only what has nothing to do with the fault is
changed, so that an unknown id does not hide it.
"""

import json
import os
import pathlib
import time
import uuid

import requests
import schemathesis
from schemathesis.core.parameters import ParameterLocation

# What the daemon under test answers to GET /v1/settings.
SETTINGS = json.loads(pathlib.Path(os.environ["CONTRACT_SETTINGS"]).read_text())["settings"]
ADDRESS = os.environ["CONTRACT_ADDRESS"]
HAS_VIDEO = os.environ.get("CONTRACT_VIDEO") == "1"
# Frames are small to keep the run short; the cases do not test frame size.
MOST_PIXELS = 48
LARGEST_SIDE = 16384
PATH = {"fps": 10, "keys": [{"t": 0, "eye": [0, 0, 3], "target": [0, 0, 0]}, {"t": 0.3, "eye": [1, 0, 3], "target": [0, 0, 0]}]}
VIEW = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -3, 1]
PROJ = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, -1, -1, 0, 0, -0.1, 0]
PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    b"0 0 0\n1 0 0\n0 1 0\n"
)
FORMATS = {
    "color": {"png", "jpeg", "webp", "qoi", "raw", "exr"},
    "depth": {"png", "raw", "exr", "pfm"},
    "normal": {"png", "jpeg", "webp", "qoi", "raw", "exr"},
    "id": {"png", "webp", "qoi", "raw", "exr"},
}


def is_positive(case, location):
    """Returns whether this part of the case is meant to be accepted."""
    if case.meta is None:
        return True
    part = case.meta.components.get(location)
    return part is None or part.mode.is_positive


def vector(value):
    """Returns a vector's numbers, given a list or the text of a query."""
    if isinstance(value, str):
        value = value.split(",")
    try:
        return [float(number) for number in value]
    except (TypeError, ValueError):
        return None


def length(numbers):
    return max((abs(number) for number in numbers), default=0.0)


def written(params, numbers):
    """Numbers as the case has its own: a list in the text of a query would become one parameter for each number."""
    own = (params.get(name) for name in ("eye", "target", "view", "proj"))
    return ",".join(map(str, numbers)) if any(isinstance(value, str) for value in own) else numbers


def follow_up(params):
    """A direction, unless it is an axis by its name."""
    up = vector(params["up"]) if "up" in params else None
    if up is not None and not 1e-100 < length(up) < 1e100:
        params["up"] = written(params, [0, 1, 0])


def follow_pose(params):
    """Keeps one of the three ways to give a pose, and makes the pose valid."""
    if "ortho_height" in params:
        params.pop("fov", None)
        params.pop("projection", None)
    if params.keys() & {"view", "proj"}:
        params.pop("projection", None)
    if "camera" in params:
        params["camera"] = "front"
        for name in ("eye", "target", "up", "fov", "ortho_height", "view", "proj"):
            params.pop(name, None)
    elif params.keys() & {"up", "fov", "ortho_height"} and not params.keys() & {"eye", "target"}:
        params.pop("view", None)
        params.pop("proj", None)
        follow_up(params)
    elif params.keys() & {"eye", "target"}:
        params.pop("view", None)
        params.pop("proj", None)
        eye = vector(params.get("eye"))
        target = vector(params.get("target"))
        apart = eye and target and length([a - b for a, b in zip(eye, target)])
        # Farther apart than rounding, and not so far that squares overflow or vanish.
        if not apart or not 1e-9 * max(length(eye), length(target)) < apart or not 1e-100 < apart < 1e100:
            params["eye"], params["target"] = written(params, [0, 0, 3]), written(params, [0, 0, 0])
        follow_up(params)
    elif params.keys() & {"view", "proj"}:
        params["view"], params["proj"] = written(params, VIEW), written(params, PROJ)


def follow_clip_boxes(params):
    """Boxes in whose text the least corner is below the largest, of a node that the scene has."""
    if params.keys() & {"clip_boxes", "clip_node"}:
        params["clip_boxes"] = "-1,*,*,1,0.5,*;outside:0,0,0,0.25,0.5,1e3"
    if "clip_node" in params:
        params["clip_node"] = "wall"


def follow_part(params):
    """A part that lies within its image, in a frame whose pose is no matrix and whose settings are not chosen."""
    if params.keys() & {"view", "proj", "budget_ms", "min_psnr_db"}:
        params.pop("part_of", None)
    if "part_of" in params:
        params["part_of"] = "20000,20000,100,50"


def follow_lens(params):
    """A lens of a size that fits its focus distance, in perspective, where settings are not chosen."""
    if params.keys() & {"ortho_height", "budget_ms", "min_psnr_db"} or params.get("projection") == "orthographic":
        params.pop("aperture", None)
        params.pop("focus_distance", None)
        params.pop("blur_samples", None)
    if "aperture" in params:
        params["aperture"] = 0.1
    if "focus_distance" in params:
        params["focus_distance"] = 3


def follow_stereo(params):
    """A shift of the eye that fits the distance of the image, in perspective."""
    if params.keys() & {"ortho_height", "view", "proj"} or params.get("projection") == "orthographic":
        params.pop("eye_offset", None)
        params.pop("stereo_distance", None)
    if "stereo_distance" in params:
        params["eye_offset"] = 0.1
        params["stereo_distance"] = 3
    if "eye_offset" in params:
        params["eye_offset"] = 0.1


def default_of(name):
    """A setting's default; `None` where the scene has one, or where there is none."""
    return next((setting.get("default") for setting in SETTINGS if setting["name"] == name), None)


def needs_of(setting, params):
    """The rules that a given setting has to follow."""
    value = params.get(setting["name"])
    # The default of a choice needs nothing.
    if value is None or (setting["kind"] == "choice" and value == setting["default"]):
        return []
    return [rule for rule in setting["needs"] if rule.get("value") in (None, value)]


def follow_needs(params):
    """Adds or changes settings that given settings need, and drops a setting whose needs contradict those of one before it.

    Where a rule asks for any value of a text, a value of the setting's examples is taken.
    """
    allowed = {}
    for setting in SETTINGS:
        rules = needs_of(setting, params)
        shared = {rule["of"]: [word for word in allowed.get(rule["of"], rule["is"]) if word in rule["is"]] for rule in rules}
        if any(rule["is"] and not shared[rule["of"]] for rule in rules):
            del params[setting["name"]]
        else:
            allowed.update(shared)
    for name, words in allowed.items():
        value = params.get(name, default_of(name))
        if words and value not in words:
            params[name] = words[0]
        elif not words and name not in params:
            params[name] = next(setting["examples"][0] for setting in SETTINGS if setting["name"] == name)


def follow_color_bounds(params):
    """Leaves the largest value out where it is not above the least one."""
    try:
        is_above = float(params["color_most"]) > float(params["color_least"])
    except (KeyError, TypeError, ValueError):
        return
    if not is_above:
        del params["color_most"]


def follow_settings(params):
    """Gives settings what they need beside them, and what this run's scene has."""
    shows_fields = {rule["value"] for setting in SETTINGS if setting["name"] == "color_by" for rule in setting["useful_with"] if rule["of"] == "fields"}
    # The scene of these requests has no scalar fields.
    params.pop("field", None)
    if params.get("color_by") in shows_fields:
        params["color_by"] = "height"
    if params.keys() & {"focus_distance", "blur_samples"}:
        params["aperture"] = 0.1
    follow_lens(params)
    follow_stereo(params)
    follow_needs(params)
    follow_clip_boxes(params)
    follow_part(params)
    follow_color_bounds(params)
    if "format" in params and params["format"].replace("jpg", "jpeg") not in FORMATS[params.get("output", "color")]:
        params["format"] = "png"
    if "deadline_ms" in params:
        params["deadline_ms"] = 60_000


def follow_frame(params, is_query=True):
    for name in [name for name, value in params.items() if value is None]:
        del params[name]
    follow_pose(params)
    # `up` is a name or a list of numbers. In a query, schemathesis writes commas only for parameters that are always lists.
    if is_query and isinstance(params.get("up"), list):
        params["up"] = ",".join(map(str, params["up"]))
    follow_settings(params)


def shrink(params):
    """Makes valid sides smaller."""
    for name in ("w", "h"):
        try:
            side = int(params[name])
        except (KeyError, TypeError, ValueError):
            if name not in params:
                params[name] = MOST_PIXELS
            continue
        if MOST_PIXELS < side <= LARGEST_SIDE:
            params[name] = MOST_PIXELS


def within(params):
    """Sets a pixel that lies in any frame."""
    params["x"] = params["y"] = 0


def follow_job(body):
    for name in [name for name, value in body.items() if value is None]:
        del body[name]
    body["scene"] = "grid"
    body["path"] = PATH if isinstance(body.get("path"), dict) else "past"
    body.pop("from", None)
    body.pop("to", None)
    body.pop("fps", None)
    follow_settings(body)
    shrink(body)
    if not HAS_VIDEO:
        body.pop("want", None)
        body.pop("bitrate_kbps", None)
    elif "bitrate_kbps" in body:
        body["want"] = ["video"]
    if "video" in (body.get("want") or []):
        body["w"] = body["h"] = MOST_PIXELS
        body.pop("output", None)
        body["format"] = "png"


def follow_change(body):
    for name in [name for name, value in body.items() if value is None]:
        del body[name]
    if "matrix" in body:
        body["matrix"] = [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]
        for name in ("translate", "rotate", "quaternion", "scale"):
            body.pop(name, None)
    if "rotate" in body:
        body.pop("quaternion", None)
    if "quaternion" in body and not length(body["quaternion"]) > 1e-6:
        body["quaternion"] = [0, 0, 0, 1]
    if not body:
        body["visible"] = True


def follow_comparison(body):
    """Gives each side settings that go together, and the first side one thing to be compared with."""
    names = {setting["name"] for setting in SETTINGS}
    for name in [name for name in body if name in names]:
        del body[name]
    follow_frame(body, is_query=False)
    shrink(body)
    for side in ("a", "b"):
        settings = body.get(side)
        if isinstance(settings, dict):
            for name in [name for name, value in settings.items() if value is None]:
                del settings[name]
            # They share the pose.
            settings.pop("projection", None)
            settings.pop("part_of", None)
            # The reference has no lens, and the pose that they share may be one of parallel rays.
            settings.pop("aperture", None)
            settings.pop("focus_distance", None)
            settings.pop("eye_offset", None)
            settings.pop("stereo_distance", None)
            follow_settings(settings)
    if "b" in body:
        body.pop("against", None)
    else:
        body["against"] = "reference"


def follow_measurement(body):
    """Cameras that the scene has, and little work."""
    for name in [name for name, value in body.items() if value is None]:
        del body[name]
    shrink(body)
    # A measurement for the planner takes longer than all other cases together.
    body.pop("planner", None)
    body.update(quick=True, repeats=1)
    if "cameras" in body:
        body["cameras"] = ["front"]


def spare(label):
    """Makes a scene or a job that a case may delete, and returns its id. Deletions of those that other cases need get it instead."""
    if label.split()[1].startswith("/v1/scenes"):
        request = {"url": f"{ADDRESS}/v1/scenes", "params": {"name": "points.ply", "id": uuid.uuid4().hex}, "data": PLY}
    else:
        request = {"url": f"{ADDRESS}/v1/jobs", "json": {"scene": "grid", "path": "past", "w": 16, "h": 16}}
    for _ in range(20):
        answer = requests.post(**request, timeout=30)
        if answer.status_code != 503:
            break
        # Full for now.
        time.sleep(0.5)
    answer.raise_for_status()
    return str(answer.json()["id"])


def known_ids(case, label):
    """Sets ids that exist, so that cases test more than unknown ids."""
    ids = case.path_parameters
    if "{id}" in label and label.split()[1].startswith("/v1/scenes"):
        ids["id"] = spare(label) if label.startswith("DELETE") else "grid"
    elif "{id}" in label:
        ids["id"] = spare(label) if label.startswith("DELETE") else "1"
    if "node" in ids:
        ids["node"] = "wall"
    if "name" in ids:
        ids["name"] = "past"
    if "n" in ids:
        ids["n"] = int(ids["n"]) % 3 if str(ids["n"]).isdigit() else ids["n"]


@schemathesis.hook
def map_case(context, case):
    label = case.operation.label
    is_stateful = case.meta is not None and case.meta.phase.name.name == "STATEFUL"
    if is_stateful:
        # Links lead to resources made by earlier cases, but also to those that all other cases need.
        if label.startswith("DELETE") and case.path_parameters.get("id") in ("grid", "1"):
            case.path_parameters["id"] = spare(label)
        # Only the run's own scene has a path, cameras and a node for clip boxes; uploaded scenes have none.
        parts = [part for part in (case.query, case.body) if isinstance(part, dict)]
        poses = [pose for part in parts for pose in part.get("poses") or [] if isinstance(pose, dict)]
        names = {name for part in parts + poses for name in part}
        if "/mjpeg" in label or "/compare" in label or names & {"path", "camera", "cameras", "clip_node"}:
            if "id" in (case.path_parameters or {}) and label.split()[1].startswith("/v1/scenes"):
                case.path_parameters["id"] = "grid"
    elif case.path_parameters and is_positive(case, ParameterLocation.PATH):
        known_ids(case, label)
    if isinstance(case.query, dict):
        query = case.query
        takes_frames = any(part in label for part in ("/frame", "/mjpeg", "/pick", "/stream")) and label.startswith("GET /v1/scenes")
        if is_positive(case, ParameterLocation.QUERY):
            if takes_frames:
                follow_frame(query)
            query.pop("from", None)
            if "path" in query:
                query["path"] = "past"
                for name in ("camera", "eye", "target", "up", "fov", "ortho_height", "view", "proj"):
                    query.pop(name, None)
            elif "loop" in query:
                del query["loop"]
        if takes_frames:
            shrink(query)
            if "/pick" in label and is_positive(case, ParameterLocation.QUERY):
                within(query)
        if "/mjpeg" in label:
            # An endless answer would block the run.
            if query.get("loop") in (True, "true"):
                del query["loop"]
            if "path" not in query:
                query["path"] = "past"
                if is_positive(case, ParameterLocation.QUERY):
                    for name in ("camera", "eye", "target", "up", "fov", "ortho_height", "view", "proj"):
                        query.pop(name, None)
            if str(query.get("fps", "")) and is_positive(case, ParameterLocation.QUERY):
                query["fps"] = 120
    if isinstance(case.body, dict) and is_positive(case, ParameterLocation.BODY):
        if label == "POST /v1/jobs":
            follow_job(case.body)
        elif label == "POST /v1/scenes/{id}/pick":
            follow_frame(case.body, is_query=False)
            shrink(case.body)
            if "pixels" in case.body:
                case.body["pixels"] = [[0, 0] for _ in case.body["pixels"]]
                case.body.pop("x", None)
                case.body.pop("y", None)
            else:
                within(case.body)
        elif label == "POST /v1/scenes/{id}/compare":
            follow_comparison(case.body)
        elif label == "POST /v1/scenes/{id}/accuracy":
            follow_measurement(case.body)
        elif label == "POST /v1/scenes/{id}/frames":
            shrink(case.body)
            for pose in [case.body, *case.body["poses"]]:
                # A part does not go with every pose, nor with a goal that another part of the body gives. Neither does a lens.
                pose.pop("part_of", None)
                pose.pop("aperture", None)
                pose.pop("focus_distance", None)
                follow_clip_boxes(pose)
                follow_color_bounds(pose)
            for pose in case.body["poses"]:
                if "w" in pose or "h" in pose:
                    shrink(pose)
        elif label.startswith("PATCH"):
            follow_change(case.body)
    if label == "POST /v1/scenes" and case.media_type == "application/octet-stream":
        # Some uploads are valid files, so that later cases have scenes to get, change and delete.
        if isinstance(case.body, bytes) and len(case.body) % 3 == 0 and is_positive(case, ParameterLocation.QUERY):
            case.body = PLY
            case.query = {**(case.query or {}), "name": "points.ply"}
    if label == "POST /v1/jobs" and case.headers and "Idempotency-Key" in case.headers:
        # The server refuses a key that was used for another job.
        if is_positive(case, ParameterLocation.HEADER):
            case.headers["Idempotency-Key"] = uuid.uuid4().hex
    return case
