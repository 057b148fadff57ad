//! Houses and the church.

use glam::{DVec2, DVec3};

use super::builder::{Builder, Frame};
use super::skin::{Facade, FacadeStyle, Roof, Skin, SkinId, class, rgb};
use crate::scene::random::SplitMix64;

const WALLS: [u32; 12] = [
    0xe8dcc0, 0xe6cf9f, 0xd9b48a, 0xc98f6b, 0xe9e4d8, 0xb9c4b1, 0xa9b7c6, 0xd8c3b4, 0xc76f52,
    0xefe3c8, 0xcfc7b8, 0xdaa95e,
];
const ROOFS: [u32; 7] = [0xa8492f, 0x9a3f2b, 0xb35a3a, 0x8a3b2c, 0x6e4234, 0x55575c, 0x9c5236];
const AWNINGS: [u32; 5] = [0xb23a36, 0x2f6f73, 0xd9a441, 0x3f5f94, 0xe7e2d6];

/// Place and size of a house. The frame's origin is the left front corner seen from the street, at street level; x runs along the
/// front and y into the plot.
pub struct House {
    pub frame: Frame,
    pub width: f64,
    pub depth: f64,
    pub storeys: u32,
    /// Rise of the roof over its run.
    pub pitch: f64,
    /// Whether neighbours adjoin the gables, which then have no windows.
    pub attached: bool,
    pub shop: bool,
}

const STOREY_M: f64 = 2.95;
const EAVES_OVERHANG_M: f64 = 0.45;
const ROOF_THICKNESS_M: f64 = 0.2;

fn pick<T: Copy>(random: &mut SplitMix64, list: &[T]) -> T {
    list[random.index(list.len())]
}

impl Builder {
    pub fn house(&mut self, house: &House, random: &mut SplitMix64) {
        let (w, d) = (house.width, house.depth);
        let eaves = STOREY_M * f64::from(house.storeys);
        let ridge = eaves + 0.5 * d * house.pitch;
        let color = rgb(pick(random, &WALLS));
        let seed = random.next_u64();
        let style = match random.unit() {
            _ if house.shop => FacadeStyle::Shop,
            u if u < 0.22 => FacadeStyle::Timber,
            _ => FacadeStyle::Plaster,
        };
        let color = if style == FacadeStyle::Timber { rgb(0xe6ddc9) } else { color };
        let frame = house.frame;
        // Each wall's origin is its own left foot; counter-clockwise from the front.
        let feet = [(0.0, 0.0, w), (w, 0.0, d), (w, d, w), (0.0, d, d)];
        let mut walls = [SkinId(0); 4];
        for (side, (x, y, width)) in feet.into_iter().enumerate() {
            let gable = side % 2 == 1;
            let style = match style {
                _ if gable && house.attached => FacadeStyle::Blank,
                FacadeStyle::Shop if side != 0 => FacadeStyle::Plaster,
                style => style,
            };
            let foot = frame.point(DVec3::new(x, y, 0.0));
            walls[side] = self.skin(Skin::Facade(Facade {
                color,
                origin: DVec2::new(foot.x, foot.y),
                along: frame.turned(side as u32).along,
                width,
                storeys: house.storeys,
                storey_height: STOREY_M,
                style,
                seed: seed ^ (side as u64),
            }));
        }
        let slope = DVec3::new(0.0, -house.pitch, 1.0);
        let ridge_point = DVec3::new(0.0, 0.5 * d, ridge);
        let corner = DVec3::new(w, d, 0.0);
        self.convex(
            &frame,
            &[
                (DVec3::NEG_Y, DVec3::ZERO, walls[0]),
                (DVec3::X, corner, walls[1]),
                (DVec3::Y, corner, walls[2]),
                (DVec3::NEG_X, DVec3::ZERO, walls[3]),
                (slope, ridge_point, walls[0]),
                (DVec3::new(0.0, house.pitch, 1.0), ridge_point, walls[0]),
                (DVec3::NEG_Z, DVec3::new(0.0, 0.0, -0.5), walls[0]),
            ],
        );
        self.roof(house, eaves, random);
        if house.shop && random.chance(0.7) {
            let cloth = rgb(pick(random, &AWNINGS));
            let awning = self.plain(cloth, 0.6, class::BUILDING);
            let (low, high) = (DVec3::new(0.5, -1.4, 2.45), DVec3::new(w - 0.5, 0.0, 2.9));
            self.slab(&frame, low, high, 0.05, [awning; 2]);
        }
    }

    fn roof(&mut self, house: &House, eaves: f64, random: &mut SplitMix64) {
        let (frame, w, d, pitch) = (house.frame, house.width, house.depth, house.pitch);
        let side = if house.attached { 0.05 } else { 0.35 };
        let tiles = self.skin(Skin::Roof(Roof {
            color: rgb(pick(random, &ROOFS)),
            origin: frame.origin,
            along: frame.along,
            seed: random.next_u64(),
        }));
        let board = self.plain(rgb(0x5e4a3a), 0.4, class::BUILDING);
        let top = ROOF_THICKNESS_M;
        let low = eaves - EAVES_OVERHANG_M * pitch + top;
        let ridge = eaves + 0.5 * d * pitch + top;
        for (y, left, right) in
            [(-EAVES_OVERHANG_M, -side, w + side), (d + EAVES_OVERHANG_M, -side, w + side)]
        {
            let low = DVec3::new(left, y, low);
            let high = DVec3::new(right, 0.5 * d, ridge);
            self.slab(&frame, low, high, ROOF_THICKNESS_M, [tiles, board]);
        }
        let brick = self.plain(rgb(0x8d4b38), 0.4, class::BUILDING);
        for _ in 0..1 + random.index(2) {
            let (x, y) = (random.range(0.8, w - 1.4), random.range(0.38, 0.62) * d);
            let min = DVec3::new(x, y, ridge - 1.5);
            self.cuboid(
                &frame,
                min,
                DVec3::new(x + 0.6, y + 0.5, ridge + random.range(0.5, 0.9)),
                brick,
            );
        }
        if pitch > 0.75 && random.chance(0.65) {
            let count = ((w - 1.6) / 2.6).floor().max(1.0);
            for i in 0..count as u32 {
                let x = w * (f64::from(i) + 0.5) / count;
                self.dormer(&frame, x, eaves, pitch, tiles, random);
            }
        }
    }

    /// Adds a dormer: a window in the roof under a small slab.
    fn dormer(
        &mut self,
        frame: &Frame,
        x: f64,
        eaves: f64,
        pitch: f64,
        tiles: SkinId,
        random: &mut SplitMix64,
    ) {
        let (front, height) = (0.7, 1.35);
        let base = eaves + front * pitch;
        let foot = frame.point(DVec3::new(x - 0.8, front, 0.0));
        let cheek = self.plain(rgb(0x6f6a63), 0.4, class::BUILDING);
        let face = self.skin(Skin::Facade(Facade {
            color: rgb(0xe3ddd0),
            origin: DVec2::new(foot.x, foot.y),
            along: frame.along,
            // Placed so that its only storey begins at the dormer's foot.
            width: 1.6,
            storeys: 1,
            storey_height: base - 0.35,
            style: FacadeStyle::Plaster,
            seed: random.next_u64(),
        }));
        let back = front + height / pitch + 0.4;
        let (min, max) =
            (DVec3::new(x - 0.8, front, base - 0.3), DVec3::new(x + 0.8, back, base + height));
        self.convex(
            frame,
            &[
                (DVec3::NEG_Y, min, face),
                (DVec3::NEG_X, min, cheek),
                (DVec3::NEG_Z, min, cheek),
                (DVec3::X, max, cheek),
                (DVec3::Y, max, cheek),
                (DVec3::Z, max, cheek),
            ],
        );
        let low = DVec3::new(x - 1.0, front - 0.25, base + height + 0.1);
        let high = DVec3::new(x + 1.0, back + 0.3, base + height + 0.45);
        self.slab(frame, low, high, 0.12, [tiles, cheek]);
    }

    /// A church: nave, choir, tower with a spire. The frame's origin is the middle of the nave's west end, and x runs along the
    /// nave.
    pub fn church(&mut self, frame: &Frame, length: f64, random: &mut SplitMix64) {
        let width = 0.46 * length;
        let nave = frame.moved(DVec3::new(0.0, -0.5 * width, 0.0));
        self.stone_hall(&nave, length, width, 9.5, 1.15, random);
        let choir = frame.moved(DVec3::new(length, -0.3 * width, 0.0));
        self.stone_hall(&choir, 0.25 * length, 0.6 * width, 7.5, 1.2, random);
        let tower_width = 0.36 * length;
        let tower = frame.moved(DVec3::new(-tower_width + 0.2, -0.5 * tower_width, 0.0));
        let height = 1.15 * length;
        let walls = self.church_walls(&tower, tower_width, tower_width, 0xcdbf9f);
        let corner = DVec3::new(tower_width, tower_width, height);
        self.convex(
            &tower,
            &[
                (DVec3::NEG_Y, DVec3::ZERO, walls[0]),
                (DVec3::X, corner, walls[1]),
                (DVec3::Y, corner, walls[2]),
                (DVec3::NEG_X, DVec3::ZERO, walls[3]),
                (DVec3::Z, corner, walls[0]),
                (DVec3::NEG_Z, DVec3::new(0.0, 0.0, -0.5), walls[0]),
            ],
        );
        let ledge = self.plain(rgb(0xb8ab8d), 0.5, class::BUILDING);
        for z in [0.55 * height, height - 0.4] {
            let min = DVec3::new(-0.25, -0.25, z);
            let max = DVec3::new(tower_width + 0.25, tower_width + 0.25, z + 0.4);
            self.cuboid(&tower, min, max, ledge);
        }
        let copper = self.plain(rgb(0x5f8f7d), 0.45, class::BUILDING);
        let min = DVec3::new(0.1, 0.1, height);
        let max = DVec3::new(tower_width - 0.1, tower_width - 0.1, height + 1.9 * tower_width);
        self.taper(&tower, min, max, DVec2::splat(0.5 * tower_width - 0.25), copper);
        let middle = tower.point(DVec3::new(0.5 * tower_width, 0.5 * tower_width, max.z - 0.1));
        let gold = self.plain(rgb(0xd8b24a), 0.8, class::BUILDING);
        self.post(middle, 0.06, 2.2, gold);
        let arm = Frame::new(middle, frame.along);
        self.cuboid(&arm, DVec3::new(-0.06, -0.55, 1.4), DVec3::new(0.06, 0.55, 1.55), gold);
        // Buttresses between the windows.
        for i in 0..=(length / 4.2) as u32 {
            let x = length * f64::from(i) / (length / 4.2).floor();
            for (y, sign) in [(0.0, -1.0), (width, 1.0)] {
                let (a, b) = (y, y + sign * 0.8);
                let min = DVec3::new(x - 0.35, a.min(b), -0.2);
                let max = DVec3::new(x + 0.35, a.max(b), 6.8);
                self.taper(&nave, min, max, DVec2::new(0.0, 0.3), walls[0]);
            }
        }
    }

    fn church_walls(&mut self, frame: &Frame, w: f64, d: f64, color: u32) -> [SkinId; 4] {
        let feet = [(0.0, 0.0, w), (w, 0.0, d), (w, d, w), (0.0, d, d)];
        let mut side = 0;
        feet.map(|(x, y, width)| {
            let foot = frame.point(DVec3::new(x, y, 0.0));
            let along = frame.turned(side).along;
            side += 1;
            self.skin(Skin::Facade(Facade {
                color: rgb(color),
                origin: DVec2::new(foot.x, foot.y),
                along,
                width,
                storeys: 1,
                storey_height: 8.0,
                style: FacadeStyle::Church,
                seed: 5,
            }))
        })
    }

    fn stone_hall(
        &mut self,
        frame: &Frame,
        length: f64,
        width: f64,
        eaves: f64,
        pitch: f64,
        random: &mut SplitMix64,
    ) {
        let walls = self.church_walls(frame, length, width, 0xd6c8a8);
        let ridge = DVec3::new(0.0, 0.5 * width, eaves + 0.5 * width * pitch);
        let corner = DVec3::new(length, width, 0.0);
        self.convex(
            frame,
            &[
                (DVec3::NEG_Y, DVec3::ZERO, walls[0]),
                (DVec3::X, corner, walls[1]),
                (DVec3::Y, corner, walls[2]),
                (DVec3::NEG_X, DVec3::ZERO, walls[3]),
                (DVec3::new(0.0, -pitch, 1.0), ridge, walls[0]),
                (DVec3::new(0.0, pitch, 1.0), ridge, walls[0]),
                (DVec3::NEG_Z, DVec3::new(0.0, 0.0, -0.5), walls[0]),
            ],
        );
        let slate = self.skin(Skin::Roof(Roof {
            color: rgb(0x5a5f68),
            origin: frame.origin,
            along: frame.along,
            seed: random.next_u64(),
        }));
        let low = eaves - 0.4 * pitch + 0.2;
        for y in [-0.4, width + 0.4] {
            let (low, high) =
                (DVec3::new(-0.2, y, low), DVec3::new(length + 0.2, ridge.y, ridge.z + 0.2));
            self.slab(frame, low, high, 0.2, [slate; 2]);
        }
    }
}
