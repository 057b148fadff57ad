use super::super::fields::Numbers;
use super::super::input::Input;
use super::*;
use crate::memory::{Admission, HostMemory, Interrupt};

fn origin() -> Origin {
    Input::from_bytes(Vec::new(), "a").origin
}

fn everything() -> Attributes {
    let columns = vec![Column::of("f", Numbers::Singles(Vec::new()))];
    Attributes { radii: true, paint: Paint::Bytes, columns }
}

fn push(strands: &mut Strands, x: f64, radius: f32) {
    let position = DVec3::new(x, 0.0, 0.0);
    let color = [x as f32, 0.0, 0.0, 255.0];
    strands.vertex(Vertex { position, radius, color, values: &[x as f32 + 100.0] }).unwrap();
}

#[test]
fn attributes_stay_beside_their_vertices_when_others_are_left_out() {
    let origin = origin();
    let mut strands = Strands::new(&origin, &ReadOptions::default(), everything());
    for x in [1.0, 2.0, f64::NAN, 4.0, f64::INFINITY, 6.0, 7.0, 8.0] {
        push(&mut strands, x, if x == 7.0 { -1.0 } else { x as f32 });
    }
    strands.cut().unwrap();
    strands.cut().unwrap();
    push(&mut strands, 9.0, 9.0);
    strands.cut().unwrap();
    push(&mut strands, 10.0, f32::NAN);
    push(&mut strands, 11.0, 0.0);
    let mut warnings = Vec::new();
    let lines = strands.finish(&mut warnings).unwrap();
    let xs: Vec<f64> = lines.positions.iter().map(|p| p.x).collect();
    assert_eq!(xs, [1.0, 2.0, 6.0, 7.0, 8.0, 10.0, 11.0]);
    assert_eq!(lines.strands, [0, 2, 5, 7]);
    assert_eq!(lines.radii.unwrap(), [1.0, 2.0, 6.0, 0.0, 8.0, 0.0, 0.0]);
    let reds: Vec<u8> = lines.colors.unwrap().iter().map(|color| color[0]).collect();
    assert_eq!(reds, [1, 2, 6, 7, 8, 10, 11]);
    let field = &lines.fields.list()[0];
    let values: Vec<f64> =
        (0..7).map(|vertex| field.value(lines.fields.at(vertex)).unwrap()).collect();
    assert_eq!(values, [101.0, 102.0, 106.0, 107.0, 108.0, 110.0, 111.0]);
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings[0].starts_with("2 vertices") && warnings[0].ends_with("vertex 2"));
    assert!(warnings[1].starts_with("2 radii") && warnings[1].ends_with("vertex 6"));
    assert!(warnings[2].starts_with("2 strands of a single vertex"), "{warnings:?}");
}

/// Strands that end before, at and behind the borders of what threads take.
#[test]
fn directions_are_coloured_strand_by_strand() {
    let origin = origin();
    let attributes = Attributes { paint: Paint::Direction, ..Attributes::nothing() };
    let mut strands = Strands::new(&origin, &ReadOptions::default(), attributes);
    let lengths =
        [COLORED_AT_A_TIME - 2, 2, 3, COLORED_AT_A_TIME - 4, 1, 3, 2 * COLORED_AT_A_TIME, 7];
    let (mut expected, mut strand) = (Vec::new(), Vec::new());
    for (number, length) in lengths.into_iter().enumerate() {
        strand.clear();
        let turn = |at: usize| DVec3::new(at as f64, (at as f64 * 0.1).sin(), number as f64);
        strand.extend((0..length).map(turn));
        for &position in &strand {
            strands.vertex(Vertex::at(position)).unwrap();
        }
        strands.cut().unwrap();
        if length > 1 {
            direction_colors(&strand, &mut expected);
        }
    }
    let lines = strands.finish(&mut Vec::new()).unwrap();
    assert_eq!(lines.strands.len(), lengths.len());
    assert_eq!(lines.colors.unwrap(), expected);
}

#[test]
fn directions_are_colours() {
    let origin = origin();
    let attributes = Attributes { paint: Paint::Direction, ..Attributes::nothing() };
    let mut strands = Strands::new(&origin, &ReadOptions::default(), attributes);
    let strand = [[0.0, 0.0, 0.0], [-5.0, 0.0, 0.0], [-5.0, 0.0, 5.0], [-5.0, 0.0, 9.0]];
    for position in strand.map(DVec3::from_array) {
        strands.vertex(Vertex::at(position)).unwrap();
    }
    strands.cut().unwrap();
    strands.vertex(Vertex::at(DVec3::ONE)).unwrap();
    strands.cut().unwrap();
    // There and back, then nowhere.
    for position in [DVec3::ZERO, DVec3::Y * 1e-200, DVec3::ZERO] {
        strands.vertex(Vertex::at(position)).unwrap();
    }
    strands.cut().unwrap();
    for _ in 0..2 {
        strands.vertex(Vertex::at(DVec3::X)).unwrap();
    }
    let colors = strands.finish(&mut Vec::new()).unwrap().colors.unwrap();
    let green = [0, 255, 0, 255];
    let expected = [
        [255, 0, 0, 255],
        [180, 0, 180, 255],
        [0, 0, 255, 255],
        [0, 0, 255, 255],
        green,
        green,
        green,
        NEUTRAL,
        NEUTRAL,
    ];
    assert_eq!(colors, expected);
}

#[test]
fn nothing_is_refused_and_memory_is_bounded() {
    let origin = origin();
    let strands = Strands::new(&origin, &ReadOptions::default(), Attributes::nothing());
    let error = strands.finish(&mut Vec::new()).unwrap_err().to_string();
    assert_eq!(error, "a: strand: the file holds no strands");

    let few = ReadOptions { max_vertices: 2, ..ReadOptions::default() };
    let mut strands = Strands::new(&origin, &few, everything());
    push(&mut strands, 0.0, 0.0);
    push(&mut strands, 1.0, 0.0);
    let third = strands.vertex(Vertex::at(DVec3::ZERO));
    assert!(matches!(third, Err(AssetError::TooLarge { found: 3, limit: 2, .. })));
    assert!(strands.reserve(3).is_err());

    let small = Origin { admission: Admission::new(&HostMemory::new(1000)), ..origin };
    let mut strands = Strands::new(&small, &ReadOptions::default(), everything());
    let refused = strands.reserve(100);
    assert!(matches!(refused, Err(AssetError::Interrupted(Interrupt::OutOfMemory(_)))));
    let refused = strands.vertex(Vertex::at(DVec3::ZERO));
    assert!(matches!(refused, Err(AssetError::Interrupted(Interrupt::OutOfMemory(_)))));
}
