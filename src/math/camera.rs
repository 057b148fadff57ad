//! Pinhole cameras, and cameras whose rays are parallel.
//!
//! View space is right-handed with x to the right, y **up** and the viewing direction along **−z**. Image space has its origin at
//! the top left, x to the right and y down. Pixel `(i, j)` covers `[i, i+1) × [j, j+1)`, with its centre at `(i + ½, j + ½)`.

use glam::{DAffine3, DMat3, DMat4, DVec2, DVec3, DVec4};
use serde::{Deserialize, Serialize};

use crate::words::words;

/// A pose: the eye, the point that it looks at, and how much it sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub eye: DVec3,
    pub target: DVec3,
    pub up: DVec3,
    pub lens: Lens,
}

/// A camera's projection, with the size of what it shows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Lens {
    /// Rays meet in the eye.
    Perspective {
        /// Vertical field of view in degrees, in [`FOV_RANGE_DEG`].
        fov_deg: f64,
    },
    /// Rays are parallel to the viewing direction and start in the plane through the eye.
    Orthographic {
        /// Height of the view in scene units, in [`ORTHO_HEIGHT_RANGE`]; twice glTF's `ymag`.
        height: f64,
    },
}

words! {
    /// How a scene is projected to the image.
    pub enum Projection {
        /// Things are smaller the farther away they are
        #[default]
        Perspective,
        /// Things have the same size at every distance: rays are parallel, and what lies behind the eye is not drawn
        Orthographic,
    }
}

/// The view of a sensor that took an asset's points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorView {
    /// The sensor's pose, with its vertical field of view.
    pub camera: Camera,
    /// Width of the sensor's image, divided by its height.
    pub aspect: f64,
}

/// The sensor that took a file's points, as far as the file describes it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Sensor {
    /// A camera, which took an image in one direction.
    View(SensorView),
    /// A scanner, which measured in all directions from this place.
    Place(DVec3),
}

impl SensorView {
    /// A camera at the sensor's pose whose image of this aspect ratio shows at least what the sensor saw.
    pub fn camera_for(&self, aspect: f64) -> Camera {
        let widened = (self.aspect / aspect).max(1.0);
        let lens = match self.camera.lens {
            Lens::Perspective { fov_deg } => {
                let tan = (0.5 * fov_deg.to_radians()).tan() * widened;
                let [least, most] = FOV_RANGE_DEG;
                Lens::Perspective { fov_deg: (2.0 * tan.atan().to_degrees()).clamp(least, most) }
            }
            Lens::Orthographic { height } => Lens::Orthographic { height: height * widened },
        };
        Camera { lens, ..self.camera }
    }
}

/// Largest coordinate. Beyond it squares might overflow.
pub const FARTHEST: f64 = 1e100;

/// Vertical fields of view that a camera can have, in degrees. Beyond them, the tangent of half the angle loses its digits.
pub const FOV_RANGE_DEG: [f64; 2] = [1e-6, 179.999_999];

/// Heights that the view of an orthographic camera can have, in scene units. Beyond them, squares of pixels per unit overflow in `f32`.
pub const ORTHO_HEIGHT_RANGE: [f64; 2] = [1e-15, 1e15];

/// The error of a pose that cannot be drawn, with the parameter at fault.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{parameter}: {reason}")]
pub struct CameraError {
    pub parameter: &'static str,
    pub reason: String,
}

/// The projection in f64: the eye, the rotation into view space, and a linear map from view directions, or from places beside the
/// optical axis, to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The eye in world space.
    pub eye: DVec3,
    /// Rows are the view axes in world space: right, up, backward. Orthonormal.
    pub view_from_world: DMat3,
    pub projection: Projection,
    /// Distance along the viewing axis around which an orthographic frame is computed, so that an eye that is far away costs no
    /// digits. The picture does not depend on it.
    pub focus: f64,
    /// Pixels per unit of `x/−z` and `y/−z`; orthographic: of `x` and `y`.
    pub focal_px: DVec2,
    /// The point of the image on the optical axis, in pixels.
    pub principal_px: DVec2,
    pub width: u32,
    pub height: u32,
}

impl Lens {
    pub fn projection(&self) -> Projection {
        match self {
            Lens::Perspective { .. } => Projection::Perspective,
            Lens::Orthographic { .. } => Projection::Orthographic,
        }
    }

    /// Vertical field of view in degrees, of a perspective.
    pub fn fov_deg(&self) -> Option<f64> {
        match *self {
            Lens::Perspective { fov_deg } => Some(fov_deg),
            Lens::Orthographic { .. } => None,
        }
    }

    /// Height of the view, of an orthographic projection.
    pub fn ortho_height(&self) -> Option<f64> {
        match *self {
            Lens::Perspective { .. } => None,
            Lens::Orthographic { height } => Some(height),
        }
    }

    /// The size of the view as a request names it, with that name.
    pub fn parameter(&self) -> (&'static str, f64) {
        match *self {
            Lens::Perspective { fov_deg } => ("fov", fov_deg),
            Lens::Orthographic { height } => ("ortho_height", height),
        }
    }

    /// The lens of an optional field of view and an optional height of the view, of which at most one is given.
    pub fn given(fov_deg: Option<f64>, ortho_height: Option<f64>) -> Option<Lens> {
        let orthographic = ortho_height.map(|height| Lens::Orthographic { height });
        orthographic.or(fov_deg.map(|fov_deg| Lens::Perspective { fov_deg }))
    }

    /// Part of the way to another lens, `share` from 0 to 1; sizes change evenly. A lens of another projection has no way to it.
    pub fn towards(self, other: Lens, share: f64) -> Lens {
        match (self, other) {
            (Lens::Perspective { fov_deg: a }, Lens::Perspective { fov_deg: b }) => {
                Lens::Perspective { fov_deg: a + (b - a) * share }
            }
            (Lens::Orthographic { height: a }, Lens::Orthographic { height: b }) => {
                Lens::Orthographic { height: a + (b - a) * share }
            }
            (lens, _) => lens,
        }
    }

    fn check(&self) -> Result<(), CameraError> {
        let (parameter, value, [least, most], unit) = match *self {
            Lens::Perspective { fov_deg } => ("fov", fov_deg, FOV_RANGE_DEG, "degrees"),
            Lens::Orthographic { height } => {
                ("ortho_height", height, ORTHO_HEIGHT_RANGE, "scene units")
            }
        };
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let reason = format!("{value} is out of range: {least} to {most} {unit} are accepted");
        Err(CameraError { parameter, reason })
    }
}

/// Vertical field of view in degrees up to which a camera is widened for a portrait frame.
const WIDEST_DEG: f64 = 100.0;

impl Camera {
    /// A camera in perspective with y up; `fov_deg`: its vertical field of view in degrees.
    pub fn perspective(eye: DVec3, target: DVec3, fov_deg: f64) -> Camera {
        Camera { eye, target, up: DVec3::Y, lens: Lens::Perspective { fov_deg } }
    }

    /// This camera for a frame of `width` × `height`. Cameras are made for frames at least as wide as high. A narrower frame
    /// shows the same width and more height; for this the field of view grows to at most 100 degrees.
    pub fn for_frame(&self, width: u32, height: u32) -> Camera {
        if height <= width {
            return *self;
        }
        let sides = f64::from(height) / f64::from(width);
        let lens = match self.lens {
            Lens::Perspective { fov_deg } => {
                let half = (0.5 * fov_deg).to_radians().tan() * sides;
                let widened = (2.0 * half.atan().to_degrees()).min(WIDEST_DEG);
                Lens::Perspective { fov_deg: fov_deg.max(widened) }
            }
            Lens::Orthographic { height } => Lens::Orthographic { height: height * sides },
        };
        Camera { lens, ..*self }
    }

    /// This camera with another projection, which shows as much at the distance of the target.
    pub fn with_projection(&self, projection: Projection) -> Camera {
        let distance = self.eye.distance(self.target);
        let lens = match (self.lens, projection) {
            (Lens::Perspective { fov_deg }, Projection::Orthographic) => {
                let [least, most] = ORTHO_HEIGHT_RANGE;
                let height = 2.0 * distance * (0.5 * fov_deg.to_radians()).tan();
                Lens::Orthographic { height: height.clamp(least, most) }
            }
            (Lens::Orthographic { height }, Projection::Perspective) => {
                let [least, most] = FOV_RANGE_DEG;
                let half = (0.5 * height / distance).atan();
                Lens::Perspective { fov_deg: (2.0 * half.to_degrees()).clamp(least, most) }
            }
            (lens, _) => lens,
        };
        Camera { lens, ..*self }
    }

    /// The view of a `width` × `height` frame.
    ///
    /// # Errors
    /// Numbers are not finite, `eye == target`, `up` is zero, or the field of view or the height is one that no camera has. An `up`
    /// along the viewing direction is no error: the axis farthest from it replaces it.
    pub fn view(&self, width: u32, height: u32) -> Result<View, CameraError> {
        let fail =
            |parameter, reason: &str| Err(CameraError { parameter, reason: reason.to_owned() });
        for (parameter, v) in [("eye", self.eye), ("target", self.target), ("up", self.up)] {
            if !v.is_finite() {
                return fail(parameter, "every coordinate must be a finite number");
            }
            if v.abs().max_element() > FARTHEST {
                return fail(parameter, "lies farther away than anything that can be drawn");
            }
        }
        self.lens.check()?;
        let Some(forward) = (self.target - self.eye).try_normalize() else {
            return fail("target", "must differ from eye");
        };
        let Some(up) = self.up.try_normalize() else {
            return fail("up", "must not be the zero vector");
        };
        let mut side = forward.cross(up);
        if side.length() < 1e-9 {
            let a = forward.abs();
            let axis = if a.x <= a.y && a.x <= a.z {
                DVec3::X
            } else if a.y <= a.z {
                DVec3::Y
            } else {
                DVec3::Z
            };
            side = forward.cross(axis);
        }
        let right = side / side.length();
        let up = right.cross(forward);
        let focal = match self.lens {
            Lens::Perspective { fov_deg } => {
                0.5 * f64::from(height) / (0.5 * fov_deg.to_radians()).tan()
            }
            Lens::Orthographic { height: units } => f64::from(height) / units,
        };
        Ok(View {
            eye: self.eye,
            view_from_world: DMat3::from_cols(right, up, -forward).transpose(),
            projection: self.lens.projection(),
            focus: self.eye.distance(self.target),
            focal_px: DVec2::splat(focal),
            principal_px: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
            width,
            height,
        })
    }
}

impl View {
    /// The view as an image of so many times the pixels along each side.
    #[must_use]
    pub fn finer(&self, factor: u32) -> View {
        View {
            focal_px: self.focal_px * f64::from(factor),
            principal_px: self.principal_px * f64::from(factor),
            width: self.width * factor,
            height: self.height * factor,
            ..*self
        }
    }

    /// The part of the image that begins at a column and a row and is so many pixels large.
    #[must_use]
    pub fn part(&self, [x, y]: [u32; 2], [width, height]: [u32; 2]) -> View {
        let principal_px = self.principal_px - DVec2::new(f64::from(x), f64::from(y));
        View { principal_px, width, height, ..*self }
    }

    /// A view from column-major `view` (world → view, rigid) and `proj` (view → clip) matrices. Near and far planes are not used.
    ///
    /// # Errors
    /// The matrices are not finite, the view scales or mirrors, or the projection is not a plain (possibly off-centre)
    /// perspective or orthographic one.
    pub fn from_matrices(
        view: DMat4,
        proj: DMat4,
        width: u32,
        height: u32,
    ) -> Result<View, CameraError> {
        let fail =
            |parameter, reason: &str| Err(CameraError { parameter, reason: reason.to_owned() });
        if !view.is_finite() {
            return fail("view", "all sixteen numbers must be finite");
        }
        if !proj.is_finite() {
            return fail("proj", "all sixteen numbers must be finite");
        }
        let rotation = DMat3::from_mat4(view);
        let error = rotation * rotation.transpose() - DMat3::IDENTITY;
        let worst = error.to_cols_array().iter().fold(0.0f64, |a, b| a.max(b.abs()));
        if worst > 1e-4 || rotation.determinant() < 0.0 || view.row(3) != DVec4::W {
            return fail("view", "must be a rotation and a translation only");
        }
        let eye = -(rotation.transpose() * view.w_axis.truncate());
        let (x, y, z, w) = (proj.x_axis, proj.y_axis, proj.z_axis, proj.w_axis);
        let half = DVec2::new(f64::from(width), f64::from(height)) * 0.5;
        let plain = x.y == 0.0 && y.x == 0.0 && x.w == 0.0 && y.w == 0.0;
        // By what x and y are divided: −z, or 1.
        let (projection, divisor, centre) = match (z.w, w.w) {
            (z_w, 0.0) if z_w != 0.0 && w.x == 0.0 && w.y == 0.0 => {
                if z_w > 0.0 {
                    return fail("proj", "must look along −z (last row 0 0 −1 0)");
                }
                (Projection::Perspective, -z_w, DVec2::new(-z.x, -z.y))
            }
            (0.0, w_w) if w_w > 0.0 && z.x == 0.0 && z.y == 0.0 => {
                (Projection::Orthographic, w_w, DVec2::new(w.x, w.y))
            }
            _ => {
                let accepted = "must be a perspective (last row 0 0 −1 0) or an orthographic projection (0 0 0 1)";
                return fail("proj", accepted);
            }
        };
        if !plain || x.x == 0.0 || y.y == 0.0 {
            return fail("proj", "must neither turn nor shear");
        }
        let focal = DVec2::new(x.x, y.y) / divisor * half;
        if focal.x <= 0.0 || focal.y <= 0.0 {
            return fail("proj", "must not mirror the image");
        }
        let centre = centre / divisor;
        Ok(View {
            eye,
            view_from_world: rotation,
            projection,
            focus: 0.0,
            focal_px: focal,
            principal_px: half * DVec2::new(1.0 + centre.x, 1.0 - centre.y),
            width,
            height,
        })
    }

    /// Transforms a world point to view space (−z is in front).
    pub fn to_view(&self, world: DVec3) -> DVec3 {
        self.view_from_world * (world - self.eye)
    }

    pub fn is_orthographic(&self) -> bool {
        self.projection == Projection::Orthographic
    }

    /// By what places are divided to get to the image, at a depth.
    pub fn divisor(&self, depth: f64) -> f64 {
        if self.is_orthographic() { 1.0 } else { depth }
    }

    /// Projects a view-space point to pixels; `None` at or behind the camera plane.
    pub fn project(&self, view: DVec3) -> Option<DVec2> {
        let depth = -view.z;
        let divisor = self.divisor(depth);
        (depth > 0.0).then(|| {
            DVec2::new(
                self.principal_px.x + self.focal_px.x * view.x / divisor,
                self.principal_px.y - self.focal_px.y * view.y / divisor,
            )
        })
    }

    /// An image position as the view-space place that it shows at divisor 1, with z = −1. In perspective this is the direction of
    /// the ray through it, which a depth scales.
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        DVec3::new(
            (pixel.x - self.principal_px.x) / self.focal_px.x,
            -(pixel.y - self.principal_px.y) / self.focal_px.y,
            -1.0,
        )
    }

    /// The view-space place at a depth on a [`ray`](Self::ray).
    pub fn at_depth(&self, ray: DVec3, depth: f64) -> DVec3 {
        if self.is_orthographic() { DVec3::new(ray.x, ray.y, -depth) } else { ray * depth }
    }

    /// The direction, up to its length, in which a view-space place is seen.
    pub fn towards(&self, view: DVec3) -> DVec3 {
        if self.is_orthographic() { DVec3::NEG_Z } else { view }
    }

    /// World space to view space as an affine map.
    pub fn view_affine(&self) -> DAffine3 {
        DAffine3::from_mat3_translation(self.view_from_world, self.view_from_world * -self.eye)
    }
}

#[cfg(test)]
mod tests;
