use super::*;

fn column(name: &str, values: &[f64]) -> Column {
    Column::of(name, Numbers::Doubles(values.to_vec()))
}

#[test]
fn whole_numbers_are_exact_and_others_are_near() {
    for values in [
        vec![-3.0, 7.0, 1e4],
        vec![0.0, 65535.0],
        vec![1e9, 1e9 + 65535.0],
        vec![5.0],
        vec![2.5],
        vec![0.25, f64::NAN, -1e6],
        vec![7.0, f64::INFINITY, 65541.0],
        vec![-1e300, 1e300],
    ] {
        let fields = encoded(vec![column("a", &values)], &mut Vec::new());
        let [field] = fields.list() else { panic!("{values:?}") };
        let is_whole = values.iter().all(|value| value.fract() == 0.0);
        for (point, &value) in values.iter().enumerate() {
            match field.value(fields.at(point)) {
                Some(found) if is_whole && value.abs() < 1e10 => assert_eq!(found, value),
                Some(found) => assert!((found - value).abs() <= 0.51 * field.scale.step),
                None => assert!(!value.is_finite()),
            }
        }
    }
}

#[test]
fn values_that_hardly_differ_are_equal() {
    let tiny = f64::from_bits(1);
    for values in
        [[0.0, tiny], [tiny, 4000.0 * tiny], [-f64::MIN_POSITIVE, f64::MIN_POSITIVE], [0.25, 0.25]]
    {
        let fields = encoded(vec![column("height", &values)], &mut Vec::new());
        let [field] = fields.list() else { panic!("{values:?} have no field") };
        assert_eq!((field.scale.step, field.scale.most), (1.0, 0), "{values:?}");
        assert_eq!(field.value(fields.at(1)), Some(values[0]));
    }
    let fields = encoded(vec![column("height", &[0.25, 0.25 + f64::EPSILON])], &mut Vec::new());
    assert!(fields.list()[0].scale.step.is_normal());
}

#[test]
fn fields_without_information_or_room_are_left_out() {
    let mut warnings = Vec::new();
    let wide = [0.5, 1.0, 7.0];
    let columns = ["a", "zero", "b", "c", "d", "e", "small"].map(|name| match name {
        "zero" => column(name, &[0.0; 3]),
        "small" => column(name, &[1.0, 2.0, 3.0]),
        name => column(name, &wide),
    });
    let fields = encoded(columns.to_vec(), &mut warnings);
    let names: Vec<&str> = fields.list().iter().map(|field| field.name.as_str()).collect();
    assert_eq!(names, ["a", "b", "c", "d"]);
    assert!(warnings[0].contains("\"e\", \"small\""), "{warnings:?}");
    assert!(encoded(vec![column("a", &[f64::NAN])], &mut warnings).is_empty());
    assert!(encoded(vec![column(&"x".repeat(65), &wide)], &mut warnings).is_empty());
    assert_eq!(warnings.len(), 2);
}

#[test]
fn warnings_name_a_few_fields() {
    let columns = (0..40).map(|i| column(&format!("f{i}"), &[0.5, 1.0, 7.0])).collect();
    let mut warnings = Vec::new();
    assert_eq!(encoded(columns, &mut warnings).list().len(), 4);
    assert!(warnings[0].contains("\"f11\" and 28 more are left out"), "{warnings:?}");
}

#[test]
fn parts_are_encoded_as_the_whole() {
    let (a, b) = (column("a", &[1.0, 5.5]), column("a", &[-2.0, f64::NAN]));
    let mut spans = Spans::default();
    spans.add(std::slice::from_ref(&a));
    spans.add(std::slice::from_ref(&b));
    let mut whole = a.clone();
    whole.append(&mut b.clone());
    let all = encoded(vec![whole], &mut Vec::new());
    let parts = [a, b].map(|part| spans.fields(vec![part]));
    assert_eq!(all.words(), parts.map(|part| part.words().to_vec()).concat());
}

#[test]
fn every_type_of_numbers_is_encoded() {
    let (bytes, words) = (vec![3u8, 250, 7], vec![9u16, 60_000, 0]);
    let shorts =
        Column { factor: 0.006, ..Column::of("angle", Numbers::Shorts(vec![-5, 0, 30_000])) };
    let singles = Column::of("single", Numbers::Singles(vec![0.5, f32::NAN, 2.5]));
    let columns = vec![
        Column::of("byte", Numbers::Bytes(bytes)),
        Column::of("word", Numbers::Words(words)),
        shorts,
        singles,
    ];
    let fields = encoded(columns, &mut Vec::new());
    let values = |name: &str| -> Vec<Option<f64>> {
        let field = fields.list().iter().find(|field| field.name == name).unwrap();
        (0..3).map(|point| field.value(fields.at(point))).collect()
    };
    assert_eq!(values("byte"), [3.0, 250.0, 7.0].map(Some));
    assert_eq!(values("word"), [9.0, 60_000.0, 0.0].map(Some));
    assert_eq!(values("single"), [Some(0.5), None, Some(2.5)]);
    let angles = values("angle").into_iter().zip([-0.03, 0.0, 180.0]);
    assert!(angles.into_iter().all(|(found, angle)| (found.unwrap() - angle).abs() < 1e-9));
    let mut kept = fields.clone();
    kept.retain(&[true, false, true]);
    assert_eq!((kept.points(), kept.at(1)), (2, fields.at(2)));
}
