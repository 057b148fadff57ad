//! Polygons and strips to a mesh, and points without either to a cloud.

use glam::{DVec3, Vec3};

use super::super::input::Origin;
use super::super::polygon::Triangulator;
use super::super::warnings::counted;
use super::super::{AssetError, Mesh, PointCloud, ReadOptions, corners, fields, tidy};
use super::{Array, Column, Numbers, PolyData, Roles};

impl PolyData {
    pub(super) fn mesh(
        &mut self,
        origin: &Origin,
        options: &ReadOptions,
    ) -> Result<Mesh, AssetError> {
        let file = origin.name.as_str();
        // A polygon has two triangles fewer than corners.
        let most = (self.polys.corners.len() + self.strips.corners.len()) as u64;
        origin.admission.grow(file, 12 * most + 40 * self.points.len() as u64)?;
        let mut triangles = Vec::new();
        let mut triangulator = Triangulator::default();
        let points = &self.points;
        let place = |at: u32| points.get(at as usize).copied().unwrap_or(DVec3::NAN);
        let mut short = 0;
        let of_cells = Roles::of(&self.cell_arrays);
        if let Some(array) = of_cells.color {
            origin.admission.grow(file, 4 * most + 8 * array.values.len() as u64)?;
        }
        let cell_colors = of_cells.color.map(|array| colors(array, "cell", &mut self.warnings));
        // Vertices and lines come before polygons, and these before strips.
        let before = (self.verts as usize).saturating_add(self.lines.len());
        let mut cell_color = cell_colors.iter().flatten().skip(before).copied();
        let mut painted = Vec::new();
        for polygon in self.polys.each() {
            match *polygon {
                [] | [_] | [_, _] => short += 1,
                [a, b, c] => triangles.push([a, b, c]),
                _ => triangulator.cut(polygon, place, |cut| {
                    triangles.push(cut.map(|corner| polygon[corner as usize]));
                }),
            }
            if let Some(color) = cell_color.next() {
                painted.resize(triangles.len(), color);
            }
            let count = triangles.len() as u64;
            AssetError::check_limit(file, "triangles", count, options.max_triangles)?;
        }
        for strip in self.strips.each() {
            let turned = strip.windows(3).enumerate().map(|(at, corners)| match at % 2 {
                0 => [corners[0], corners[1], corners[2]],
                _ => [corners[1], corners[0], corners[2]],
            });
            // A repeated corner is how strips turn; it covers nothing.
            triangles.extend(turned.filter(|[a, b, c]| a != b && b != c && c != a));
            if let Some(color) = cell_color.next() {
                painted.resize(triangles.len(), color);
            }
            let count = triangles.len() as u64;
            AssetError::check_limit(file, "triangles", count, options.max_triangles)?;
        }
        self.warnings.extend(counted(
            short,
            "polygon with fewer than three corners is left out",
            "polygons with fewer than three corners are left out",
        ));
        self.warnings.extend(counted(
            triangulator.forced,
            "polygon crosses itself and is drawn as a fan",
            "polygons cross themselves and are drawn as fans",
        ));
        if let Some(array) = of_cells.normals {
            self.warnings.push(format!(
                "array \"{}\" of cells is not used for polygons: normals of polygons are read from arrays of points",
                array.name
            ));
        }
        let (colors, normals) = self.appearance();
        let positions = self.points.clone();
        let mut mesh = Mesh { positions, triangles, colors, normals, ..Mesh::default() };
        if cell_colors.is_some() {
            corners::paint(&mut mesh, &painted, file, options, &mut self.warnings)?;
        }
        tidy::finish_mesh(mesh, file, &mut self.warnings)
    }

    /// The points of a file without other cells.
    pub(super) fn cloud(&mut self, origin: &Origin) -> Result<PointCloud, AssetError> {
        let file = origin.name.as_str();
        origin.admission.grow(file, 64 * self.points.len() as u64)?;
        let (colors, normals) = self.appearance();
        let roles = Roles::of(&self.point_arrays);
        let radii = roles.radius.map(|array| array.values.clone()).filter(|radii| {
            let odd = radii.iter().position(|radius| !(*radius > 0.0 && radius.is_finite()));
            if let Some(point) = odd {
                self.warnings.push(format!(
                    "point {point} has a radius of {}, which is no positive number, so none is used",
                    radii[point]
                ));
            }
            odd.is_none()
        });
        let mut columns = Vec::new();
        for array in &roles.fields {
            for (at, name) in array.names().into_iter().enumerate() {
                let values = array.values.iter().skip(at).step_by(array.components);
                let numbers = Numbers::Singles(values.copied().collect());
                columns.push(Column::of(&fields::name_of(&name), numbers));
            }
        }
        let cloud = PointCloud {
            positions: std::mem::take(&mut self.points),
            colors,
            normals,
            fields: fields::encoded(columns, &mut self.warnings),
            radii,
            ..PointCloud::default()
        };
        tidy::finish_cloud(cloud, file, &mut self.warnings)
    }

    /// Colours and normals of points.
    fn appearance(&mut self) -> (Option<Vec<[u8; 4]>>, Option<Vec<Vec3>>) {
        let roles = Roles::of(&self.point_arrays);
        let colors = roles.color.map(|array| colors(array, "vertex", &mut self.warnings));
        let normals = roles.normals.map(|array| {
            array.values.as_chunks::<3>().0.iter().map(|normal| Vec3::from_array(*normal)).collect()
        });
        (colors, normals.and_then(|normals| tidy::unit_normals(normals, &mut self.warnings)))
    }
}

/// The colours of an array, whose elements warnings call `element`.
fn colors(array: &Array, element: &str, warnings: &mut Vec<String>) -> Vec<[u8; 4]> {
    let floats = (0..array.values.len() / array.components).map(|at| array.color(at));
    if array.is_byte {
        floats.map(|color| color.map(|channel| channel as u8)).collect()
    } else {
        let first = format!("that of {element}");
        tidy::colors_from_floats(&floats.collect::<Vec<_>>(), &first, warnings)
    }
}
