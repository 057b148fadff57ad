//! The vertex element's columns.

use std::collections::HashSet;

use glam::{DVec3, Vec2, Vec3};

use super::super::fields::{self, Column, Fields, INTENSITY, Numbers, Spans};
use super::super::points::WordColors;
use super::super::{PointCloud, tidy};
use super::body::{Row, Wanted};
use super::colors::{self, Colors};
use super::header::{Element, Kind, Scalar};

const X: usize = 0;
const NORMAL: usize = 3;
const COLOR: usize = 6;
const UV: usize = 10;
const RADIUS: usize = 12;
/// Slots with a meaning; those behind them are scalar fields.
const SLOTS: usize = 13;

/// Names of each slot's property, the best first.
const NAMES: [&[&str]; SLOTS] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx", "normal_x"],
    &["ny", "normal_y"],
    &["nz", "normal_z"],
    // [`colors::properties`] finds colours.
    &[],
    &[],
    &[],
    &[],
    &["s", "u", "texture_u", "texture_s"],
    &["t", "v", "texture_v", "texture_t"],
    &["radius", "scalar_radius", "radii", "scalar_radii"],
];

/// Vertices as they come in.
pub(super) struct Vertices {
    pub positions: Vec<DVec3>,
    slots: Vec<Option<usize>>,
    normals: Option<Vec<Vec3>>,
    colors: Colors,
    has_alpha: bool,
    uvs: Option<Vec<Vec2>>,
    /// Scalar fields, of points alone.
    fields: Vec<Column>,
    radii: Option<Vec<f32>>,
}

/// Vertices once they are all there.
pub(super) struct Finished {
    pub positions: Vec<DVec3>,
    pub normals: Option<Vec<Vec3>>,
    pub colors: Option<Vec<[u8; 4]>>,
    pub uvs: Option<Vec<Vec2>>,
    pub fields: Fields,
    pub radii: Option<Vec<f32>>,
}

impl Vertices {
    /// Columns for the properties that `element` has, scalar fields only if `with_fields`; `Err` names a coordinate that it lacks.
    pub fn new(
        element: &Element,
        reserve: usize,
        with_fields: bool,
    ) -> Result<Vertices, &'static str> {
        let mut found = NAMES.map(|names| element.scalar(names));
        for (slot, names) in NAMES.iter().enumerate().take(3) {
            if found[slot].is_none() {
                return Err(names[0]);
            }
        }
        // A vector counts only when it is complete.
        for group in [NORMAL..NORMAL + 3, UV..UV + 2] {
            if group.clone().any(|slot| found[slot].is_none()) {
                group.for_each(|slot| found[slot] = None);
            }
        }
        let colors = colors::properties(element);
        found[COLOR..UV].copy_from_slice(&colors);
        let mut slots = vec![None; element.properties.len()];
        for (slot, property) in found.iter().enumerate() {
            if let Some(property) = property {
                slots[*property] = Some(slot);
            }
        }
        let fields = if with_fields { fields(element, &mut slots, reserve) } else { Vec::new() };
        let has = |slot: usize| found[slot].is_some();
        Ok(Vertices {
            positions: Vec::with_capacity(reserve),
            slots,
            normals: has(NORMAL).then(|| Vec::with_capacity(reserve)),
            colors: Colors::new(element, colors, reserve),
            has_alpha: has(COLOR + 3),
            uvs: has(UV).then(|| Vec::with_capacity(reserve)),
            fields,
            radii: has(RADIUS).then(|| Vec::with_capacity(reserve)),
        })
    }

    /// Which properties [`Vertices::push`] needs.
    pub fn wanted(&self) -> Wanted {
        let values = SLOTS + self.fields.len();
        Wanted { slots: self.slots.clone(), values, list: None, numbers: None }
    }

    /// Bytes of a vertex at most, with everything that is kept of one.
    pub fn bytes_each(&self) -> u64 {
        VERTEX_BYTES + 8 * self.fields.len() as u64
    }

    /// How many there are so far.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn push(&mut self, row: &Row) {
        let v = row.values.as_slice();
        let vector = |at: usize| DVec3::new(v[at], v[at + 1], v[at + 2]);
        self.positions.push(vector(X));
        if let Some(normals) = &mut self.normals {
            normals.push(vector(NORMAL).as_vec3());
        }
        let alpha = self.has_alpha.then_some(v[COLOR + 3]);
        self.colors.push([v[COLOR], v[COLOR + 1], v[COLOR + 2]], alpha);
        if let Some(uvs) = &mut self.uvs {
            uvs.push(Vec2::new(v[UV] as f32, (1.0 - v[UV + 1]) as f32));
        }
        self.fields.iter_mut().zip(&v[SLOTS..]).for_each(|(field, &value)| field.push(value));
        if let Some(radii) = &mut self.radii {
            radii.push(v[RADIUS] as f32);
        }
    }

    pub fn finish(self, warnings: &mut Vec<String>) -> Finished {
        let radii = self.radii.filter(|radii| {
            let odd = radii.iter().position(|radius| !(*radius > 0.0 && radius.is_finite()));
            if let Some(vertex) = odd {
                let radius = radii[vertex];
                warnings.push(format!(
                    "vertex {vertex} has a radius of {radius}, which is no positive number, so none is used"
                ));
            }
            odd.is_none()
        });
        Finished {
            positions: self.positions,
            normals: self.normals.and_then(|normals| tidy::unit_normals(normals, warnings)),
            colors: self.colors.finish("that of vertex", warnings),
            uvs: self.uvs,
            fields: fields::encoded(self.fields, warnings),
            radii,
        }
    }
}

/// Bytes of a vertex without scalar fields at most.
const VERTEX_BYTES: u64 = 64;

/// Columns for the scalar properties that have no slot yet, and their slots.
fn fields(element: &Element, slots: &mut [Option<usize>], reserve: usize) -> Vec<Column> {
    let mut columns: Vec<Column> = Vec::new();
    let mut known = HashSet::new();
    for (property, slot) in element.properties.iter().zip(slots) {
        let Kind::Scalar(scalar) = property.kind else { continue };
        if slot.is_some() {
            continue;
        }
        let usual = fields::name_of(&property.name);
        let is_taken = !known.insert(usual.clone());
        let numbers = match scalar {
            Scalar::U8 => Numbers::Bytes(Vec::with_capacity(reserve)),
            Scalar::U16 => Numbers::Words(Vec::with_capacity(reserve)),
            Scalar::I8 | Scalar::I16 | Scalar::F32 => Numbers::Singles(Vec::with_capacity(reserve)),
            _ => Numbers::Doubles(Vec::with_capacity(reserve)),
        };
        *slot = Some(SLOTS + columns.len());
        let name = if is_taken { property.name.clone() } else { usual };
        columns.push(Column::of(&name, numbers));
    }
    // Scanners of the 1990s write the strength of a signal so.
    if columns.iter().all(|column| column.name != INTENSITY)
        && let Some(column) = columns.iter_mut().find(|column| column.name == "confidence")
    {
        column.name = INTENSITY.to_owned();
    }
    columns
}

/// Facts about all vertices of a file.
#[derive(Clone, Debug, Default)]
pub(in crate::assets) struct Facts {
    has_normals: bool,
    has_colors: bool,
    counts_to_255: bool,
    words: WordColors,
    fields: Spans,
    has_odd_radii: bool,
}

impl Facts {
    pub(super) fn add(&mut self, vertices: &Vertices) {
        let normals = vertices.normals.iter().flatten();
        self.has_normals =
            self.has_normals || normals.copied().any(|n| tidy::unit_normal(n) != Vec3::ZERO);
        self.has_colors = self.has_colors || vertices.colors.are_filled();
        if let Colors::Floats(colors) = &vertices.colors {
            self.counts_to_255 = self.counts_to_255 || colors.iter().any(tidy::counts_to_255);
        }
        if let Colors::Words(colors, _) = &vertices.colors {
            self.words.add(colors);
        }
        // Vertices without a place are left out before values are encoded, but may widen the ranges.
        self.fields.add(&vertices.fields);
        let is_radius = |radius: &f32| *radius > 0.0 && radius.is_finite();
        self.has_odd_radii |= !vertices.radii.iter().flatten().all(is_radius);
    }

    /// Some of the file's vertices as points; those without a place are left out.
    pub(super) fn cloud(&self, vertices: Vertices) -> PointCloud {
        let Vertices { positions, normals, colors, mut fields, radii, .. } = vertices;
        let has_place: Vec<bool> = positions.iter().map(|position| position.is_finite()).collect();
        fn kept<T>(values: Vec<T>, has_place: &[bool]) -> Vec<T> {
            values.into_iter().zip(has_place).filter_map(|(v, keep)| keep.then_some(v)).collect()
        }
        let colors = match colors {
            Colors::None => None,
            Colors::Bytes(colors) => Some(colors),
            Colors::Words(colors, alpha) => colors::bytes_of_words(&colors, &alpha, self.words),
            Colors::Floats(colors) => {
                let color = |c: [f32; 4]| tidy::color_from_floats(c, self.counts_to_255);
                Some(colors.into_iter().map(color).collect())
            }
        };
        let colors = colors.filter(|_| self.has_colors);
        let normals = normals.filter(|_| self.has_normals);
        fields.iter_mut().for_each(|field| field.retain(&has_place));
        PointCloud {
            colors: colors.map(|colors| kept(colors, &has_place)),
            normals: normals.map(|normals| {
                kept(normals, &has_place).into_iter().map(tidy::unit_normal).collect()
            }),
            fields: self.fields.fields(fields),
            radii: radii.filter(|_| !self.has_odd_radii).map(|radii| kept(radii, &has_place)),
            positions: kept(positions, &has_place),
            ..PointCloud::default()
        }
    }
}

impl Finished {
    pub fn into_cloud(self) -> PointCloud {
        PointCloud {
            positions: self.positions,
            colors: self.colors,
            normals: self.normals,
            fields: self.fields,
            radii: self.radii,
            oriented: false,
            kernels: None,
            clips: None,
        }
    }
}
