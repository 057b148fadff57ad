//! The appearance of surfaces to a camera and to a laser: colour, reflectance, class.
//!
//! Colours are in linear light. Patterns (windows, tiles, timber) are functions of the position on the surface, so nothing is
//! stored for them.

use glam::{DVec2, DVec3};

use super::super::numeric::{fractal, hash_unit};

/// Index into the town's table of skins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SkinId(pub u32);

/// Classes of the ASPRS LAS specification.
pub mod class {
    pub const UNCLASSIFIED: u8 = 1;
    pub const GROUND: u8 = 2;
    pub const LOW_VEGETATION: u8 = 3;
    pub const HIGH_VEGETATION: u8 = 5;
    pub const BUILDING: u8 = 6;
    pub const LOW_NOISE: u8 = 7;
    pub const ROAD: u8 = 11;
}

/// Linear RGB.
pub type Rgb = [f64; 3];

/// The properties of a surface at one place.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    pub color: Rgb,
    /// Share of the laser's light that is reflected, 0..=1.
    pub reflectance: f64,
    pub class: u8,
    /// Distance of the surface behind the wall's plane, in metres (for windows).
    pub recess: f64,
}

/// The appearance of a solid's face.
#[derive(Clone, Debug)]
pub enum Skin {
    Plain { color: Rgb, reflectance: f64, class: u8, grain: f64 },
    Leaves { color: Rgb, class: u8 },
    Roof(Roof),
    Facade(Facade),
}

/// A tiled slope.
#[derive(Clone, Debug)]
pub struct Roof {
    pub color: Rgb,
    /// A point of the slope, and the horizontal direction of its rows of tiles.
    pub origin: DVec3,
    pub along: DVec2,
    pub seed: u64,
}

/// A wall with windows.
#[derive(Clone, Debug)]
pub struct Facade {
    pub color: Rgb,
    /// The wall's left foot seen from outside, and the direction to its right foot.
    pub origin: DVec2,
    pub along: DVec2,
    pub width: f64,
    pub storeys: u32,
    pub storey_height: f64,
    pub style: FacadeStyle,
    pub seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FacadeStyle {
    /// A wall without openings.
    Blank,
    Plaster,
    /// Timber frame with plaster between.
    Timber,
    /// Plaster above wide ground-floor windows.
    Shop,
    /// Tall arched windows without storeys.
    Church,
}

/// Converts sRGB bytes, in which palettes are easiest to read, to linear light (gamma 2, which is exact on every machine).
pub fn rgb(hex: u32) -> Rgb {
    [hex >> 16 & 255, hex >> 8 & 255, hex & 255].map(|byte| {
        let c = f64::from(byte) / 255.0;
        c * c
    })
}

pub fn scaled(color: Rgb, factor: f64) -> Rgb {
    color.map(|c| c * factor)
}

impl Skin {
    /// The surface at `p`.
    pub fn surface(&self, p: DVec3) -> Surface {
        match self {
            Skin::Plain { color, reflectance, class, grain } => {
                let tone = 1.0 + grain * fractal(p * 3.0, 3, 11);
                Surface {
                    color: scaled(*color, tone),
                    reflectance: *reflectance,
                    class: *class,
                    recess: 0.0,
                }
            }
            Skin::Leaves { color, class } => {
                let [x, y, z] = (p * 5.0).floor().to_array().map(|c| c as i64);
                let tone = 0.7 + 0.6 * hash_unit(x, y, z, 3) + 0.25 * fractal(p, 2, 5);
                let [r, g, b] = scaled(*color, tone);
                let yellow = 0.3 * hash_unit(z, x, y, 9);
                Surface {
                    color: [r * (1.0 + yellow), g, b * (1.0 - yellow)],
                    reflectance: 0.45,
                    class: *class,
                    recess: 0.0,
                }
            }
            Skin::Roof(roof) => roof.surface(p),
            Skin::Facade(facade) => facade.surface(p),
        }
    }
}

fn building(color: Rgb, reflectance: f64) -> Surface {
    Surface { color, reflectance, class: class::BUILDING, recess: 0.0 }
}

impl Roof {
    fn surface(&self, p: DVec3) -> Surface {
        let d = p - self.origin;
        let u = d.x * self.along.x + d.y * self.along.y;
        // The height counts the rows, because it is constant along a row.
        let (row, column) = (d.z / 0.2, u / 0.24);
        let (r, c) = (row.floor(), column.floor());
        let tile = hash_unit(r as i64, c as i64, 0, self.seed);
        let mut tone = 0.82 + 0.3 * tile + 0.35 * fractal(p * 0.4, 3, self.seed);
        if row - r < 0.22 {
            tone *= 0.7;
        }
        let moss = (fractal(p * 0.7, 3, self.seed ^ 1) - 0.12).clamp(0.0, 0.3);
        let [red, green, blue] = scaled(self.color, tone);
        building([red * (1.0 - 1.6 * moss), green * (1.0 - 0.4 * moss), blue * (1.0 - moss)], 0.4)
    }
}

const TIMBER: u32 = 0x4a3527;
const FRAME: u32 = 0xe9e6df;

impl Facade {
    fn surface(&self, p: DVec3) -> Surface {
        let u = (p.x - self.origin.x) * self.along.x + (p.y - self.origin.y) * self.along.y;
        let v = p.z;
        let weather = 1.0 + 0.18 * fractal(p * 0.6, 4, self.seed) - 0.1 * (1.0 - v * 0.4).max(0.0);
        let wall = building(scaled(self.color, weather), 0.62);
        let eaves = self.storey_height * f64::from(self.storeys);
        if self.style == FacadeStyle::Church {
            return self.church(u, v, wall);
        }
        if self.style == FacadeStyle::Blank {
            return wall;
        }
        if v < 0.55 {
            return building(scaled(rgb(0x8d8880), 0.9 + 0.2 * fractal(p * 2.0, 2, 8)), 0.45);
        }
        if let Some(opening) = self.opening(u, v, eaves) {
            return opening;
        }
        if self.style == FacadeStyle::Timber && self.is_beam(u, v) {
            return building(scaled(rgb(TIMBER), weather), 0.25);
        }
        if self.style == FacadeStyle::Plaster && (v - eaves).abs() < 0.16 {
            return building(rgb(FRAME), 0.65);
        }
        wall
    }

    /// The surface of a window or door. Coordinates in an opening run from its middle and its sill.
    fn opening(&self, u: f64, v: f64, eaves: f64) -> Option<Surface> {
        let columns = ((self.width - 0.7) / 2.2).floor();
        if columns < 1.0 || v > eaves + 3.0 {
            return None;
        }
        let spacing = self.width / columns;
        let column = (u / spacing).floor();
        if column < 0.0 || column >= columns {
            return None;
        }
        let across = u - (column + 0.5) * spacing;
        let storey = (v / self.storey_height).floor();
        let above_floor = v - storey * self.storey_height;
        if v > eaves {
            // A gable has a single small window.
            let middle = u - 0.5 * self.width;
            return window(middle, v - eaves - 0.7, 0.4, 1.0, 0.0);
        }
        let ground = storey < 0.5;
        let door = (hash_unit(3, 1, 4, self.seed) * columns) as i64 == column as i64;
        if ground && door {
            return self.door(across, v);
        }
        if ground && self.style == FacadeStyle::Shop {
            return window(across, v - 0.6, 0.42 * spacing, 1.9, 0.0);
        }
        let blind = hash_unit(column as i64, storey as i64, 2, self.seed);
        window(across, above_floor - 0.95, 0.52, 1.4, blind)
    }

    fn door(&self, across: f64, v: f64) -> Option<Surface> {
        let (half, height) = (0.55, 2.35);
        if across.abs() > half + 0.12 || v > height + 0.12 {
            return None;
        }
        if across.abs() > half || v > height {
            return Some(building(rgb(0xb9b2a5), 0.55));
        }
        let palette = [0x5b3a24, 0x2f4a3a, 0x6d1f1f, 0x2b3a55];
        let pick = (hash_unit(1, 5, 9, self.seed) * 4.0) as usize & 3;
        Some(Surface { recess: 0.1, ..building(rgb(palette[pick]), 0.35) })
    }

    fn is_beam(&self, u: f64, v: f64) -> bool {
        let bay = self.width / (self.width / 1.15).round().max(1.0);
        let x = u - (u / bay).floor() * bay;
        let y = v - (v / self.storey_height).floor() * self.storey_height;
        let (post, rail) = (x < 0.09 || x > bay - 0.09, y < 0.13 || y > self.storey_height - 0.13);
        let cell =
            hash_unit((u / bay).floor() as i64, (v / self.storey_height) as i64, 7, self.seed);
        let slope = y / self.storey_height * bay;
        let brace = (cell < 0.22 && (slope - x).abs() < 0.09)
            || (cell > 0.78 && (bay - slope - x).abs() < 0.09);
        post || rail || brace || (y - 0.85).abs() < 0.07
    }

    fn church(&self, u: f64, v: f64, wall: Surface) -> Surface {
        let columns = (self.width / 4.2).floor().max(1.0);
        let spacing = self.width / columns;
        let across = (u - ((u / spacing).floor() + 0.5) * spacing).abs();
        let (sill, spring, half) = (2.4, 6.0, 0.75);
        let arch = {
            let rise = (v - spring).max(0.0);
            across * across + rise * rise
        };
        if v > sill && arch < half * half {
            let lead = (v * 2.5).fract() < 0.12 || (across * 4.0).fract() < 0.15;
            let glass = if lead { 0x2a2a2c } else { 0x3d4d63 };
            return Surface { recess: 0.25, ..building(rgb(glass), 0.12) };
        }
        if v > sill - 0.25 && arch < (half + 0.25) * (half + 0.25) {
            return building(rgb(0xcabfa6), 0.6);
        }
        // Courses of ashlar.
        let course = (v / 0.45).floor();
        let stone =
            hash_unit(((u + 0.4 * (course % 2.0)) / 0.8).floor() as i64, course as i64, 0, 3);
        Surface { color: scaled(wall.color, 0.85 + 0.3 * stone), ..wall }
    }
}

/// The surface of a window with its frame and its surround; `u` from the middle, `v` from the sill.
fn window(u: f64, v: f64, half: f64, height: f64, blind: f64) -> Option<Surface> {
    let side = u.abs();
    if side > half + 0.13 || v < -0.14 || v > height + 0.13 {
        return None;
    }
    if side > half || v < 0.0 || v > height {
        return Some(building(rgb(0xd3ccbd), 0.6));
    }
    let frame = side > half - 0.08
        || v < 0.08
        || v > height - 0.08
        || side < 0.035
        || (v - 0.65 * height).abs() < 0.03;
    if frame {
        return Some(Surface { recess: 0.12, ..building(rgb(FRAME), 0.6) });
    }
    if blind > 0.72 && v > height * (1.9 - blind) {
        return Some(Surface { recess: 0.14, ..building(rgb(0xb5ac98), 0.5) });
    }
    let sky = (v / height).clamp(0.0, 1.0);
    let glass = [0.025 + 0.03 * sky, 0.035 + 0.05 * sky, 0.05 + 0.09 * sky];
    Some(Surface { recess: 0.16, ..building(glass, 0.06) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facades_have_windows_that_lie_behind_the_wall() {
        let facade = Facade {
            color: rgb(0xeeddbb),
            origin: DVec2::ZERO,
            along: DVec2::X,
            width: 9.0,
            storeys: 3,
            storey_height: 2.9,
            style: FacadeStyle::Plaster,
            seed: 1,
        };
        let mut glass = 0;
        for i in 0..90 {
            for j in 0..90 {
                let p = DVec3::new(f64::from(i) * 0.1, 0.0, f64::from(j) * 0.1);
                let surface = Skin::Facade(facade.clone()).surface(p);
                assert_eq!(surface.class, class::BUILDING);
                assert!(surface.color.iter().all(|c| (0.0..=1.6).contains(c)));
                glass += i32::from(surface.reflectance < 0.1);
                assert!(surface.reflectance > 0.1 || surface.recess > 0.1);
            }
        }
        assert!((500..3000).contains(&glass), "{glass}");
    }
}
