//! Builds solids: frames, boxes, prisms, posts, and the table of their skins.

use glam::{DVec2, DVec3};

use super::skin::{Rgb, Skin, SkinId};
use super::solid::{Face, Shape, Solid};

/// An upright coordinate system: x along, y to the left of it, z up.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    pub origin: DVec3,
    /// A unit vector.
    pub along: DVec2,
}

impl Frame {
    pub fn new(origin: DVec3, along: DVec2) -> Frame {
        Frame { origin, along }
    }

    fn left(&self) -> DVec2 {
        DVec2::new(-self.along.y, self.along.x)
    }

    pub fn point(&self, p: DVec3) -> DVec3 {
        self.origin + self.vector(p)
    }

    pub fn vector(&self, v: DVec3) -> DVec3 {
        let flat = self.along * v.x + self.left() * v.y;
        DVec3::new(flat.x, flat.y, v.z)
    }

    /// The frame turned to the left by `quarters` right angles.
    pub fn turned(&self, quarters: u32) -> Frame {
        let mut frame = *self;
        for _ in 0..quarters % 4 {
            frame.along = frame.left();
        }
        frame
    }

    pub fn moved(&self, by: DVec3) -> Frame {
        Frame { origin: self.point(by), ..*self }
    }
}

/// The collected solids and skins.
#[derive(Default)]
pub struct Builder {
    pub solids: Vec<Solid>,
    pub skins: Vec<Skin>,
}

impl Builder {
    pub fn skin(&mut self, skin: Skin) -> SkinId {
        self.skins.push(skin);
        SkinId(self.skins.len() as u32 - 1)
    }

    pub fn plain(&mut self, color: Rgb, reflectance: f64, class: u8) -> SkinId {
        self.skin(Skin::Plain { color, reflectance, class, grain: 0.15 })
    }

    pub fn add(&mut self, shape: Shape) {
        self.solids.push(Solid::new(shape));
    }

    /// Adds a convex solid. Its faces are given in a frame by a normal (of any length), a point and a skin.
    pub fn convex(&mut self, frame: &Frame, faces: &[(DVec3, DVec3, SkinId)]) {
        let faces = faces
            .iter()
            .map(|&(normal, point, skin)| {
                let normal = frame.vector(normal / normal.length());
                Face { normal, offset: normal.dot(frame.point(point)), skin }
            })
            .collect();
        self.add(Shape::Convex(faces));
    }

    /// Adds a box between two corners in a frame.
    pub fn cuboid(&mut self, frame: &Frame, min: DVec3, max: DVec3, skin: SkinId) {
        let faces = [
            (DVec3::NEG_X, min, skin),
            (DVec3::NEG_Y, min, skin),
            (DVec3::NEG_Z, min, skin),
            (DVec3::X, max, skin),
            (DVec3::Y, max, skin),
            (DVec3::Z, max, skin),
        ];
        self.convex(frame, &faces);
    }

    /// Adds a box whose sides are inset by `inset` at the top: pedestals, cabins, spires.
    pub fn taper(&mut self, frame: &Frame, min: DVec3, max: DVec3, inset: DVec2, skin: SkinId) {
        let height = max.z - min.z;
        let faces = [
            (DVec3::new(-height, 0.0, inset.x), min, skin),
            (DVec3::new(0.0, -height, inset.y), min, skin),
            (DVec3::NEG_Z, min, skin),
            (DVec3::new(height, 0.0, inset.x), DVec3::new(max.x, max.y, min.z), skin),
            (DVec3::new(0.0, height, inset.y), DVec3::new(max.x, max.y, min.z), skin),
            (DVec3::Z, max, skin),
        ];
        self.convex(frame, &faces);
    }

    /// Adds a slab of `thickness` whose top passes through `low` and `high`, the corners of a rectangle that is level along x.
    pub fn slab(
        &mut self,
        frame: &Frame,
        low: DVec3,
        high: DVec3,
        thickness: f64,
        skin: [SkinId; 2],
    ) {
        let d = high - low;
        let up = DVec3::new(0.0, -d.z, d.y) * if d.y < 0.0 { -1.0 } else { 1.0 };
        let up = up / up.length();
        let run = DVec3::new(0.0, d.y, d.z);
        let (left, right) = if d.x > 0.0 { (low, high) } else { (high, low) };
        let [top, side] = skin;
        let faces = [
            (up, low, top),
            (-up, low - up * thickness, side),
            (run, high, side),
            (-run, low, side),
            (DVec3::NEG_X, left, side),
            (DVec3::X, right, side),
        ];
        self.convex(frame, &faces);
    }

    pub fn post(&mut self, base: DVec3, radius: f64, height: f64, skin: SkinId) {
        self.add(Shape::Cylinder { base, radius, height, skin });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_slabs_and_tapers_have_their_bounds() {
        let mut builder = Builder::default();
        let skin = builder.plain([0.5; 3], 0.5, 1);
        let frame = Frame::new(DVec3::new(10.0, 0.0, 0.0), DVec2::Y);
        builder.cuboid(&frame, DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0), skin);
        let bounds = builder.solids[0].bounds;
        assert!((bounds.min - DVec3::new(8.0, 0.0, 0.0)).length() < 1e-9, "{bounds:?}");
        assert!((bounds.max - DVec3::new(10.0, 1.0, 3.0)).length() < 1e-9);
        let level = Frame::new(DVec3::ZERO, DVec2::X);
        let (low, high) = (DVec3::new(0.0, 0.0, 1.0), DVec3::new(4.0, 3.0, 5.0));
        builder.slab(&level, low, high, 0.1, [skin; 2]);
        let bounds = builder.solids[1].bounds;
        // Its ends are square to the slope, so the underside extends by a fifth of 0.4.
        assert!((bounds.max - DVec3::new(4.0, 3.08, 5.0)).length() < 1e-9, "{bounds:?}");
        assert!((bounds.min - DVec3::new(0.0, 0.0, 0.94)).length() < 1e-9, "{bounds:?}");
        builder.taper(&level, DVec3::ZERO, DVec3::splat(2.0), DVec2::splat(1.0), skin);
        let bounds = builder.solids[2].bounds;
        assert!(bounds.min.length() < 1e-9 && (bounds.max - DVec3::splat(2.0)).length() < 1e-9);
    }
}
