//! Objects in the town: trees, cars, lamps, benches, stalls, a fountain, hedges.

use glam::{DVec2, DVec3};

use super::builder::{Builder, Frame};
use super::skin::{Skin, class, rgb};
use super::solid::Shape;
use crate::generate::numeric::sin_cos;
use crate::scene::random::SplitMix64;

const FOLIAGE: [u32; 6] = [0x4f7a33, 0x5d8a3a, 0x3f6b30, 0x6f9440, 0x86953a, 0x4a7f45];
const PAINT: [u32; 8] =
    [0xd8d9db, 0x1d1f22, 0x8c8f94, 0x9c1f22, 0x1f3f77, 0xf0efec, 0x4d5a52, 0x51555c];

fn direction(angle: f64) -> DVec2 {
    let (s, c) = sin_cos(angle);
    DVec2::new(c, s)
}

impl Builder {
    /// A broad-leaved tree of `height` metres.
    pub fn tree(&mut self, base: DVec3, height: f64, random: &mut SplitMix64) {
        let bark = self.plain(rgb(0x5b4a3a), 0.35, class::HIGH_VEGETATION);
        let color = rgb(FOLIAGE[random.index(FOLIAGE.len())]);
        let leaves = self.skin(Skin::Leaves { color, class: class::HIGH_VEGETATION });
        let trunk = height * random.range(0.42, 0.55);
        self.post(base - DVec3::Z * 0.2, 0.022 * height + 0.03, trunk + 0.2, bark);
        let crown = 0.5 * (height - 0.3 * height);
        let seed = random.next_u64();
        let lobe = |offset: DVec3, radii: DVec3, builder: &mut Builder| {
            let centre = base + DVec3::Z * (0.3 * height + crown) + offset;
            builder.add(Shape::Leaves { centre, radii, density: 0.34, skin: leaves, seed });
        };
        lobe(DVec3::ZERO, DVec3::new(0.62, 0.62, 0.95) * crown, self);
        for i in 0..5 {
            let way = direction(f64::from(i) * 1.256 + random.range(-0.4, 0.4));
            let (reach, lift) =
                (random.range(0.35, 0.55) * crown, random.range(-0.4, 0.35) * crown);
            let size = random.range(0.36, 0.5) * crown;
            lobe(
                DVec3::new(way.x * reach, way.y * reach, lift),
                DVec3::new(size, size, 0.85 * size),
                self,
            );
        }
    }

    /// A conifer: tiers that get smaller upwards.
    pub fn conifer(&mut self, base: DVec3, height: f64, random: &mut SplitMix64) {
        let bark = self.plain(rgb(0x4d3b2c), 0.35, class::HIGH_VEGETATION);
        let leaves =
            self.skin(Skin::Leaves { color: rgb(0x2f5234), class: class::HIGH_VEGETATION });
        self.post(base - DVec3::Z * 0.2, 0.17, 0.3 * height, bark);
        let seed = random.next_u64();
        for tier in 0..5 {
            let share = f64::from(tier) / 5.0;
            let radius = height * (0.2 - 0.17 * share);
            let centre = base + DVec3::Z * height * (0.24 + 0.72 * share);
            let radii = DVec3::new(radius, radius, 0.15 * height);
            self.add(Shape::Leaves { centre, radii, density: 0.42, skin: leaves, seed });
        }
    }

    /// A porous box of leaves, made of a row of ellipsoids.
    pub fn hedge(&mut self, frame: &Frame, length: f64, random: &mut SplitMix64) {
        let leaves = self.skin(Skin::Leaves { color: rgb(0x3f6a2c), class: class::LOW_VEGETATION });
        let seed = random.next_u64();
        let count = (length / 0.7).ceil().max(1.0);
        for i in 0..count as u32 {
            let x = length * (f64::from(i) + 0.5) / count;
            let centre = frame.point(DVec3::new(x, 0.0, 0.55));
            let radii = DVec3::new(0.6, 0.6, random.range(0.62, 0.75));
            self.add(Shape::Leaves { centre, radii, density: 0.5, skin: leaves, seed });
        }
    }

    /// A car. The frame's origin is the middle of its footprint, and x points to its front.
    pub fn car(&mut self, frame: &Frame, random: &mut SplitMix64) {
        let paint = rgb(PAINT[random.index(PAINT.len())]);
        let body = self.skin(Skin::Plain {
            color: paint,
            reflectance: 0.55,
            class: class::UNCLASSIFIED,
            grain: 0.04,
        });
        let glass = self.plain([0.03, 0.04, 0.05], 0.12, class::UNCLASSIFIED);
        let rubber = self.plain([0.012; 3], 0.1, class::UNCLASSIFIED);
        let (half, side) = (random.range(1.95, 2.3), 0.88);
        let height = random.range(1.4, 1.62);
        let faces = [
            (DVec3::new(-1.0, 0.0, 0.25), DVec3::new(-half, 0.0, 0.45), body),
            (DVec3::new(1.0, 0.0, 0.35), DVec3::new(half, 0.0, 0.45), body),
            (DVec3::new(0.0, -1.0, 0.12), DVec3::new(0.0, -side, 0.4), body),
            (DVec3::new(0.0, 1.0, 0.12), DVec3::new(0.0, side, 0.4), body),
            (DVec3::NEG_Z, DVec3::new(0.0, 0.0, 0.24), rubber),
            (DVec3::new(0.08, 0.0, 1.0), DVec3::new(0.0, 0.0, 0.88), body),
        ];
        self.convex(frame, &faces);
        let (min, max) =
            (DVec3::new(-half + 0.35, -0.78, 0.85), DVec3::new(0.36 * half, 0.78, height - 0.06));
        self.taper(frame, min, max, DVec2::new(0.5, 0.2), glass);
        let roof = DVec3::new(0.36 * half - 0.5, 0.6, height);
        self.cuboid(frame, DVec3::new(-half + 0.83, -0.6, height - 0.07), roof, body);
        for (x, y) in [(-0.62, -1.0), (-0.62, 1.0), (0.64, -1.0), (0.64, 1.0)] {
            let hub = frame.moved(DVec3::new(x * half, y * (side - 0.1), 0.32));
            let faces: Vec<_> = (0..10)
                .map(|i| {
                    let way = direction(f64::from(i) * 0.628_318_53);
                    let normal = DVec3::new(way.x, 0.0, way.y);
                    (normal, normal * 0.32, rubber)
                })
                .chain([
                    (DVec3::NEG_Y, DVec3::new(0.0, -0.1, 0.0), rubber),
                    (DVec3::Y, DVec3::new(0.0, 0.1, 0.0), rubber),
                ])
                .collect();
            self.convex(&hub, &faces);
        }
    }

    /// A lamp post whose arm points along the frame's x.
    pub fn lamp(&mut self, frame: &Frame) {
        let metal = self.plain(rgb(0x49504f), 0.4, class::UNCLASSIFIED);
        let light = self.plain(rgb(0xe9e4cf), 0.7, class::UNCLASSIFIED);
        self.post(frame.origin, 0.14, 0.8, metal);
        self.post(frame.origin, 0.075, 5.6, metal);
        self.cuboid(frame, DVec3::new(-0.04, -0.04, 5.5), DVec3::new(1.3, 0.04, 5.6), metal);
        self.cuboid(frame, DVec3::new(0.9, -0.16, 5.36), DVec3::new(1.55, 0.16, 5.52), light);
    }

    /// A traffic sign that faces along the frame's x.
    pub fn sign(&mut self, frame: &Frame, color: u32) {
        let metal = self.plain(rgb(0x9a9c9c), 0.6, class::UNCLASSIFIED);
        let board = self.plain(rgb(color), 0.9, class::UNCLASSIFIED);
        self.post(frame.origin, 0.035, 2.7, metal);
        self.cuboid(frame, DVec3::new(0.035, -0.3, 2.05), DVec3::new(0.06, 0.3, 2.65), board);
    }

    /// A bench whose seat faces along the frame's y.
    pub fn bench(&mut self, frame: &Frame) {
        let wood = self.plain(rgb(0x7a5836), 0.45, class::UNCLASSIFIED);
        self.cuboid(frame, DVec3::new(-0.9, -0.25, 0.42), DVec3::new(0.9, 0.2, 0.48), wood);
        self.cuboid(frame, DVec3::new(-0.9, -0.3, 0.5), DVec3::new(0.9, -0.25, 0.9), wood);
        for x in [-0.75, 0.7] {
            self.cuboid(frame, DVec3::new(x, -0.25, 0.0), DVec3::new(x + 0.06, 0.2, 0.42), wood);
        }
    }

    /// A market stall under a striped roof.
    pub fn stall(&mut self, frame: &Frame, random: &mut SplitMix64) {
        let wood = self.plain(rgb(0x8a6a45), 0.45, class::UNCLASSIFIED);
        let cloth = [0xb8322f, 0x2f7d55, 0xe0b23f, 0x3d5fa8, 0xf0ece0][random.index(5)];
        let cloth = self.plain(rgb(cloth), 0.6, class::UNCLASSIFIED);
        for (x, y) in [(-1.5, -1.0), (1.5, -1.0), (-1.5, 1.0), (1.5, 1.0)] {
            self.post(frame.point(DVec3::new(x, y, 0.0)), 0.04, 2.2, wood);
        }
        self.cuboid(frame, DVec3::new(-1.4, -0.9, 0.0), DVec3::new(1.4, 0.0, 0.95), wood);
        for y in [-1.4, 1.4] {
            let (low, high) = (DVec3::new(-1.8, y, 2.15), DVec3::new(1.8, 0.0, 2.85));
            self.slab(frame, low, high, 0.05, [cloth; 2]);
        }
        for i in 0..5 {
            let fruit = [0xc8402a, 0xd99a2b, 0x6f9a35, 0x8c3f6a, 0xd9c64a][random.index(5)];
            let skin = self.plain(rgb(fruit), 0.5, class::UNCLASSIFIED);
            let centre = frame.point(DVec3::new(-1.1 + 0.55 * f64::from(i), -0.45, 0.98));
            self.add(Shape::Ellipsoid { centre, radii: DVec3::new(0.24, 0.35, 0.16), skin });
        }
    }

    /// A round fountain with a column in the middle.
    pub fn fountain(&mut self, base: DVec3) {
        let stone = self.plain(rgb(0xb3aa98), 0.5, class::UNCLASSIFIED);
        let water = self.plain([0.03, 0.09, 0.11], 0.08, class::UNCLASSIFIED);
        self.post(base, 3.1, 0.25, stone);
        self.post(base, 2.7, 0.62, stone);
        self.post(base, 2.45, 0.66, water);
        self.post(base, 0.42, 2.1, stone);
        self.add(Shape::Ellipsoid {
            centre: base + DVec3::Z * 2.1,
            radii: DVec3::new(1.2, 1.2, 0.28),
            skin: stone,
        });
        self.post(base, 0.2, 3.3, stone);
        self.add(Shape::Ellipsoid {
            centre: base + DVec3::Z * 3.5,
            radii: DVec3::splat(0.38),
            skin: stone,
        });
    }

    /// A standing person.
    pub fn person(&mut self, base: DVec3, random: &mut SplitMix64) {
        let coat = [0x2b3a55, 0x7a2f2f, 0x3f3f44, 0xb39a6a, 0x4a6a55, 0xc9c4bb][random.index(6)];
        let coat = self.plain(rgb(coat), 0.4, class::UNCLASSIFIED);
        let trousers = self.plain(rgb(0x2a2c33), 0.3, class::UNCLASSIFIED);
        let skin = self.plain(rgb(0xc99a7c), 0.5, class::UNCLASSIFIED);
        let tall = random.range(0.92, 1.06);
        let mut part = |z: f64, radii: [f64; 3], part_skin| {
            let centre = base + DVec3::Z * z * tall;
            let radii = DVec3::from_array(radii) * tall;
            self.add(Shape::Ellipsoid { centre, radii, skin: part_skin });
        };
        part(0.45, [0.17, 0.17, 0.5], trousers);
        part(1.13, [0.24, 0.24, 0.4], coat);
        part(1.62, [0.11, 0.11, 0.14], skin);
    }
}
