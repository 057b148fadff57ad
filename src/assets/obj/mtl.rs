//! MTL libraries: the materials that faces ask for, and their textures.
//!
//! Nothing here refuses an asset: what is missing or broken becomes a warning and a plain material.

use std::collections::HashMap;

use super::super::input::{Folder, read_bounded};
use super::super::texture::{self, TextureBudget};
use super::super::tidy::linear_from_srgb;
use super::super::tokens::{BYTE_ORDER_MARK, Tokens, number};
use super::super::{
    Encoding, LEAST_ALPHA, MOST_EMISSIVE, Material, Physical, ReadOptions, ScaledMap, Texture, Wrap,
};
use crate::memory::Admission;

const MAX_LIBRARY_BYTES: u64 = 64 << 20;
/// More libraries than this are no sensible file.
const MAX_LIBRARIES: usize = 256;

/// The materials in use, with their textures.
#[derive(Default)]
pub(super) struct Library {
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
}

/// A `newmtl` block.
#[derive(Clone, Debug, Default, PartialEq)]
struct Definition {
    diffuse: Option<[f32; 3]>,
    specular: [f32; 3],
    exponent: f32,
    /// `d`.
    alpha: Option<f32>,
    /// `Tr`, the opposite.
    transparency: Option<f32>,
    /// Illumination model; 0 is unlit, 1 has no highlight.
    model: Option<u32>,
    map: Option<Map>,
    has_alpha_map: bool,
    /// `Ke`.
    emissive: [f32; 3],
    /// `Pm` and `Pr`, statements beside those of MTL that many programs write for the metallic-roughness model.
    metallic: Option<f32>,
    roughness: Option<f32>,
    /// `Tf`: what the surface lets pass, of each channel. It counts beside `Pm` and `Pr` alone, since others write 1 for opaque materials, too.
    filter: Option<[f32; 3]>,
    metallic_map: Option<Map>,
    roughness_map: Option<Map>,
    emissive_map: Option<Map>,
    /// `norm`: normals in tangent space.
    normal_map: Option<Map>,
}

/// A map and its options.
#[derive(Clone, Debug, Default, PartialEq)]
struct Map {
    file: String,
    clamp: bool,
    /// Whether options were given that move or change the image.
    altered: bool,
    /// `-bm`, the factor of bumps.
    factor: Option<f32>,
}

/// The materials called `used`, in that order.
pub(super) fn read(
    libraries: &[String],
    used: &[String],
    folder: Option<&Folder>,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Library {
    let definitions = definitions(libraries, folder, &options.admission, warnings);
    let mut textures = Textures {
        budget: TextureBudget::new(options),
        known: HashMap::new(),
        reflections: HashMap::new(),
        textures: Vec::new(),
        folder,
    };
    let mut library = Library::default();
    let mut undefined = Vec::new();
    for name in used {
        let material = match definitions.get(name) {
            Some(definition) => definition.material(name, &mut textures, warnings),
            None => {
                undefined.push(name.as_str());
                Material { name: name.clone(), ..Material::default() }
            }
        };
        library.materials.push(material);
    }
    if let [first, rest @ ..] = undefined.as_slice() {
        let more = if rest.is_empty() { String::new() } else { format!(" and {}", rest.len()) };
        warnings.push(format!("material {first}{more} is not defined and is drawn plain"));
    }
    library.textures = textures.textures;
    library
}

fn definitions(
    libraries: &[String],
    folder: Option<&Folder>,
    admission: &Admission,
    warnings: &mut Vec<String>,
) -> HashMap<String, Definition> {
    let mut definitions = HashMap::new();
    let mut seen = Vec::new();
    for library in libraries {
        if seen.contains(&library) {
            continue;
        }
        if seen.len() == MAX_LIBRARIES {
            warnings.push(format!("material libraries after {MAX_LIBRARIES} are ignored"));
            break;
        }
        seen.push(library);
        match library_text(library, folder, admission) {
            Ok(texts) => texts.iter().for_each(|text| parse(text, &mut definitions)),
            Err(reason) => {
                warnings.push(format!("material library {library} is left out: {reason}"));
            }
        }
    }
    definitions
}

/// The text of one `mtllib` statement: one file whose name may have blanks, or several files.
fn library_text(
    statement: &str,
    folder: Option<&Folder>,
    admission: &Admission,
) -> Result<Vec<Vec<u8>>, String> {
    let folder = folder.ok_or("the asset lies in no folder")?;
    let load = |name: &str| {
        let path = folder.find(name)?;
        read_bounded(&path, MAX_LIBRARY_BYTES, admission).map_err(|error| error.to_string())
    };
    load(statement).map(|text| vec![text]).or_else(|reason| {
        let names: Vec<&str> = statement.split_whitespace().take(16).collect();
        if names.len() < 2 {
            return Err(reason);
        }
        names.into_iter().map(load).collect()
    })
}

/// Adds a library's definitions; the first of a name counts.
fn parse(text: &[u8], definitions: &mut HashMap<String, Definition>) {
    let text = text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text);
    let mut current: Option<(String, Definition)> = None;
    let mut finish = |done: Option<(String, Definition)>| {
        if let Some((name, definition)) = done {
            definitions.entry(name).or_insert(definition);
        }
    };
    for line in text.split(|byte| matches!(byte, b'\n' | b'\r')) {
        let mut tokens = Tokens(line);
        let keyword = tokens.next().unwrap_or_default();
        if keyword == b"newmtl" {
            finish(current.take());
            current = Some((tokens.rest(), Definition::default()));
        } else if let Some((_, definition)) = &mut current {
            definition.statement(keyword, tokens);
        }
    }
    finish(current);
}

impl Definition {
    fn statement(&mut self, keyword: &[u8], mut tokens: Tokens) {
        let first = |mut tokens: Tokens| {
            tokens.find_map(number).filter(|value| value.is_finite()).map(|value| value as f32)
        };
        match keyword.to_ascii_lowercase().as_slice() {
            b"kd" => self.diffuse = color(tokens),
            b"ks" => self.specular = color(tokens).unwrap_or_default(),
            b"ns" => self.exponent = first(tokens).unwrap_or(0.0),
            b"d" => self.alpha = first(tokens),
            b"tr" => self.transparency = first(tokens),
            b"illum" => self.model = first(tokens).map(|model| model as u32),
            b"map_kd" => self.map = Some(map(&mut tokens)),
            b"map_d" | b"map_opacity" => self.has_alpha_map = true,
            b"ke" => self.emissive = color(tokens).unwrap_or_default(),
            b"pm" => self.metallic = first(tokens),
            b"pr" => self.roughness = first(tokens),
            b"tf" => self.filter = color(tokens),
            b"map_pm" => self.metallic_map = Some(map(&mut tokens)),
            b"map_pr" => self.roughness_map = Some(map(&mut tokens)),
            b"map_ke" => self.emissive_map = Some(map(&mut tokens)),
            b"norm" => self.normal_map = Some(map(&mut tokens)),
            _ => {}
        }
    }

    fn material(
        &self,
        name: &str,
        textures: &mut Textures,
        warnings: &mut Vec<String>,
    ) -> Material {
        let texture =
            self.map.as_ref().and_then(|map| textures.load(map, Encoding::Srgb, warnings));
        if self.has_alpha_map {
            warnings.push(format!("material {name}: its separate alpha map is ignored"));
        }
        let mut diffuse = self.diffuse.unwrap_or([1.0; 3]);
        // Exporters write black under a texture and mean the texture.
        if texture.is_some() && diffuse == [0.0; 3] {
            diffuse = [1.0; 3];
        }
        let alpha = self.alpha.or(self.transparency.map(|tr| 1.0 - tr));
        // Meshlab writes `Tr 1` for opaque; nobody stores what cannot be seen.
        let alpha = alpha.filter(|alpha| *alpha > 0.0).map_or(1.0, |alpha| alpha.min(1.0));
        let lets_through = texture
            .and_then(|texture| textures.textures.get(texture as usize))
            .is_some_and(texture::has_alpha);
        let [r, g, b] = diffuse.map(linear_from_srgb);
        let unlit = self.model == Some(0);
        let is_physical = !unlit
            && (self.metallic.is_some()
                || self.roughness.is_some()
                || self.metallic_map.is_some()
                || self.roughness_map.is_some());
        let reflection = if is_physical { textures.reflection(self, warnings) } else { None };
        let has_metal = reflection.is_some_and(|own| own.has_metal);
        let factor = |own: Option<f32>, is_mapped: bool, plain: f32| match own {
            // Exporters write 0 beside a map and mean the map.
            Some(0.0) | None if is_mapped => 1.0,
            own => own.unwrap_or(plain).clamp(0.0, 1.0),
        };
        let is_rough = reflection.is_some_and(|own| own.has_roughness);
        let filter = self.filter.filter(|_| is_physical).unwrap_or_default();
        let transmission = filter.into_iter().fold(0.0, f32::max).min(1.0);
        let passed = |channel: f32| (channel / transmission).clamp(0.0, 1.0);
        let physical = is_physical.then(|| Physical {
            metallic: factor(self.metallic, has_metal, 0.0),
            roughness: factor(self.roughness, is_rough, 1.0),
            map: reflection.map(|own| own.texture),
            transmission,
            volume: if transmission > 0.0 { filter.map(passed) } else { [1.0; 3] },
            ..Physical::default()
        });
        let mut load = |map: &Option<Map>, encoding| match map {
            Some(map) if !unlit => textures.load(map, encoding, warnings),
            _ => None,
        };
        let emissive_map = load(&self.emissive_map, Encoding::Srgb);
        let normal_map = load(&self.normal_map, Encoding::Linear);
        // Exporters write black under a map here, too.
        let emissive = match emissive_map {
            Some(_) if self.emissive == [0.0; 3] => [1.0; 3],
            _ if unlit => [0.0; 3],
            // Beyond 1 it is a strength.
            _ => {
                let strength = self.emissive.into_iter().fold(1.0, f32::max).min(MOST_EMISSIVE);
                self.emissive
                    .map(|own| linear_from_srgb((own / strength).clamp(0.0, 1.0)) * strength)
            }
        };
        // An exponent below 1 is how exporters say that there is no highlight.
        let shines = self.model.unwrap_or(2) >= 2 && self.exponent >= 1.0;
        Material {
            name: name.to_owned(),
            base_color: [r, g, b, alpha],
            base_texture: texture,
            specular: if shines { self.specular.map(linear_from_srgb) } else { [0.0; 3] },
            shininess: if shines { self.exponent.min(1000.0) } else { 1.0 },
            physical,
            emissive,
            emissive_map,
            normal_map: normal_map.map(|texture| ScaledMap {
                texture,
                factor: self.normal_map.as_ref().and_then(|map| map.factor).unwrap_or(1.0),
            }),
            unlit,
            // An alpha channel alone is that of a cut-out: leaves, fences.
            alpha_cutoff: match alpha < 1.0 {
                true => Some(LEAST_ALPHA),
                false => lets_through.then_some(0.5),
            },
            translucent: alpha < 1.0 || transmission > 0.0,
            ..Material::default()
        }
    }
}

fn color(tokens: Tokens) -> Option<[f32; 3]> {
    let values: Vec<f32> = tokens.take(3).map_while(number).map(|value| value as f32).collect();
    match values.as_slice() {
        [r, g, b] if values.iter().all(|value| value.is_finite()) => Some([*r, *g, *b]),
        [grey] if grey.is_finite() => Some([*grey; 3]),
        _ => None,
    }
}

/// Options, then a file name that may have blanks.
fn map(tokens: &mut Tokens) -> Map {
    let mut map = Map::default();
    loop {
        let mut ahead = tokens.clone();
        let Some(option) = ahead.next().filter(|token| token.starts_with(b"-")) else { break };
        let (numbers, words) = match option {
            b"-o" | b"-s" | b"-t" => (3, 0),
            b"-mm" => (2, 0),
            b"-bm" | b"-boost" | b"-texres" => {
                let value = ahead.clone().next().and_then(number).filter(|own| own.is_finite());
                if option == b"-bm" {
                    map.factor = value.map(|own| own as f32);
                }
                (1, 0)
            }
            b"-clamp" | b"-blendu" | b"-blendv" | b"-cc" | b"-imfchan" | b"-type" => (0, 1),
            _ => break,
        };
        map.altered |= matches!(option, b"-o" | b"-s" | b"-t" | b"-mm");
        for _ in 0..numbers {
            let mut next = ahead.clone();
            if next.next().and_then(number).is_some() {
                ahead = next;
            }
        }
        for _ in 0..words {
            let word = ahead.next().unwrap_or_default();
            map.clamp |= option == b"-clamp" && word == b"on";
        }
        *tokens = ahead;
    }
    map.file = tokens.rest();
    map
}

/// A texture of roughness and metallic value, and which of them it has.
#[derive(Clone, Copy)]
struct Reflection {
    texture: u32,
    has_roughness: bool,
    has_metal: bool,
}

/// Textures that were asked for so far, each decoded once.
struct Textures<'a> {
    budget: TextureBudget,
    /// By file, clamping and encoding; `None` for one that cannot be had.
    known: HashMap<(String, bool, Encoding), Option<u32>>,
    /// By files and clamping.
    reflections: HashMap<([String; 2], bool), Option<Reflection>>,
    textures: Vec<Texture>,
    folder: Option<&'a Folder>,
}

impl Textures<'_> {
    /// The texture of a material's roughness and metallic value, from an image of grey for each, in the channels in which glTF has them.
    fn reflection(&mut self, own: &Definition, warnings: &mut Vec<String>) -> Option<Reflection> {
        let maps = [&own.roughness_map, &own.metallic_map];
        let files = maps.map(|map| map.as_ref().map_or("", |map| &map.file));
        let clamp = maps.iter().filter_map(|map| map.as_ref()).any(|map| map.clamp);
        let key = (files.map(str::to_owned), clamp);
        if let Some(known) = self.reflections.get(&key) {
            return *known;
        }
        for map in maps.iter().filter_map(|map| map.as_ref()).filter(|map| map.altered) {
            warnings.push(format!("texture {}: its placement options are ignored", map.file));
        }
        let mut read = |map: &Option<Map>| {
            let read = texture::load(&map.as_ref()?.file, self.folder, &mut self.budget);
            read.map_err(|reason| warnings.push(reason)).ok()
        };
        let [roughness, mut metallic] = maps.map(&mut read);
        let size = |map: &Texture| (map.width, map.height);
        if let (Some(one), Some(other)) = (&roughness, &metallic)
            && size(one) != size(other)
        {
            warnings.push(format!(
                "texture {} is left out: it makes one map with {} and must be as large",
                other.name, one.name
            ));
            metallic = None;
        }
        let number = roughness.as_ref().or(metallic.as_ref()).cloned().map(|mut merged| {
            let value =
                |map: &Option<Texture>, at: usize| map.as_ref().map_or(255, |own| own.rgba[at][0]);
            let texel = |at| [255, value(&roughness, at), value(&metallic, at), 255];
            merged.rgba = (0..merged.rgba.len()).map(texel).collect();
            merged.encoding = Encoding::Linear;
            if clamp {
                merged.wrap = [Wrap::Clamp; 2];
            }
            self.textures.push(merged);
            Reflection {
                texture: self.textures.len() as u32 - 1,
                has_roughness: roughness.is_some(),
                has_metal: metallic.is_some(),
            }
        });
        self.reflections.insert(key, number);
        number
    }

    fn load(&mut self, map: &Map, encoding: Encoding, warnings: &mut Vec<String>) -> Option<u32> {
        let key = (map.file.clone(), map.clamp, encoding);
        if let Some(known) = self.known.get(&key) {
            return *known;
        }
        if map.altered {
            warnings.push(format!("texture {}: its placement options are ignored", map.file));
        }
        let number = match texture::load(&map.file, self.folder, &mut self.budget) {
            Ok(mut texture) => {
                if map.clamp {
                    texture.wrap = [Wrap::Clamp; 2];
                }
                texture.encoding = encoding;
                self.textures.push(texture);
                Some(self.textures.len() as u32 - 1)
            }
            Err(reason) => {
                warnings.push(reason);
                None
            }
        };
        self.known.insert(key, number);
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(text: &str) -> Definition {
        let mut definitions = HashMap::new();
        parse(format!("newmtl a b\n{text}").as_bytes(), &mut definitions);
        definitions.remove("a b").unwrap()
    }

    #[test]
    fn map_options_end_where_the_name_begins() {
        for (text, file, clamp, altered) in [
            ("map_Kd a b.png", "a b.png", false, false),
            ("map_Kd -s 1 1 1 -o 0.5 2 name.png", "name.png", false, true),
            ("map_Kd -clamp on -bm 0.3 1.png", "1.png", true, false),
            ("map_Kd -blendu off -mm 0 1 x y.jpg ", "x y.jpg", false, true),
            ("map_kd -unknown.png", "-unknown.png", false, false),
            ("map_Kd", "", false, false),
        ] {
            let map = one(text).map.unwrap();
            assert_eq!((map.file.as_str(), map.clamp, map.altered), (file, clamp, altered));
        }
    }

    fn material(text: &str) -> Material {
        let mut textures = Textures {
            budget: TextureBudget::new(&ReadOptions { max_texels: 0, ..ReadOptions::default() }),
            known: HashMap::new(),
            reflections: HashMap::new(),
            textures: Vec::new(),
            folder: None,
        };
        one(text).material("m", &mut textures, &mut Vec::new())
    }

    #[test]
    fn highlights_need_an_exponent_and_a_model() {
        let shiny = material("Ks 1 1 1\nNs 40\nillum 2\nKd 1 0 0");
        assert_eq!((shiny.specular, shiny.shininess), ([1.0; 3], 40.0));
        assert_eq!(shiny.base_color, [1.0, 0.0, 0.0, 1.0]);
        for dull in ["Ks 1 1 1\nNs 0\nillum 2", "Ks 1 1 1\nNs 40\nillum 1", "Ks 1 1 1"] {
            assert_eq!(material(dull).specular, [0.0; 3], "{dull}");
        }
        assert!(material("illum 0").unlit);
    }

    #[test]
    fn some_materials_are_metals() {
        let steel = material("Kd 1 1 1\nPm 0.75\nPr 0.5");
        let own = steel.physical.unwrap();
        assert_eq!((own.metallic, own.roughness, own.map), (0.75, 0.5, None));
        let rough = material("Pr 0.25").physical.unwrap();
        assert_eq!((rough.metallic, rough.roughness), (0.0, 0.25));
        assert_eq!(material("Pr 7\nPm -1").physical.unwrap().roughness, 1.0);
        assert_eq!(material("Ks 1 1 1\nNs 40\nillum 2").physical, None);
        assert_eq!(material("Pm 1\nillum 0").physical, None);
        let glass = material("Pr 0.1\nTf 0.25 0.5 0.5");
        let own = glass.physical.unwrap();
        assert_eq!((own.transmission, own.volume), (0.5, [0.5, 1.0, 1.0]));
        assert!(glass.translucent && glass.transmits() && !glass.blends());
        for opaque in ["Tf 1 1 1", "Tf 1 1 1\nillum 2", "Tf 0 0 0\nPr 1", "Tf 1 1 1\nPr 1\nillum 0"]
        {
            assert!(!material(opaque).translucent, "{opaque}");
        }
        let ember = material("Ke 1 0 0.5\nKd 0 0 0");
        assert_eq!(ember.emissive, [1.0, 0.0, linear_from_srgb(0.5)]);
        assert_eq!(material("Ke 1 1 1\nillum 0").emissive, [0.0; 3]);
        assert_eq!(material("Ke 4 2 0").emissive, [4.0, 4.0 * linear_from_srgb(0.5), 0.0]);
        // A map that cannot be had is no factor of 1.
        assert_eq!(material("map_Ke missing.png").emissive, [0.0; 3]);
    }

    #[test]
    fn maps_of_roughness_and_metal_become_one() {
        let folder = tempfile::tempdir().unwrap();
        let image = |name: &str, width: u32, texels: &[[u8; 4]]| {
            std::fs::write(folder.path().join(name), texture::tests::png(width, texels)).unwrap();
        };
        image("rough.png", 2, &[[10, 0, 0, 255], [20, 0, 0, 255]]);
        image("metal.png", 2, &[[255, 9, 9, 255], [0, 9, 9, 255]]);
        image("other.png", 1, &[[50, 9, 9, 255]]);
        let folder = Folder::of(&folder.path().join("a.obj"), &ReadOptions::default()).unwrap();
        let read = |text: &str| {
            let mut textures = Textures {
                budget: TextureBudget::new(&ReadOptions::default()),
                known: HashMap::new(),
                reflections: HashMap::new(),
                textures: Vec::new(),
                folder: Some(&folder),
            };
            let mut warnings = Vec::new();
            let material = one(text).material("m", &mut textures, &mut warnings);
            (material, textures.textures, warnings)
        };
        let (material, textures, warnings) =
            read("map_Pr rough.png\nmap_Pm metal.png\nPm 0\nnorm -bm 0.5 rough.png");
        let own = material.physical.unwrap();
        assert_eq!((own.metallic, own.roughness, own.map), (1.0, 1.0, Some(0)));
        assert_eq!(textures[0].rgba, [[255, 10, 255, 255], [255, 20, 0, 255]]);
        assert!(textures.iter().all(|texture| texture.encoding == Encoding::Linear));
        assert_eq!(material.normal_map, Some(ScaledMap { texture: 1, factor: 0.5 }));
        assert!(warnings.is_empty(), "{warnings:?}");
        // A map that cannot be had leaves the factor as it is, whether or not the other map is there.
        for text in ["map_Pr gone.png\nPr 0", "map_Pr gone.png\nmap_Pm metal.png\nPr 0\nPm 0"] {
            let (material, textures, warnings) = read(text);
            let own = material.physical.unwrap();
            assert_eq!((own.roughness, own.map.is_some()), (0.0, !textures.is_empty()), "{text}");
            assert_eq!(own.metallic, if textures.is_empty() { 0.0 } else { 1.0 }, "{text}");
            assert_eq!(warnings.len(), 1, "{warnings:?}");
        }
        let (material, textures, warnings) = read("map_Pr rough.png\nmap_Pm other.png");
        let own = material.physical.unwrap();
        assert_eq!((own.metallic, own.map), (0.0, Some(0)));
        assert_eq!(textures[0].rgba[0], [255, 10, 255, 255]);
        assert!(warnings.len() == 1 && warnings[0].contains("other.png"), "{warnings:?}");
    }

    #[test]
    fn alpha_has_two_spellings() {
        let glass = material("d 0.25\nTr 0.1");
        assert_eq!((glass.base_color[3], glass.translucent), (0.25, true));
        assert_eq!((material("d 0").base_color[3], material("d 0").translucent), (1.0, false));
        assert_eq!(material("Tr 0.25").base_color[3], 0.75);
        assert_eq!(material("Tr 1.0").base_color[3], 1.0);
        assert_eq!(material("d -halo 0.5").base_color[3], 0.5);
        assert_eq!(material("d nan").base_color[3], 1.0);
    }

    #[test]
    fn the_first_definition_counts() {
        let mut definitions = HashMap::new();
        parse(b"Kd 9 9 9\nnewmtl a\nKd 1 0 0\r\nnewmtl a\nKd 0 1 0", &mut definitions);
        assert_eq!(definitions["a"].diffuse, Some([1.0, 0.0, 0.0]));
        assert_eq!(definitions.len(), 1);
        parse(b"\xef\xbb\xbfnewmtl b\nKd 0 0 1", &mut definitions);
        assert_eq!(definitions["b"].diffuse, Some([0.0, 0.0, 1.0]), "after a byte order mark");
    }
}
