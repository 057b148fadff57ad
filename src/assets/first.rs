//! The first geometry of a kind, for tests of readers.

use super::{Asset, Geometry, Mesh, PointCloud, Polylines};

fn first<'a, T>(asset: &'a Asset, of_kind: impl Fn(&'a Geometry) -> Option<&'a T>) -> &'a T {
    asset.geometries.iter().find_map(of_kind).unwrap()
}

pub fn cloud(asset: &Asset) -> &PointCloud {
    first(asset, |geometry| if let Geometry::Points(cloud) = geometry { Some(cloud) } else { None })
}

pub fn mesh(asset: &Asset) -> &Mesh {
    first(asset, |geometry| if let Geometry::Mesh(mesh) = geometry { Some(mesh) } else { None })
}

pub fn lines(asset: &Asset) -> &Polylines {
    first(asset, |geometry| if let Geometry::Lines(lines) = geometry { Some(lines) } else { None })
}
