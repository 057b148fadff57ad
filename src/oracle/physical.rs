//! Metallic-roughness reflection (glTF 2.0, appendix B), from its definitions.

use glam::DVec3;

use crate::assets::{Material, Physical};

/// Smoother surfaces reflect as this rough ones.
const LEAST_ROUGHNESS: f64 = 0.045;

/// How a surface of a metallic-roughness material reflects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection {
    pub metallic: f64,
    pub roughness: f64,
    /// Reflectance at normal incidence where the surface is no metal.
    pub dielectric: [f64; 3],
    /// Reflectance at grazing angles there.
    pub grazing: f64,
    /// What passes: `None` for surfaces that hide what is behind them.
    pub transmission: Option<Transmission>,
}

/// How light passes a surface (KHR_materials_transmission), straight on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission {
    /// Of the light that is neither reflected nor taken up by a metal.
    pub share: f64,
    /// What the volume behind the surface leaves of it.
    pub volume: [f64; 3],
}

/// What a material adds to Lambert's and Phong's models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Details {
    /// `None` for materials of Phong's model.
    pub reflection: Option<Reflection>,
    /// Light that the surface gives off.
    pub emissive: [f64; 3],
    /// Share of ambient light that the material's occlusion map leaves.
    pub unoccluded: f64,
}

impl Details {
    /// Those of a material without its maps.
    pub fn of(material: &Material) -> Details {
        let reflection = |own: Physical| Reflection {
            metallic: own.metallic.into(),
            roughness: own.roughness.into(),
            dielectric: own.dielectric.map(f64::from),
            grazing: own.grazing.into(),
            transmission: None,
        };
        Details {
            reflection: material.physical.map(reflection),
            emissive: material.emissive.map(f64::from),
            unoccluded: 1.0,
        }
    }
}

impl Reflection {
    /// Reflectance at normal incidence and at grazing angles, and the share of light that is scattered below the surface, of one channel.
    fn parts(&self, albedo: f64, channel: usize) -> [f64; 3] {
        let mixed = |dielectric: f64, metal: f64| {
            dielectric * (1.0 - self.metallic) + metal * self.metallic
        };
        let stays = self.transmission.map_or(1.0, |own| 1.0 - own.share);
        let scattered = mixed(albedo, 0.0) * stays;
        [mixed(self.dielectric[channel], albedo), mixed(self.grazing, 1.0), scattered]
    }

    /// The share of the light of one channel from behind that passes towards the eye. `facing_eye`: the cosine between normal and eye; `None`
    /// where nothing is reflected.
    pub fn passing(&self, albedo: f64, channel: usize, facing_eye: Option<f64>) -> f64 {
        let Some(transmission) = self.transmission else { return 0.0 };
        let [facing, grazing, _] = self.parts(albedo, channel);
        let reflected = facing_eye.map_or(0.0, |cosine| {
            facing + (grazing - facing) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
        });
        let below = (1.0 - reflected) * (1.0 - self.metallic) * albedo;
        below * transmission.share * transmission.volume[channel]
    }

    /// Light of one channel that leaves towards the eye for each unit that falls along `to_light` on a surface square to it; times π, so that white
    /// Lambertian surfaces reflect 1. All vectors have unit length.
    pub fn towards_eye(
        &self,
        albedo: f64,
        channel: usize,
        [normal, to_light, to_eye]: [DVec3; 3],
    ) -> f64 {
        let [facing, grazing, diffuse] = self.parts(albedo, channel);
        let alpha_squared = self.roughness.max(LEAST_ROUGHNESS).powi(4);
        let (nl, nv) = (normal.dot(to_light).max(0.0), normal.dot(to_eye).clamp(1e-4, 1.0));
        let half = (to_light + to_eye).normalize_or_zero();
        // Trowbridge & Reitz 1975, times π.
        let nh = normal.dot(half);
        let distribution = alpha_squared / (nh * nh * (alpha_squared - 1.0) + 1.0).powi(2);
        // Heitz 2014: Smith's height-correlated masking and shadowing over 4 (n·l) (n·v).
        let one = |cosine: f64, other: f64| {
            cosine * (other * other * (1.0 - alpha_squared) + alpha_squared).sqrt()
        };
        let visibility = 0.5 / (one(nl, nv) + one(nv, nl));
        // Schlick 1994.
        let fresnel =
            facing + (grazing - facing) * (1.0 - to_eye.dot(half).clamp(0.0, 1.0)).powi(5);
        ((1.0 - fresnel) * diffuse + fresnel * distribution * visibility) * nl
    }

    /// The direction from which most of the light comes that facets mirror towards the eye: for rough surfaces it is nearer to the normal than that of a mirror
    /// (Lagarde & de Rousiers 2014, listing 21). A normal that looks away from the eye counts as one at the rim.
    pub fn direction_of_most(&self, normal: DVec3, to_eye: DVec3) -> DVec3 {
        let alpha = self.roughness.clamp(0.0, 1.0).powi(2);
        let share = (1.0 - alpha) * ((1.0 - alpha).sqrt() + alpha);
        normal.lerp(2.0 * normal.dot(to_eye).max(0.0) * normal - to_eye, share)
    }

    /// Light of one channel under light of 1 from everywhere: what facets mirror once ([`fit`]), and what is scattered, between facets (Fdez-Agüera 2019) or
    /// below the surface.
    pub fn of_surroundings(&self, albedo: f64, channel: usize, facing_eye: f64) -> [f64; 2] {
        let [facing, grazing, diffuse] = self.parts(albedo, channel);
        let [all, aside] = fit(self.roughness.clamp(0.0, 1.0), facing_eye.clamp(0.0, 1.0));
        let single = facing * (all - aside) + grazing * aside;
        let lost = 1.0 - all;
        let mean = facing + (grazing - facing) / 21.0;
        let multiple = single * mean * lost / (1.0 - mean * lost);
        [single, multiple + diffuse * (1.0 - single - multiple)]
    }
}

/// Coefficients of powers of the roughness, by rows, and of 1 − n·v, by columns.
type Coefficients = [[f64; 4]; 5];

/// Least squares over 41 × 41 places, with weights √(n·v + 0.02): off by 0.012 on average (root mean square) and by 0.04 at most where n·v is 0.1 or more.
const ALL: Coefficients = [
    [1.008, -0.012, -0.133, 0.180],
    [-0.269, -0.513, 7.245, -7.840],
    [2.066, 3.320, -40.165, 38.781],
    [-5.208, -5.971, 63.667, -56.584],
    [2.705, 3.553, -31.152, 26.215],
];
const GRAZING: Coefficients = [
    [-0.016, 0.409, -1.902, 2.443],
    [0.094, -1.954, 6.776, -5.331],
    [-0.162, 2.467, -2.663, -6.284],
    [0.088, -0.148, -10.135, 22.023],
    [-0.004, -0.781, 7.973, -12.886],
];

/// What the reflection of a white metal adds up to over all directions of light, and the part of it that Fresnel's term makes.
fn fit(roughness: f64, facing_eye: f64) -> [f64; 2] {
    let value = |coefficients: &Coefficients| -> f64 {
        let terms = coefficients.iter().enumerate().flat_map(|(i, row)| {
            row.iter().enumerate().map(move |(j, coefficient)| {
                coefficient * roughness.powi(i as i32) * (1.0 - facing_eye).powi(j as i32)
            })
        });
        terms.sum()
    };
    let all = value(&ALL).clamp(0.0, 1.0);
    [all, value(&GRAZING).clamp(0.0, all)]
}

#[cfg(test)]
mod tests {
    use super::*;

    const MIRROR: Reflection = Reflection {
        metallic: 1.0,
        roughness: 0.5,
        dielectric: [0.04; 3],
        grazing: 1.0,
        transmission: None,
    };

    fn direction(polar: f64, azimuth: f64) -> DVec3 {
        let (sine, cosine) = polar.sin_cos();
        DVec3::new(sine * azimuth.cos(), sine * azimuth.sin(), cosine)
    }

    /// The integral of what is reflected over all directions of light, over π.
    fn reflectance(reflection: &Reflection, albedo: f64, facing_eye: f64) -> f64 {
        let to_eye = direction(facing_eye.acos(), 0.0);
        let steps = 400;
        let mut sum = 0.0;
        for i in 0..steps {
            let polar = 0.5 * std::f64::consts::PI * (f64::from(i) + 0.5) / f64::from(steps);
            for j in 0..2 * steps {
                let azimuth = std::f64::consts::PI * (f64::from(j) + 0.5) / f64::from(steps);
                let vectors = [DVec3::Z, direction(polar, azimuth), to_eye];
                sum += reflection.towards_eye(albedo, 0, vectors) * polar.sin();
            }
        }
        sum * 0.5 * std::f64::consts::PI / f64::from(steps * steps)
    }

    /// White metals reflect no more than they get. The standard's dielectrics do at grazing angles, where diffuse light is weighed by Fresnel's
    /// share at the half vector alone.
    #[test]
    fn reflectance_is_bounded() {
        for roughness in [0.2, 0.5, 1.0] {
            for facing_eye in [0.1, 0.5, 1.0] {
                for (metallic, most) in
                    [(0.0, if facing_eye < 0.5 { 1.45 } else { 1.05 }), (1.0, 1.005)]
                {
                    let own = Reflection { metallic, roughness, ..MIRROR };
                    let found = reflectance(&own, 1.0, facing_eye);
                    assert!((0.3..most).contains(&found), "{own:?} {facing_eye}: {found}");
                }
            }
        }
    }

    /// The fit of what is scattered once, against the integral of the same reflection.
    #[test]
    fn the_fit_is_near_the_integral() {
        for roughness in [0.3, 0.6, 1.0] {
            for facing_eye in [0.2, 0.6, 1.0] {
                let own = Reflection { roughness, ..MIRROR };
                let [all, grazing] = fit(roughness, facing_eye);
                for albedo in [0.04, 0.5, 1.0] {
                    let found = albedo * all + (1.0 - albedo) * grazing;
                    let exact = reflectance(&own, albedo, facing_eye);
                    assert!(
                        (found - exact).abs() < 0.05,
                        "{roughness} {facing_eye}: {found} {exact}"
                    );
                }
            }
        }
    }

    /// In a white furnace a white metal and a white dielectric of any roughness cannot be seen.
    #[test]
    fn white_surfaces_vanish_in_white_surroundings() {
        for roughness in [0.0, 0.3, 1.0] {
            for facing_eye in [0.0, 0.4, 1.0] {
                for metallic in [0.0, 1.0] {
                    let own = Reflection { metallic, roughness, ..MIRROR };
                    let found = own.of_surroundings(1.0, 0, facing_eye).iter().sum::<f64>();
                    assert!((found - 1.0).abs() < 1e-9, "{own:?} {facing_eye}: {found}");
                }
            }
        }
    }

    #[test]
    fn reflection_is_reciprocal() {
        let (a, b) = (direction(0.3, 0.2), direction(1.1, 2.0));
        let own = Reflection { metallic: 0.3, ..MIRROR };
        let forth = own.towards_eye(0.7, 1, [DVec3::Z, a, b]) / a.z;
        let back = own.towards_eye(0.7, 1, [DVec3::Z, b, a]) / b.z;
        assert!((forth - back).abs() < 1e-12);
    }
}
