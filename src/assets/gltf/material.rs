//! Materials and their base textures, made when a primitive first asks for them.
//!
//! Where a node's material makes a surface one of Phong's model, what the node leaves open is metallic–roughness as
//! `specular = mix(0.04, base, metallic)` and `shininess = 2 / roughness⁴ − 2`, clamped to 1..=512:
//! the reflectance at normal incidence, and the exponent whose lobe is as wide as a Beckmann
//! distribution of slope `roughness²` (Walter et al., "Microfacet Models for Refraction", 2007).
//! Specular–glossiness uses its specular colour, for a dielectric, and `roughness = 1 − glossiness`.
//!
//! A mesh has one pair of texture coordinates for each vertex. They are those of the base colour's texture, or of the first
//! map where there is none; a map with others is left out.

use std::collections::HashMap;

use ::gltf::json::extensions::material::Volume;
use ::gltf::json::extensions::texture::TextureTransform as Transform;
use ::gltf::json::material::AlphaMode;
use ::gltf::json::texture::{self as json_texture, MagFilter, WrappingMode};
use ::gltf::json::validation::Checked;
use ::gltf::json::{Index, Root, Value, material};
use serde_json::Map;

use super::super::input::{Folder, read_bounded};
use super::super::texture::{self, TextureBudget};
use super::super::{
    DIELECTRIC, Encoding, Filter, LEAST_ALPHA, MOST_EMISSIVE, Material, Physical, ReadOptions,
    ScaledMap, Texture, Wrap,
};
use super::buffers::{Buffers, external};
use super::container::data_uri;

/// How a primitive's texture coordinates are to be read for its material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TexturePlacement {
    /// Which `TEXCOORD_n`.
    pub set: u32,
    pub offset: [f32; 2],
    pub rotation: f32,
    pub scale: [f32; 2],
}

impl Default for TexturePlacement {
    fn default() -> Self {
        Self { set: 0, offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] }
    }
}

pub(super) struct Materials<'a> {
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    folder: Option<&'a Folder>,
    budget: TextureBudget,
    known: HashMap<usize, (u32, TexturePlacement)>,
    /// `None` for one that cannot be had.
    known_textures: HashMap<Sampled, Option<u32>>,
    /// By the number of a material that light passes through.
    absorbing: HashMap<u32, Absorption>,
    /// By the number of such a material, and what it lets through where its mesh is scaled.
    scaled: HashMap<(u32, [u32; 3]), u32>,
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub warnings: Vec<String>,
}

/// An image and how it is read.
type Sampled = (usize, [Wrap; 2], Filter, Encoding);

/// A reference to a texture, from either material model.
#[derive(Clone, Copy)]
struct Reference {
    texture: usize,
    placement: TexturePlacement,
}

/// Values that both material models have.
struct Surface {
    base: [f32; 4],
    texture: Option<Reference>,
    /// Reflectance at normal incidence of what is not metal, and at grazing angles.
    dielectric: [f32; 3],
    grazing: f32,
    metallic: f32,
    roughness: f32,
    map: Option<Reference>,
    transmission: f32,
    transmission_map: Option<Reference>,
    absorption: Option<Absorption>,
}

/// How the volume behind a surface takes up light (KHR_materials_volume, Beer's law).
#[derive(Clone, Copy)]
struct Absorption {
    /// What is left of white light after the attenuation distance.
    color: [f32; 3],
    /// Thickness over attenuation distance, where the mesh is not scaled.
    depth: f32,
}

impl Absorption {
    /// `None` where all light passes, also for distances that the standard excludes: zero and less.
    fn of(volume: &Volume) -> Option<Absorption> {
        let depth = volume.thickness_factor.0 / volume.attenuation_distance.0;
        let color = volume.attenuation_color.0.map(unit);
        let absorbs = depth.is_finite() && depth > 0.0 && color != [1.0; 3];
        absorbs.then_some(Absorption { color, depth })
    }

    /// What passes where the mesh is scaled: the thickness is in its units.
    fn left(&self, scale: f64) -> [f32; 3] {
        let depth = f64::from(self.depth) * scale;
        self.color.map(|channel| f64::from(channel).powf(depth) as f32)
    }
}

/// The maps that a document names beside those of a [`Surface`], each with the factor of what it shows.
struct Maps {
    normal: Option<(Reference, f32)>,
    occlusion: Option<(Reference, f32)>,
    emissive: Option<Reference>,
}

impl<'a> Materials<'a> {
    pub fn new(
        root: &'a Root,
        buffers: &'a Buffers<'a>,
        folder: Option<&'a Folder>,
        options: &ReadOptions,
    ) -> Self {
        Self {
            root,
            buffers,
            folder,
            budget: TextureBudget::new(options),
            known: HashMap::new(),
            known_textures: HashMap::new(),
            absorbing: HashMap::new(),
            scaled: HashMap::new(),
            materials: Vec::new(),
            textures: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// The number of a material in the asset and how it places its texture; `None` if the document
    /// has no such material.
    pub fn get(&mut self, index: Index<material::Material>) -> Option<(u32, TexturePlacement)> {
        if let Some(known) = self.known.get(&index.value()) {
            return Some(*known);
        }
        let source = self.root.get(index)?;
        let name = source.name.clone().unwrap_or_else(|| format!("material {}", index.value()));
        let surface = specular_glossiness(source).unwrap_or_else(|| metallic_roughness(source));
        let unlit = source.extensions.as_ref().is_some_and(|ext| ext.unlit.is_some());
        // Unlit materials have no other map (KHR_materials_unlit).
        let maps = if unlit { Maps::NONE } else { Maps::of(source) };
        let map = surface.map.filter(|_| !unlit);
        let transmission_map = surface.transmission_map.filter(|_| !unlit);
        let references = [
            surface.texture,
            map,
            transmission_map,
            maps.normal.map(|own| own.0),
            maps.occlusion.map(|own| own.0),
            maps.emissive,
        ];
        let placement =
            references.iter().flatten().next().map_or_else(Default::default, |own| own.placement);
        let place = (name.as_str(), placement);
        let base_texture = self.texture(surface.texture, Encoding::Srgb, place);
        let physical = Physical {
            metallic: surface.metallic,
            roughness: unit(surface.roughness),
            dielectric: surface.dielectric.map(unit),
            grazing: surface.grazing,
            map: self.texture(map, Encoding::Linear, place),
            transmission: surface.transmission,
            transmission_map: self.texture(transmission_map, Encoding::Linear, place),
            volume: surface.absorption.map_or([1.0; 3], |own| own.left(1.0)),
        };
        let mut scaled = |own: Option<(Reference, f32)>| {
            let (reference, factor) = own?;
            let texture = self.texture(Some(reference), Encoding::Linear, place)?;
            Some(ScaledMap { texture, factor })
        };
        let (normal_map, occlusion_map) = (scaled(maps.normal), scaled(maps.occlusion));
        let emissive_map = self.texture(maps.emissive, Encoding::Srgb, place);
        let [r, g, b, a] = surface.base.map(unit);
        let alpha_cutoff = match source.alpha_mode {
            Checked::Valid(AlphaMode::Mask) => {
                Some(source.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0).max(0.0))
            }
            Checked::Valid(AlphaMode::Blend) => Some(LEAST_ALPHA),
            _ => None,
        };
        let base = [r, g, b];
        let specular: [f32; 3] = std::array::from_fn(|channel| {
            let dielectric = physical.dielectric[channel];
            dielectric + (base[channel] - dielectric) * physical.metallic
        });
        let transmits = !unlit && physical.transmission > 0.0;
        self.materials.push(Material {
            name,
            base_color: [r, g, b, a],
            base_texture,
            specular,
            shininess: shininess(physical.roughness),
            physical: (!unlit).then_some(physical),
            emissive: if unlit { [0.0; 3] } else { emissive(source) },
            emissive_map,
            normal_map,
            occlusion_map,
            double_sided: source.double_sided,
            unlit,
            alpha_cutoff,
            translucent: transmits || matches!(source.alpha_mode, Checked::Valid(AlphaMode::Blend)),
        });
        let known = (self.materials.len() as u32 - 1, placement);
        if let Some(absorption) = surface.absorption.filter(|_| transmits) {
            self.absorbing.insert(known.0, absorption);
        }
        self.known.insert(index.value(), known);
        Some(known)
    }

    /// The material for a mesh without texture coordinates: its textures would show one texel everywhere.
    pub fn without_textures(&mut self, number: u32) -> u32 {
        let Some(own) = self.materials.get(number as usize) else { return number };
        if own.base_texture.is_none() && !own.has_maps() {
            return number;
        }
        self.warnings.push(format!(
            "material {}: its textures are left out of a mesh that has no texture coordinates",
            own.name
        ));
        let plain = |own| Physical { map: None, transmission_map: None, ..own };
        let physical = own.physical.map(plain);
        self.materials.push(Material {
            base_texture: None,
            emissive_map: None,
            normal_map: None,
            occlusion_map: None,
            physical,
            ..own.clone()
        });
        let made = self.materials.len() as u32 - 1;
        if let Some(absorption) = self.absorbing.get(&number).copied() {
            self.absorbing.insert(made, absorption);
        }
        made
    }

    /// Whether the scale of its mesh changes what a material lets through.
    pub fn absorbs(&self, number: u32) -> bool {
        self.absorbing.contains_key(&number)
    }

    /// The material for a mesh that is scaled.
    pub fn scaled(&mut self, number: u32, scale: f64) -> u32 {
        let (Some(absorption), Some(own)) =
            (self.absorbing.get(&number), self.materials.get(number as usize))
        else {
            return number;
        };
        let volume = absorption.left(scale);
        let Some(physical) = own.physical.filter(|physical| physical.volume != volume) else {
            return number;
        };
        let key = (number, volume.map(f32::to_bits));
        if let Some(&known) = self.scaled.get(&key) {
            return known;
        }
        let physical = Some(Physical { volume, ..physical });
        let material = Material { physical, ..own.clone() };
        self.materials.push(material);
        let made = self.materials.len() as u32 - 1;
        self.scaled.insert(key, made);
        made
    }

    /// Decodes a texture of a material, or says why not and returns `None`; `place`: the material's name, and how its vertices' texture
    /// coordinates are placed.
    fn texture(
        &mut self,
        reference: Option<Reference>,
        encoding: Encoding,
        (material, placed): (&str, TexturePlacement),
    ) -> Option<u32> {
        let Reference { texture: index, placement } = reference?;
        if placement != placed {
            self.warnings.push(format!(
                "material {material}: texture {index} is left out: it has other texture coordinates than the material's first texture"
            ));
            return None;
        }
        let Some(source) = self.root.textures.get(index) else {
            self.warnings.push(format!("texture {index} does not exist"));
            return None;
        };
        let webp = source
            .extensions
            .as_ref()
            .and_then(|ext| ext.others.get("EXT_texture_webp")?.get("source")?.as_u64());
        let image = webp.and_then(|image| usize::try_from(image).ok());
        let image = image.unwrap_or(source.source.value());
        let sampler = source.sampler.and_then(|sampler| self.root.get(sampler));
        let (wrap, filter) = sampler.map_or_else(Default::default, sampling);
        let key = (image, wrap, filter, encoding);
        if let Some(known) = self.known_textures.get(&key) {
            return *known;
        }
        let number = match self.decode(image) {
            Ok(mut texture) => {
                texture.wrap = wrap;
                texture.filter = filter;
                texture.encoding = encoding;
                self.textures.push(texture);
                Some(self.textures.len() as u32 - 1)
            }
            Err(reason) => {
                self.warnings.push(reason);
                None
            }
        };
        self.known_textures.insert(key, number);
        number
    }

    fn decode(&mut self, index: usize) -> Result<Texture, String> {
        let place = format!("image {index}");
        let Some(source) = self.root.images.get(index) else {
            return Err(format!("texture {place} is left out: it does not exist"));
        };
        let fail = |reason: String| format!("texture {place} is left out: {reason}");
        let name = source
            .name
            .clone()
            .or_else(|| source.uri.clone().filter(|uri| !uri.starts_with("data:")));
        let name = name.unwrap_or_else(|| place.clone());
        let owned;
        let bytes = match (source.buffer_view, &source.uri) {
            (Some(view), _) => self.buffers.view(view).map_err(|error| fail(error.to_string()))?,
            (None, Some(uri)) => {
                owned = self.external(uri).map_err(fail)?;
                owned.as_slice()
            }
            (None, None) => return Err(fail("it has neither bufferView nor uri".to_owned())),
        };
        texture::decode(bytes, &name, &mut self.budget)
    }

    fn external(&self, uri: &str) -> Result<Vec<u8>, String> {
        if let Some(bytes) = data_uri(uri) {
            return bytes;
        }
        let (_, path) = external(uri, self.folder)?;
        read_bounded(&path, self.budget.max_encoded_bytes(), self.budget.admission())
            .map_err(|error| error.to_string())
    }
}

fn unit(value: f32) -> f32 {
    if value.is_finite() { value.clamp(0.0, 1.0) } else { 1.0 }
}

/// The Phong exponent for a roughness.
pub(super) fn shininess(roughness: f32) -> f32 {
    let squared = f64::from(unit(roughness)).powi(2).max(1e-6);
    (2.0 / (squared * squared) - 2.0).clamp(1.0, 512.0) as f32
}

fn metallic_roughness(source: &material::Material) -> Surface {
    let model = &source.pbr_metallic_roughness;
    let extensions = source.extensions.as_ref();
    // KHR_materials_specular scales what a dielectric reflects, KHR_materials_ior says how much that is.
    let specular = extensions.and_then(|ext| ext.specular.as_ref());
    let (strength, tint) = specular
        .map_or((1.0, [1.0; 3]), |s| (unit(s.specular_factor.0), s.specular_color_factor.0));
    let reflectance = extensions.and_then(|ext| ext.ior.as_ref()).map_or(DIELECTRIC, |own| {
        let ior = own.ior.0;
        ((ior - 1.0) / (ior + 1.0)).powi(2)
    });
    let transmission = extensions.and_then(|ext| ext.transmission.as_ref());
    Surface {
        base: model.base_color_factor.0,
        texture: model.base_color_texture.as_ref().map(reference),
        dielectric: tint.map(|tint| unit(reflectance * tint) * strength),
        grazing: strength,
        metallic: unit(model.metallic_factor.0),
        roughness: model.roughness_factor.0,
        map: model.metallic_roughness_texture.as_ref().map(reference),
        transmission: transmission.map_or(0.0, |own| unit(own.transmission_factor.0)),
        transmission_map: transmission
            .and_then(|own| own.transmission_texture.as_ref().map(reference)),
        absorption: extensions.and_then(|ext| ext.volume.as_ref()).and_then(Absorption::of),
    }
}

/// Light that the surface gives off; KHR_materials_emissive_strength lets it exceed 1.
fn emissive(source: &material::Material) -> [f32; 3] {
    let extensions = source.extensions.as_ref();
    let strength = extensions
        .and_then(|ext| ext.emissive_strength.as_ref())
        .map_or(1.0, |own| own.emissive_strength.0);
    let strength = if strength.is_finite() { strength.clamp(0.0, MOST_EMISSIVE) } else { 1.0 };
    source.emissive_factor.0.map(|channel| unit(channel) * strength)
}

impl Maps {
    const NONE: Maps = Maps { normal: None, occlusion: None, emissive: None };

    fn of(source: &material::Material) -> Maps {
        let of = |index: Index<json_texture::Texture>, set: u32, transform: Option<&Transform>| {
            Reference { texture: index.value(), placement: placed(set, transform) }
        };
        let finite = |factor: f32| if factor.is_finite() { factor } else { 1.0 };
        Maps {
            normal: source.normal_texture.as_ref().map(|own| {
                let transform = other_transform(own.extensions.as_ref().map(|ext| &ext.others));
                (of(own.index, own.tex_coord, transform.as_ref()), finite(own.scale))
            }),
            occlusion: source.occlusion_texture.as_ref().map(|own| {
                let transform = other_transform(own.extensions.as_ref().map(|ext| &ext.others));
                (of(own.index, own.tex_coord, transform.as_ref()), unit(own.strength.0))
            }),
            emissive: source.emissive_texture.as_ref().map(reference),
        }
    }
}

/// KHR_texture_transform of a reference for which the `gltf` crate leaves it as JSON.
fn other_transform(others: Option<&Map<String, Value>>) -> Option<Transform> {
    serde_json::from_value(others?.get("KHR_texture_transform")?.clone()).ok()
}

fn reference(info: &json_texture::Info) -> Reference {
    let transform = info.extensions.as_ref().and_then(|ext| ext.texture_transform.as_ref());
    Reference { texture: info.index.value(), placement: placed(info.tex_coord, transform) }
}

fn placed(set: u32, transform: Option<&Transform>) -> TexturePlacement {
    let mut placement = TexturePlacement { set, ..TexturePlacement::default() };
    if let Some(transform) = transform {
        placement.set = transform.tex_coord.unwrap_or(placement.set);
        placement.offset = transform.offset.0;
        placement.rotation = transform.rotation.0;
        placement.scale = transform.scale.0;
    }
    placement
}

/// KHR_materials_pbrSpecularGlossiness, which the `gltf` crate leaves as JSON.
fn specular_glossiness(source: &material::Material) -> Option<Surface> {
    let extensions = source.extensions.as_ref()?;
    let model = extensions.others.get("KHR_materials_pbrSpecularGlossiness")?;
    let number = |value: &Value| value.as_f64().map(|value| value as f32);
    let numbers = |value: Option<&Value>| -> Option<Vec<f32>> {
        value?.as_array()?.iter().map(number).collect()
    };
    let base = numbers(model.get("diffuseFactor")).and_then(|base| base.try_into().ok());
    let specular = numbers(model.get("specularFactor")).and_then(|s| s.try_into().ok());
    let glossiness = model.get("glossinessFactor").and_then(number).unwrap_or(1.0);
    let texture = model.get("diffuseTexture").and_then(|info| {
        let info = serde_json::from_value::<json_texture::Info>(info.clone()).ok()?;
        Some(reference(&info))
    });
    Some(Surface {
        base: base.unwrap_or([1.0; 4]),
        texture,
        dielectric: specular.unwrap_or([1.0; 3]),
        grazing: 1.0,
        metallic: 0.0,
        roughness: 1.0 - unit(glossiness),
        map: None,
        transmission: 0.0,
        transmission_map: None,
        absorption: None,
    })
}

fn sampling(sampler: &json_texture::Sampler) -> ([Wrap; 2], Filter) {
    let wrap = |mode: Checked<WrappingMode>| match mode {
        Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
        Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
        _ => Wrap::Repeat,
    };
    let filter = match sampler.mag_filter {
        Some(Checked::Valid(MagFilter::Nearest)) => Filter::Nearest,
        _ => Filter::Linear,
    };
    ([wrap(sampler.wrap_s), wrap(sampler.wrap_t)], filter)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_follow_roughness() {
        assert_eq!(shininess(1.0), 1.0);
        assert_eq!(shininess(0.0), 512.0);
        assert!((shininess(0.5) - 30.0).abs() < 1e-3);
        assert!(shininess(f32::NAN) == 1.0);
    }
}
