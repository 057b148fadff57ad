use proptest::prelude::*;

use super::*;
use crate::assets::first::lines;

fn read(bytes: Vec<u8>) -> Result<Asset, AssetError> {
    read_from(Input::from_bytes(bytes, "a.trk"), &ReadOptions::default())
}

/// Points with their scalars, and properties.
type Streamline = (Vec<Vec<f32>>, Vec<f32>);

/// A file under construction.
struct File {
    big: bool,
    version: i32,
    voxel: [f32; 3],
    dimensions: [i16; 3],
    order: &'static str,
    matrix: [[f32; 4]; 4],
    scalars: Vec<&'static [u8]>,
    scalar_count: i16,
    properties: Vec<&'static [u8]>,
    property_count: i16,
    count: i32,
    streamlines: Vec<Streamline>,
}

const IDENTITY: [[f32; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

impl Default for File {
    fn default() -> File {
        let streamlines = vec![
            (vec![vec![1.0, 2.0, 3.0], vec![4.0, 2.0, 3.0]], vec![]),
            (vec![vec![0.5, 0.5, 0.5], vec![0.5, 9.5, 0.5], vec![0.5, 9.5, 8.5]], vec![]),
        ];
        File {
            big: false,
            version: 2,
            voxel: [1.0; 3],
            dimensions: [10, 20, 30],
            order: "RAS",
            matrix: IDENTITY,
            scalars: vec![],
            scalar_count: 0,
            properties: vec![],
            property_count: 0,
            count: 2,
            streamlines,
        }
    }
}

impl File {
    fn bytes(&self) -> Vec<u8> {
        let short = |n: i16| if self.big { n.to_be_bytes() } else { n.to_le_bytes() };
        let int = |n: i32| if self.big { n.to_be_bytes() } else { n.to_le_bytes() };
        let float = |n: f32| int(n.to_bits() as i32);
        let mut head = vec![0u8; 1000];
        let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"TRACK\0");
        for axis in 0..3 {
            put(6 + 2 * axis, &short(self.dimensions[axis]));
            put(12 + 4 * axis, &float(self.voxel[axis]));
        }
        put(36, &short(self.scalar_count));
        self.scalars.iter().enumerate().for_each(|(at, name)| put(38 + 20 * at, name));
        put(238, &short(self.property_count));
        self.properties.iter().enumerate().for_each(|(at, name)| put(240 + 20 * at, name));
        for row in 0..4 {
            for column in 0..4 {
                put(440 + 16 * row + 4 * column, &float(self.matrix[row][column]));
            }
        }
        put(948, self.order.as_bytes());
        put(988, &int(self.count));
        put(992, &int(self.version));
        put(996, &int(1000));
        for (points, properties) in &self.streamlines {
            head.extend(int(points.len() as i32));
            head.extend(points.iter().flatten().chain(properties).flat_map(|n| float(*n)));
        }
        head
    }
}

fn first(file: &File) -> DVec3 {
    lines(&read(file.bytes()).unwrap()).positions[0]
}

#[test]
fn both_byte_orders_are_read() {
    for (big, count) in [(false, 2), (true, 2), (false, 0), (true, 0)] {
        let asset = read(File { big, count, ..File::default() }.bytes()).unwrap();
        let lines = lines(&asset);
        assert!(asset.warnings.is_empty(), "{:?}", asset.warnings);
        assert_eq!(lines.strands, [0, 2, 5]);
        // Half a voxel before what the file has.
        let places =
            [[0.5, 1.5, 2.5], [3.5, 1.5, 2.5], [0.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 9.0, 8.0]];
        assert_eq!(lines.positions, places.map(DVec3::from_array));
        let colors = lines.colors.as_ref().unwrap();
        assert_eq!(colors[0], [255, 0, 0, 255]);
        assert_eq!((colors[2], colors[4]), ([0, 255, 0, 255], [0, 0, 255, 255]));
        assert!(lines.fields.is_empty() && lines.radii.is_none());
    }
}

/// The places that NiBabel 5.4 gives, and at last an order of axes that is worked out by hand.
#[test]
fn coordinates_are_those_of_the_scanner() {
    let row = |a: f32, b: f32, c: f32, d: f32| [a, b, c, d];
    let last = row(0.0, 0.0, 0.0, 1.0);
    let cases = [
        (
            "LPS",
            [2.0, 3.0, 4.0],
            [5, 6, 7],
            [row(2.0, 0.0, 0.0, 0.0), row(0.0, 3.0, 0.0, 0.0), row(0.0, 0.0, 4.0, 0.0), last],
            [8.0, 14.5, 1.0],
        ),
        (
            "LAS",
            [2.0; 3],
            [10, 20, 30],
            [
                row(-2.0, 0.0, 0.0, 90.0),
                row(0.0, 2.0, 0.0, -126.0),
                row(0.0, 0.0, 2.0, -72.0),
                last,
            ],
            [90.0, -125.0, -70.0],
        ),
        (
            "SRP",
            [1.0, 2.0, 3.0],
            [10, 20, 30],
            [row(0.0, 2.0, 0.0, 5.0), row(0.1, 0.0, 3.0, -6.0), row(1.0, 0.0, 0.0, 7.0), last],
            [6.0, 79.5499969497323, 7.5],
        ),
        (
            "PIR",
            [1.5, 2.0, 0.5],
            [11, 12, 13],
            [row(1.4, -0.3, 0.1, 5.0), row(0.4, 1.9, 0.05, -6.0), row(-0.2, 0.1, 0.5, 7.0), last],
            [10.8, 15.408333, 12.133333],
        ),
    ];
    for (order, voxel, dimensions, matrix, expected) in cases {
        let found = first(&File { order, voxel, dimensions, matrix, ..File::default() });
        assert!(found.distance(expected.into()) < 1e-5, "{order}: {found} {expected:?}");
    }
}

#[test]
fn what_old_headers_lack_is_assumed_with_a_warning() {
    let nothing = [[0.0; 4]; 4];
    for (version, matrix) in [(1, nothing), (2, nothing), (1, IDENTITY)] {
        let file = File { version, matrix, order: "", ..File::default() };
        let asset = read(file.bytes()).unwrap();
        assert_eq!(asset.warnings.len(), 2, "{:?}", asset.warnings);
        // LPS: mirrored along x and y.
        assert_eq!(lines(&asset).positions[0], DVec3::new(8.5, 17.5, 2.5));
    }
}

#[test]
fn scalars_and_properties_are_fields() {
    let streamlines = vec![
        (vec![vec![1.0, 1.0, 1.0, 0.5, 7.0], vec![2.0, 1.0, 1.0, 0.75, 8.0]], vec![3.0, 100.0]),
        (vec![vec![1.0, 1.0, 1.0, 0.5, 9.0], vec![3.0, 1.0, 1.0, 1.0, 10.0]], vec![4.0, 200.0]),
    ];
    for big in [false, true] {
        let file = File {
            big,
            scalars: vec![b"fa"],
            scalar_count: 2,
            properties: vec![b"id\x002"],
            property_count: 2,
            streamlines: streamlines.clone(),
            ..File::default()
        };
        let asset = read(file.bytes()).unwrap();
        let fields = &lines(&asset).fields;
        let values = |name: &str| -> Vec<f64> {
            let field = fields.list().iter().find(|field| field.name == name).unwrap();
            (0..4).map(|vertex| field.value(fields.at(vertex)).unwrap()).collect()
        };
        assert!(values("fa").iter().zip([0.5, 0.75, 0.5, 1.0]).all(|(a, b)| (a - b).abs() < 1e-5));
        assert_eq!(values("value_1"), [7.0, 8.0, 9.0, 10.0]);
        assert_eq!(values("id_0"), [3.0, 3.0, 4.0, 4.0]);
        assert_eq!(values("id_1"), [100.0, 100.0, 200.0, 200.0]);
    }
}

#[test]
fn scalars_called_colours_are_colours() {
    let streamlines = vec![(
        vec![vec![1.0, 1.0, 1.0, 1.0, 0.0, 0.5, 0.25], vec![2.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.5]],
        vec![],
    )];
    let file = File {
        scalars: vec![b"colors\x003", b"fa"],
        scalar_count: 4,
        count: 1,
        streamlines,
        ..File::default()
    };
    let asset = read(file.bytes()).unwrap();
    let lines = lines(&asset);
    assert_eq!(lines.colors.as_ref().unwrap()[..], [[255, 0, 128, 255], [0, 255, 0, 255]]);
    assert_eq!(lines.fields.list().len(), 1);
    assert_eq!(lines.fields.list()[0].name, "fa");
}

#[test]
fn damage_is_refused() {
    let whole = File::default().bytes();
    for length in 0..whole.len() {
        let error = read(whole[..length].to_vec()).unwrap_err().to_string();
        assert!(error.starts_with("a.trk: "), "{length}: {error}");
    }
    // Without a count a file may end behind any streamline.
    let open = File { count: 0, ..File::default() }.bytes();
    for length in 1000..open.len() {
        let is_end = length == 1000 + 4 + 24;
        assert_eq!(read(open[..length].to_vec()).is_ok(), is_end, "{length}");
    }
    let error = |change: &dyn Fn(&mut File)| {
        let mut file = File::default();
        change(&mut file);
        read(file.bytes()).unwrap_err().to_string()
    };
    type Damage<'a> = (&'a dyn Fn(&mut File), &'a str);
    let refused: [Damage; 8] = [
        (&|f| f.version = 4, "header, version: 4 is unknown"),
        (&|f| f.voxel[1] = 0.0, "header, voxel_size"),
        (&|f| f.matrix[2][2] = 0.0, "header, vox_to_ras: the matrix is singular"),
        (&|f| f.matrix[1][3] = f32::NAN, "header, vox_to_ras"),
        (&|f| f.order = "RLS", "header, voxel_order: \"RLS\" names no three axes"),
        (&|f| f.scalar_count = 11, "n_scalars is 11; a file has 0 to 10"),
        (&|f| f.property_count = -1, "n_properties is -1"),
        (&|f| f.count = -2, "header, n_count: -2 is negative"),
    ];
    for (change, expected) in refused {
        let error = error(change);
        assert!(error.contains(expected), "{error}");
    }
    assert!(error(&|f| f.count = i32::MAX).contains("declares 2147483647, which take at least"));
    assert!(error(&|f| f.count = 3).contains("streamline 2, number of points: the file ends here"));
    let mut lying = whole.clone();
    lying[1000..1004].copy_from_slice(&i32::MAX.to_le_bytes());
    let error = read(lying.clone()).unwrap_err().to_string();
    assert!(error.contains("streamline 0, number of points: 2147483647 points take"), "{error}");
    lying[1003] = 0xff;
    assert!(read(lying).unwrap_err().to_string().contains("-1 is negative"));
    let mut odd = whole.clone();
    odd[996] = 7;
    assert!(read(odd).unwrap_err().to_string().contains("hdr_size"));
    let mut longer = whole;
    longer.push(0);
    assert!(read(longer).unwrap().warnings[0].contains("what follows the 2 streamlines"));
}

/// A count that lies inside of a gzip stream allocates nothing.
#[test]
fn streams_of_unknown_length_are_read_piece_by_piece() {
    let mut file = File { property_count: 1, ..File::default() };
    file.streamlines.iter_mut().for_each(|(_, properties)| properties.push(5.0));
    let open = |bytes: Vec<u8>| {
        let mut input = Input::from_bytes(bytes, "a.trk");
        (input.origin.exact, input.origin.max_bytes) = (false, 1 << 40);
        read_from(input, &ReadOptions::default())
    };
    assert_eq!(lines(&open(file.bytes()).unwrap()).strands, [0, 2, 5]);
    let mut lying = file.bytes();
    lying[1000..1004].copy_from_slice(&i32::MAX.to_le_bytes());
    let error = open(lying).unwrap_err().to_string();
    assert!(error.contains("streamline 0: the file ends 72 bytes behind"), "{error}");
}

#[test]
fn long_streamlines_are_read_in_blocks() {
    let points = (0..30_000).map(|i| vec![i as f32 + 0.5, 0.5, 0.5]).collect();
    let file = File { count: 1, streamlines: vec![(points, vec![])], ..File::default() };
    let asset = read(file.bytes()).unwrap();
    assert!(lines(&asset).positions.iter().enumerate().all(|(i, p)| p.x == i as f64));
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(at in 0usize..1100, with in any::<u8>(), cut in 0usize..20) {
        let file = File { scalar_count: 0, property_count: 0, ..File::default() };
        let mut bytes = file.bytes();
        let at = at % bytes.len();
        bytes[at] = with;
        bytes.truncate(bytes.len() - cut);
        let _ = read(bytes);
    }
}
