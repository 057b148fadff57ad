//! Polygons and strips to a mesh, and points without either to a cloud.

use glam::{DVec3, Vec3};

use super::super::input::Origin;
use super::super::polygon::Triangulator;
use super::super::warnings::counted;
use super::super::{AssetError, Mesh, PointCloud, ReadOptions, fields, tidy};
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
        for polygon in self.polys.each() {
            match *polygon {
                [] | [_] | [_, _] => short += 1,
                [a, b, c] => triangles.push([a, b, c]),
                _ => triangulator.cut(polygon, place, |cut| {
                    triangles.push(cut.map(|corner| polygon[corner as usize]));
                }),
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
        let of_cells = Roles::of(&self.cell_arrays);
        for (array, what) in [(of_cells.color, "colours"), (of_cells.normals, "normals")] {
            let Some(array) = array else { continue };
            self.warnings.push(format!(
                "array \"{}\" of cells is not used for polygons: {what} of polygons are read from arrays of points",
                array.name
            ));
        }
        let (colors, normals) = self.appearance();
        let positions = self.points.clone();
        let mesh = Mesh { positions, triangles, colors, normals, ..Mesh::default() };
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
        let count = self.points.len();
        let colors = |array: &Array, warnings: &mut Vec<String>| {
            let floats = (0..count).map(|point| array.color(point));
            if array.is_byte {
                floats.map(|color| color.map(|channel| channel as u8)).collect()
            } else {
                tidy::colors_from_floats(&floats.collect::<Vec<_>>(), "that of vertex", warnings)
            }
        };
        let colors = roles.color.map(|array| colors(array, &mut self.warnings));
        let normals = roles.normals.map(|array| {
            array.values.as_chunks::<3>().0.iter().map(|normal| Vec3::from_array(*normal)).collect()
        });
        (colors, normals.and_then(|normals| tidy::unit_normals(normals, &mut self.warnings)))
    }
}
