//! The scalar fields of a scene, and where shaders find them.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::model::AssetModel;
use crate::bake::pack::{PackedField, PackedGeometry, value_words};
use crate::scene::fields::{SceneField, class_color};

/// Rows of class colours at the begin of the table, four colours each; as in `shared/fields_shown`.
const CLASS_ROWS: usize = 64;
/// Tells shaders that the codes of a field are classes.
const CLASSES: u32 = 1 << 13;

/// The scalar fields that points and lines of these assets have, by their names.
pub fn scene_fields(assets: &[Arc<AssetModel>]) -> Vec<SceneField> {
    let mut found: BTreeMap<&str, SceneField> = BTreeMap::new();
    for field in assets.iter().flat_map(|asset| &asset.packed.geometries).flat_map(fields_of) {
        let ([least, most], shown) = (field.range(), field.shown());
        let classes = field.is_class().then(|| field.classes().collect::<Vec<u8>>());
        let Some(known) = found.get_mut(field.name()) else {
            let name = field.name().to_owned();
            found.insert(field.name(), SceneField { name, least, most, shown, classes });
            continue;
        };
        known.least = known.least.min(least);
        known.most = known.most.max(most);
        known.shown = [known.shown[0].min(shown[0]), known.shown[1].max(shown[1])];
        // Only fields that are classes in every geometry are shown as such.
        known.classes = known.classes.take().zip(classes).map(|(known, more)| {
            let mut all = [known, more].concat();
            all.sort_unstable();
            all.dedup();
            all
        });
    }
    found.into_values().collect()
}

fn fields_of(geometry: &PackedGeometry) -> &[PackedField] {
    match geometry {
        PackedGeometry::Samples(samples) => &samples.fields,
        PackedGeometry::Lines(lines) => &lines.fields,
        PackedGeometry::Triangles(_) => &[],
    }
}

/// The table that `shared/fields_shown` reads: the colours of classes, then for each geometry, counted asset by asset, a row for each
/// field of the scene. A field's values are shares of its range in the scene.
pub(super) fn table(assets: &[Arc<AssetModel>], fields: &[SceneField]) -> Vec<[u32; 4]> {
    let color = |class: usize| {
        let [r, g, b] = class_color(class as u8);
        u32::from_le_bytes([r, g, b, 255])
    };
    let colors = (0..CLASS_ROWS).map(|row| std::array::from_fn(|at| color(4 * row + at)));
    let geometries = assets.iter().flat_map(|asset| &asset.packed.geometries);
    let rows = geometries.flat_map(|geometry| {
        let own = fields_of(geometry);
        let words = value_words(own);
        fields.iter().map(move |field| {
            let found = own.iter().find(|own| own.name() == field.name);
            found.map_or([0; 4], |own| row(own, words, field))
        })
    });
    // Scenes without fields have a row as well, that of a geometry without the field.
    colors.chain(rows).chain([[0; 4]]).collect()
}

/// Where the codes of a field are and what they stand for: words of a sample or a vertex (2 bits), lowest bit (6), number of bits (5), whether they
/// are classes (1), largest code (16); the class of code 0; the share of code 0, and that of a step.
fn row(own: &PackedField, words: usize, field: &SceneField) -> [u32; 4] {
    let scale = own.scale();
    let extent = field.most - field.least;
    let share = |length: f64| if extent > 0.0 { (length / extent) as f32 } else { 0.0 };
    let classes = if field.classes.is_some() { CLASSES } else { 0 };
    [
        words as u32 | own.place() << 2 | scale.bits() << 8 | classes | u32::from(scale.most) << 16,
        scale.least as i64 as u32,
        share(scale.least - field.least).to_bits(),
        share(scale.step).to_bits(),
    ]
}
