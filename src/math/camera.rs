//! Pinhole cameras.
//!
//! View space is right-handed with x to the right, y **up** and the viewing direction along **−z**. Image space has its origin at
//! the top left, x to the right and y down. Pixel `(i, j)` covers `[i, i+1) × [j, j+1)`, with its centre at `(i + ½, j + ½)`.

use glam::{DAffine3, DMat3, DMat4, DVec2, DVec3, DVec4};
use serde::{Deserialize, Serialize};

/// A pose: the eye, the point that it looks at, and the field of view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub eye: DVec3,
    pub target: DVec3,
    pub up: DVec3,
    /// Vertical field of view in degrees, in (0, 180).
    pub fov_deg: f64,
}

/// The view of a sensor that took an asset's points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorView {
    /// The sensor's pose, with its vertical field of view.
    pub camera: Camera,
    /// Width of the sensor's image, divided by its height.
    pub aspect: f64,
}

/// The sensor that took a file's points, as far as the file describes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sensor {
    /// A camera, which took an image in one direction.
    View(SensorView),
    /// A scanner, which measured in all directions from this place.
    Place(DVec3),
}

impl SensorView {
    /// A camera at the sensor's pose whose image of this aspect ratio shows at least what the sensor saw.
    pub fn camera_for(&self, aspect: f64) -> Camera {
        let tan = (0.5 * self.camera.fov_deg.to_radians()).tan() * (self.aspect / aspect).max(1.0);
        let [least, most] = FOV_RANGE_DEG;
        Camera { fov_deg: (2.0 * tan.atan().to_degrees()).clamp(least, most), ..self.camera }
    }
}

/// Largest coordinate. Beyond it squares might overflow.
pub const FARTHEST: f64 = 1e100;

/// Vertical fields of view that a camera can have, in degrees. Beyond them, the tangent of half the angle loses its digits.
pub const FOV_RANGE_DEG: [f64; 2] = [1e-6, 179.999_999];

/// The error of a pose that cannot be drawn, with the parameter at fault.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{parameter}: {reason}")]
pub struct CameraError {
    pub parameter: &'static str,
    pub reason: String,
}

/// The projection in f64: the eye, the rotation into view space, and a linear map from view directions to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The eye in world space.
    pub eye: DVec3,
    /// Rows are the view axes in world space: right, up, backward. Orthonormal.
    pub view_from_world: DMat3,
    /// Pixels per unit of `x/−z` and `y/−z`.
    pub focal_px: DVec2,
    /// The point of the image on the optical axis, in pixels.
    pub principal_px: DVec2,
    pub width: u32,
    pub height: u32,
}

/// Vertical field of view in degrees up to which a camera is widened for a portrait frame.
const WIDEST_DEG: f64 = 100.0;

impl Camera {
    /// This camera for a frame of `width` × `height`. Cameras are made for frames at least as wide as high. A narrower frame
    /// shows the same width and more height; for this the field of view grows to at most 100 degrees.
    pub fn for_frame(&self, width: u32, height: u32) -> Camera {
        if height <= width {
            return *self;
        }
        let half = (0.5 * self.fov_deg).to_radians().tan() * f64::from(height) / f64::from(width);
        let widened = (2.0 * half.atan().to_degrees()).min(WIDEST_DEG);
        Camera { fov_deg: self.fov_deg.max(widened), ..*self }
    }

    /// The view of a `width` × `height` frame.
    ///
    /// # Errors
    /// Numbers are not finite, `eye == target`, `up` is zero, or the field of view is outside [`FOV_RANGE_DEG`]. An `up` along
    /// the viewing direction is no error: the axis farthest from it replaces it.
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
        let [least, most] = FOV_RANGE_DEG;
        if !(least..=most).contains(&self.fov_deg) {
            let reason =
                format!("{} is out of range: {least} to {most} degrees are accepted", self.fov_deg);
            return Err(CameraError { parameter: "fov", reason });
        }
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
        let focal = 0.5 * f64::from(height) / (0.5 * self.fov_deg.to_radians()).tan();
        Ok(View {
            eye: self.eye,
            view_from_world: DMat3::from_cols(right, up, -forward).transpose(),
            focal_px: DVec2::splat(focal),
            principal_px: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
            width,
            height,
        })
    }
}

impl View {
    /// A view from column-major `view` (world → view, rigid) and `proj` (view → clip, perspective) matrices.
    ///
    /// # Errors
    /// The matrices are not finite, the view scales or mirrors, or the projection is not a plain (possibly off-centre)
    /// perspective.
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
        let perspective = z.w != 0.0 && x.w == 0.0 && y.w == 0.0 && w.w == 0.0;
        let plain = x.y == 0.0 && y.x == 0.0 && w.x == 0.0 && w.y == 0.0;
        if !perspective || !plain || x.x == 0.0 || y.y == 0.0 {
            return fail("proj", "must be a perspective projection (last row 0 0 ±1 0)");
        }
        let flip = -z.w;
        if flip <= 0.0 {
            return fail("proj", "must look along −z (last row 0 0 −1 0)");
        }
        let half = DVec2::new(f64::from(width), f64::from(height)) * 0.5;
        let focal = DVec2::new(x.x, y.y) / flip * half;
        if focal.x <= 0.0 || focal.y <= 0.0 {
            return fail("proj", "must not mirror the image");
        }
        let centre = DVec2::new(-z.x, -z.y) / flip;
        Ok(View {
            eye,
            view_from_world: rotation,
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

    /// Projects a view-space point to pixels; `None` at or behind the camera plane.
    pub fn project(&self, view: DVec3) -> Option<DVec2> {
        let depth = -view.z;
        (depth > 0.0).then(|| {
            DVec2::new(
                self.principal_px.x + self.focal_px.x * view.x / depth,
                self.principal_px.y - self.focal_px.y * view.y / depth,
            )
        })
    }

    /// The view-space direction through an image position, scaled to z = −1, so that multiplying by a depth gives the point.
    pub fn ray(&self, pixel: DVec2) -> DVec3 {
        DVec3::new(
            (pixel.x - self.principal_px.x) / self.focal_px.x,
            -(pixel.y - self.principal_px.y) / self.focal_px.y,
            -1.0,
        )
    }

    /// World space to view space as an affine map.
    pub fn view_affine(&self) -> DAffine3 {
        DAffine3::from_mat3_translation(self.view_from_world, self.view_from_world * -self.eye)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            eye: DVec3::new(1.0, 2.0, 5.0),
            target: DVec3::new(0.5, 1.0, 0.0),
            up: DVec3::Y,
            fov_deg: 40.0,
        }
    }

    #[test]
    fn target_projects_to_the_centre() {
        let view = camera().view(640, 480).unwrap();
        let p = view.project(view.to_view(camera().target)).unwrap();
        assert!((p - DVec2::new(320.0, 240.0)).length() < 1e-9);
    }

    #[test]
    fn ray_inverts_project() {
        let view = camera().view(640, 480).unwrap();
        let pixel = DVec2::new(17.25, 400.5);
        let back = view.project(view.ray(pixel) * 7.0).unwrap();
        assert!((back - pixel).length() < 1e-9);
    }

    #[test]
    fn matrices_agree_with_the_pose() {
        let (w, h) = (640, 480);
        let view = camera().view(w, h).unwrap();
        let m = DMat4::from(view.view_affine());
        let f = 1.0 / (20.0f64.to_radians()).tan();
        let aspect = f64::from(w) / f64::from(h);
        let proj = DMat4::from_cols(
            DVec4::new(f / aspect, 0.0, 0.0, 0.0),
            DVec4::new(0.0, f, 0.0, 0.0),
            DVec4::new(0.2, -0.1, -1.0, -1.0),
            DVec4::new(0.0, 0.0, -0.1, 0.0),
        );
        let other = View::from_matrices(m, proj, w, h).unwrap();
        let p = DVec3::new(0.3, 0.9, -0.5);
        let clip = proj * m * p.extend(1.0);
        let ndc = clip.truncate() / clip.w;
        let expected = DVec2::new((ndc.x + 1.0) * 320.0, (1.0 - ndc.y) * 240.0);
        let found = other.project(other.to_view(p)).unwrap();
        assert!((found - expected).length() < 1e-9, "{found} {expected}");
    }

    #[test]
    fn narrow_frames_show_as_much_of_the_width() {
        let corner = |width, height| {
            let view = camera().for_frame(width, height).view(width, height).unwrap();
            let square = camera().view(width, width).unwrap();
            (view.focal_px, square.focal_px)
        };
        let (found, expected) = corner(390, 844);
        assert!((found - expected).length() < 1e-9, "{found} {expected}");
        assert_eq!(camera().for_frame(640, 480), camera());
        assert_eq!(camera().for_frame(480, 480), camera());
        assert_eq!(camera().for_frame(1, 257).fov_deg, 100.0);
        let wide = Camera { fov_deg: 179.0, ..camera() };
        assert_eq!(wide.for_frame(1, 257), wide);
    }

    #[test]
    fn bad_poses_name_their_parameter() {
        let mut c = camera();
        for fov_deg in [180.0, 179.999_999_999, 1e-7, 5e-324, 0.0, f64::NAN] {
            c.fov_deg = fov_deg;
            assert_eq!(c.view(8, 8).unwrap_err().parameter, "fov");
        }
        for fov_deg in FOV_RANGE_DEG {
            c.fov_deg = fov_deg;
            c.view(8, 8).unwrap();
        }
        let mut c = camera();
        c.target = c.eye;
        assert_eq!(c.view(8, 8).unwrap_err().parameter, "target");
        let mut c = camera();
        c.up = DVec3::ZERO;
        assert_eq!(c.view(8, 8).unwrap_err().parameter, "up");
        let mut c = camera();
        c.eye.x = f64::NAN;
        assert_eq!(c.view(8, 8).unwrap_err().parameter, "eye");
    }

    #[test]
    fn looking_along_up_is_drawn() {
        let c = Camera { eye: DVec3::Y, target: DVec3::ZERO, up: DVec3::Y, fov_deg: 60.0 };
        let view = c.view(8, 8).unwrap();
        assert!(view.view_from_world.is_finite());
    }
}
