//! Assets in memory: PLY for f64 coordinates and vertex colours, GLB for materials and textures.

use glam::{DVec3, Vec3};
use pointillist::encode::{FrameImage, png};
use pointillist::scene::random::SplitMix64;
use serde_json::{Value, json};

/// Points or triangles with optional attributes, each as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    pub positions: Vec<DVec3>,
    pub colors: Vec<[u8; 4]>,
    pub normals: Vec<Vec3>,
    pub uvs: Vec<[f32; 2]>,
    pub triangles: Vec<[u32; 3]>,
    /// Scalar fields: name, type and values.
    pub fields: Vec<(&'static str, &'static str, Vec<f64>)>,
}

impl Shape {
    /// Adds another shape with the same attributes.
    pub fn add(&mut self, other: &Shape) {
        let first = self.positions.len() as u32;
        self.positions.extend(&other.positions);
        self.colors.extend(&other.colors);
        self.normals.extend(&other.normals);
        self.uvs.extend(&other.uvs);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|corner| first + corner)));
    }

    /// A single triangle in one colour.
    pub fn triangle(corners: [[f64; 3]; 3], color: [u8; 3]) -> Shape {
        let [r, g, b] = color;
        Shape {
            positions: corners.map(DVec3::from).to_vec(),
            colors: vec![[r, g, b, 255]; 3],
            triangles: vec![[0, 1, 2]],
            ..Shape::default()
        }
    }

    /// A parallelogram of two triangles, counter-clockwise from `corner` along `u`, then `v`, with texture
    /// coordinates from 0 to `repeats`.
    pub fn quad(corner: DVec3, u: DVec3, v: DVec3, repeats: f32) -> Shape {
        Shape {
            positions: vec![corner, corner + u, corner + u + v, corner + v],
            uvs: vec![[0.0, repeats], [repeats, repeats], [repeats, 0.0], [0.0, 0.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Shape::default()
        }
    }

    /// A closed smooth sphere around the origin, coloured by position, with normals and texture coordinates.
    pub fn ball(rings: u32, radius: f64) -> Shape {
        let sectors = 2 * rings;
        let mut shape = Shape::default();
        for i in 0..=rings {
            for k in 0..=sectors {
                let (u, v) = (f64::from(k) / f64::from(sectors), f64::from(i) / f64::from(rings));
                let (sin, cos) = (v * std::f64::consts::PI).sin_cos();
                // The two sides of the seam coincide exactly, and so do the vertices of each pole.
                let (turn_sin, turn_cos) =
                    if k == sectors { (0.0, 1.0) } else { (u * std::f64::consts::TAU).sin_cos() };
                let sin = if i == 0 || i == rings { 0.0 } else { sin };
                let normal = DVec3::new(sin * turn_cos, cos, sin * turn_sin);
                shape.positions.push(normal * radius);
                shape.normals.push(normal.as_vec3());
                shape.uvs.push([u as f32, v as f32]);
                let wave = |f: f64| (128.0 + 100.0 * (f * 6.0).sin()) as u8;
                shape.colors.push([wave(normal.x), wave(normal.y + 1.0), wave(normal.z), 255]);
            }
        }
        for i in 0..rings {
            for k in 0..sectors {
                let a = i * (sectors + 1) + k;
                let (b, c) = (a + sectors + 1, a + sectors + 2);
                if i > 0 {
                    shape.triangles.push([a, a + 1, c]);
                }
                if i + 1 < rings {
                    shape.triangles.push([a, c, b]);
                }
            }
        }
        shape
    }

    /// Random points in a box, with random colours and normals.
    pub fn cloud(count: usize, low: [f64; 3], high: [f64; 3], seed: u64) -> Shape {
        let mut random = SplitMix64::new(seed);
        let mut shape = Shape::default();
        for _ in 0..count {
            let position = std::array::from_fn(|axis| random.range(low[axis], high[axis]));
            shape.positions.push(DVec3::from_array(position));
            shape.colors.push(random_color(&mut random));
            shape.normals.push(random_direction(&mut random).as_vec3());
        }
        shape
    }

    pub fn moved(mut self, offset: DVec3) -> Shape {
        self.positions.iter_mut().for_each(|position| *position += offset);
        self
    }

    pub fn without_normals(mut self) -> Shape {
        self.normals.clear();
        self
    }

    /// A binary PLY file with f64 coordinates.
    pub fn ply(&self) -> Vec<u8> {
        let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
        header += &format!("element vertex {}\n", self.positions.len());
        let mut property = |kind: &str, names: &[&str], present: bool| {
            for name in names.iter().filter(|_| present) {
                header += &format!("property {kind} {name}\n");
            }
        };
        property("double", &["x", "y", "z"], true);
        property("float", &["nx", "ny", "nz"], !self.normals.is_empty());
        property("uchar", &["red", "green", "blue", "alpha"], !self.colors.is_empty());
        for (name, kind, _) in &self.fields {
            property(kind, &[name], true);
        }
        if !self.triangles.is_empty() {
            header += &format!("element face {}\n", self.triangles.len());
            header += "property list uchar uint vertex_indices\n";
        }
        header += "end_header\n";
        let mut bytes = header.into_bytes();
        for (i, position) in self.positions.iter().enumerate() {
            bytes.extend(position.to_array().iter().flat_map(|v| v.to_le_bytes()));
            if let Some(normal) = self.normals.get(i) {
                bytes.extend(normal.to_array().iter().flat_map(|v| v.to_le_bytes()));
            }
            bytes.extend(self.colors.get(i).into_iter().flatten());
            for (_, kind, values) in &self.fields {
                match *kind {
                    "uchar" => bytes.push(values[i] as u8),
                    "ushort" => bytes.extend((values[i] as u16).to_le_bytes()),
                    "double" => bytes.extend(values[i].to_le_bytes()),
                    _ => bytes.extend((values[i] as f32).to_le_bytes()),
                }
            }
        }
        for triangle in &self.triangles {
            bytes.push(3);
            bytes.extend(triangle.iter().flat_map(|v| v.to_le_bytes()));
        }
        bytes
    }
}

pub fn random_color(random: &mut SplitMix64) -> [u8; 4] {
    let bits = random.next_u64().to_le_bytes();
    [bits[0], bits[1], bits[2], 255]
}

pub fn random_direction(random: &mut SplitMix64) -> DVec3 {
    loop {
        let v = DVec3::from_array([(); 3].map(|()| random.range(-1.0, 1.0)));
        if (0.01..1.0).contains(&v.length_squared()) {
            return v / v.length();
        }
    }
}

/// An image of `width` × `height` sRGB texels as a PNG file.
pub fn picture(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    let rgba = (0..width * height).map(|i| texel(i % width, i / width)).collect();
    png::encode(&FrameImage::Color { width, height, rgba }).unwrap().bytes
}

/// A binary glTF file under construction.
pub struct Glb {
    json: Value,
    buffer: Vec<u8>,
}

impl Glb {
    pub fn new() -> Glb {
        let json = json!({ "asset": { "version": "2.0" }, "accessors": [], "bufferViews": [], "images": [],
            "samplers": [], "textures": [], "materials": [], "meshes": [], "nodes": [] });
        Glb { json, buffer: Vec::new() }
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.buffer.resize(self.buffer.len().next_multiple_of(4), 0);
        let (offset, length) = (self.buffer.len(), bytes.len());
        self.buffer.extend(bytes);
        self.push("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }))
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let bytes: Vec<u8> = values.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let mut accessor = json!({ "bufferView": view, "componentType": 5126, "count": values.len(),
            "type": format!("VEC{N}") });
        if N == 3 {
            let bound = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
                (0..N).map(|axis| values.iter().map(|v| v[axis]).reduce(pick).unwrap()).collect()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        self.push("accessors", accessor)
    }

    /// Adds a texture from a PNG file; `sampler` as in glTF.
    pub fn texture(&mut self, png: &[u8], sampler: Value) -> usize {
        let view = self.view(png);
        let image = self.push("images", json!({ "bufferView": view, "mimeType": "image/png" }));
        let sampler = self.push("samplers", sampler);
        self.push("textures", json!({ "source": image, "sampler": sampler }))
    }

    pub fn material(&mut self, material: Value) -> usize {
        self.push("materials", material)
    }

    /// Adds a mesh with one primitive.
    pub fn mesh(&mut self, shape: &Shape, material: Option<usize>) -> usize {
        let positions: Vec<[f32; 3]> =
            shape.positions.iter().map(|p| p.as_vec3().to_array()).collect();
        let mut attributes = json!({ "POSITION": self.floats(&positions) });
        if !shape.normals.is_empty() {
            let normals: Vec<[f32; 3]> = shape.normals.iter().map(|n| n.to_array()).collect();
            attributes["NORMAL"] = json!(self.floats(&normals));
        }
        if !shape.uvs.is_empty() {
            attributes["TEXCOORD_0"] = json!(self.floats(&shape.uvs));
        }
        let indices: Vec<u8> =
            shape.triangles.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&indices);
        let count = shape.triangles.len() * 3;
        let indices = self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": 5125, "type": "SCALAR", "count": count }),
        );
        let mut primitive = json!({ "attributes": attributes, "indices": indices });
        if let Some(material) = material {
            primitive["material"] = json!(material);
        }
        self.push("meshes", json!({ "primitives": [primitive] }))
    }

    /// Adds a root node that draws a mesh. `transform` holds `translation`, `scale`, `matrix` … or nothing.
    pub fn node(&mut self, mesh: usize, transform: Value) -> usize {
        let mut node = transform;
        node["mesh"] = json!(mesh);
        self.push("nodes", node)
    }

    pub fn finish(mut self) -> Vec<u8> {
        let roots: Vec<usize> = (0..self.json["nodes"].as_array().unwrap().len()).collect();
        self.json["scenes"] = json!([{ "nodes": roots }]);
        self.json["scene"] = json!(0);
        for list in ["images", "samplers", "textures", "materials"] {
            // glTF does not allow empty lists.
            if self.json[list].as_array().unwrap().is_empty() {
                self.json.as_object_mut().unwrap().remove(list);
            }
        }
        self.buffer.resize(self.buffer.len().next_multiple_of(4), 0);
        self.json["buffers"] = json!([{ "byteLength": self.buffer.len() }]);
        let mut text = serde_json::to_vec(&self.json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = b"glTF".to_vec();
        let total = 12 + 8 + text.len() + 8 + self.buffer.len();
        for word in [2, total as u32, text.len() as u32] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(b"JSON");
        bytes.extend(text);
        bytes.extend((self.buffer.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(self.buffer);
        bytes
    }
}
