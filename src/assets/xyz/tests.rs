use proptest::prelude::*;

use super::*;

fn read_text(text: &str) -> Result<Asset, AssetError> {
    read_from(text.as_bytes(), "t.xyz", &ReadOptions::default())
}

fn cloud_of(text: &str) -> PointCloud {
    match read_text(text).unwrap().geometries.remove(0) {
        Geometry::Points(cloud) => cloud,
        _ => panic!("a text file holds points"),
    }
}

#[test]
fn three_columns_in_every_separator() {
    for text in [
        "1 2 3\n4 5 6\n",
        "1\t2\t3 \r\n4\t5\t6",
        "1,2,3,\n4, 5, 6\n",
        "1;2;3\n4;5;6\n",
        "# made by hand\n\n1 2 3\n// more\n4 5 6",
        "2\n1 2 3\n4 5 6\n",
        "x,y,z\r1,2,3\r4,5,6\r",
    ] {
        let cloud = cloud_of(text);
        let expected = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)];
        assert_eq!(cloud.positions, expected, "{text:?}");
        assert!(cloud.colors.is_none() && cloud.normals.is_none() && cloud.fields.is_empty());
    }
    assert_eq!(cloud_of("1,5;2,5;3\n").positions, [DVec3::new(1.5, 2.5, 3.0)]);
    let cloud = cloud_of("-1,5 2,50\t3,0\n4 5 6,25\n");
    assert_eq!(cloud.positions, [DVec3::new(-1.5, 2.5, 3.0), DVec3::new(4.0, 5.0, 6.25)]);
}

#[test]
fn positions_of_surveys_are_named_in_many_ways() {
    let expected = [DVec3::new(8.5, 47.25, 410.0)];
    for text in [
        "longitude;latitude;height\n8,5;47,25;410\n",
        "Lat,Lon,Alt\n47.25,8.5,410\n",
        "easting northing elevation\n8.5 47.25 410\n",
    ] {
        assert_eq!(cloud_of(text).positions, expected, "{text:?}");
    }
}

#[test]
fn columns_are_told_by_content() {
    let cloud = cloud_of("0 0 0 0\n0 0 0 10\n");
    assert_eq!(cloud.values_of("intensity"), Some(vec![0.0, 10.0]));

    let cloud = cloud_of("0 0 0 255 0 17\n0 0 1 0 0 0\n");
    assert_eq!(cloud.colors, Some(vec![[255, 0, 17, 255], [0, 0, 0, 255]]));

    let cloud = cloud_of("0 0 0 0 0 1\n0 0 1 0.6 0 0.8\n");
    assert!(cloud.colors.is_none());
    assert!((cloud.normals.unwrap()[1] - glam::Vec3::new(0.6, 0.0, 0.8)).length() < 1e-6);

    let cloud = cloud_of("0 0 0 0 -2 0\n0 0 1 0.5 0 3\n");
    assert_eq!(cloud.normals.unwrap()[0], -glam::Vec3::Y);

    // PTS, also with an intensity that would pass for a colour.
    let cloud = cloud_of("2\n0 0 0 -1613 52 70 64\n0 0 1 602 120 127 103\n");
    assert_eq!(cloud.values_of("intensity"), Some(vec![-1613.0, 602.0]));
    assert_eq!(cloud.colors.unwrap()[0], [52, 70, 64, 255]);
    let cloud = cloud_of("0 0 0 9 52 70 64\n0 0 1 8 120 127 103\n");
    assert_eq!(cloud.colors.unwrap()[0], [52, 70, 64, 255]);
    let cloud = cloud_of("0 0 0 52 70 64 0.25\n0 0 1 120 127 103 0.5\n");
    assert_eq!(cloud.values_of("intensity"), Some(vec![0.25, 0.5]));
    assert_eq!(cloud.colors.unwrap()[0], [52, 70, 64, 255]);

    for text in ["0 0 0 0 1 0 7 8 9\n", "0 0 0 7 8 9 0 1 0\n"] {
        let cloud = cloud_of(text);
        assert_eq!(cloud.colors, Some(vec![[7, 8, 9, 255]]), "{text}");
        assert_eq!(cloud.normals, Some(vec![glam::Vec3::Y]), "{text}");
    }
}

#[test]
fn headers_name_columns() {
    let text = "\"Name\",Z,X,Y,Label,Nx,Ny,Nz,red,green,blue,intensity\n\
                tree,3,1,2,5,0,0,2,255,0,0,0\nroof,6,4,5,6,0,3,0,0,255,0,7\n";
    let cloud = cloud_of(text);
    assert_eq!(cloud.positions[0], DVec3::new(1.0, 2.0, 3.0));
    assert_eq!(cloud.values_of("classification"), Some(vec![5.0, 6.0]));
    assert_eq!(cloud.normals, Some(vec![glam::Vec3::Z, glam::Vec3::Y]));
    assert_eq!(cloud.colors, Some(vec![[255, 0, 0, 255], [0, 255, 0, 255]]));
    assert_eq!(cloud.values_of("intensity"), Some(vec![0.0, 7.0]));
    // A header in a comment, with the count below it.
    let cloud = cloud_of("//X Y Z R G B\n1\n1 2 3 0.5 1 0\n");
    assert_eq!(cloud.colors, Some(vec![[128, 255, 0, 255]]));
}

#[test]
fn names_of_columns_may_have_blanks() {
    for text in [
        "//X,Y,Z,Gps Time,Return Number\n1,2,3,50,1\n4,5,6,70,2\n",
        "x; y; z; \"Gps Time\"; return number;\n1;2;3;50;1\n4;5;6;70;2\n",
    ] {
        let cloud = cloud_of(text);
        assert_eq!(cloud.positions[1], DVec3::new(4.0, 5.0, 6.0), "{text}");
        assert_eq!(cloud.values_of("Gps Time"), Some(vec![50.0, 70.0]), "{text}");
        assert_eq!(cloud.values_of("return_number"), Some(vec![1.0, 2.0]), "{text}");
    }
    assert_eq!(cloud_of("x, y z\n1, 2 3\n").positions, [DVec3::new(1.0, 2.0, 3.0)]);
}

#[test]
fn text_in_a_column_may_have_blanks() {
    for text in [
        "x,y,z,Zone,height above ground\n0,0,1,pine wood,2\n0,0,2, ,7\n",
        "x,y,z,\"Zone\",height above ground\n0, 0 ,1,\"wood, old pine\",2\n0,0,2,\"\",7\n",
        "x,y,z,Zone,height above ground\n0,0,1,\"pine; old\",2\n0,0,2,5\",7\n",
        "x,y,z,Zone,height above ground\n0,0,1, \"a \"\"b\"\", c\",2\n0,0,2,\"\",7\n",
        "x;y;z;Zone;height above ground;\n0;0;1;pine; 2\n0;0;2,0;two small trees;7;\n",
        "x\ty\tz\tZone\theight above ground\n0\t0\t1\tpine, old\t2\n0\t0\t2,0\t\t7\n",
        "\tx\ty\tz\theight above ground\tZone\nold pine\t0\t0\t1\t2\tA 1\n\t0\t0\t2\t7\t\n",
        "//x\ty\tz\tZone\theight above ground\n0\t0\t1\t\"a\tb\"\t2\t\n0\t0\t2\ta b\t7\n",
    ] {
        let cloud = cloud_of(text);
        assert_eq!(cloud.positions, [DVec3::Z, DVec3::Z * 2.0], "{text}");
        assert_eq!(cloud.values_of("height above ground"), Some(vec![2.0, 7.0]), "{text}");
    }
    // Without a header, blanks separate. Tabs may align columns.
    for text in ["1, 2 3\n", "\t1\t\t2 3\t\n", "x\ty\tz\n1\t\t\t2\t3\n", "x\ty\tz\n1 2 3\n"] {
        assert_eq!(cloud_of(text).positions, [DVec3::new(1.0, 2.0, 3.0)], "{text}");
    }
}

#[test]
fn other_columns_are_fields() {
    let text = "x,y,z,scalar_Roughness,Zone,above_ground\n0,0,1,0.5,wood,2\n0,0,2,,field,7\n";
    let cloud = cloud_of(text);
    let roughness = cloud.values_of("Roughness").unwrap();
    assert!(roughness[0] == 0.5 && roughness[1].is_nan(), "{roughness:?}");
    assert_eq!(cloud.values_of("above_ground"), Some(vec![2.0, 7.0]));
    assert_eq!(cloud.fields.list().len(), 2);
    let cloud = cloud_of("0 0 0 5 9.5\n0 0 1 6 7.25\n");
    assert_eq!(cloud.values_of("intensity"), Some(vec![5.0, 6.0]));
    assert_eq!(cloud.values_of("column_5"), Some(vec![9.5, 7.25]));
}

#[test]
fn the_last_column_may_be_empty() {
    for text in ["x,y,z,Zone\n0,0,1,\n0,0,2,7\n", "x;y;z;Zone;\n0;0;1;;\n0;0;2;7\n"] {
        let cloud = cloud_of(text);
        assert_eq!(cloud.positions, [DVec3::Z, DVec3::Z * 2.0], "{text}");
        let zones = cloud.values_of("Zone").unwrap();
        assert!(zones[0].is_nan() && zones[1] == 7.0, "{zones:?}");
    }
    assert_eq!(cloud_of("1,2,3,\n4,5,6\n").positions.len(), 2);
    let error = read_text("1,2,3\n4,5,6,,\n").unwrap_err().to_string();
    assert!(error.contains("line 2: has 5 columns"), "{error}");
}

#[test]
fn fields_keep_the_digits_of_large_numbers() {
    let text = "x,y,z,gps_time\n0,0,0,300000000.25\n0,0,1,300000001.5\n0,0,2,300000002.75\n";
    let times = cloud_of(text).values_of("gps_time").unwrap();
    for (found, time) in times.into_iter().zip([300000000.25, 300000001.5, 300000002.75]) {
        assert!((found - time).abs() < 1e-4, "{found}");
    }
}

#[test]
fn errors_name_line_and_column() {
    let error = |text: &str| read_text(text).unwrap_err().to_string();
    assert_eq!(error("0 0 0\n1 2 rose\n"), "t.xyz: line 2, column 3: \"rose\" is not a number");
    assert!(error("0 0 0\n1 2\n").contains("line 2: has 2 columns"));
    assert!(error("0 0\n").contains("line 1: has 2 columns"));
    assert!(error("0 0 0\n1 2 3 4\n").contains("line 2: has 4 columns"));
    assert!(error("x,y,z\n1,2,rose\n").contains("line 2, column 3"));
    assert!(error("nan 0 0\n0 inf 0\n").contains("none of its 2 points is finite"));
    assert!(error("").contains("holds no points"));
    assert!(error("\u{1}\0\0").contains("line 1"));
}

#[test]
fn oddities_are_counted() {
    let asset = read_text("9\n0 0 0\nnan 0 0\n0 1e999 0\n").unwrap();
    assert_eq!(asset.geometries[0].positions().len(), 1);
    assert_eq!(asset.warnings.len(), 2, "{:?}", asset.warnings);
    assert!(asset.warnings[0].contains("announces 9 points and holds 3"));
    assert!(asset.warnings[1].contains("2 points"));
    let few = ReadOptions { max_vertices: 1, ..ReadOptions::default() };
    let error = read_from("0 0 0\n0 0 1\n".as_bytes(), "t.xyz", &few).unwrap_err();
    assert!(matches!(error, AssetError::TooLarge { .. }), "{error}");
}

proptest! {
    #[test]
    fn anything_is_answered(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let _ = read_from(&bytes[..], "t.xyz", &ReadOptions::default());
    }

    #[test]
    fn anything_numeric_is_answered(text in "[0-9 ,;.\\-e\"xyzrgb#/\n]{0,200}") {
        if let Ok(asset) = read_text(&text) {
            let Geometry::Points(cloud) = &asset.geometries[0] else { panic!("points") };
            let count = cloud.positions.len();
            prop_assert!(cloud.positions.iter().all(|p| p.is_finite()));
            prop_assert!(cloud.colors.as_ref().is_none_or(|c| c.len() == count));
            prop_assert!(cloud.normals.as_ref().is_none_or(|n| n.len() == count));
            prop_assert!(cloud.normals.iter().flatten().all(|n| n.is_finite()));
        }
    }
}
