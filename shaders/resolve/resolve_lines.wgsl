// Writes the attributes of the pixels that show a segment of a line of one page, or the layers of translucent segments before them. Tubes that are wide enough have the normals of their
// surface; thin ones are lit as the mean over a cylinder, and ribbons from both sides alike.
//!include shared/frame
//!include shared/scene
//!include shared/line
//!include shared/barycentric
//!include shared/normals
//!include shared/resolve_each
//!include shared/light
//!include shared/recolor
//!include FIELDS

@group(2) @binding(3) var<storage, read> placed: array<Placed>;

// Width in pixels from which on a tube has the normals of its surface.
const ROUND_PX: f32 = 2.0;

// Which share of a segment a ray meets a ribbon at.
fn ribbon_share(line: Line, triangle: u32, ray: vec3<f32>) -> f32 {
    let a0 = line.a - line.side_a;
    let b1 = line.b + line.side_b;
    if triangle == 1u {
        return barycentric_weights(barycentric_forms(a0, line.a + line.side_a, b1), ray).c;
    }
    let w = barycentric_weights(barycentric_forms(a0, b1, line.b - line.side_b), ray);
    return w.b + w.c;
}

// The factors of a light for albedo and specular colour, of a cylinder thinner than can be seen: see `crate::oracle::shade::line`.
fn cylinder(tangent: vec3<f32>, l: vec3<f32>, to_eye: vec3<f32>, shininess: f32) -> vec2<f32> {
    let lt = dot(l, tangent);
    let vt = dot(to_eye, tangent);
    let across = sqrt(max(1.0 - lt * lt, 0.0));
    let seen = sqrt(max(1.0 - vt * vt, 0.0));
    let cosine = clamp((dot(l, to_eye) - lt * vt) / max(across * seen, 1e-12), -1.0, 1.0);
    let angle = acos(cosine);
    let mean = across * 0.25 * (sqrt(1.0 - cosine * cosine) + (3.1415927 - angle) * cosine);
    let peak = pow(max(across * seen - lt * vt, 0.0), shininess);
    return vec2<f32>(mean, peak * 0.5 * sqrt(3.1415927 / (2.0 * shininess + 2.0)) * cos(0.5 * angle));
}

// Light of the surroundings that falls on a line: on both sides of a ribbon, or on the visible half of a cylinder. Normals of the latter at a sine of s
// from the eye count alike for each s, so that Gauss's quadrature with three places integrates over them.
fn environment_of_line(direction: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    if RIBBONS {
        return 0.5 * (environment_at(direction, SCATTERED) + environment_at(-direction, SCATTERED));
    }
    let facing = unit_or_zero(to_eye - direction * dot(to_eye, direction));
    if all(facing == vec3<f32>(0.0)) {
        return environment_at(to_eye, SCATTERED);
    }
    let aside = cross(direction, facing);
    let turned = facing * 0.6324555;
    let left = environment_at(turned + aside * 0.7745967, SCATTERED);
    let right = environment_at(turned - aside * 0.7745967, SCATTERED);
    return (4.0 / 9.0) * environment_at(facing, SCATTERED) + (5.0 / 18.0) * (left + right);
}

// The light that a line reflects. `direction`: the axis of a tube, or the normal of a ribbon.
fn line_light(light: Light, albedo: vec3<f32>, material: Material, direction: vec3<f32>, place: vec3<f32>, to_eye: vec3<f32>) -> vec3<f32> {
    if ENVIRONMENT && light.kind == LIGHT_SURROUNDINGS {
        return albedo * environment_of_line(direction, to_eye);
    }
    let l = arriving(light, place, to_eye);
    if is_ambient(light) {
        return albedo * light.color.rgb * l.w;
    }
    var factors = cylinder(direction, l.xyz, to_eye, material.shininess);
    if RIBBONS {
        let cosine = dot(direction, l.xyz);
        let mirrored = 2.0 * cosine * direction - l.xyz;
        factors = vec2<f32>(abs(cosine), pow(max(dot(mirrored, to_eye), 0.0), material.shininess));
    }
    if factors.x <= 0.0 {
        return vec3<f32>(0.0);
    }
    var reflected = albedo * factors.x;
    if SPECULAR {
        reflected += material.specular * factors.y;
    }
    return reflected * light.color.rgb * (l.w * reaching(light, factors.x, place, l.xyz));
}

fn line_lights(albedo: vec3<f32>, material: Material, direction: vec3<f32>, place: vec3<f32>) -> vec3<f32> {
    let to_eye = eye_from(place);
    let count = light_count();
    var color = vec3<f32>(0.0);
    for (var i = 0u; i < count; i++) {
        color += line_light(light_at(i), albedo, material, direction, place, to_eye);
    }
    return color;
}

// Segments of a tube lie over each other where they meet, and where they are shorter than the tube is wide. How far apart they may seem there, as a
// factor of the radius and as a share of the distance.
const JOINT: f32 = 1.1;
const JOINT_SLACK: f32 = 4e-6;

fn is_in_tube(line: Line, place: vec3<f32>) -> bool {
    let from_a = place - line.a;
    let foot = clamp(dot(from_a, line.ab) / max(dot(line.ab, line.ab), 1e-37), 0.0, 1.0);
    let radius = mix(line.radius.x, line.radius.y, foot);
    return length(from_a - line.ab * foot) <= JOINT * radius + JOINT_SLACK * length(place);
}

// Whether the strand of a segment begins or ends with it, and does so within another segment.
fn ends_in_tube(one: Line, other: Line) -> bool {
    return ((one.link & LINE_BEGINS) != 0u && is_in_tube(other, one.a))
        || ((one.link & LINE_ENDS) != 0u && is_in_tube(other, one.b));
}

// Whether a place on a segment lies within another one, which the word of a layer before shows, of the same strand or of one that begins or ends
// on it. A strand is known by its hash: another one has the same only if hundreds of strands lie between them in the file.
fn is_in_strand(before: vec2<u32>, own: Line, instance: u32, place: vec3<f32>) -> bool {
    let run = runs[frame.first_run + segment.index];
    let index = slot_of(before);
    if before.y == 0u || index - run.first_slot >= run.count {
        return false;
    }
    let slot = frame.first_slot + index;
    let chunk = slots[slot].chunk;
    let element = chunks[chunk].first + (~before.x & SLOT_MASK);
    let link = line_segments[element].x;
    let is_same = (link & LINE_HASH) == (own.link & LINE_HASH);
    let may_fork = ((link | own.link) & (LINE_BEGINS | LINE_ENDS)) != 0u;
    if slots[slot].instance != instance || !(is_same || may_fork) {
        return false;
    }
    let at = placed[frame.first_instance + instance];
    let line = line_of(at, radius_scale(at), chunks[chunk].vertex_first, element);
    return is_in_tube(line, place) && (is_same || ends_in_tube(own, line) || ends_in_tube(line, own));
}

// Whether a pixel's ray is within the strand already where it meets a segment: a strand hides once between where a ray enters and leaves it.
fn is_joint(pixel: u32, own: Line, instance: u32, place: vec3<f32>) -> bool {
    var found = false;
    for (var layer = 0u; layer < MOST_BEFORE; layer++) {
        found = found || is_in_strand(word_before(layer, pixel), own, instance, place);
    }
    return found;
}

fn resolve(column: Column) {
    var surface: Surface;
    surface.slot = slot_of(column.word);
    surface.inverse_depth = bitcast<f32>(column.word.y);
    surface.depth_scale = 1.0;
    if needs_depth() {
        finish(column.pixel, column.at, surface);
        return;
    }
    let slot = frame.first_slot + surface.slot;
    let instance = slots[slot].instance;
    if needs_id() {
        surface.id = instances[instance].id;
        finish(column.pixel, column.at, surface);
        return;
    }
    let chunk = slots[slot].chunk;
    let at = placed[frame.first_instance + instance];
    let element = chunks[chunk].first + (~column.word.x & SLOT_MASK);
    let seen = seen_line(line_of(at, radius_scale(at), chunks[chunk].vertex_first, element));
    let pixel = pixel_centre(column.at);
    let ray = ray_through(pixel);
    let hit = meet_line(seen, pixel);
    var share = hit.share;
    if hit.triangle != 0u {
        share = ribbon_share(seen.line, hit.triangle, ray);
    }
    share = mix(seen.line.range.x, seen.line.range.y, share);
    if !RIBBONS && is_joint(column.pixel, seen.line, instance, on_ray(ray, 1.0 / surface.inverse_depth)) {
        return;
    }
    let way = world_from_camera(towards(ray));
    let is_round = !RIBBONS && hit.width_px >= ROUND_PX;
    let tangent = unit_or_zero(world_from_camera(seen.line.ab));
    if needs_normal() {
        var own = way - tangent * dot(way, tangent);
        if RIBBONS {
            let a = octahedral_decode(line_vertices[seen.line.words.x + 5u]);
            let b = octahedral_decode(line_vertices[seen.line.words.y + 5u]);
            own = turned(normal_map(instance), mix(a, b, share));
        } else if is_round {
            own = world_from_camera(hit.normal);
        }
        surface.normal = facing_normal(own, way);
    }
    var material = materials[chunks[chunk].material];
    if OVERRIDES {
        material = effective_material(material, instances[instance].material);
    }
    let word_a = line_vertices[seen.line.words.x + 3u];
    let word_b = line_vertices[seen.line.words.y + 3u];
    let color_a = linear_color(word_a);
    let color_b = linear_color(word_b);
    surface.alpha = material.base_color.a * mix(unpack4x8unorm(word_a).a, unpack4x8unorm(word_b).a, share);
    // A strip is a pixel wide where the line is thinner.
    if SORT == SORT_TRANSLUCENT && hit.triangle == 0u {
        surface.alpha *= min(hit.width_px, 1.0);
    }
    surface.color = material.base_color.rgb * mix(color_a, color_b, share);
    if SHOWS_FIELD {
        surface.color = linear_color(field_color_between(seen.line.words / line_words(), share, instance));
    }
    if is_round {
        finish(column.pixel, column.at, surface);
        return;
    }
    surface.color = recoloured(surface, column.at);
    let direction = select(tangent, surface.normal, RIBBONS);
    if SHADED && (material.flags & MATERIAL_UNLIT) == 0u && (!RIBBONS || any(direction != vec3<f32>(0.0))) {
        surface.color = toned(line_lights(surface.color, material, direction, place_of(surface, column.at)) + emitted(material));
    }
    finish_lit(column.pixel, column.at, surface);
}

@compute @workgroup_size(64)
fn resolve_lines(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    begin_view(group.z);
    let resolved = resolve_each(group, lane, runs[frame.first_run + segment.index]);
    if resolved != 0u {
        note_segments(resolved);
    }
}
