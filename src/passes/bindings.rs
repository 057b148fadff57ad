//! The buffer behind every name that a shader binds.

use super::scratch::Scratch;
use super::uniforms::{DIGITS, GroupUniforms, SEGMENT_WINDOW, VIEWS_WINDOW};
use crate::gpu::bind::Binding;
use crate::gpu::buffer::Buffer;
use crate::residency::layout::{FEW_LIGHTS, GpuLight};
use crate::residency::{Lists, Residency, ResidentScene};

/// The places where names are looked up.
pub struct Names<'a> {
    pub scratch: &'a Scratch,
    pub residency: &'a Residency,
    pub scene: &'a ResidentScene,
    pub uniforms: &'a GroupUniforms,
    pub shadow_maps: Option<&'a Buffer>,
    /// The segment that a pass draws, if it draws one.
    pub segment: Option<usize>,
    /// The level of the pyramid that a pass makes, or the digit that it sorts by.
    pub level: usize,
    /// The window that translucent surfaces are drawn in, and the layer.
    pub window: (usize, usize),
}

impl<'a> Names<'a> {
    /// The buffer that a shader means by `name`, and its dynamic offset.
    pub fn find(&self, name: &str) -> Option<(Binding<'a>, u32)> {
        let Names { scratch, residency, scene, uniforms, segment, level, window, .. } = *self;
        let buffer: &Buffer = match name {
            "frames" => {
                let window = Binding::Window(scratch.uniforms.buffer(), VIEWS_WINDOW);
                return Some((window, uniforms.views));
            }
            "segment" => {
                let offset = *uniforms.segments.get(segment?)?;
                return Some((Binding::Window(scratch.uniforms.buffer(), SEGMENT_WINDOW), offset));
            }
            "level" => {
                let offset = *uniforms.levels.get(level)?;
                return Some((Binding::Window(scratch.uniforms.buffer(), SEGMENT_WINDOW), offset));
            }
            "window" => {
                let (_, layers) = uniforms.windows.get(window.0)?;
                let offset = *layers.get(window.1)?;
                return Some((Binding::Window(scratch.uniforms.buffer(), SEGMENT_WINDOW), offset));
            }
            "digit" => {
                let offset = *uniforms.digits.get(level)?;
                return Some((Binding::Window(scratch.uniforms.buffer(), SEGMENT_WINDOW), offset));
            }
            "few_lights" => {
                let window = u64::from(FEW_LIGHTS) * size_of::<GpuLight>() as u64;
                return Some((Binding::Window(&scene.lights, window), 0));
            }
            "visibility" => scratch.visibility.buffer(),
            "sums_0" => scratch.sums[0].buffer(),
            "sums_1" => scratch.sums[1].buffer(),
            "sums_2" => scratch.sums[2].buffer(),
            "sums_3" => scratch.sums[3].buffer(),
            "patches_0" => scratch.patches[0].buffer(),
            "patches_1" => scratch.patches[1].buffer(),
            "patches_2" => scratch.patches[2].buffer(),
            "patches_3" => scratch.patches[3].buffer(),
            "layers" => scratch.layers.buffer(),
            "paint_list" => scratch.paint_list.buffer(),
            "paint_records" => scratch.paint_records.buffer(),
            "paint_counts" => scratch.paint_counts.buffer(),
            "paint_sums" => scratch.paint_sums.buffer(),
            "paint_ends" => scratch.paint_ends.buffer(),
            "painted" => scratch.painted.buffer(),
            // Digits are sorted from one into the other, and back.
            "sort_from" => scratch.paint_keys[level % 2].buffer(),
            "sort_to" if self.segment.is_some() => scratch.paint_keys[0].buffer(),
            "sort_to" => scratch.paint_keys[(level + 1) % 2].buffer(),
            "sorted" => scratch.paint_keys[DIGITS as usize % 2].buffer(),
            "paint_order" => scratch.paint_keys[(DIGITS as usize + 1) % 2].buffer(),
            "paint_cursors" => scratch.paint_cursors.buffer(),
            "fragments" => scratch.fragments.buffer(),
            "covered" => scratch.covered.buffer(),
            "pixels" => scratch.pixels.buffer(),
            "colors" => scratch.colors.buffer(),
            "normals" => scratch.normals.buffer(),
            "mapped" => scratch.mapped.buffer(),
            "openness" => scratch.openness.buffer(),
            "exposed" => scratch.exposed.buffer(),
            "stats" => scratch.stats.buffer(),
            "placed" => scratch.placed.buffer(),
            "seen" => scratch.seen.buffer(),
            "ranks" => scratch.ranks.buffer(),
            "group_counts" => scratch.group_counts.buffer(),
            "slots" => scratch.slots.buffer(),
            "runs" => scratch.runs.buffer(),
            "dispatches" => scratch.dispatches.buffer(),
            "large" => scratch.large.buffer(),
            "depths" => scratch.depths.buffer(),
            "portions" => scratch.portions.buffer(),
            "turns" => scratch.turns.buffer(),
            "turn_slots" => scratch.turn_slots.buffer(),
            "pyramid" => scratch.pyramid.buffer(),
            "instances" => &scene.instances,
            "group_flags" => scratch.group_flags.buffer(),
            "listed" => scratch.listed.buffer(),
            "chosen" => scratch.chosen.buffer(),
            "chosen_first" => scratch.chosen_first.buffer(),
            "entries" | "segments" | "sizes" | "instance_groups" | "pieces" | "geometries" => {
                match (&scene.lists, name) {
                    (Lists::Full(full), "entries") => &full.entries,
                    (Lists::Full(full), "segments") => &full.segments,
                    (Lists::Full(full), "sizes") => &full.sizes,
                    (Lists::Trees(_), "entries") => scratch.entries.buffer(),
                    (Lists::Trees(_), "segments") => scratch.segments.buffer(),
                    (Lists::Trees(_), "sizes") => scratch.sizes.buffer(),
                    (Lists::Trees(trees), "instance_groups") => &trees.groups,
                    (Lists::Trees(trees), "pieces") => &trees.pieces,
                    (Lists::Trees(trees), "geometries") => &trees.geometries,
                    _ => return None,
                }
            }
            "shadow_maps" => self.shadow_maps?,
            "lights" => &scene.lights,
            "environment" => &scene.environment.as_ref()?.buffer,
            "fields" => &scene.field_table,
            // Shaders read no values of pages that have none.
            "values" => {
                residency.page_buffer(scene.pages[segment?], name).unwrap_or(&scene.field_table)
            }
            "chunks" => residency.chunk_table(),
            "parts" => residency.part_table(),
            "materials" => residency.material_table(),
            "textures" => residency.texture_table(),
            "texels_0" => residency.texel_page(0),
            "texels_1" => residency.texel_page(1),
            // The streams of the segment's page.
            _ => residency.page_buffer(scene.pages[segment?], name)?,
        };
        Some((Binding::Whole(buffer), 0))
    }
}
