//! Assets of a scene: files, and solids that are made of other assets.

use std::path::PathBuf;

use glam::DAffine3;

use super::{Draws, Node, Scene};

/// Something that nodes draw by its name, or that others are made of.
#[derive(Clone, Debug, PartialEq)]
pub struct AssetRef {
    pub name: String,
    pub source: AssetSource,
}

#[derive(Clone, Debug, PartialEq)]
pub enum AssetSource {
    File(FileSource),
    Solid(Solid),
}

/// A file, and what is done with it when it is read.
#[derive(Clone, Debug, PartialEq)]
pub struct FileSource {
    /// Absolute, inside the scene root.
    pub path: PathBuf,
    /// Turn its meshes into samples.
    pub sample: Option<MeshSampling>,
    /// Look for sharp features of its points.
    pub features: bool,
    /// Turn leaves and branches of its meshes into lines.
    pub as_lines: Option<AsLines>,
    /// Radius of its lines, in place of its own.
    pub line_radius: Option<f64>,
}

/// How a mesh is sampled; what is absent is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeshSampling {
    /// Distance between neighbouring samples, in the file's unit.
    pub spacing: Option<f64>,
    /// Angle between faces above which their edge is sharp.
    pub crease_deg: Option<f64>,
}

/// Which parts of a mesh become lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AsLines {
    /// Strips of quads become ribbons.
    pub leaves: bool,
    /// Rows of rings become tubes.
    pub branches: bool,
    /// Largest radius of a tube and half-width of a ribbon, in the file's unit; when absent, a hundredth and a
    /// twentieth of the mesh's diagonal.
    pub max_radius: Option<f64>,
}

/// A solid made of sampled ones (constructive solid geometry).
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    pub operation: CsgOperation,
    /// At least two.
    pub operands: Vec<Operand>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CsgOperation {
    Union,
    Intersection,
    /// The first operand without the others.
    Difference,
}

impl CsgOperation {
    /// Its key in scene files.
    pub fn key(self) -> &'static str {
        match self {
            CsgOperation::Union => "union",
            CsgOperation::Intersection => "intersection",
            CsgOperation::Difference => "difference",
        }
    }
}

/// An asset as part of a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Operand {
    /// Index into [`Scene::assets`].
    pub asset: usize,
    pub solid_from_operand: DAffine3,
}

impl AssetRef {
    /// A file that is drawn as it is.
    pub fn file(name: &str, path: PathBuf) -> AssetRef {
        let source = AssetSource::File(FileSource {
            path,
            sample: None,
            features: false,
            as_lines: None,
            line_radius: None,
        });
        AssetRef { name: name.to_owned(), source }
    }

    /// Its name in errors: that of its file, or else its name in the scene.
    pub fn label(&self) -> String {
        match &self.source {
            AssetSource::File(source) => {
                let file = source.path.file_name();
                file.map_or_else(|| self.name.clone(), |file| file.to_string_lossy().into_owned())
            }
            AssetSource::Solid(_) => self.name.clone(),
        }
    }

    /// Its operands; none for a file.
    pub fn operands(&self) -> &[Operand] {
        match &self.source {
            AssetSource::File(_) => &[],
            AssetSource::Solid(solid) => &solid.operands,
        }
    }
}

impl Scene {
    /// For each asset whether it is only there for others to be made of: no node draws it, visible or not.
    pub fn operands_only(&self) -> Vec<bool> {
        let mut only = vec![false; self.assets.len()];
        for operand in self.assets.iter().flat_map(AssetRef::operands) {
            only[operand.asset] = true;
        }
        mark_drawn(&self.nodes, &mut only);
        for prototype in &self.prototypes {
            mark_drawn(&prototype.children, &mut only);
        }
        only
    }
}

/// The recursion is as deep as the scene's nodes, which its limits bound.
fn mark_drawn(nodes: &[Node], only: &mut [bool]) {
    for node in nodes {
        if let Draws::Asset(index) = node.draws {
            only[index] = false;
        }
        mark_drawn(&node.children, only);
    }
}
