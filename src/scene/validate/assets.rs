//! Files, how they are sampled, and solids made of other assets.

use std::path::PathBuf;

use super::super::wire::{AsLinesWire, AssetWire, Named, Object, OperandWire, SampleWire};
use super::super::{
    AsLines, AssetRef, AssetSource, CsgOperation, FileSource, MeshSampling, Operand, Solid,
};
use super::{LARGEST_COORDINATE, LARGEST_SCALE, Names, Place, Valid, each, placement, within};

type Resolve<'a> = &'a dyn Fn(&str) -> Result<PathBuf, String>;

pub(super) fn assets(
    named: &Named<AssetWire>,
    names: &Names<'_>,
    resolve: Resolve<'_>,
) -> Valid<Vec<AssetRef>> {
    each(named, "assets", |name, wire, place| {
        Ok(AssetRef { name: name.to_owned(), source: source(wire, names, resolve, place)? })
    })
}

fn source(
    wire: &AssetWire,
    names: &Names<'_>,
    resolve: Resolve<'_>,
    place: Place<'_>,
) -> Valid<AssetSource> {
    let solids = [
        (CsgOperation::Union, &wire.union),
        (CsgOperation::Intersection, &wire.intersection),
        (CsgOperation::Difference, &wire.difference),
    ];
    let mut made = solids
        .into_iter()
        .filter_map(|(operation, list)| list.as_deref().map(|operands| (operation, operands)));
    match (&wire.file, made.next(), made.next()) {
        (_, Some((first, _)), Some((second, _))) => place.refuse(format!(
            "has both `{}` and `{}`; only one can be",
            first.key(),
            second.key()
        )),
        (Some(_), Some((operation, _)), _) => {
            place.refuse(format!("has both `file` and `{}`; only one can be", operation.key()))
        }
        (None, None, _) => {
            place.refuse("needs `file`, or one of `union`, `intersection` and `difference`")
        }
        (Some(file), None, _) => file_source(file, wire, resolve, place).map(AssetSource::File),
        (None, Some((operation, operands)), None) => {
            for (key, present) in [
                ("sample", wire.sample.is_some()),
                ("features", wire.features.is_some()),
                ("as_lines", wire.as_lines.is_some()),
                ("line_radius", wire.line_radius.is_some()),
            ] {
                if present {
                    let reason = format!("means nothing beside `{}`", operation.key());
                    return place.key(key).refuse(reason);
                }
            }
            let list = place.key(operation.key());
            if operands.len() < 2 {
                return list.refuse("needs at least two operands");
            }
            let operands = operands.iter().enumerate();
            let operands = operands.map(|(i, wire)| operand(wire, names, list.index(i)));
            Ok(AssetSource::Solid(Solid { operation, operands: operands.collect::<Valid<_>>()? }))
        }
    }
}

fn file_source(
    file: &str,
    wire: &AssetWire,
    resolve: Resolve<'_>,
    place: Place<'_>,
) -> Valid<FileSource> {
    let path = match resolve(file) {
        Ok(path) => path,
        Err(reason) => return place.key("file").refuse(reason),
    };
    let features = wire.features.unwrap_or(false);
    if features && wire.sample.is_some() {
        return place
            .key("features")
            .refuse("cannot stand beside `sample`, which finds a mesh's creases itself");
    }
    let sample = match &wire.sample {
        Some(wire) => Some(sampling(wire, place.key("sample"))?),
        None => None,
    };
    let as_lines = match &wire.as_lines {
        Some(wire) => Some(as_lines(wire, place.key("as_lines"))?),
        None => None,
    };
    if as_lines.is_some() && wire.line_radius.is_some() {
        return place
            .key("line_radius")
            .refuse("cannot stand beside `as_lines`, which takes radii from the mesh");
    }
    let line_radius = match wire.line_radius {
        Some(radius) => {
            let place = place.key("line_radius");
            Some(within(radius, 1.0 / LARGEST_SCALE, LARGEST_COORDINATE, place)?)
        }
        None => None,
    };
    Ok(FileSource { path, sample, features, as_lines, line_radius })
}

fn as_lines(wire: &AsLinesWire, place: Place<'_>) -> Valid<AsLines> {
    let (leaves, branches) = (wire.leaves.unwrap_or(true), wire.branches.unwrap_or(true));
    if !(leaves || branches) {
        return place.refuse("needs `leaves` or `branches`");
    }
    let within =
        |radius| within(radius, 1.0 / LARGEST_SCALE, LARGEST_COORDINATE, place.key("max_radius"));
    Ok(AsLines { leaves, branches, max_radius: wire.max_radius.map(within).transpose()? })
}

fn sampling(wire: &SampleWire, place: Place<'_>) -> Valid<MeshSampling> {
    let within_some = |number: Option<f64>, low, high, key| match number {
        Some(number) => within(number, low, high, place.key(key)).map(Some),
        None => Ok(None),
    };
    Ok(MeshSampling {
        spacing: within_some(wire.spacing, 1.0 / LARGEST_SCALE, LARGEST_COORDINATE, "spacing")?,
        crease_deg: within_some(wire.crease, 0.0, 180.0, "crease")?,
    })
}

fn operand(wire: &Object<OperandWire>, names: &Names<'_>, place: Place<'_>) -> Valid<Operand> {
    Ok(Operand {
        asset: names.find(&wire.asset, place.key("asset"))?,
        solid_from_operand: placement::transform(&**wire, place)?,
    })
}
