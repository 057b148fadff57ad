// Exposure and tone mapping of the light that surfaces reflect and give off.

// 0: none; 1: exposure alone; 2: neutral; 3: ACES.
override TONE: u32 = 0u;

const EXPOSED: u32 = 1u;
const NEUTRAL: u32 = 2u;
const ACES: u32 = 3u;

// Up to 0.8 colours stay as they are but for what Fresnel's reflection adds to them; above, they are compressed and lose saturation (Khronos
// PBR Neutral, 2024).
fn neutral(light: vec3<f32>) -> vec3<f32> {
    let start = 0.76;
    let least = min(light.r, min(light.g, light.b));
    let c = light - vec3<f32>(select(0.04, least - 6.25 * least * least, least < 0.08));
    let peak = max(c.r, max(c.g, c.b));
    let room = 1.0 - start;
    let compressed = 1.0 - room * room / max(peak + room - start, room);
    let grey = 1.0 - 1.0 / (0.15 * (peak - compressed) + 1.0);
    let scaled = mix(c * (compressed / max(peak, 1e-6)), vec3<f32>(compressed), grey);
    return select(scaled, c, peak < start);
}

// Reference rendering and output transforms of the Academy Color Encoding System, as fitted by Hill (2016).
fn aces(light: vec3<f32>) -> vec3<f32> {
    let c = min(light, vec3<f32>(1e6));
    let v = vec3<f32>(
        dot(vec3<f32>(0.59719, 0.35458, 0.04823), c),
        dot(vec3<f32>(0.07600, 0.90834, 0.01566), c),
        dot(vec3<f32>(0.02840, 0.13383, 0.83777), c),
    );
    let f = (v * (v + 0.0245786) - vec3<f32>(0.000090537)) / (v * (0.983729 * v + 0.4329510) + 0.238081);
    return max(vec3<f32>(0.0), vec3<f32>(
        dot(vec3<f32>(1.60475, -0.53108, -0.07367), f),
        dot(vec3<f32>(-0.10208, 1.10813, -0.00605), f),
        dot(vec3<f32>(-0.00327, -0.07276, 1.07602), f),
    ));
}

fn toned(light: vec3<f32>) -> vec3<f32> {
    if TONE == 0u {
        return light;
    }
    let exposed = light * frame.exposure;
    if TONE == NEUTRAL {
        return neutral(exposed);
    }
    if TONE == ACES {
        return aces(exposed);
    }
    return exposed;
}
